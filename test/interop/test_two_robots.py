"""Two robots in two namespaces of one domain do not affect each other."""

from __future__ import annotations

import signal
from typing import Any

import numpy as np
import pytest
from live import Live
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from dqwalk_ros.config import load


@pytest.mark.long
def test_a_robot_walks_on_when_another_is_killed(nodes: Any) -> None:
    robots: dict[str, Live] = {}
    commands: dict[str, list[JointState]] = {}
    states: dict[str, list[JointState]] = {}
    for name in ("left", "right"):
        robots[name] = one = nodes(load("paper").updated({"dt": 0.02}), name=f"test_{name}")
        watcher = robots["left"]
        for topic, box in (("joint_velocity_commands", commands), ("joint_states", states)):
            kept = box.setdefault(name, [])
            watcher.node.create_subscription(JointState, f"/{name}/{topic}", kept.append, QoSProfile(depth=1000))
        for node in ("integrator", "controller"):
            one.processes.start(node, ["--ros-args", "--params-file", str(one.params), "-r", f"__ns:=/{name}"])

    def moves(name: str) -> bool:
        return bool(commands[name]) and max(map(abs, commands[name][-1].velocity)) > 1e-3

    for name in robots:
        watcher.until(lambda name=name: moves(name), 180.0, f"the walk of {name}")
    robots["left"].processes.signal("controller", signal.SIGKILL)
    robots["left"].processes.wait("controller", 10.0)

    def stands() -> bool:
        watcher.spin(1.0)
        last = states["left"][-40:]
        return len(last) == 40 and last[0].position == last[-1].position

    watcher.until(stands, 30.0, "left standing still")
    commands["right"].clear()
    watcher.until(lambda: states["right"], 30.0, "a state of right")
    at = np.array(states["right"][-1].position)

    def has_moved() -> bool:
        return bool(np.abs(np.array(states["right"][-1].position) - at).max() > 0.0)

    watcher.until(lambda: len(commands["right"]) > 50 and moves("right") and has_moved(), 30.0, "right walking on")
    for node in ("integrator", "controller"):
        assert robots["right"].processes.exit_code(node) is None
    assert robots["left"].processes.exit_code("integrator") is None
    assert not any("two controllers" in one.logs() or "two plants" in one.logs() for one in robots.values())
