"""The plant of the whole-body controller: rigid bodies on rigid ground, pushed on request.

It publishes a state, waits for the torques with that very stamp, and moves on: as fast as the machine in lockstep, at
most at 1/dt else. Time is that of the simulation. Which feet stand follows from the timing of the steps, which the
plant and the controller read from the same parameters, as in the paper's simulation.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistStamped, WrenchStamped
from sensor_msgs.msg import JointState

from dqwalk_ros.errors import DqwalkError, PlantError
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import STEADY, WalkNode
from dqwalk_ros.nodes.inputs import EFFORT, CommandInput
from dqwalk_ros.nodes.safety import BodyGate, clamp_effort
from dqwalk_ros.robot import Foot, load_model
from dqwalk_ros.topics import ODOM
from dqwalk_ros.whole_body.controller import BodyCommand, WholeBodyController, Wrench
from dqwalk_ros.whole_body.preview import Stepping
from dqwalk_ros.whole_body.rigid_plant import RigidPlant

__all__ = ["Rigid"]

_ASK_AGAIN = 0.5
"""A state without an answer is published again after this long [s]."""


class Rigid(WalkNode):
    """Stand in for the robot of the whole-body controller: rigid bodies on rigid ground.

    Subscribes to::

        joint_effort_commands    sensor_msgs/JointState [N m]
        push                     geometry_msgs/WrenchStamped: its force times 1 s hits the torso [N s], in odom

    Publishes::

        joint_states, base_pose, base_twist   one state in three messages with one stamp, from 0 s on
        left_wrench, right_wrench  geometry_msgs/WrenchStamped: ground on a sole that stands, about its origin
        push_applied             geometry_msgs/WrenchStamped, latched; stamp: the first state after it
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
        self._stepping = Stepping.of(config.whole_body, Foot(config.gait.first_support))
        start = WholeBodyController(config, model).start  # where a walk begins
        damping = config.whole_body.contact_damping
        self._plant = RigidPlant(model, start, pushed=config.whole_body.torso, damping=damping)
        self._hardest = BodyGate.speed * model.mass  # a body that is faster is no state for a controller [N s]
        self._commands = CommandInput(self, model, EFFORT)
        self._write = ros.JointWriter(model.joint_names)
        self._pelvis = config.robot.pelvis
        self._command: BodyCommand | None = None
        self._stamp, self._ticks, self._asked = 0, 0, -float("inf")
        self._wait = config.node.wait_for_recorder
        self._pushes: list[WrenchStamped] = []  # that the next state will show
        streams = ("joint_states", "base_pose", "base_twist", "left_wrench", "right_wrench", "push_applied")
        self._pub = {name: self.advertise(name) for name in streams}
        self.create_subscription(JointState, EFFORT, self._on_command, ros.stream(10))
        self.create_subscription(WrenchStamped, "push", self._on_push, ros.stream(10))
        self.create_timer(self._dt, self._on_period, clock=STEADY)
        self.create_timer(1.0 / config.monitor.rate, self._diagnose, clock=STEADY)
        mode = "lockstep" if self.lockstep else f"at most {1.0 / self._dt:g} Hz"
        self.get_logger().info(f"{model.name}: {model.n} joints, rigid, {mode}")

    def _on_command(self, msg: JointState) -> None:
        command = self._commands.take_answer(msg, self._stamp)
        if command is None or command.effort is None or self._command is not None:
            return  # what answers a state first counts: a controller that hears nothing more says zero after it
        effort = clamp_effort(command.effort, self._model)
        now = self._ticks * self._dt
        self._command = BodyCommand(
            now,
            np.zeros(len(effort)),
            acceleration=np.zeros(6 + len(effort)),
            effort=effort,
            stance=self._stepping.stance(now),
            landing=self._stepping.landing(now, self._dt),
        )
        if self.lockstep:
            self._step()

    def _on_push(self, msg: WrenchStamped) -> None:
        """Hit the robot between this period and the next."""
        self._pushes.append(msg)

    def _hit(self) -> None:
        """Take each force times one second as the impulse [N s]; moments are not in (S23)."""
        log = self.get_logger()
        for msg in self._pushes:
            f = msg.wrench.force
            try:
                if not np.abs([f.x, f.y, f.z]).max() <= self._hardest:
                    raise PlantError(f"{f.x:g}, {f.y:g}, {f.z:g} N s are beyond {self._hardest:.0f} N s, or not finite")
                self._plant.push([f.x, f.y, f.z])
            except DqwalkError as error:
                log.error(f"push rejected: {error}")
                continue
            msg.header.stamp, msg.header.frame_id = ros.time_msg(self._stamp), ODOM
            self._pub["push_applied"].publish(msg)
            log.info(f"pushed: {f.x:g}, {f.y:g}, {f.z:g} N s")
        self._pushes.clear()

    def _on_period(self) -> None:
        if not self.lockstep:
            self._commands.log_motion()
        if self._command is not None:
            self._step()
        elif time.monotonic() - self._asked > _ASK_AGAIN and self._may_begin():
            self._publish()

    def _step(self) -> None:
        command, self._command = self._command, None
        if command is None:
            return
        try:
            self._plant.step(command, self._dt)
        except DqwalkError as error:
            self.get_logger().error(f"the plant failed: {error}")
            self.stop(1)
            return
        for foot, wrench in self._plant.wrenches.items():
            self._pub[f"{foot.value}_wrench"].publish(self._wrench(wrench))
        self._ticks += 1
        self._stamp = round(self._ticks * self._dt * 1e9)
        self._hit()
        self._publish()

    def _wrench(self, wrench: Wrench) -> WrenchStamped:
        msg = WrenchStamped()
        msg.header.stamp, msg.header.frame_id = ros.time_msg(self._stamp), ODOM
        force, torque = msg.wrench.force, msg.wrench.torque
        force.x, force.y, force.z = wrench.force.tolist()
        torque.x, torque.y, torque.z = wrench.moment.tolist()
        return msg

    def _may_begin(self) -> bool:
        """Hold the first state of a recorded walk until nothing of it can be lost."""
        if self._ticks or not self._wait:
            return True
        streams = ("joint_states", "base_pose", "base_twist", "left_wrench", "right_wrench")
        return all(ros.is_heard_by(self, self._pub[name], "recorder") for name in streams)

    def _publish(self) -> None:
        s = self._plant.state
        self._asked = time.monotonic()
        self._pub["base_pose"].publish(ros.pose(self._stamp, ODOM, s.x_base))
        twist = TwistStamped()
        twist.header.stamp, twist.header.frame_id = ros.time_msg(self._stamp), self._pelvis
        linear, angular = twist.twist.linear, twist.twist.angular
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = s.v_base.tolist()
        self._pub["base_twist"].publish(twist)
        self._pub["joint_states"].publish(self._write(self._stamp, position=s.q, velocity=s.dq))

    def _diagnose(self) -> None:
        level, text = self._commands.level()
        if self.lockstep and level == "WARN" and not self._commands.gate.rejected:  # it waits, and that is fine
            waits = self._commands.gate.watchdog.age
            level, text = ("OK", "in step") if waits < 2.0 else ("WARN", "waiting for a command")
        counts = {"ticks": self._ticks, **self._commands.counts()}
        self.diagnose("plant", self._model.name, level, text, counts, self._stamp)
