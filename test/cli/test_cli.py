"""The command line: help, results and exit codes."""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import logging
import os
import re
import signal
import subprocess
import sys
import termios
import time
from pathlib import Path

import click
import pytest
from recorded import SHORT, short_walk

from dqwalk_ros import __version__, cli
from dqwalk_ros.cli.options import config_of, parse_overrides
from dqwalk_ros.cli.progress import Progress
from dqwalk_ros.config import SHIPPED, Config, from_yaml, load
from dqwalk_ros.report import bag
from dqwalk_ros.report.figures.style import new_figure
from dqwalk_ros.report.viewer import player
from dqwalk_ros.support.errors import ConfigError

FAST = [word for key, value in SHORT.items() for word in ("--set", f"{key}={value}")]


ROOT = Path(__file__).parents[2]
HERE = {
    **os.environ,
    "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
}


def is_one_line(text):
    """Return whether a text is one line that starts with the name of the program, without traceback."""
    return text.startswith("dqwalk: ") and text.count("\n") == 1 and "Traceback" not in text


# ---------------------------------------------------------------------- help


@pytest.mark.parametrize("command", [[], ["simulate"], ["walk"], ["report"], ["config"]])
def test_help_contains_examples(command, capsys):
    assert cli.main([*command, "--help"]) == 0
    shown = capsys.readouterr().out
    assert "examples:" in shown
    assert shown.count(f"dqwalk {' '.join(command)}".strip()) > 3
    assert max(map(len, shown.splitlines())) <= 120


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], "dqwalk --help"),
        (["fly"], "'fly'; the commands are simulate"),
        (["simulate", "--cycles", "many"], "'many' is not a valid integer"),
        (["simulate", "--cycels", "1"], "'--cycles'"),
        (["simulate", "--out", ""], "Invalid value for '--out': it is empty"),
        (["simulate", "--out=~/walk"], "'~/walk': no shell has replaced the '~'; write the whole path"),
        (["adopt", "r.urdf", "--package-path", "nowhere"], "Directory 'nowhere' does not exist"),
        (["report"], "Missing argument 'BAG'; `dqwalk report --help`"),
        (["pushes", "--bottle"], "requires an argument; `dqwalk pushes --help`"),
        (["identify", "bag", "--mass", "3kg"], "'3kg' is not a valid number"),
        (["simulate", "--params", "none.yaml"], "no parameter file 'none.yaml'"),
        (["doctor", "--controllers", "c.yaml"], "--controllers is of a robot with --plant ros2_control, not poppy"),
        (["doctor", "--offline", "--by-hand"], "--by-hand listens to the robot, which --offline does not"),
        (
            ["doctor", "--offline", "--plant", "ros2_control", "--controllers", "none.yaml"],
            "cannot read 'none.yaml': No such file or directory\n",
        ),
        (["simulate", "--format", "gif"], "png, pdf or svg"),
        (["movie", "bag", "--between", "1,2,3"], "2 numbers"),
        (["movie", "bag", "--between", "5,2"], "in their order"),
        (["reach", "--duration", "-1"], "-1.0 is not in the range"),
        (["robustness", "--config", "paper"], "needs a standing or a dynamic walk; gait.style of 'paper'"),
        (["robustness", "--axis", "latency_error=nan"], "KEY=NUMBER"),
        (["robustness", "--axis", "latency_error=1e300"], "servo.assumed_latency"),
    ],
)
def test_wrong_arguments_give_one_line_and_exit_code_2(arguments, expected, capsys):
    assert cli.main(arguments) == 2
    output = capsys.readouterr().err
    assert is_one_line(output), output
    assert expected in output


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_no_option_takes_what_is_not_a_finite_number(command, capsys):
    with click.Context(cli.dqwalk) as context:
        options = cli.dqwalk.get_command(context, command).params
    for option in (one for one in options if isinstance(one.type, click.types.FloatParamType)):
        for text in ("nan", "inf", "-inf"):
            assert cli.main([command, "bag", f"{option.opts[0]}={text}"]) == 2
            output = capsys.readouterr().err
            assert is_one_line(output), output
            assert f"Invalid value for '{option.opts[0]}'" in output


