"""The launch file: its table of arguments, and where a ROS is installed (`make colcon`) what `ros2 launch` does."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml

from dqwalk_ros.config import load
from dqwalk_ros.packages import expanded
from dqwalk_ros.robot import load_model, parse_model

ROOT = Path(__file__).resolve().parent.parent
FILE = ROOT / "launch" / "walk.launch.py"
ARGUMENTS = {
    *("config", "plant", "lockstep", "namespace", "use_sim_time", "autostart", "dummy", "respawn"),
    *("log_level", "rviz", "view", "bag", "interface"),
}


def assigned(name: str) -> Any:
    """Return a constant of the launch file, whose own imports need a ROS."""
    names = {"TRUE_OR_FALSE": ["true", "false"]}
    for node in ast.parse(FILE.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") in ("PLANTS", name):
            names[node.targets[0].id] = eval(compile(ast.Expression(node.value), str(FILE), "eval"), {}, dict(names))
    return names[name]


def test_every_argument_is_described() -> None:
    found = assigned("ARGUMENTS")
    assert set(found) == ARGUMENTS
    assert all(len(description) > 20 for _, description, _ in found.values())


def test_every_node_it_starts_is_installed() -> None:
    tree = ast.parse(FILE.read_text(encoding="utf-8"))
    calls = [n for n in ast.walk(tree) if isinstance(n, ast.Call) and getattr(n.func, "id", "") == "node"]
    started = {c.args[0].value for c in calls if isinstance(c.args[0], ast.Constant) and len(c.args) == 1}
    started |= set(assigned("PLANTS").values())
    assert started == {
        "controller",
        "integrator",
        "physics",
        "poppy_driver",
        "drive",
        "phase_monitor",
        "recorder",
        "viewer",
    }
    for name in started:
        script = ROOT / "scripts" / name
        assert script.stat().st_mode & 0o111, f"{script} cannot be executed"
        assert f'main("{name}"' in script.read_text(encoding="utf-8")


def test_poppy_behind_ros2_control_is_the_robot_that_walks() -> None:
    """All its joints with both interfaces, and controllers in the order in which the node drive tells them."""
    config = load("poppy")
    urdf = expanded(ROOT / "urdf" / "poppy.ros2_control.urdf.xacro", plugin="a/Plugin").decode()
    assert parse_model(urdf, config.robot).joint_names == load_model(config.robot).joint_names
    root = ElementTree.fromstring(urdf)
    (component,) = root.iter("ros2_control")
    assert component.findtext("hardware/plugin") == "a/Plugin"
    moving = {joint.get("name") for joint in root.iter("joint") if joint.get("type") == "revolute"}
    told = {joint.get("name"): [i.get("name") for i in joint.iter("command_interface")] for joint in component}
    assert {name for name, interfaces in told.items() if interfaces} == moving
    assert all(interfaces in ([], ["position", "velocity"]) for interfaces in told.values())
    controllers = yaml.safe_load((ROOT / "config" / "ros2_control" / "controllers.yaml").read_text())
    for interface in ("position", "velocity"):
        controller = controllers[f"/**/forward_{interface}_controller"]["ros__parameters"]
        assert controller["interface_name"] == interface
        assert tuple(controller["joints"]) == load_model(config.robot).joint_names
    assert 1.0 / controllers["/**/controller_manager"]["ros__parameters"]["update_rate"] == config.dt


@pytest.mark.native
def test_launch_reads_it() -> None:
    """As `ros2 launch` does; the wheels of ROS have no `launch`."""
    import launch
    from launch.launch_description_sources import PythonLaunchDescriptionSource

    description = PythonLaunchDescriptionSource(str(FILE)).get_launch_description(launch.LaunchContext())
    arguments = {argument.name: argument for argument in description.get_launch_arguments()}
    assert set(arguments) == {*ARGUMENTS, "discovery"}
