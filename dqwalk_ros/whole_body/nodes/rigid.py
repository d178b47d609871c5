"""The plant of the whole-body controller: rigid bodies on rigid ground, with pushes on request.

It publishes a state, waits for the torques with the same stamp, and advances: in lockstep as fast as the machine
allows, otherwise at most at 1/dt. Stamps are simulated time. Which feet are in contact follows from the step timing,
which plant and controller read from the same parameters, as in the paper's simulation.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistStamped, WrenchStamped
from sensor_msgs.msg import JointState

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.plant import SimulatedPlant
from dqwalk_ros.robot.limits import clamp_effort
from dqwalk_ros.support.errors import DqwalkError
from dqwalk_ros.support.topics import EFFORT, ODOM
from dqwalk_ros.whole_body.controller import BodyCommand, WholeBodyController
from dqwalk_ros.whole_body.nodes.body_gate import BodyGate
from dqwalk_ros.whole_body.preview import Stepping
from dqwalk_ros.whole_body.rigid_plant import RigidPlant


class Rigid(SimulatedPlant):
    """Simulate the robot of the whole-body controller: rigid bodies on rigid ground.

    Subscribes to::

        joint_effort_commands    sensor_msgs/JointState [N m]
        push                     geometry_msgs/WrenchStamped: its force times 1 s hits the torso [N s], in odom

    Publishes::

        joint_states, base_pose, base_twist   one state in three messages with one stamp, from 0 s on
        left_wrench, right_wrench  geometry_msgs/WrenchStamped: ground on a sole in contact, about its origin
        push_applied             geometry_msgs/WrenchStamped, latched; stamp: that of the first state after the push
        /clock                   rosgraph_msgs/Clock with plant.clock: the time of its stamps, for all nodes
        /diagnostics             diagnostic_msgs/DiagnosticArray

    Sections of the schema: dt, robot, plant, monitor.rate, node, whole_body.

    Example::

        dqwalk_rigid --ros-args --params-file config/whole_body.yaml -p plant.lockstep:=true
    """

    topic = EFFORT

    def __init__(self, options: argparse.Namespace, **keywords: Any) -> None:
        super().__init__("rigid", options, **keywords)
        model = self.model
        self._stepping = Stepping.of(self.config)
        self._max_impulse = BodyGate.speed * model.mass  # the controller rejects states of faster bodies [N s]
        self._command: BodyCommand | None = None
        self._pushes: list[WrenchStamped] = []  # to be applied before the next state
        streams = ("base_pose", "base_twist", "left_wrench", "right_wrench", "push_applied")
        self._pub = {name: self.advertise(name) for name in streams}
        self.create_subscription(WrenchStamped, "push", self._pushes.append, 10)
        mode = "lockstep" if self.lockstep else f"at most {1.0 / self.dt:g} Hz"
        self.get_logger().info(f"{model.name}: {model.n} joints, rigid, {mode}")

    def make_plant(self) -> RigidPlant:
        """Return the robot in the initial state of a walk."""
        settings, start = self.config.whole_body, WholeBodyController(self.config, self.model).start
        return RigidPlant(self.model, start, pushed=settings.torso, damping=settings.contact_damping)

    def real_time(self) -> int:
        """Return the simulated time [ns]."""
        return round(self.ticks * self.dt * 1e9)

    def _on_answer(self, msg: JointState) -> None:
        command = self.commands.take_answer(msg, self._stamp)
        if command is None or command.effort is None or self._command is not None:
            return  # only the first command of a state is used; after a timeout the controller also sends zero torque
        effort = clamp_effort(command.effort, self.model)
        now = self.ticks * self.dt
        body = BodyCommand(
            now,
            np.zeros(len(effort)),
            effort=effort,
            stance=self._stepping.stance(now),
            landing=self._stepping.landing(now, self.dt),
        )
        if self.lockstep:
            self._move(body, self.dt)
        else:
            self._command = body  # of the next period

    _on_command = _on_answer

    def _on_period(self) -> None:
        self.commands.log_motion()
        command, self._command = self._command, None
        if command is not None:
            self._move(command, self.dt)
        else:
            self._ask()

    def _may_begin(self) -> bool:
        """Return whether the walk may begin: with a recorder, once it has subscribed to every message."""
        return bool(self.ticks) or self.may_publish()

    def on_step(self, before: int) -> None:
        """Publish the wrenches of the period, and apply the impulse of each push; (S23) contains no moments."""
        for foot, wrench in self.plant.wrenches.items():
            self._pub[f"{foot.value}_wrench"].publish(ros.wrench(before, ODOM, wrench))
        log = self.get_logger()
        for msg in self._pushes:
            try:
                impulse = ros.impulse(msg, self._max_impulse)
                self.plant.push(impulse)
            except DqwalkError as error:
                log.error(f"push rejected: {error}")
                continue
            msg.header = ros.header(self._stamp, ODOM)
            self._pub["push_applied"].publish(msg)
            log.info("pushed: {:g}, {:g}, {:g} N s".format(*impulse))
        self._pushes.clear()

    def publish(self) -> None:
        """Publish the state in its three messages."""
        s = self.plant.state
        self._pub["base_pose"].publish(ros.pose(self._stamp, ODOM, s.x_base))
        twist = TwistStamped(header=ros.header(self._stamp, self.config.robot.pelvis))
        linear, angular = twist.twist.linear, twist.twist.angular
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = s.v_base.tolist()
        self._pub["base_twist"].publish(twist)
        super().publish()