def test_a_question_that_nobody_answers_ends_without_traceback(capsys, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    monkeypatch.setattr(cli.dqwalk, "invoke", lambda _: click.confirm("continue?", abort=True))
    assert cli.main(["version"]) == 1
    assert is_one_line(capsys.readouterr().err.lstrip())


def test_error_messages_contain_no_control_characters(capsys):
    assert cli.main(["config", "\x1b[31mred\n.yaml"]) == 2
    assert capsys.readouterr().err == "dqwalk: no configuration '\\x1b[31mred\\n.yaml'\n"


def test_version(capsys):
    assert cli.main(["version"]) == 0
    out = capsys.readouterr().out
    assert {"dqwalk_ros", "python", "numpy", "system"} <= {line.split()[0] for line in out.splitlines()}
    assert __version__ in out


# ---------------------------------------------------------------------- config


def test_config_lists_every_parameter(capsys):
    assert cli.main(["config"]) == 0
    out = capsys.readouterr().out
    for spec in Config.specs():
        assert f"{spec.name} " in out
    assert "a number in [0.0001, 1]" in out
    assert "one of left, right" in out


OWN = """
/**:
  ros__parameters:
    dt: 0.01
    robot: {urdf: poppy.urdf, lock: ["head_*", "?_shoulder_*", "?_arm_*", "?_elbow_*"], mass: 3.0}
    gait: {style: standing, steps: 4}
    servo: {assumed_latency: 0.012}
    monitor: {tolerance: 0.1}
"""


def test_what_the_file_of_the_plant_replaces_is_said_once(tmp_path, capsys):
    own, kept = tmp_path / "own.yaml", tmp_path / "kept.yaml"
    own.write_text(OWN)
    made = config_of(str(own), plant="poppy_as_built")
    assert (made.dt, made.servo.assumed_latency, made.monitor.tolerance) == (0.02, 0.04, 0.005)
    assert capsys.readouterr().err == (
        "dqwalk: config/plants/poppy_as_built.yaml replaces values of the configuration: dt 0.01 by 0.02, "
        "robot.mass 3.0 by 3.2, servo.assumed_latency 0.012 by 0.04; to keep one: --params FILE or --set KEY=VALUE, "
        "which are applied last\n"
    )
    kept.write_text("/**: {ros__parameters: {servo: {assumed_latency: 0.012}, robot: {mass: 3.0}}}")
    made = config_of(str(own), ["dt=0.01"], plant="poppy_as_built", params=[kept])
    assert (made.dt, made.robot.mass, made.servo.assumed_latency) == (0.01, 3.0, 0.012)
    assert not capsys.readouterr().err


@pytest.mark.parametrize("plant", ["integrator", "physics", "poppy_as_built", "ros2_control", "poppy"])
def test_nothing_is_said_of_a_shipped_configuration(capsys, plant):
    for name in set(SHIPPED) - {"whole_body"}:  # which does not walk
        config_of(name, plant=plant)
    assert not capsys.readouterr().err


@pytest.mark.parametrize("command", ["doctor", "pushes", "exercise"])
def test_parameter_files_are_read_by_every_command_with_a_plant(command, tmp_path, capsys):
    params = tmp_path / "params.yaml"
    params.write_text("/**: {ros__parameters: {gait: {stride: 1.0}}}")
    assert cli.main([command, "--params", str(params)]) == 2
    assert "unknown parameter 'gait.stride'" in capsys.readouterr().err


def test_doctor_has_params(tmp_path, capsys):
    """The file of `dqwalk identify` applies to the check as to the walk."""
    params = tmp_path / "params.yaml"
    params.write_text("/**: {ros__parameters: {robot: {left_sole: r_sole, right_sole: l_sole}}}")
    words = ["doctor", "--offline", "--plant", "ros2_control"]
    assert cli.main(words) == 0
    assert cli.main([*words, "--params", str(params)]) == 1
    assert cli.main([*words, "--params", str(tmp_path / "none.yaml")]) == 2
    assert "no parameter file" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["config"], ["config", "--params"], ["adopt", "--yes", "--no-walk"]])
