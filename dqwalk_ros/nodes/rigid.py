"""The plant of the whole-body controller: rigid bodies on rigid ground, with pushes on request.

It publishes a state, waits for the torques with the same stamp, and advances: in lockstep as fast as the machine
allows, otherwise at most at 1/dt. Stamps are simulated time. Which feet are in contact follows from the step timing,
which plant and controller read from the same parameters, as in the paper's simulation.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistStamped, WrenchStamped
from sensor_msgs.msg import JointState

from dqwalk_ros.errors import DqwalkError
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode
from dqwalk_ros.nodes.inputs import EFFORT, CommandInput
from dqwalk_ros.nodes.safety import BodyGate, clamp_effort
from dqwalk_ros.robot import load_model
from dqwalk_ros.topics import ODOM
from dqwalk_ros.whole_body.controller import BodyCommand, WholeBodyController
from dqwalk_ros.whole_body.preview import Stepping
from dqwalk_ros.whole_body.rigid_plant import RigidPlant

__all__ = ["Rigid"]

_ASK_AGAIN = 0.5
"""Time after which a state without a command is published again [s]."""


class Rigid(WalkNode):
    """Simulate the robot of the whole-body controller: rigid bodies on rigid ground.

    Subscribes to::

        joint_effort_commands    sensor_msgs/JointState [N m]
        push                     geometry_msgs/WrenchStamped: its force times 1 s hits the torso [N s], in odom

    Publishes::

        joint_states, base_pose, base_twist   one state in three messages with one stamp, from 0 s on
        left_wrench, right_wrench  geometry_msgs/WrenchStamped: ground on a sole in contact, about its origin
        push_applied             geometry_msgs/WrenchStamped, latched; stamp: that of the first state after the push
        /diagnostics             diagnostic_msgs/DiagnosticArray

    Sections of the schema: dt, robot, plant, whole_body.

    Example::

        dqwalk_rigid --ros-args --params-file config/whole_body.yaml -p plant.lockstep:=true
    """

    claims = "joint_states"

    def __init__(self, options: argparse.Namespace, **keywords: Any) -> None:
        super().__init__("rigid", options, **keywords)
        config = self.config
        self._dt = config.dt
        self._model = model = load_model(config.robot)
        self._stepping = Stepping.of(config)
        start = WholeBodyController(config, model).start  # initial state of a walk
        damping = config.whole_body.contact_damping
        self._plant = RigidPlant(model, start, pushed=config.whole_body.torso, damping=damping)
        self._max_impulse = BodyGate.speed * model.mass  # the controller rejects states of faster bodies [N s]
        self._commands = CommandInput(self, model, EFFORT)
        self._write = ros.JointWriter(model.joint_names)
        self._pelvis = config.robot.pelvis
        self._command: BodyCommand | None = None
        self._stamp, self._ticks, self._published_at = 0, 0, -float("inf")
        self._pushes: list[WrenchStamped] = []  # to be applied before the next state
        streams = ("joint_states", "base_pose", "base_twist", "left_wrench", "right_wrench", "push_applied")
        self._pub = {name: self.advertise(name) for name in streams}
        self.create_subscription(JointState, EFFORT, self._on_command, ros.stream(10))
        self.create_subscription(WrenchStamped, "push", self._pushes.append, ros.stream(10))
        self.create_timer(self._dt, self._on_period)
        self.create_timer(1.0 / config.monitor.rate, self._diagnose)
        mode = "lockstep" if self.lockstep else f"at most {1.0 / self._dt:g} Hz"
        self.get_logger().info(f"{model.name}: {model.n} joints, rigid, {mode}")

    def _on_command(self, msg: JointState) -> None:
        command = self._commands.take_answer(msg, self._stamp)
        if command is None or command.effort is None or self._command is not None:
            return  # only the first command of a state is used; after a timeout the controller also sends zero torque
        effort = clamp_effort(command.effort, self._model)
        now = self._ticks * self._dt
        body = BodyCommand(
            now,
            np.zeros(len(effort)),
            acceleration=np.zeros(6 + len(effort)),
            effort=effort,
            stance=self._stepping.stance(now),
            landing=self._stepping.landing(now, self._dt),
        )
        if self.lockstep:
            self._step(body)
        else:
            self._command = body  # of the next period

    def _apply_pushes(self) -> None:
        """Apply the impulse of each push; (S23) contains no moments."""
        log = self.get_logger()
        for msg in self._pushes:
            try:
                impulse = ros.impulse(msg, self._max_impulse)
                self._plant.push(impulse)
            except DqwalkError as error:
                log.error(f"push rejected: {error}")
                continue
            msg.header.stamp, msg.header.frame_id = ros.time_msg(self._stamp), ODOM
            self._pub["push_applied"].publish(msg)
            log.info("pushed: {:g}, {:g}, {:g} N s".format(*impulse))
        self._pushes.clear()

    def _on_period(self) -> None:
        if not self.lockstep:
            self._commands.log_motion()
        if self._command is not None:
            self._step(self._command)
        elif time.monotonic() - self._published_at > _ASK_AGAIN and self._may_begin():
            self._publish()

    def _step(self, command: BodyCommand) -> None:
        self._command = None
        try:
            self._plant.step(command, self._dt)
        except DqwalkError as error:
            self.get_logger().error(f"the plant failed: {error}")
            self.stop(1)
            return
        for foot, wrench in self._plant.wrenches.items():
            self._pub[f"{foot.value}_wrench"].publish(ros.wrench(self._stamp, ODOM, wrench))
        self._ticks += 1
        self._stamp = round(self._ticks * self._dt * 1e9)
        self._apply_pushes()
        self._publish()

    def _may_begin(self) -> bool:
        """Return whether the walk may begin: with a recorder, once it has subscribed to every message."""
        return bool(self._ticks) or not self.config.node.wait_for_recorder or self.is_recorded()

    def _publish(self) -> None:
        s = self._plant.state
        self._published_at = time.monotonic()
        self._pub["base_pose"].publish(ros.pose(self._stamp, ODOM, s.x_base))
        twist = TwistStamped()
        twist.header.stamp, twist.header.frame_id = ros.time_msg(self._stamp), self._pelvis
        linear, angular = twist.twist.linear, twist.twist.angular
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = s.v_base.tolist()
        self._pub["base_twist"].publish(twist)
        self._pub["joint_states"].publish(self._write(self._stamp, position=s.q, velocity=s.dq))

    def _diagnose(self) -> None:
        level, text = self._commands.level()
        counts = {"ticks": self._ticks, **self._commands.counts()}
        self.diagnose("plant", self._model.name, level, text, counts, self._stamp)
