"""The whole-body walk in real time: its nodes are killed and frozen, and the robot does not fall."""

from __future__ import annotations

import signal
from typing import Any

import numpy as np
import pytest
from chaos import row
from geometry_msgs.msg import PoseStamped, WrenchStamped
from live import Live
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from dqwalk_ros.config import load

pytestmark = pytest.mark.long


class Body(Live):
    """Controller and rigid plant; records pelvis poses and torques."""

    def __init__(self, *args: Any, **keywords: Any) -> None:
        super().__init__(*args, **keywords)
        self.pelvis: list[PoseStamped] = []
        self.torques: list[JointState] = []
        deep = QoSProfile(depth=1000)
        self.node.create_subscription(PoseStamped, "base_pose", self.pelvis.append, deep)
        self.node.create_subscription(JointState, "joint_effort_commands", self.torques.append, deep)
        for name in ("whole_body_controller", "rigid"):
            self.start(name)

    def until_walked(self, seconds: float = 1.0) -> None:
        """Wait for `seconds` of simulated walking, and check that the robot is upright and its torques are valid."""
        self.until(lambda: self.pelvis, 60.0, "a state")
        end = self.now + seconds
        # a killed controller is counted for 20 s more: until then a third one of the same name is rejected
        self.until(lambda: self.now >= end, 120.0, f"{seconds} s of walking")
        assert abs(self.pelvis[-1].pose.position.z - self.pelvis[0].pose.position.z) < 0.05
        assert all(np.isfinite(msg.effort).all() and np.abs(msg.effort).max() <= 150.0 for msg in self.torques)

    @property
    def now(self) -> float:
        """The simulated time [s]."""
        stamp = self.pelvis[-1].header.stamp
        return float(stamp.sec + 1e-9 * stamp.nanosec)

    def until_holding(self) -> None:
        """Wait until the plant holds, and check that simulated time does not advance."""
        self.until(lambda: "holding" in getattr(self.status("rigid"), "message", ""), 20.0, "the plant holding")
        then = self.now
        self.spin(0.7)
        assert self.now <= then + 1e-9


def test_frozen_and_killed_nodes_and_excessive_pushes(nodes: Any) -> None:
    walk = nodes(load("whole_body").updated({"monitor.rate": 10.0}), kind=Body)
    walk.until_walked()
    walk.processes.signal("whole_body_controller", signal.SIGSTOP)
    walk.until_holding()
    walk.processes.signal("whole_body_controller", signal.SIGCONT)
    walk.until_walked()
    row("body: controller SIGSTOP, SIGCONT", "the plant holds", None, "continues")

    walk.processes.signal("rigid", signal.SIGSTOP)
    walk.until(lambda: getattr(walk.status("whole_body_controller"), "level", None) == b"\x03", 20.0, "STALE")
    walk.until(lambda: not any(walk.torques[-1].effort), 20.0, "zero torque")
    walk.processes.signal("rigid", signal.SIGCONT)
    walk.until_walked()
    row("body: plant SIGSTOP, SIGCONT", "STALE, zero torque once", None, "continues")

    for fraction in (0.35, 0.92):  # fraction of a step: during the swing, and during the weight transfer
        walk.until(lambda at=fraction: 0.0 <= (walk.now - 0.4) / 0.8 % 1.0 - at < 0.05, 60.0, f"{fraction} of a step")
        walk.processes.signal("whole_body_controller", signal.SIGKILL)
        walk.until_holding()
        walk.start("whole_body_controller")
        walk.until_walked()
        row(f"body: controller SIGKILL at {fraction:.0%} of a step", "the plant holds", None, "resumes the walk")

    push = walk.offer(WrenchStamped, "push", "rigid")
    for force in (1e300, float("nan"), 1e4):
        msg = WrenchStamped()
        msg.wrench.force.y = force
        push.publish(msg)
    walk.until(lambda: walk.processes.log("rigid").count("push rejected") == 3, 20.0, "three rejections")
    walk.until_walked()
    row("body: pushes of 1e300 N s, NaN, 10 000 N s", "rejected", None, "undisturbed")

    assert walk.call("/whole_body_controller/reset").success
    walk.until_walked()
    row("body: ~/reset in mid-step", "resumes the walk", None, "continues")