def test_a_pipe_is_not_called_missing_or_damaged(tmp_path, capsys, words):
    """As of `<(xacro robot.xacro)` in a shell: it exists, but can be read only once."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    assert cli.main([*words, str(pipe), *(["paper"] if "--params" in words else [])]) == 2
    assert capsys.readouterr().err == f"dqwalk: '{pipe}' is a pipe or a device: write its content into a file\n"


def test_config_of_one_section(capsys):
    assert cli.main(["config", "--section", "ssp"]) == 0
    out = capsys.readouterr().out
    assert "ssp.com_radius" in out
    assert "dsp." not in out
    assert cli.main(["config", "--section", "legs"]) == 2


def test_the_output_of_config_can_be_loaded(capsys, tmp_path):
    assert cli.main(["config", "paper", "--set", "gait.step_length=0.04"]) == 0
    text = capsys.readouterr().out
    assert from_yaml(text) == load("paper").updated({"gait.step_length": 0.04})
    (tmp_path / "mine.yaml").write_text(text)
    assert cli.main(["config", str(tmp_path / "mine.yaml"), "--check"]) == 0
    assert "can be used" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["config", "nowhere.yaml"], "nowhere.yaml"),
        (["config", "popy"], "one of paper, poppy, poppy_dynamic, poppy_dynamic_50hz, whole_body"),
        (["config", "paper", "--section", "gait"], "leave out CONFIG"),
        (["simulate", "--cmd-vel", "0.1,0,0,5"], "gait.steps=0"),
        (["walk", "--config", "poppy", "--set", "gait.steps=4", "--cmd-vel", "0.1,0,0,5"], "gait.steps=0"),
        (["walk", "--config", "poppy", "--set", "gait.steps=0"], "add --cmd-vel, or set ROS_DOMAIN_ID"),
        (["config", "paper", "--set", "ssp.com_radios=0.04"], "did you mean 'ssp.com_radius'"),
        (["config", "paper", "--set", "ssp.com_radius"], "KEY=VALUE"),
        (["config", "paper", "--set", "gait.walk=\udcff"], "not a text in UTF-8"),
        (["config", "--check"], "--check is about a configuration; name it"),
        (["report", ""], "Invalid value for 'BAG': it is empty"),
        (["config", "paper", "--params", ""], "Invalid value for '--params': it is empty"),
        (["config", "poppy", "--check", "--set", "collision.pairs=[shin=r_shin]"], "no link 'shin'"),
        (["config", "paper", "--check", "--set", "collision.pairs=[a=b]"], "no link 'a'"),
        (["config", "poppy", "--check", "--set", "gait.walk=nowhere:Walk"], "No module named 'nowhere'"),
        (["config", "poppy", "--check", "--set", "servo.types=['*=NOPE']"], "servo.types names 'NOPE'"),
        (["config", "poppy", "--check", "--set", "gait.footsteps=['nan,0,0']"], "gait.footsteps"),
        (["config", "poppy", "--check", "--set", "standing.posture=[l_knee_y=nan]"], "must be JOINT=RADIANS"),
        (["doctor", "--offline", "--plant", "ros2_control", "--set", "servo.types=['*=NOPE']"], "names 'NOPE'"),
        (["config", "--set", "nothing=1"], "unknown parameter"),
        (["config", "paper", "--set", f"gait.cycles={'9' * 6000}"], "--set gait.cycles: not YAML"),
        (["simulate", "--cycles", "0"], "gait.cycles"),
        (["simulate", "--set", "robot.urdf=nowhere.urdf"], "nowhere.urdf"),
        (["simulate", "--set", "robot.right_sole=l_sole"], "no joint moves the soles"),
        (["simulate", "--set", "gait.walk=dqwalk_ros.paper.walk"], "'dqwalk_ros.paper.walk'; it must be MODULE:CLASS"),
        (
            ["config", "paper", "--check", "--set", "gait.walk=dqwalk_ros.paper.walk:Walk"],
            "not define both_feet, describe",
        ),
        (["simulate", "--config", "whole_body"], "whole-body controller: dqwalk reach --config CONFIG"),
        (["reach", "--config", "paper"], "'paper' is not a configuration of the whole-body controller"),
        (["robustness", "--steps", "0"], "the walk has no end"),
        (["study", str(ROOT / "config/paper.yaml")], "paper.yaml: this is a configuration, not a study"),
    ],
)
def test_an_invalid_configuration_gives_one_line_and_exit_code_2(arguments, expected, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    assert cli.main(arguments) == 2
    output = capsys.readouterr().err
    assert is_one_line(output), output
    assert expected in output
    assert list(tmp_path.iterdir()) == []


def test_a_walk_without_a_first_command_cannot_be_used(capsys):
    assert cli.main(["config", "paper", "--check", "--set", "pelvis.height=2.0"]) == 1
    output = capsys.readouterr()
    assert "pelvis is short by" in output.err
    assert "can be used" not in output.out


@pytest.mark.parametrize(
    ("config", "change", "code", "expected"),
    [
        ("paper", "robot.pelvis=l_sole", 2, "robot.pelvis is 'l_sole', which is part of a leg: 0 joints move it"),
        ("poppy_dynamic", "robot.pelvis=l_hip", 2, "4 joints move it against the left sole, 6 against the right one"),
        ("poppy_dynamic", "robot.left_sole_rpy=[3.14159,0,0]", 1, "the pelvis is below the soles: they are upside"),
        (
            "poppy_dynamic",
            "robot.left_sole_xyz=[0,0.3,0]",
            1,
            "the centre of the left sole is 275 mm beside the shapes",
        ),
        ("poppy_dynamic", "robot.sole_length=0.001", 1, "a sole has a side of 1 mm"),
        ("poppy_dynamic", 'robot.payload=["l_hand=30"]', 1, "N m to stand on one foot; its limit is 2.51 N m"),
        ("poppy_dynamic", 'robot.payload=["l_hand=1"]', 1, "to the left of the middle of the soles; a walk stands up"),
    ],
)
def test_a_configuration_that_contradicts_its_robot_cannot_be_used(config, change, code, expected, capsys):
    assert cli.main(["config", config, "--check", "--set", change]) == code
    output = capsys.readouterr()
    assert expected in output.err + output.out
    assert "can be used" not in output.out


def test_overrides_are_read_as_yaml():
    values = parse_overrides(["a.b=1", "c=1e-3", "d=true", "e=[x, z]", "f=left", "g=k=v", "h=0.5", "i="])
    assert values == {"a.b": 1, "c": 1e-3, "d": True, "e": ["x", "z"], "f": "left", "g": "k=v", "h": 0.5, "i": ""}
    with pytest.raises(ConfigError):
        parse_overrides(["=1"])
    with pytest.raises(ConfigError):
        parse_overrides(["a=[1"])


# ---------------------------------------------------------------------- simulate and report


def leaves(report, name=""):
    """Return the leaves of a report by their paths."""
    if isinstance(report, dict | list):
        items = report.items() if isinstance(report, dict) else enumerate(report)
        return {key: value for k, v in items for key, value in leaves(v, f"{name}/{k}").items()}
    return {name: report}


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    """Output folder and output of a complete cycle simulated by the command line."""
    out, shown = tmp_path_factory.mktemp("cli") / "walk", io.StringIO()
    with contextlib.redirect_stdout(shown):
        assert cli.main(["simulate", *FAST, "--cycles", "1", "--first", "right", "--out", str(out)]) == 0
    return out, shown.getvalue()


def test_a_walk_that_exists_is_refused_before_a_page_is_shown(walked, monkeypatch, capsys):
    monkeypatch.setattr(player, "Feed", lambda *_: pytest.fail("it is shown"))
    assert cli.main(["simulate", "--view", "--out", str(walked[0])]) == 1
    assert "exists already; choose another --out" in capsys.readouterr().err


def test_a_current_folder_that_was_removed_is_named(walked, tmp_path, capsys, monkeypatch):
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert cli.main(["report", str(walked[0] / "bag"), "--out", "here", "--no-figures"]) == 1
    assert "the current folder was removed" in capsys.readouterr().err


def test_simulate_writes_bag_report_and_figures(walked):
    out, shown = walked
    names = {"bag", "report.json", "figure7.png", "figure8.png", "figure9.png", "top_view.png"}
    assert {path.name for path in out.iterdir()} == names
    report = json.loads((out / "report.json").read_text())
    assert report["ok"] is True
    assert min((out / name).stat().st_size for name in names if name.endswith("png")) > 20_000
    assert report["walk"]["steps"] == 2
    assert [phase["name"] for phase in report["phases"]] == [
        "double_support/right",
        "single_support/right",
        "double_support/left",
        "single_support/left",
    ]
    assert "OK: every constraint was kept" in shown
    assert str(out / "figure7.png") in shown
    assert report["config"]["task.eta"] == 0.4


def test_report_of_the_bag_equals_the_report_of_simulate(walked, tmp_path, capsys):
    out, _ = walked
    assert cli.main(["report", str(out / "bag"), "--out", str(tmp_path), "--json", "--no-figures", "--quiet"]) == 0
    report = json.loads(capsys.readouterr().out)
    before = json.loads((out / "report.json").read_text())
    for one in (report, before):
        one.pop("solve_time")  # not stored in a bag
    assert leaves(report) == pytest.approx(leaves(before), abs=1e-9)
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"]


def test_report_is_written_beside_the_bag_in_every_format(walked, capsys, monkeypatch):
    out, _ = walked
    monkeypatch.setattr("dqwalk_ros.report.figures.FIGURES", {"figure8": (lambda series: new_figure(2.0, 1.0), "")})
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)  # progress is shown on terminals only
    assert cli.main(["report", str(out / "bag"), "--format", "svg,pdf"]) == 0
    assert re.search("reading.*computing.*drawing", capsys.readouterr().err, re.DOTALL)
    assert {path.suffix for path in (out / "bag_report").iterdir()} == {".json", ".svg", ".pdf"}


def test_an_earlier_walk_is_not_overwritten_without_force(walked, capsys):
    out, _ = walked
    before = (out / "bag/metadata.yaml").read_text()
    assert cli.main(["simulate", *FAST, "--out", str(out)]) == 1
    output = capsys.readouterr().err
    assert is_one_line(output)
    assert "--force" in output
    assert (out / "bag/metadata.yaml").read_text() == before


@pytest.mark.parametrize(
    ("name", "expected"),
    [("env.sh", "dqwalk: 'env.sh' is a file, not a folder\n"), ("env.sh/walk", "'env.sh/walk': Not a directory\n")],
)
def test_a_folder_that_cannot_be_created_is_an_error_without_number(name, expected, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("env.sh").touch()
    assert cli.main(["simulate", *FAST, "--out", name]) == 1
    error = capsys.readouterr().err
    assert is_one_line(error)
    assert error.endswith(expected)


def test_force_replaces_bags_only(tmp_path):
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag/thesis.tex").touch()
    assert cli.main(["simulate", *FAST, "--out", str(tmp_path), "--force", "--quiet"]) == 1
    assert (tmp_path / "bag/thesis.tex").exists()


def test_a_violated_constraint_gives_exit_code_1_and_the_reason(tmp_path, capsys):
    import dataclasses

    trace = short_walk()
    q = trace.q.copy()
    q[100, trace.model.joint_names.index("l_knee_y")] = -1.0
    bag.write(dataclasses.replace(trace, q=q), tmp_path / "b")
    assert cli.main(["report", str(tmp_path / "b"), "--no-figures"]) == 1
    shown = capsys.readouterr().out
    assert "NOT OK" in shown
    assert "l_knee_y" in shown


def test_the_folder_of_results_is_not_a_bag_but_contains_it(walked, capsys):
    out, _ = walked
    assert cli.main(["report", str(out)]) == 1
    assert f"did you mean '{out}/bag'?" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["report", "--out", "x"], ["movie", "--out", "x.gif"]])
def test_no_result_is_written_into_a_bag(walked, capsys, words):
    out, _ = walked
    command, option, name = words
    assert cli.main([command, str(out / "bag"), option, str(out / "bag" / name), "--force"]) == 2
    assert "is in the bag, which is not changed" in capsys.readouterr().err


def test_a_missing_walk_to_compare_is_an_error_before_any_result(walked, tmp_path, capsys):
    out, _ = walked
    assert cli.main(["report", f"{out}/bag", "--compare", f"{tmp_path}/none", "--out", f"{tmp_path}/r", "--quiet"]) == 1
    assert is_one_line(capsys.readouterr().err)
    assert not (tmp_path / "r").exists()


def test_a_step_too_long_fails_with_a_reason_and_a_bag(tmp_path, capsys):
    too_long = ["--set", "gait.step_length=0.2", "--set", "gait.phase_timeout=20", "--no-figures"]
    assert cli.main(["simulate", *FAST, *too_long, "--out", str(tmp_path / "w")]) == 1
    output = capsys.readouterr().err
    assert "single_support" in output
    assert "Traceback" not in output
    trace = bag.read(tmp_path / "w/bag")
    assert not trace.finished
    assert [record.name for record in trace.phases] == ["double_support/left", "single_support/left"]
    report = json.loads((tmp_path / "w/report.json").read_text())
    assert report["walk"]["finished"] is False
    assert report["ok"] is False
    assert [v["what"] for v in report["violations"]] == ["finished"]  # no constraint was violated
    capsys.readouterr()
    assert cli.main(["report", str(tmp_path / "w/bag"), "--no-figures", "--quiet"]) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert is_one_line(said.err)
    assert said.err.startswith("dqwalk: NOT OK: the walk stopped before its end")


def test_ctrl_c_saves_the_walk_so_far(tmp_path):
    """A walk with the paper's parameters, interrupted during a phase."""
    out = tmp_path / "walk"
    ours, terminal = os.openpty()  # the progress is shown on a terminal only
    termios.tcsetwinsize(terminal, (24, 120))
    process = subprocess.Popen(
        [sys.executable, "-u", "-m", "dqwalk_ros.cli", "simulate", "--out", str(out), "--cycles", "20", "--no-figures"],
        stdout=subprocess.PIPE,
        stderr=terminal,
        text=True,
        env=HERE,
    )
    os.close(terminal)
    stderr = ""
    with os.fdopen(ours, "rb", buffering=0) as shown:
        while stderr.count("support/") < 3:
            stderr += shown.read(1000).decode()
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(OSError):  # the other end of the terminal is closed
            while True:
                stderr += shown.read(1000).decode()
    stdout, _ = process.communicate(timeout=60)
    assert process.returncode == 1, stderr
    assert "interrupted" in stderr
    assert "Traceback" not in stderr
    trace = bag.read(out / "bag")
    assert not trace.finished
    assert len(trace.time) > 100
    report = json.loads((out / "report.json").read_text())
    assert report["walk"]["ticks"] == len(trace.time)
    assert "stopped before its end" in stdout


