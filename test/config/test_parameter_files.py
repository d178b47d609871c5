"""A parameter file gets the same answer from the command line and from the nodes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from dqwalk_ros import cli
from dqwalk_ros.config import Config, load, with_files
from dqwalk_ros.support.errors import ConfigError

OURS = "ros__parameters: {dt: 0.01, gait.cycles: 3}"
ACCEPTED = {
    "plain": f"/**: {{{OURS}}}",
    "a node of another package": f"/**: {{{OURS}}}\ncamera: {{ros__parameters: {{dt: 7, a: {{b: [1, 2]}}}}}}",
    "parameters of another package": "/**: {ros__parameters: {dt: 0.01, gait.cycles: 3, camera: {fps: 30}, hz: 1}}",
    "parameters of rclpy": "/**: {ros__parameters: {dt: 0.01, gait.cycles: 3, use_sim_time: false}}",
    "a nested namespace": f"robot_1: {{phase_monitor: {{{OURS}}}}}",
    "two nested namespaces": f"lab: {{robot_1: {{phase_monitor: {{{OURS}}}, camera: {{ros__parameters: {{a: 3}}}}}}}}",
    "a namespace in the name": f"/robot_1/phase_monitor: {{{OURS}}}",
    "any namespace": f"/**/phase_monitor: {{{OURS}}}",
    "one namespace": f"/*/phase_monitor: {{{OURS}}}",
    "all nodes of a namespace": f"robot_1: {{'*': {{{OURS}}}}}",
    "several of our nodes": f"controller: {{{OURS}}}\nphase_monitor: {{{OURS}}}",
    "numbers in other notations": "/**: {ros__parameters: {dt: +1.e-2, gait.cycles: 0x3, gait.steps: 012}}",
    "one letter for true": "/**: {ros__parameters: {dt: .01, gait.cycles: 3, dsp.flat_feet: n, dynamic.catch: On}}",
}  # fmt: skip
REFUSED = {
    "a misspelt parameter": ("/**: {ros__parameters: {gait.cycels: 3}}", "gait.cycels"),
    "a misspelt section": ("/**: {ros__parameters: {gait.cycles: 3}}\nphase_monitr: {ros__parameters: {dt: 0.01}}",
                           "did you mean 'phase_monitor'"),
    "a misspelt parameter of a section of ours": ("/**: {ros__parameters: {gait: {speed: 3}}}", "gait.speed"),
    "a wrong type": ("/**: {ros__parameters: {dt: fast}}", "dt"),
    "a number with an underscore": ("/**: {ros__parameters: {gait.cycles: 1_0}}", "gait.cycles"),
    "a time for a number": ("/**:\n  ros__parameters:\n    gait.cycles: 1:30", "gait.cycles"),
    "a binary number": ("/**: {ros__parameters: {gait.cycles: 0b11}}", "gait.cycles"),
    "digits of another script": ("/**: {ros__parameters: {dt: \u0660.\u0660\u0661}}", "dt"),
    "no answer whether time is simulated": ("/**: {ros__parameters: {use_sim_time: maybe}}", "use_sim_time"),
    "a value out of bounds": ("phase_monitor: {ros__parameters: {dt: 100.0}}", "dt"),
}  # fmt: skip
NAMESPACES = {
    "a nested namespace": "/robot_1",
    "two nested namespaces": "/lab/robot_1",
    "a namespace in the name": "/robot_1",
    "any namespace": "/lab/robot_1",
    "one namespace": "/robot_1",
    "all nodes of a namespace": "/robot_1",
}


@pytest.mark.parametrize("name", ACCEPTED)
def test_what_the_nodes_accept_the_command_line_accepts(
    name: str, make: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    namespace = NAMESPACES.get(name)
    one = make("phase_monitor", ACCEPTED[name], ros=("-r", f"__ns:={namespace}") if namespace else ())
    assert (one.node.config.dt, one.node.config.gait.cycles) == (0.01, 3)
    file = tmp_path / "file.yaml"
    file.write_text(ACCEPTED[name])
    assert load(file) == one.node.config
    assert cli.main(["config", str(file), "--check"]) == 0
    assert "can be used" in capsys.readouterr().out


@pytest.mark.parametrize("name", REFUSED)
def test_what_the_nodes_refuse_the_command_line_refuses(
    name: str, make: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, named = REFUSED[name]
    with pytest.raises(ConfigError, match=named):
        make("phase_monitor", text)
    file = tmp_path / "file.yaml"
    file.write_text(text)
    for command in (["config", str(file), "--check"], ["footsteps", "--config", str(file)]):
        assert cli.main(command) == 2
        assert named in capsys.readouterr().err


def test_ignored_parameters_are_named(make: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    text = ACCEPTED["parameters of another package"]
    one = make("phase_monitor", text)
    assert "ignoring parameters of other packages: camera.fps, hz" in one.log
    (tmp_path / "file.yaml").write_text(text)
    load(tmp_path / "file.yaml")
    assert "ignoring parameters of other packages: camera.fps, hz" in caplog.text


@pytest.mark.parametrize(
    ("text", "names"),
    [
        (
            "amcl: {ros__parameters: {alpha1: 0.2}}\nbt_navigator: {ros__parameters: {odom_topic: odom}}",
            "amcl, bt_navigator",
        ),
        ("/**: {ros__parameters: {alpha1: 0.2}}", r"/\*\*"),
    ],
)
def test_a_file_for_other_packages_only_is_no_configuration(text, names, tmp_path):
    file = tmp_path / "nav2.yaml"
    file.write_text(text)
    for read in (lambda: load(file), lambda: with_files(Config(), [file])):
        with pytest.raises(ConfigError, match=f"no parameter of this package, only of others in {names};"):
            read()


@pytest.mark.parametrize("own", ["gait.steps: 3", "use_sim_time: true", ""])
def test_a_file_of_a_whole_robot_may_hold_little_of_this_package(own, tmp_path):
    file = tmp_path / "robot.yaml"
    file.write_text(f"amcl: {{ros__parameters: {{alpha1: 0.2}}}}\n/**: {{ros__parameters: {{{own}}}}}")
    assert with_files(Config(), [file]).gait.steps == load(file).gait.steps
