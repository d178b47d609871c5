"""The runner of a walk in several processes: it stops all of them and reports why a walk failed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import psutil
import pytest
from live import SHORT

from dqwalk_ros import cli
from dqwalk_ros.cli.runner import Processes, _Progress, _recording_error, environment, private_domain, run_walk
from dqwalk_ros.config import load
from dqwalk_ros.report import bag
from dqwalk_ros.support.compiled import COMPILING
from dqwalk_ros.support.errors import BagError


def children() -> list[psutil.Process]:
    return [p for p in psutil.Process().children(recursive=True) if "dqwalk_ros.nodes" in " ".join(p.cmdline())]


@pytest.mark.long
def test_a_step_that_is_too_long_ends_with_the_reason(tmp_path: Path) -> None:
    own = {"dt": 0.02, "dsp.eta_ground": 40.0, "gait.step_length": 0.3, "gait.phase_timeout": 5.0}
    config = load("paper").updated(SHORT | own)
    outcome = run_walk(config, tmp_path / "bag")
    assert not outcome.finished
    assert "single_support/left" in outcome.reason
    assert "com_cylinder" in outcome.reason
    assert outcome.ticks > 10
    assert not children()
    walked = bag.read(tmp_path / "bag")  # with the walk until then
    assert not walked.finished
    assert len(walked.time) >= outcome.ticks


def test_a_walk_that_does_not_begin_can_be_tried_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As without a robot at the ports: it is plugged in, and the same line typed again."""
    words = ["walk", "--plant", "poppy", "--config", "poppy", "--set", "poppy.motors=nowhere", "--out", str(tmp_path)]
    for _ in range(2):
        assert cli.main([*words, "--quiet"]) == 1
        assert "poppy_driver: no table of motors 'nowhere'" in capsys.readouterr().err
    assert [file.name for file in tmp_path.iterdir()] == ["log"]
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag/precious").write_text("data")
    assert "exists already" in str(run_walk(load("poppy"), tmp_path / "bag"))
    assert (tmp_path / "bag/precious").exists()