def test_quiet_prints_nothing(tmp_path, capsys):
    assert cli.main(["simulate", *FAST, "--out", str(tmp_path / "w"), "--quiet", "--no-figures"]) == 0
    assert capsys.readouterr() == ("", "")
    assert {path.name for path in (tmp_path / "w").iterdir()} == {"bag", "report.json"}


def test_an_unusable_opengl_platform_is_named(tmp_path):
    words = [sys.executable, "-m", "dqwalk_ros.cli", "movie", str(tmp_path)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=HERE | {"MUJOCO_GL": "paper"})
    assert done.returncode == 1
    assert is_one_line(done.stderr), done.stderr
    assert "MUJOCO_GL=paper" in done.stderr


def test_walks_of_a_new_robot_need_the_engine_before_the_work(monkeypatch, capsys, tmp_path):
    """The trials called it a fall, and looked for cures."""
    monkeypatch.setitem(sys.modules, "mujoco", None)
    monkeypatch.delitem(sys.modules, "dqwalk_ros.plants.mujoco", raising=False)
    urdf = Path(__file__).parents[1] / "data/biped12.urdf"
    assert cli.main(["adopt", str(urdf), "--out", str(tmp_path / "out"), "--yes", "--quiet"]) == 1
    assert capsys.readouterr().err == "dqwalk: the physics engine is not installed: pip install mujoco\n"
    assert not (tmp_path / "out").exists()


