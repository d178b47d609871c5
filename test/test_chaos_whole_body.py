"""The whole-body walk in real time: its nodes are killed and frozen, and the robot does not fall."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chaos import row
from geometry_msgs.msg import PoseStamped, WrenchStamped
from live import Live
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from dqwalk_ros.config import load
from dqwalk_ros.runner import private_domain

pytestmark = pytest.mark.long


class Body(Live):
    """Controller and rigid plant; the pelvis, the torques and the stamps of the states are listened to."""

    def __init__(self, folder: Path, domain: int) -> None:
        super().__init__(folder, domain, load("whole_body").updated({"monitor.rate": 10.0}))
        self.pelvis: list[PoseStamped] = []
        self.torques: list[JointState] = []
        deep = QoSProfile(depth=1000)
        self.node.create_subscription(PoseStamped, "base_pose", self.pelvis.append, deep)
        self.node.create_subscription(JointState, "joint_effort_commands", self.torques.append, deep)
        for name in ("whole_body_controller", "rigid"):
            self.start(name)

    def walks(self, seconds: float = 1.0) -> None:
        """Wait until the robot has walked for so long [s], by its own time, and is still up."""
        self.until(lambda: self.pelvis, 60.0, "a state")
        until = self.now + seconds
        # a controller that was killed is remembered for 20 s: until then a third one of its name is one too many
        self.until(lambda: self.now >= until, 120.0, f"{seconds} s of walking")
        assert abs(self.pelvis[-1].pose.position.z - self.pelvis[0].pose.position.z) < 0.05
        assert all(np.isfinite(msg.effort).all() and np.abs(msg.effort).max() <= 150.0 for msg in self.torques)

    @property
    def now(self) -> float:
        """Time of the simulation [s]."""
        stamp = self.pelvis[-1].header.stamp
        return float(stamp.sec + 1e-9 * stamp.nanosec)

    def holds(self) -> None:
        """Wait until time stands still."""
        self.until(lambda: "holding" in (getattr(self.status("rigid"), "message", "")), 20.0, "the plant holding")
        then = self.now
        self.spin(0.7)
        assert self.now <= then + 1e-9


@pytest.fixture
def walk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with private_domain() as domain:
        made = Body(tmp_path, domain)
        made.walks()
        yield made
        made.close()


def test_the_nodes_are_frozen_killed_and_pushed_too_hard(walk: Body) -> None:
    walk.processes.signal("whole_body_controller", signal.SIGSTOP)
    walk.holds()
    walk.processes.signal("whole_body_controller", signal.SIGCONT)
    walk.walks()
    row("body: controller SIGSTOP, SIGCONT", "the plant holds", None, "walks on")

    walk.processes.signal("rigid", signal.SIGSTOP)
    walk.until(lambda: walk.status("whole_body_controller").level == b"\x03", 20.0, "STALE")
    walk.until(lambda: not any(walk.torques[-1].effort), 5.0, "zero torque")
    walk.processes.signal("rigid", signal.SIGCONT)
    walk.walks()
    row("body: plant SIGSTOP, SIGCONT", "STALE, zero torque once", None, "walks on")

    for share in (0.35, 0.92):  # of a step: in a swing, and while the weight goes over
        walk.until(lambda at=share: 0.0 <= (walk.now - 0.4) / 0.8 % 1.0 - at < 0.05, 60.0, f"{share} of a step")
        walk.processes.signal("whole_body_controller", signal.SIGKILL)
        walk.holds()
        walk.start("whole_body_controller")
        walk.walks()
        row(f"body: controller SIGKILL at {share:.0%} of a step", "the plant holds", None, "takes up the walk")

    push = walk.node.create_publisher(WrenchStamped, "push", 10)
    walk.until(push.get_subscription_count, 20.0, "the plant's subscription")
    for newtons in (1e300, float("nan"), 1e4):
        hit = WrenchStamped()
        hit.wrench.force.y = newtons
        push.publish(hit)
    walk.until(lambda: walk.processes.log("rigid").count("push rejected") == 3, 20.0, "three refusals")
    walk.walks()
    row("body: pushes of 1e300 N s, NaN, 10 000 N s", "refused", None, "undisturbed")

    assert walk.call("/whole_body_controller/reset").success
    walk.walks()
    row("body: ~/reset in mid-step", "takes up the walk", None, "walks on")
