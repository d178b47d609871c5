"""Converts the commands of the walk for the controllers of any robot, such as those of ros2_control.

Commanded velocities are integrated to positions near the measured ones, and torques are converted to angles that are
added to them (`plants.bus`). A velocity interface gets the velocity that leads to those positions.
"""

from __future__ import annotations

import argparse
import array
import dataclasses
from typing import Any

import numpy as np
from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode, throttled
from dqwalk_ros.nodes.inputs import VELOCITY, CommandInput
from dqwalk_ros.plants.bus import Bus
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.robot.servos import Drive, Servos
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ConfigError, StateError

__all__ = ["RobotDrive"]


_TOPICS = {
    ("float64_multi_array", "velocity"): "forward_velocity_controller/commands",
    ("float64_multi_array", "position"): "forward_position_controller/commands",
    ("joint_trajectory", "position"): "joint_trajectory_controller/joint_trajectory",
    ("joint_state", "velocity"): "joint_commands",
    ("joint_state", "position"): "joint_commands",
}
"""Default topics of ros2_control's controllers and of its joint_state_topic_hardware_interface."""
_TYPES = {
    "float64_multi_array": Float64MultiArray,
    "joint_trajectory": JointTrajectory,
    "joint_state": JointState,
}
_CHECK = 0.02
"""Period of the check for a command timeout [s]."""
_PERIODS = 2.0
"""Largest number of periods for which one command moves the robot: lost time is not made up for."""