def test_a_closed_pipe_is_no_error():
    words = f"{sys.executable} -m dqwalk_ros.cli config | head -1"
    done = subprocess.run(words, shell=True, capture_output=True, text=True, check=False, env=HERE)
    assert done.returncode == 0
    assert done.stderr == ""


def test_closed_streams_are_no_error(monkeypatch):
    for stream in ("stdin", "stdout", "stderr"):
        monkeypatch.setattr(sys, stream, None)
    assert cli.main(["config", "paper"]) == 0
    assert cli.main(["config", "papr"]) == 2


@pytest.mark.parametrize(
    ("module", "named"),
    [
        ("own_module", "'own_module' is not installed\n"),
        ("rclpy", "'rclpy' is not installed: source the setup file of a ROS 2 Jazzy, "
                  "or pip install -e '.[ros]' in the folder of dqwalk_ros\n"),
        ("pinocchio.utils", "'pinocchio.utils' is not installed: pip install pin\n"),
    ],
)  # fmt: skip
def test_a_missing_python_module_is_named_with_its_package(monkeypatch, capsys, tmp_path, module, named):
    def run_walk(*_, **__):
        raise ModuleNotFoundError(f"No module named '{module}'", name=module)

    monkeypatch.setattr("dqwalk_ros.cli.runner.run_walk", run_walk)
    assert cli.main(["walk", "--out", str(tmp_path)]) == 1
    assert capsys.readouterr().err.endswith(named)