def test_the_progress_of_an_exercise_is_its_time(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """It has one phase of five minutes, of which the bar said 0 %."""
    asked: dict[str, Any] = {}

    def run(*_: Any, **keywords: Any) -> SimpleNamespace:
        asked.update(keywords)
        return SimpleNamespace(finished=True)

    monkeypatch.setattr("dqwalk_ros.cli.runner.run_walk", run)
    few = "robot.lock=['*_z', '*_x', '*_arm_*', '*_shoulder_*', '*_elbow_*', 'abs_*', 'bust_*', 'head_*']"
    assert cli.main(["exercise", "--plant", "poppy", "--set", few, "--out", str(tmp_path)]) == 0
    assert asked["duration"] == pytest.approx(65.0)
    shown: list[tuple[float, str]] = []
    now = {"time": 13.0, "phase_index": 0, "ticks": 650, "phase": "stance/left", "error": 0.1}
    processes: Any = SimpleNamespace(reports={"controller": now})
    walk = _Progress(load("poppy"), processes, "poppy_driver", asked["duration"], lambda *text: shown.append(text))
    walk.update()
    walk.show()
    assert shown[0][0] == pytest.approx(0.2)


def test_an_existing_bag_is_not_changed(make: Any, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "precious").write_text("data")
    with pytest.raises(BagError, match="exists already"):
        make("recorder", load("paper"), "--bag", str(tmp_path / "bag"))
    assert [file.name for file in (tmp_path / "bag").iterdir()] == ["precious"]


@pytest.mark.parametrize(
    ("log", "code", "expected"),
    [
        ("[INFO] [1.0] [recorder]: recording to x\n", -9, "recorder was killed by SIGKILL"),
        ("[WARN] [1.0] [recorder]: slow\n", -15, "recorder was killed by SIGTERM: [WARN] [1.0] [recorder]: slow"),
        ("[ERROR] [1.0]: full\n[INFO] x\n", -6, "recorder was killed by SIGABRT: [ERROR] [1.0]: full"),
        ("", -40, "recorder was killed by signal 40"),
        ("", -11, "recorder was killed by SIGSEGV"),
        ("[INFO] recording\nno space\n", 1, "recorder ended (1): no space"),
    ],
)
def test_the_end_of_a_node_is_named_by_its_signal(tmp_path: Path, log: str, code: int, expected: str) -> None:
    (tmp_path / "recorder.log").write_text(log)
    assert Processes(tmp_path).end_of("recorder", code) == expected


@pytest.mark.parametrize(
    ("target", "lockstep"),
    [  # in lockstep the other nodes wait 12 s for the acknowledgements of the killed one
        ("controller", False),
        *(pytest.param(name, True, marks=pytest.mark.long) for name in ("controller", "integrator", "phase_monitor")),
    ],
)
def test_a_killed_node_ends_the_walk_unless_it_is_the_monitor(tmp_path: Path, target: str, lockstep: bool) -> None:
    """The monitor is not in the control loop."""
    killed = False

    def kill(fraction: float, text: str) -> None:
        nonlocal killed
        if not killed and "support" in text:
            for process in children():
                if process.cmdline()[3] == target:
                    process.kill()
                    killed = True

    in_the_loop = target != "phase_monitor"  # a fast machine must not finish before the kill
    config = load("paper").updated({**SHORT, "task.eta": 0.3, "ssp.threshold": 1e-3} if in_the_loop else SHORT)
    if not lockstep:  # a busy machine must not miss so many states that the walk ends
        config = config.updated({"dt": 0.02, "dsp.eta_ground": 40.0})
    outcome = run_walk(config, tmp_path / "bag", progress=kill, lockstep=lockstep)
    assert killed
    assert outcome.finished is not in_the_loop
    if not outcome.finished:
        assert outcome.reason.startswith(f"{target} was killed by SIGKILL")
        assert "[INFO]" not in outcome.reason
    assert not children()


@pytest.mark.parametrize("number", [pytest.param(signal.SIGINT, marks=pytest.mark.long), signal.SIGKILL])
def test_no_node_remains_when_the_runner_has_ended(tmp_path: Path, number: signal.Signals) -> None:
    code = (
        "import json, sys\n"
        "from dqwalk_ros.config import load\n"
        "from dqwalk_ros.cli.runner import run_walk\n"
        "show = lambda fraction, text: print(json.dumps(text), flush=True)\n"
        f"out = run_walk(load('paper').updated({SHORT!r}), sys.argv[1], progress=show)\n"
        "print(json.dumps('reason ' + out.reason), flush=True)\n"
    )
    with private_domain() as domain:
        runner = subprocess.Popen(
            [sys.executable, "-c", code, str(tmp_path / "bag")],
            env=environment(domain),
            stdout=subprocess.PIPE,
            text=True,
        )
        assert runner.stdout is not None
        for line in runner.stdout:
            if "support" in json.loads(line):
                break
        nodes = psutil.Process(runner.pid).children(recursive=True)
        assert len(nodes) == 4
        os.kill(runner.pid, number)
        rest = runner.stdout.read()
        runner.wait(60)
        deadline = time.monotonic() + 60.0  # in lockstep a node waits 12 s for acknowledgements of those that are gone
        while any(node.is_running() and node.status() != psutil.STATUS_ZOMBIE for node in nodes):
            assert time.monotonic() < deadline, [node.cmdline() for node in nodes if node.is_running()]
            time.sleep(0.1)
    if number is not signal.SIGKILL:
        assert f"reason interrupted by {number.name}" in rest
    assert len(bag.read(tmp_path / "bag")) > 0


@pytest.mark.long
def test_progress_is_shown_and_a_suspended_recorder_loses_no_messages(tmp_path: Path) -> None:
    held: list[threading.Timer] = []
    shown: list[tuple[float, str]] = []

    def hold(fraction: float, text: str) -> None:
        shown.append((fraction, text))
        if not held and "support" in text:
            nodes = children()
            for node in nodes:  # a suspended receiver can break the middleware's transport through shared memory
                assert "/dev/shm/fastrtps" not in Path(f"/proc/{node.pid}/maps").read_text()
            recorder = next(node for node in nodes if node.cmdline()[3] == "recorder")
            recorder.suspend()
            held.append(threading.Timer(1.5, recorder.resume))
            held[0].start()

    outcome = run_walk(load("paper").updated(SHORT), tmp_path / "bag", progress=hold)
    assert held
    assert outcome.finished, outcome.reason + (tmp_path / "log" / "recorder.log").read_text()
    assert "lockstep: true" in (tmp_path / "log" / "params.yaml").read_text()
    walked = bag.read(tmp_path / "bag")
    assert len(walked) >= outcome.ticks
    assert len(walked.phases) == 4
    assert not walked.notes
    assert any("double_support/left" in text and "ticks/s" in text for _, text in shown)
    fractions = [fraction for fraction, _ in shown]
    assert min(fractions) >= 0.0
    assert max(fractions) > 0.5


def test_nodes_in_a_domain_of_their_own_need_no_discovery_server(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it did not answer, no node heard another, and the walk waited for three minutes."""
    monkeypatch.setenv("ROS_DISCOVERY_SERVER", "10.255.255.1:11811")
    assert "ROS_DISCOVERY_SERVER" not in environment(7)
    assert environment(None)["ROS_DISCOVERY_SERVER"] == "10.255.255.1:11811"


def test_a_bag_without_the_end_of_the_walk_is_incomplete() -> None:
    """Without a later message of the topic the recorder sees no gap."""
    counts = {"joint_states": 1268, "joint_velocity_commands": 2}
    processes = SimpleNamespace(reports={"recorder": {"missing": {}, "counts": counts}}, exit_code=lambda _: 0)
    error = _recording_error(processes, True, 1267)
    assert error == "the bag is incomplete: 1265 of joint_velocity_commands are missing"
    assert not _recording_error(processes, False, 1267)
    counts["joint_velocity_commands"] = 1267
    assert not _recording_error(processes, True, 1267)
    processes.exit_code, processes.last_error = lambda _: 1, lambda _: "cannot write 'bag': [Errno 27] File too large"
    for lockstep in (True, False):
        assert _recording_error(processes, lockstep, 1267).endswith("cannot write 'bag': [Errno 27] File too large")


@pytest.mark.long
def test_an_exercise_that_failed_is_not_to_be_identified(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = ["exercise", "--plant", "poppy", "--set", f"poppy.lower_port={tmp_path}/nothing", "--out", str(tmp_path)]
    assert cli.main(robot) == 1
    output = capsys.readouterr()
    assert "the lower bus cannot be opened" in output.err
    assert not children()
    assert "next:" not in output.out


@pytest.mark.long
def test_the_first_start_on_a_machine_says_that_it_compiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Said(Exception):
        pass

    def progress(fraction: float, text: str) -> None:
        if text.startswith(COMPILING):
            raise Said
        assert "phase" not in text

    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with pytest.raises(Said):
        run_walk(load("paper").updated(SHORT), tmp_path / "bag", progress=progress)
    assert not children()


def test_private_domains_are_not_shared() -> None:
    with private_domain() as one, private_domain() as two:
        assert one != two
        assert 1 <= one <= 101