class RobotDrive(WalkNode):
    """Drive a robot of your own: send the walk's commands to the topic of its controllers, with a watchdog.

    The robot's joint_state_broadcaster publishes joint_states, to which the controller of the walk subscribes. This
    node converts joint_velocity_commands for the robot's forward_command_controller. That controller repeats its last
    command for ever, so without a command for plant.command_timeout this node commands the robot to stay where it is.
    It sends nothing to the robot before the first command.

    Subscribes to::

        joint_velocity_commands  sensor_msgs/JointState [rad/s]; effort [N m] is fed forward as angles
        joint_states             sensor_msgs/JointState [rad]: measured angles

    Publishes, depending on output.type, output.interface and output.topic::

        forward_position_controller/commands           std_msgs/Float64MultiArray [rad], in the order of output.joints
        forward_velocity_controller/commands           the same [rad/s]
        joint_trajectory_controller/joint_trajectory   trajectory_msgs/JointTrajectory of one point [rad]
        joint_commands                                 sensor_msgs/JointState [rad or rad/s]
        plant_ready              std_msgs/Bool, latched: whether that topic has a subscriber, and states arrive
        /diagnostics             diagnostic_msgs/DiagnosticArray

    Sections of the schema: dt, robot, plant, servo, monitor.rate, output.

    Example::

        dqwalk_drive --ros-args --params-file config/poppy.yaml -p output.interface:=velocity

    Raises
    ------
    ConfigError
        In lockstep, or if the section `output` is invalid.
    """

    def __init__(self, options: argparse.Namespace, **keywords: Any) -> None:
        super().__init__("drive", options, **keywords)
        config = self.config
        if config.plant.lockstep:
            raise ConfigError("'plant.lockstep' must be false: a robot does not wait for its command")
        self._model = load_model(config.robot)
        o, own = config.output, self._model.joint_names
        if o.type == "joint_trajectory" and o.interface == "velocity":
            raise ConfigError("'output.type' joint_trajectory needs 'output.interface' position")
        self._joints = o.joints or own  # of the robot's controllers
        if missing := [name for name in own if name not in self._joints]:
            raise ConfigError(f"'output.joints' lacks {', '.join(missing)}, which the walk moves")
        if len(set(self._joints)) < len(self._joints):
            raise ConfigError("'output.joints' names a joint twice")
        self._own = np.array([self._joints.index(name) for name in own])  # the joints of the walk among them
        topic = o.topic or _TOPICS[o.type, o.interface]
        self._output = self.create_publisher(_TYPES[o.type], topic, 1)
        self._commands = CommandInput(self, self._model)
        self._commands.unable = "starting"
        self._reader = ros.JointReader(self._joints)
        self._measured = self._rest = np.zeros(len(self._joints))  # now, and at the first command [rad]
        self._stamp = self._moved = -1  # of the last state, and of the command that moved the robot last [ns]
        self._goals: Bus | None = None  # None before the first command
        self._commanded = np.zeros(self._model.n)  # angles at the end of the last command [rad]
        self._rejected = 0
        self.listen(JointState, "joint_states", self._on_state, ros.best_effort(1))
        self.create_subscription(JointState, VELOCITY, self._on_command, 1)
        self.create_timer(_CHECK, self._check)
        self.create_timer(1.0 / config.monitor.rate, self._diagnose)
        description = f"{len(self._joints)} joints on {self._output.topic_name}, {o.interface} as {o.type}"
        self.get_logger().info(f"{self._model.name}: {description}")

    def _on_state(self, msg: JointState) -> None:
        if self._reader.is_foreign(msg):
            return
        try:
            self._measured = self._reader.state(msg).q
        except StateError as error:
            self._rejected += 1
            self.get_logger().error(f"joint_states rejected ({self._rejected} so far): {error}", **throttled())
            return
        self._stamp = ros.nanoseconds(msg.header.stamp)

    def _on_command(self, msg: JointState) -> None:
        if self._stamp < 0 or not self._commands.take(msg, self._stamp) or self._commands.gate.holding:
            return
        # the time since the previous command; a command without a stamp gets that of the last state
        at = ros.nanoseconds(msg.header.stamp) or self._stamp
        dt = min(1e-9 * max(at - self._moved, 0), _PERIODS * self.config.dt)
        if dt > 0.0 or not any(msg.velocity):
            self._moved = at
            self._send(dt)

    def _check(self) -> None:
        """Command the robot to stay while it must hold; repeatedly, because a message may be lost."""
        self._commands.log_motion()
        if self._goals is not None and self._commands.gate.holding:
            self._send(0.0)
        self._commands.unable = ""
        if self._stamp < 0:
            self._commands.unable = "no joint_states yet"
        elif not self._output.get_subscription_count():
            topic = self._output.topic_name
            self._commands.unable = f"no node subscribes to {topic}: is the robot's controller active?"

    def _send(self, dt: float) -> None:
        """Command the robot to move for `dt` [s] with the commanded velocities; with 0 to stay."""
        model, gate, q = self._model, self._commands.gate, self._measured[self._own]
        if self._goals is None:
            self._goals = self._make_goals(q)
            self._commanded, self._rest = q.copy(), self._measured.copy()
            dt = self.config.dt
        u = gate.velocity(self._goals.wanted, dt)
        self._goals.command(u, gate.effort, q, 1e-9 * self._stamp, dt)
        goals, _ = self._goals.output(1e-9 * self._stamp)
        if self.config.output.interface == "position":
            out = self._rest.copy()  # joints that the walk does not move stay where they were
            out[self._own] = goals
        else:
            out, period = np.zeros_like(self._rest), self.config.dt
            if dt > 0.0:
                v = np.clip((goals - self._commanded) / period, -model.velocity_max, model.velocity_max)
                self._commanded = self._commanded + period * v
                out[self._own] = v
        self._publish(out)

    def _publish(self, values: Array) -> None:
        """Publish commands of the joints (N,) [rad or rad/s] that answer the last state."""
        o, data = self.config.output, array.array("d", values.tobytes())
        if o.type == "float64_multi_array":
            self._output.publish(Float64MultiArray(data=data))
        elif o.type == "joint_trajectory":
            after = Duration(seconds=self.config.dt).to_msg()
            point = JointTrajectoryPoint(positions=data, time_from_start=after)
            self._output.publish(JointTrajectory(joint_names=list(self._joints), points=[point]))  # stamp 0: at once
        else:
            msg = JointState(name=list(self._joints), **{o.interface: data})
            msg.header.stamp = ros.time_msg(self._stamp)
            self._output.publish(msg)

    def _make_goals(self, q: Array) -> Bus:
        """Return the integrator of the commands, from the angles q (n,) [rad]: a bus without delay and rounding."""
        direct = self.config.updated({"servo.rate": 0.0, "servo.latency": 0.0})
        model, drive = self._model, Drive.of(self.config, self._model)
        servos = dataclasses.replace(Servos.of(direct, model), resolution=np.zeros(model.n))
        return Bus(direct.servo, servos, drive, q, model.q_min, model.q_max)

    def _diagnose(self) -> None:
        level, text = self._commands.level()
        values = {"states rejected": self._rejected, **self._commands.counts()}
        self.diagnose("plant", self._model.name, level, text, values, max(self._stamp, 0))

    def close(self) -> None:
        """Command the robot to stay, because its controllers repeat the last command."""
        if self._goals is not None:
            self._commands.gate.hold()
            self._send(0.0)
