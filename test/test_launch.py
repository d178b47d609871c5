"""The launch file: read as text, and where a ROS is installed (`make colcon`) as `ros2 launch` reads it."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parent.parent
FILE = ROOT / "launch" / "walk.launch.py"


def calls(name: str) -> list[ast.Call]:
    tree = ast.parse(FILE.read_text(encoding="utf-8"))
    return [n for n in ast.walk(tree) if isinstance(n, ast.Call) and getattr(n.func, "id", "") == name]


def constant(node: Any) -> Any:
    return node.value if isinstance(node, ast.Constant) else None


def test_every_argument_is_described() -> None:
    found = {constant(call.args[0]): {k.arg: k.value for k in call.keywords} for call in calls("DeclareLaunchArgument")}
    assert set(found) == {"config", "plant", "lockstep", "discovery", "view", "bag"}
    for name, keywords in found.items():
        assert constant(keywords["description"]), name
        assert "default_value" in keywords, name


def test_every_node_it_starts_is_installed() -> None:
    started = {constant(call.args[0]) for call in calls("node")}
    assert started == {"controller", "integrator", "physics", "poppy_driver", "phase_monitor", "recorder", "viewer"}
    for name in started:
        script = ROOT / "scripts" / name
        assert script.stat().st_mode & 0o111, f"{script} cannot be executed"
        assert f'main("{name}"' in script.read_text(encoding="utf-8")


@pytest.mark.native
def test_launch_reads_it() -> None:
    """As `ros2 launch` does; the wheels of ROS have no `launch`."""
    import launch
    from launch.launch_description_sources import PythonLaunchDescriptionSource

    description = PythonLaunchDescriptionSource(str(FILE)).get_launch_description(launch.LaunchContext())
    arguments = {argument.name: argument for argument in description.get_launch_arguments()}
    assert set(arguments) == {"config", "plant", "lockstep", "discovery", "view", "bag"}