def test_a_package_that_refuses_its_environment_is_named_and_other_errors_are_not_hidden(monkeypatch, capsys, tmp_path):
    (tmp_path / "grumpy.py").write_text("raise ValueError('threads must be > 0')")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("GRUMPY_THREADS", "0")
    monkeypatch.setattr("dqwalk_ros.cli.runner.run_walk", lambda *_, **__: importlib.import_module("grumpy"))
    assert cli.main(["walk", "--out", str(tmp_path / "out")]) == 1
    said = "grumpy cannot be imported: threads must be > 0; is GRUMPY_THREADS in the environment right?\n"
    assert capsys.readouterr().err.endswith(said)
    monkeypatch.setattr("dqwalk_ros.cli.runner.run_walk", lambda *_, **__: int("abc"))
    with pytest.raises(ValueError, match="abc"):
        cli.main(["walk", "--out", str(tmp_path / "out")])


@pytest.mark.parametrize(("program", "package"), [("dqwalk", "click"), ("dqwalk_controller", "msgspec")])
def test_a_package_of_another_python_is_named_before_a_program_has_begun(tmp_path, program, package):
    (tmp_path / f"{package}.py").write_text("raise ImportError('undefined symbol: _PyX')")
    environment = {**HERE, "PYTHONPATH": os.pathsep.join([str(tmp_path), HERE["PYTHONPATH"]])}
    line = (
        f"import sys; from dqwalk_ros.programs import {'dqwalk' if program == 'dqwalk' else 'node'} as p; sys.exit(p())"
    )
    code = f"import sys; sys.argv = ['{program}', '--help']; {line}"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == f"{program}: {package} cannot be imported: undefined symbol: _PyX\n"


