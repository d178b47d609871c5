"""What is wrong in the environment of ROS is said in one line, before ROS fails because of it."""

import sys
from pathlib import Path

import pytest

from dqwalk_ros import cli
from dqwalk_ros.nodes.command_line import main
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.ros_environment import check_ros_environment


@pytest.mark.parametrize("domain", ["233", "abc", "-1", "1e2", "9" * 5000])
@pytest.mark.parametrize("command", [["walk", "--out", "w"], ["exercise", "--ros", "--out", "w"], ["doctor"]])
def test_a_domain_that_there_is_not_is_named(
    domain: str, command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    assert cli.main(command) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert "ROS_DOMAIN_ID" in said
    assert "from 0 to 232" in said
    assert not list(tmp_path.iterdir())
    assert main("controller", []) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_nodes_that_would_not_hear_each_other_are_refused() -> None:
    """They waited for three minutes, and the last line of the controller's log was said to be the cause."""
    with pytest.raises(ConfigError, match=r"ROS_AUTOMATIC_DISCOVERY_RANGE is OFF, so no node hears another"):
        check_ros_environment({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"})
    check_ros_environment({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"})
    check_ros_environment({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF", "ROS_LOCALHOST_ONLY": "1"})


def test_a_middleware_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    index = tmp_path / "share/ament_index/resource_index/rmw_typesupport"
    index.mkdir(parents=True)
    for name in ("rmw_implementation", "rmw_fastrtps_cpp", "rmw_zenoh_cpp"):
        (index / name).touch()
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    for rmw in ("", "rmw_zenoh_cpp"):
        check_ros_environment({"RMW_IMPLEMENTATION": rmw, "ROS_DOMAIN_ID": "0"})
    with pytest.raises(ConfigError, match=r"rmw_x.*set it to one of rmw_fastrtps_cpp, rmw_zenoh_cpp, or unset it"):
        check_ros_environment({"RMW_IMPLEMENTATION": "rmw_x"})
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "none"))  # without an index, ROS has to find out
    check_ros_environment({"RMW_IMPLEMENTATION": "rmw_x"})


@pytest.mark.parametrize("name", ["a b", "1st", "a//b", "a-b", "é"])
def test_a_namespace_that_there_cannot_be_is_refused(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["doctor", "--namespace", name]) == 2
    assert "--namespace" in capsys.readouterr().err
