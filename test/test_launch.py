"""The launch file: its table of arguments, and where a ROS is installed (`make colcon`) what `ros2 launch` does."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import pytest

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
    assert started == {"controller", "integrator", "physics", "poppy_driver", "drive", "phase_monitor", "recorder", "viewer"}
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
    assert set(arguments) == {*ARGUMENTS, "discovery"}
