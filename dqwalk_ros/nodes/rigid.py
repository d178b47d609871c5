"""The plant of the whole-body controller: rigid bodies on rigid ground, pushed on request.

It publishes a state, waits for the torques with that very stamp, and moves on: as fast as the machine in lockstep, at
most at 1/dt else. Time is that of the simulation. Which feet stand follows from the timing of the steps, which the
plant and the controller read from the same parameters, as in the paper's simulation.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistStamped, WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState

from dqwalk_ros.controllers.whole_body import BodyCommand, WholeBodyController
from dqwalk_ros.exceptions import DqwalkError
from dqwalk_ros.model import Foot, load_model
from dqwalk_ros.nodes import entry
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.parameters import Parameters
from dqwalk_ros.nodes.runtime import LAST_WORDS, STEADY, Life, Worker, run
from dqwalk_ros.plants.rigid import RigidPlant
from dqwalk_ros.preview import Stepping

__all__ = ["RigidNode", "main"]

_ASK_AGAIN = 0.5
"""A state without an answer is published again after this long [s]."""


class RigidNode(Worker):
    """joint_effort_commands, push -> joint_states, base_pose, base_twist.

    Parameters
    ----------
    node : rclpy.node.Node
    life : Life
    options : argparse.Namespace
        From `entry.parse`.
    """

    def __init__(self, node: Node, life: Life, options: Any) -> None:
        self.node, self.life = node, life
        config = Parameters(node, options.argv).config
        self._dt, self._lockstep = config.dt, config.plant.lockstep
        self.last_words = LAST_WORDS[self._lockstep]
        model = load_model(config.robot)
        self._stepping = Stepping.of(config.whole_body, Foot(config.gait.first_support))
        start = WholeBodyController(config, model).start  # where a walk begins
        damping = config.whole_body.contact_damping
        self._plant = RigidPlant(model, start, pushed=config.whole_body.torso, damping=damping)
        self._names = {name: i for i, name in enumerate(model.joint_names)}
        self._write = ros.JointWriter(model.joint_names)
        self._pelvis = config.robot.pelvis
        self._command: BodyCommand | None = None
        self._stamp, self._ticks, self._asked = 0, 0, -float("inf")
        self._states = ros.publisher(node, "joint_states")
        self._poses = ros.publisher(node, "base_pose")
        self._twists = node.create_publisher(TwistStamped, "base_twist", ros.stream(10))
        node.create_subscription(JointState, "joint_effort_commands", self._on_command, ros.stream(1))
        node.create_subscription(WrenchStamped, "push", self._on_push, ros.stream(10))
        node.create_timer(self._dt, self._on_period, clock=STEADY)
        mode = "lockstep" if self._lockstep else f"at most {1.0 / self._dt:g} Hz"
        node.get_logger().info(f"{model.name}: {model.n} joints, rigid, {mode}")

    def _on_command(self, msg: JointState) -> None:
        if ros.nanoseconds(msg.header.stamp) != self._stamp or len(msg.name) != len(msg.effort):
            return  # the answer to a state that was asked for twice, or no torques
        effort = np.full(len(self._names), np.nan)
        for name, torque in zip(msg.name, msg.effort, strict=True):
            if name in self._names:
                effort[self._names[name]] = torque
        now = self._ticks * self._dt
        swing = self._stepping.swing(now)
        ends = swing is not None and swing.remaining <= self._dt + 1e-9
        self._command = BodyCommand(
            now,
            np.zeros(len(effort)),
            acceleration=np.zeros(6 + len(effort)),
            effort=effort,
            stance=tuple(Foot) if swing is None else (swing.foot.other,),
            landing=swing.foot if swing is not None and ends else None,
        )
        if self._lockstep:
            self._step()

    def _on_push(self, msg: WrenchStamped) -> None:
        """Take the force times one second as the impulse [N s]; moments are not in (23)."""
        f = msg.wrench.force
        try:
            self._plant.push([f.x, f.y, f.z])
        except DqwalkError as error:
            self.node.get_logger().error(f"push rejected: {error}")
            return
        self.node.get_logger().info(f"pushed: {f.x:g}, {f.y:g}, {f.z:g} N s")

    def _on_period(self) -> None:
        if self._command is not None:
            self._step()
        elif time.monotonic() - self._asked > _ASK_AGAIN:
            self._publish()

    def _step(self) -> None:
        command, self._command = self._command, None
        if command is None:
            return
        try:
            self._plant.step(command, self._dt)
        except DqwalkError as error:
            self.node.get_logger().error(f"the plant failed: {error}")
            self.life.end(1)
            return
        self._ticks += 1
        self._stamp = round(self._ticks * self._dt * 1e9)
        self._publish()

    def _publish(self) -> None:
        s = self._plant.state
        self._asked = time.monotonic()
        self._poses.publish(ros.pose(self._stamp, "odom", s.x_base))
        twist = TwistStamped()
        twist.header.stamp, twist.header.frame_id = ros.time_msg(self._stamp), self._pelvis
        linear, angular = twist.twist.linear, twist.twist.angular
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = s.v_base.tolist()
        self._twists.publish(twist)
        self._states.publish(self._write(self._stamp, position=s.q, velocity=s.dq))


def main(argv: list[str] | None = None) -> int:
    """Run the node; return the exit code."""
    options = entry.parse("rigid", sys.argv[1:] if argv is None else argv)
    return run("rigid", lambda node, life: RigidNode(node, life, options), options)


if __name__ == "__main__":
    sys.exit(main())