@pytest.mark.parametrize("command", ["servos", "footsteps"])
def test_a_robot_of_a_parameter_file_is_shown(command, tmp_path, capsys):
    """As in all commands that take a robot; here the file is refused, which shows that it is read."""
    own = tmp_path / "mine.yaml"
    own.write_text("/**: {ros__parameters: {robot: {mass: -3.2}}}")
    assert cli.main([command, "--params", str(own)]) == 2
    assert "'robot.mass'" in capsys.readouterr().err


# ---------------------------------------------------------------------- progress


@pytest.mark.parametrize("quiet", [False, True])
def test_progress_in_a_file_is_a_line_now_and_then(quiet, capsys, monkeypatch):
    monkeypatch.setattr("dqwalk_ros.cli.progress._PAUSE", 0.1)
    with Progress(quiet=quiet) as bar:
        bar.stage(0.5, "reading")
        bar(0.7, "walking")
        bar.print("a line")
        time.sleep(0.15)
    assert capsys.readouterr() == ("a line\n", "" if quiet else " 70 % after 0 s: walking\n")


def test_the_time_passes_on_a_terminal_also_without_progress(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr("dqwalk_ros.cli.progress._TICK", 0.1)
    with Progress() as bar:
        bar.stage(0.5, "reading")
        capsys.readouterr()
        time.sleep(0.15)
    assert "reading" in capsys.readouterr().err


def test_progress_shows_fraction_text_and_time_left(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with Progress() as bar:
        bar(0.5, "single_support/left")
        bar(2.0, "never more than all")
    assert "single_support/left" not in capsys.readouterr().out
    with Progress() as bar:
        bar.stage(0.5, "reading")
    assert re.search("50 %.* 00:00<00:00 reading", capsys.readouterr().err)
    with Progress(quiet=True) as bar:
        bar(0.5, "never")
        bar.stage(0.5, "never")
    assert capsys.readouterr().err == ""


def test_the_time_left_follows_from_the_mean_speed(capsys, monkeypatch):
    """A walk reports whole phases, and the last step of its bar takes no time."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    now = [100.0]
    monkeypatch.setattr("tqdm.std.time", lambda: now[0])
    with Progress() as bar:
        for at in range(23):
            now[0] = 100.0 + at
            bar(0.0 if at < 20 else 0.25, "walking")
    assert "00:20<01:00" in capsys.readouterr().err


def test_no_time_left_is_shown_before_it_can_be_known(capsys, monkeypatch):
    """The first of many steps, after a compilation, would make it hours."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    now = [100.0]
    monkeypatch.setattr("tqdm.std.time", lambda: now[0])
    with Progress() as bar:
        now[0] += 40.0
        bar(0.0003, "walking")
        assert re.search(r"00:40 walking", capsys.readouterr().err)
        now[0] += 40.0
        bar(0.5, "walking")
    assert "01:20<01:20 walking" in capsys.readouterr().err


def test_a_new_text_is_shown_also_without_progress(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with Progress() as bar:
        for fraction, text in ((0.5, "first"), (0.5, "second")):
            time.sleep(0.11)  # longer than tqdm's interval
            bar(fraction, text)
    assert "second" in capsys.readouterr().err


def test_a_log_message_does_not_continue_the_line_of_the_progress_bar(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with Progress() as bar:
        bar(0.5, "single_support/left")
        logging.getLogger("dqwalk_ros").warning("compiling")
    assert "compiling" in re.split(r"[\r\n]", capsys.readouterr().err)
