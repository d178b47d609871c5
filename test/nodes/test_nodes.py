"""The nodes as real processes over DDS, each test in its own ROS domain, and the checks of one node's inputs."""

from __future__ import annotations

import importlib
import itertools
import math
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from inside import state
from live import SHORT, Live
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from dqwalk_ros.cli.runner import environment, private_domain, run_walk
from dqwalk_ros.config import load, to_yaml
from dqwalk_ros.nodes import command_line
from dqwalk_ros.nodes.command_line import parse
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.report import bag
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.simulation import simulate
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.node_table import NODES
from dqwalk_ros.support.topics import OPTIONAL, TOPICS
from dqwalk_ros.walks.table import make_controller

PAPER = load("paper")
MODEL = load_model(PAPER.robot)
NAMES, ZERO = MODEL.joint_names, np.zeros(MODEL.n)
LONG = {**SHORT, "task.eta": 0.3, "ssp.threshold": 1e-3}
"""Five times as many ticks as `SHORT`, so that a fast machine can be stopped in the middle."""


# ---------------------------------------------------------------------- lockstep


@pytest.mark.parametrize("walks", [1, pytest.param(2, marks=pytest.mark.long)])
def test_a_lockstep_walk_equals_that_of_one_process(tmp_path: Path, walks: int) -> None:
    """Every time, and with a complete bag."""
    config = PAPER.updated({**SHORT, "dt": 0.02, "dsp.eta_ground": 50.0})  # 317 ticks
    expected = simulate(make_controller(config, MODEL), KinematicPlant(MODEL))
    assert expected.finished
    for path in [tmp_path / str(k) / "bag" for k in range(walks)]:
        outcome = run_walk(config, path)
        assert outcome.finished, outcome.reason
        walked = bag.read(path)
        assert walked.finished
        n = len(expected.time)
        assert 0 <= len(walked.time) - n <= 1  # the plant steps once more, at zero velocity
        np.testing.assert_allclose(walked.q[:n], expected.q, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(walked.u[:n], expected.u, rtol=0.0, atol=1e-9)
        assert [(p.name, p.start) for p in walked.phases] == [(p.name, p.start) for p in expected.phases]
        for a, b in zip(walked.phases, expected.phases, strict=True):
            np.testing.assert_allclose(a.x_odom_base, b.x_odom_base, rtol=0.0, atol=1e-9)
        check_bag_is_complete(path, round(config.dt * 1e9))


def check_bag_is_complete(path: Path, period: int) -> None:
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    stamps: dict[str, list[int]] = {}
    judged = []
    with Reader(path) as reader:
        assert {connection.topic for connection in reader.connections} == {
            "/rosout",
            *(f"/{name}" for name, topic in TOPICS.items() if topic.source not in OPTIONAL),
            "/odom",
        }
        for connection, time, raw in reader.messages():
            message = store.deserialize_cdr(raw, connection.msgtype)
            if connection.topic in ("/joint_states", "/joint_velocity_commands", "/base_pose"):
                stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                assert stamp == time
                stamps.setdefault(connection.topic, []).append(stamp)
            elif connection.topic == "/diagnostics":
                judged += [s for s in message.status if s.name == "phase_monitor: walk" and s.values]
    assert len(judged) > 20
    assert all(status.level < 2 for status in judged), [status.message for status in judged if status.level > 1]
    for topic, found in stamps.items():
        assert found == [k * period for k in range(len(found))], topic
    assert len(stamps["/joint_velocity_commands"]) == len(stamps["/base_pose"]) == len(stamps["/joint_states"]) - 1


@pytest.mark.long
def test_a_bag_of_a_late_recorder_is_a_walk(nodes: Any, tmp_path: Path) -> None:
    one = nodes(PAPER.updated({**LONG, "plant.lockstep": True}))
    walk = [f"{kind}_support/{foot}" for foot in ("left", "right") for kind in ("double", "single")]
    one.start("integrator")
    one.start("controller")
    one.until_ready("controller/pause")  # during discovery, so that the call comes before the end of the walk
    one.until(lambda: "double_support/left" in one.phases(), 60.0, "the first phase")
    assert one.call("controller/pause").success
    one.until(lambda: one.phase == "paused", 10.0, "the pause")
    before_the_pause = [name for name in one.phases() if name in walk][-1]  # at least the first, see above
    ahead = walk[walk.index(before_the_pause) :]
    one.start("recorder", "--bag", str(tmp_path / "bag"))
    one.until_started("recorder")
    one.until(lambda: one.node.count_subscribers("joint_states") > 2, 60.0, "the recorder listening")
    one.spin(2.0)
    assert one.call("controller/start").success
    one.until(lambda: "finished" in one.phases(), 60.0, "the end of the walk")
    one.spin(1.0)
    one.processes.signal("recorder", signal.SIGINT)
    assert one.processes.wait("recorder", 20.0) == 0
    walked = bag.read(tmp_path / "bag")
    assert walked.finished
    assert [phase.name for phase in walked.phases][-len(ahead) :] == ahead
    assert walked.time[0] > 0.0


def at_rest(one: Live) -> bool:
    """Return whether nothing moves for 0.7 s; on a loaded machine some states still arrive at first."""
    before = one.last("joint_states")
    one.spin(0.7)
    after = one.last("joint_states")
    if before is None or after.position != before.position:
        return False
    return not one.config.plant.lockstep or after.header.stamp == before.header.stamp


@pytest.mark.long
def test_pause_stops_the_simulated_time_in_lockstep(nodes: Any) -> None:
    one = nodes(PAPER.updated({"plant.lockstep": True}))
    one.start("integrator")
    one.start("controller")
    one.until_ready("controller/pause")
    one.until(lambda: len(one.got["joint_states"]) > 200, 60.0, "walking")
    assert one.call("controller/pause").success
    one.until(lambda: one.phase == "paused", 10.0, "the pause")
    one.until(lambda: at_rest(one), 20.0, "time standing still")
    before = one.stamp()
    assert one.call("controller/start").success
    one.until(lambda: one.stamp() > before, 10.0, "going on")


# ---------------------------------------------------------------------- real time


def test_a_real_time_walk_follows_the_clock(nodes: Any) -> None:
    one = nodes(PAPER.updated({"dt": 0.02, "monitor.rate": 20.0}))  # a walk ends where most states are missed
    for name in ("integrator", "controller", "phase_monitor"):
        one.start(name)
    one.until(lambda: "double_support/left" in one.phases(), 60.0, "the first phase")
    count = len(one.got["joint_states"])
    one.until(lambda: len(one.got["joint_states"]) > count + 50, 60.0, "a second of states")
    one.until(lambda: one.speed_of() > 1e-3, 20.0, "motion")
    one.until(lambda: any(s.values for s in one.statuses("phase_monitor")), 20.0, "a status with values")
    watched = [s for s in one.statuses("phase_monitor") if s.values]
    keys = {pair.key for pair in watched[-1].values}
    assert {"phase", "error", "distance/tip_plane", "distance/back_plane", "margin/polygon"} <= keys
    assert all(s.level in (b"\x00", b"\x01") for s in watched), [s.message for s in watched if s.level == b"\x02"]
    one.processes.signal("controller", signal.SIGINT)
    assert one.processes.wait("controller", 15.0) == 0
    one.until(lambda: one.speed_of() == 0.0, 10.0, "a zero command at the end")
    one.until(lambda: at_rest(one), 20.0, "the robot standing still")
    for name in ("phase_monitor", "integrator"):
        one.processes.signal(name, signal.SIGINT)
        assert one.processes.wait(name, 15.0) == 0
    assert "Traceback" not in one.logs()


# ---------------------------------------------------------------------- one node, called directly


def test_services_start_pause_and_reset(make: Any) -> None:
    one = make("controller", PAPER.updated({"node.autostart": False}))
    plant, ticks = KinematicPlant(MODEL), itertools.count()

    def succeeds(service: str) -> bool:
        return bool(one.call(service, Trigger.Request()).success)

    def moves(phase: str) -> bool:
        """Send a few states; check the published phase, and return whether the last command moves the robot."""
        for _ in range(5):
            u = one.exchange(plant, MODEL, 1.0 + PAPER.dt * next(ticks))
        assert one.got["phase"][-1].data == phase
        return bool(u.any())

    assert not moves("idle")
    assert succeeds("start")
    assert moves("double_support/left")
    assert succeeds("pause")
    assert not moves("paused")
    assert succeeds("start")
    assert moves("double_support/left")
    assert succeeds("reset")
    assert not moves("idle")
    assert not succeeds("pause")
    assert succeeds("start")
    assert moves("double_support/left")
    began, answered = (
        [(msg.header.stamp.sec, msg.header.stamp.nanosec) for msg in one.got[topic]]
        for topic in ("phase_start", "joint_velocity_commands")
    )
    assert len(began) == 2
    assert set(began) <= set(answered)


INVALID_STATES = [
    (NAMES, np.where(np.arange(MODEL.n) == 3, np.nan, 0.0), (), f"not a finite position: {NAMES[3]}"),
    (NAMES, np.where(np.arange(MODEL.n) == 0, -np.inf, 0.0), (), f"not a finite position: {NAMES[0]}"),
    (NAMES[1:], ZERO[1:], (), f"joints missing: {NAMES[0]}"),
    (["wrong", *NAMES[1:]], ZERO, (), f"joints missing: {NAMES[0]}; it has wrong"),
    ([*NAMES, NAMES[2]], [*ZERO, 0.0], (), f"joints named twice: {NAMES[2]}"),
    (NAMES, ZERO[1:], (), "numbers in 'position'"),
    (NAMES, ZERO, ZERO[1:], "numbers in 'velocity'"),
    ([], [], (), "joints missing"),
]
"""Names, angles and velocities, and why they are rejected."""


def test_an_invalid_state_is_rejected_and_the_next_one_is_answered(make: Any) -> None:
    one = make("controller", PAPER.updated({"node.autostart": False}))
    answers, stamps = one.got["joint_velocity_commands"], itertools.count(1)

    def is_answered(names: Any, q: Any, dq: Any = ()) -> bool:
        before = len(answers)
        one.send("joint_states", state(names, q, 1.0 + PAPER.dt * next(stamps), velocity=dq))
        return len(answers) > before

    for names, q, dq, why in INVALID_STATES:
        one.node._diagnosed = -math.inf
        assert not is_answered(names, q, dq)
        status = one.got["diagnostics"][-1].status[0]
        assert status.level == b"\x02"
        assert why in status.message
        assert is_answered(NAMES, ZERO)
    assert "joint_states rejected" in one.log
    assert is_answered(NAMES[::-1], ZERO)
    assert is_answered([*NAMES, "head_z"], [*ZERO, 0.0])


@pytest.mark.parametrize("stamp", [0.0, 12.5])
def test_states_whose_stamps_do_not_advance_are_an_error_and_cause_no_walk(make: Any, stamp: float) -> None:
    one = make("controller", PAPER)
    commands = one.got["joint_velocity_commands"]
    for k in range(30):
        one.node._diagnosed = -math.inf
        one.send("joint_states", state(NAMES, ZERO, stamp))
        one.tick()
        if k > 15:
            status = one.got["diagnostics"][-1].status[0]
            assert status.level == b"\x02"
            assert f"joint_states rejected: they all have the stamp {stamp:g}: set header.stamp" in status.message
        if k == 20:
            one.node._gate.watchdog.starve()  # as after a timeout, when a smaller stamp is a clock set back
    assert len(commands) == 2  # the answer to the first state, and zero
    assert not any(commands[-1].velocity)
    assert "timed out" not in one.log
    one.send("joint_states", state(NAMES, ZERO, stamp + 0.005))
    assert len(commands) == 3


def test_an_invalid_command_causes_no_motion(make: Any) -> None:
    one = make("integrator", PAPER.updated({"plant.lockstep": True}))
    one.node.publish()
    states = one.got["joint_states"]
    one.send("joint_velocity_commands", state(NAMES, [], 0.0, velocity=ZERO + np.nan))
    assert "joint_velocity_commands rejected" in one.log
    one.send("joint_velocity_commands", state(NAMES, [], 7.0, velocity=ZERO + 1.0))  # not the stamp of the state
    assert len(states) == 1
    one.send("joint_velocity_commands", state(NAMES, [], 0.0, velocity=ZERO + 1.0))
    np.testing.assert_allclose(np.subtract(states[1].position, states[0].position), PAPER.dt, atol=1e-12)


def test_parameters_are_described_and_live_ones_can_be_set(make: Any) -> None:
    one = make("integrator", to_yaml(PAPER).replace("step_width: 0.0", "step_width: 0"))  # an integer for a float
    length, foot = one.node.describe_parameters(["gait.step_length", "gait.first_support"])
    assert "[m]" in length.description
    assert length.floating_point_range[0].to_value == 0.5
    assert length.read_only
    assert "left, right" in foot.additional_constraints

    def can_be_set(name: str, value: float) -> bool:
        return bool(one.node.set_parameters([Parameter(name, value=value)])[0].successful)

    assert can_be_set("plant.command_timeout", 0.2)
    assert not can_be_set("plant.command_timeout", -1.0)
    assert not can_be_set("gait.step_length", 0.01)


# ---------------------------------------------------------------------- start and end


SIGNALLED = ["controller", "integrator", "phase_monitor", "poppy_driver", "recorder"]
BY_DEFAULT = [("recorder", signal.SIGINT), ("integrator", signal.SIGTERM)]


@pytest.mark.parametrize(
    ("name", "number"),
    [
        pytest.param(name, number, marks=() if (name, number) in BY_DEFAULT else pytest.mark.long)
        for name in SIGNALLED
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    ],
)
def test_a_signal_ends_a_node_without_a_traceback(nodes: Any, name: str, number: signal.Signals) -> None:
    """Right after its start; the tests of live walks and of the Poppy driver end the others by SIGINT."""
    one = nodes(PAPER.updated({"dt": 0.02, "poppy.dummy": True} if name == "poppy_driver" else {}))
    one.start(name, *(["--bag", str(one.params.parent / "bag")] if name == "recorder" else []))
    one.until_started(name)
    one.processes.signal(name, number)
    assert one.processes.wait(name, 20.0) == 0, one.logs()
    assert "Traceback" not in one.processes.log(name)


def test_a_module_that_only_this_node_needs_is_named(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Such as the SDK of the servos, where only the package and ROS are installed."""
    monkeypatch.setitem(sys.modules, "dynamixel_sdk", None)
    monkeypatch.setenv("ROS_DOMAIN_ID", "103")
    assert command_line.main("poppy_driver", ["--ros-args", "-p", "poppy.dummy:=true", "-p", "dt:=0.02"]) == 2
    said = capfd.readouterr().err.splitlines()[-1]
    assert said.endswith("poppy_driver: the Python module 'dynamixel_sdk' is not installed: pip install dynamixel-sdk")


def test_an_interrupt_during_the_start_is_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """A compiled module that is being imported may swallow a KeyboardInterrupt, and the node would start."""
    handlers: list[Any] = []

    def imported(name: str) -> Any:
        handlers.append(signal.getsignal(signal.SIGINT))
        raise ConfigError("enough")

    monkeypatch.setattr(importlib, "import_module", imported)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert command_line.main("controller", []) == 2
    finally:
        signal.signal(signal.SIGINT, before)
    assert handlers == [signal.SIG_DFL]


def test_a_later_value_of_another_type_is_not_ignored(tmp_path: Path) -> None:
    """Which rcl does: of a whole number in a file and a fraction in the command line it keeps the first."""
    from dqwalk_ros.nodes.parameters import check_types

    first = tmp_path / "first.yaml"
    first.write_text("/**: {ros__parameters: {robot: {mass: 3}, dt: 0.005, gait: {walk: '1'}}}")
    files, names = ["--params-file", str(first), "-p", "robot.mass:=2.5"], ("controller", "/controller")
    kept = {"robot.mass": 3, "dt": 0.005, "gait.walk": "1"}
    context = rclpy.Context()
    rclpy.init(context=context, args=["", "--ros-args", *files])
    node = rclpy.create_node("controller", context=context, enable_rosout=False)
    assert {name: node._parameter_overrides[name].value for name in kept} == kept
    node.destroy_node()
    context.shutdown()
    with pytest.raises(
        ConfigError, match=r"'robot.mass' is 3 and later 2.5, .* would be ignored by ROS: write numbers"
    ):
        check_types(kept, files, names)
    with pytest.raises(ConfigError, match="later abc"):
        check_types(kept, ["--params-file", str(first), "-p", "dt:=abc"], names)
    check_types(kept, ["-p", "robot.mass:=2.5", "--params-file", str(first), "-p", "drive:dt:=abc"], names)
    check_types({"dt": 0.01, "gait.step_length": 1e30}, ["-p", "dt:=0.01", "-p", "gait.step_length:=1e30"], names)


@pytest.mark.parametrize(
    ("name", "body", "expected"),
    [
        ("controller", "gait: {step_lenght: 0.04}", "did you mean 'gait.step_length'"),
        ("drive", "output: {topic: 'a b'}", "drive: Invalid topic name"),
    ],
)
def test_invalid_parameters_end_a_node_with_exit_code_2(tmp_path: Path, name: str, body: str, expected: str) -> None:
    file = tmp_path / "params.yaml"
    file.write_text(f"/**: {{ros__parameters: {{{body}}}}}")
    with private_domain() as domain:
        done = subprocess.run(
            [sys.executable, "-m", "dqwalk_ros.nodes", name, "--ros-args", "--params-file", str(file)],
            env=environment(domain),
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    assert done.returncode == 2, done.stderr
    assert expected in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(("folder", "why"), [("", "it is empty"), ("~/walk", "no shell has replaced the '~'")])
def test_a_recording_is_made_where_it_was_meant(folder: str, why: str, capsys: pytest.CaptureFixture[str]) -> None:
    """No shell replaces the '~' of ``bag:=~/walk``, nor does launch."""
    with pytest.raises(SystemExit, match="2"):
        parse("recorder", ["--bag", folder])
    assert f"argument --bag: '{folder}': {why}" in capsys.readouterr().err


def test_help_of_every_node_works_without_ros() -> None:
    code = (
        "import sys; sys.modules['rclpy'] = None\n"
        "from dqwalk_ros.nodes.command_line import NODES, script\n"
        "for name in NODES:\n"
        "    sys.argv = [f'bin/dqwalk_{name}', '--help']\n"
        "    try: script()\n"
        "    except SystemExit as end: print(f'exit code {end.code}', end='\\f')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    for name, shown in zip(NODES, done.stdout.split("\f")[:-1], strict=True):
        for word in ("Subscribes to", "Example:", f"dqwalk_{name}", f"ros2 run dqwalk_ros {name}", "joint_"):
            assert word in shown
        assert shown.endswith("exit code 0")
