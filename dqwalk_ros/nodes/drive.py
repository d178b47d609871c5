"""Converts the commands of the walk for the controllers of any robot, such as those of ros2_control.

The positions are those of `plants.servo_goals`. A velocity interface gets the velocity that leads to them from where
those sent before lead, each for as long as it is in effect: the robot's controller writes it when it publishes the next
state, and until it does so again, also where a period is missed.
"""

from __future__ import annotations

import argparse
import array
import math
from collections import deque
from typing import Any

import numpy as np
from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes import wheels
from dqwalk_ros.nodes.base import WalkNode, throttled
from dqwalk_ros.nodes.command_input import CommandInput
from dqwalk_ros.nodes.publishers import FirstPublisher
from dqwalk_ros.nodes.robot_controllers import RobotControllers
from dqwalk_ros.nodes.watchdog import ClockSteps
from dqwalk_ros.plants.robot_output import commanded_joints, output_topic
from dqwalk_ros.plants.servo_goals import JUMPS, ServoGoals
from dqwalk_ros.robot.limits import outside_limits
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import StateError
from dqwalk_ros.support.topics import VELOCITY

_TYPES = {
    "float64_multi_array": Float64MultiArray,
    "joint_trajectory": JointTrajectory,
    "joint_state": JointState,
}
_CHECK = 0.02
"""Period of the check whether states and commands still arrive [s]."""
_REPEATED = 1.0
"""Time for which the command to hold still is repeated [s]."""
_PERIODS = 2.0
"""Largest number of periods for which one command moves the robot: lost time is not made up for."""


class RobotDrive(WalkNode):
    """Drive a robot of your own: send the walk's commands to the topic of its controllers, with a watchdog.

    The robot's joint_state_broadcaster publishes joint_states, to which the controller of the walk subscribes. This
    node converts joint_velocity_commands for the robot's forward_command_controller. That controller repeats its last
    command forever, so without a command or a state for plant.command_timeout this node commands the robot to hold
    still: it repeats the last positions, or sends zero velocity. It sends nothing before the first command, and begins
    at angles on which three states in a row agree. A joint that jumps to another angle, or moves against its full
    torque, stops the robot until ~/reset.

    Subscribes to::

        joint_velocity_commands  sensor_msgs/JointState [rad/s]; effort [N m] is fed forward as angles
        joint_states             sensor_msgs/JointState [rad]: measured angles
        /diagnostics             diagnostic_msgs/DiagnosticArray of a controller_manager: which controllers are active

    Publishes, depending on output.type, output.interface and output.topic::

        forward_position_controller/commands           std_msgs/Float64MultiArray [rad], in the order of output.joints
        forward_velocity_controller/commands           the same [rad/s]
        joint_trajectory_controller/joint_trajectory   trajectory_msgs/JointTrajectory of one point [rad]
        joint_commands                                 sensor_msgs/JointState [rad or rad/s]
        plant_ready              std_msgs/Bool, latched: whether states arrive, and that topic has a subscriber, which
                                 for a Float64MultiArray must have the joints and the interface of `output`
        /diagnostics             diagnostic_msgs/DiagnosticArray

    Services::

        ~/reset                  std_srvs/Trigger: begin again at the measured angles, with the next command

    Sections of the schema: dt, robot, plant, servo, monitor.rate, safety.outside, output.

    The defaults are those of config/plants/ros2_control.yaml.

    Example::

        dqwalk_drive --ros-args --params-file config/poppy.yaml -p output.interface:=velocity

    Raises
    ------
    ConfigError
        In lockstep, or if the section `output` is invalid.
    """

    claims = "plant_ready"

    def __init__(self, options: argparse.Namespace, **keywords: Any) -> None:
        super().__init__("drive", options, **keywords)
        config = self.config
        self._model = load_model(config.robot)
        o, own = config.output, self._model.joint_names
        self._joints = commanded_joints(config, self._model)
        self._own = np.array([self._joints.index(name) for name in own])  # the joints of the walk among them
        self._output = self.create_publisher(_TYPES[o.type], output_topic(config), 1)
        self._commands = CommandInput(self, self._model)
        self._commands.unable = "starting"
        self._reader = ros.JointReader(self._joints)
        self._source = FirstPublisher(lambda: self.config.plant.command_timeout, self.steady)
        self._time, self._clock_was = 0.0, math.inf
        self._law = ServoGoals.of(config, self._model, lambda: self.config.plant.command_timeout)
        self._recent: deque[Array] = deque(maxlen=JUMPS)  # measured angles of all joints (N,) [rad]
        self._rest = np.zeros(len(self._joints))  # where the other joints stay [rad]
        self._stamp, self._steps = -1, ClockSteps()  # of the last state [ns]
        self._moved = self._stopped = 0.0  # times of the last command, and since when the robot holds still [s]
        self._blind = ""  # why no command can have an effect
        unnamed = self._joints if o.type == "float64_multi_array" else ()
        self._controllers = RobotControllers(self, self._output, unnamed, o.interface, self.steady)
        self._last: Array | None = None  # values sent last
        self._led, self._holds, self._next = np.zeros((3, len(own)))  # by velocity: see `_lead_to`
        self._rejected, self._invalid = 0, ""  # states, and why the first one since the last valid one
        self.offer("~/reset", self._reset)
        self.listen(JointState, "joint_states", wheels.numbered(self._on_state), ros.best_effort(1))
        self.create_subscription(JointState, VELOCITY, self._on_command, 1)
        self.create_timer(_CHECK, self._check)
        self.create_timer(1.0 / config.monitor.rate, self._diagnose)
        description = f"{len(self._joints)} joints on {self._output.topic_name}, {o.interface} as {o.type}"
        self.get_logger().info(f"{self._model.name}: {description}")

    def _on_state(self, msg: JointState, number: int) -> None:
        if self._reader.is_foreign(msg):
            return
        try:
            q = self._reader.state(msg).q
            if self._source.is_another(number):
                others = ", ".join(ros.publishers_of(self, "joint_states"))
                raise StateError(f"overtaken by another one, or of a second publisher: {others} publish them")
            if outside := outside_limits(q[self._own], self._model, self.config.safety.outside):
                raise StateError(f"outside the joint limits: {outside}")
        except StateError as error:
            self._rejected, self._invalid = self._rejected + 1, self._invalid or f": {error}"
            self.get_logger().error(f"joint_states rejected ({self._rejected} so far): {error}", **throttled())
            return
        now, stamp = self._now(), ros.nanoseconds(msg.header.stamp)
        if stamp and not self._follows(stamp, now):
            return
        self._stamp, self._invalid = stamp, ""
        self._recent.append(q)
        self._law.measure(q[self._own], now)
        if self._law.fault:
            self._check()

    def _follows(self, stamp: int, now: float) -> bool:
        """Return whether the stamp of a state [ns] is not that of the last one, out of order, or wrong."""
        gate, passed = self._law.gate, 1e-9 * (stamp - self._stamp)
        longest = gate.age(now) + self.config.plant.command_timeout
        follows = self._stamp <= 0 or not gate.fresh(now) or 0.0 < passed <= longest
        return passed != 0.0 and self._steps.accepts(stamp, follows=follows)

    def _on_command(self, msg: JointState) -> None:
        self._look()
        if self._blind or not self._commands.take(msg, self._stamp) or self._commands.gate.holding:
            return  # without states no command feeds the watchdog
        now, gate, period = self._now(), self._commands.gate, self.config.dt
        if not self._law.active:
            self._law.begin(held=self._law.goal if self.config.output.interface == "position" else None)
            self._rest = np.median(self._recent, axis=0)
            self._moved = now - period
            self._rest_at(self._law.goal)
        passed = now - self._moved
        dt = min(passed, _PERIODS * period)
        u, before = gate.velocity(self._law.wanted, dt), self._law.goal
        if dt <= 0.0:  # a clock that did not advance: only a stop has an effect
            if not u.any():
                self._stay()
            return
        self._law.command(u, gate.effort, now, dt)
        self._moved = self._stopped = now
        if self.config.output.interface == "position":
            out = self._rest.copy()  # joints that the walk does not move stay where they were
            out[self._own], _ = self._law.output(now)
        else:
            out = np.zeros_like(self._rest)
            out[self._own] = self._lead_to(self._law.goal, (self._law.goal - before) / dt, passed)
        self._publish(out)

    def _lead_to(self, goal: Array, asked: Array, passed: float) -> Array:
        """Return the velocities (n,) [rad/s] that lead to positions [rad], `passed` [s] after the last command.

        `_led` is where the joints have been led until now [rad]; `_holds` is in effect from now on, for a period. A
        joint that was led too far waits: it moves neither against the velocity `asked` for [rad/s], nor at more than
        twice that.
        """
        fastest, twice = self._model.velocity_max, 2.0 * asked
        self._led = self._led + passed * self._holds
        self._holds = self._next
        wanted = (goal - self._led) / self.config.dt - self._holds
        least, most = np.maximum(np.minimum(twice, 0.0), -fastest), np.minimum(np.maximum(twice, 0.0), fastest)
        self._next = np.clip(wanted, least, most)
        return self._next

    def _rest_at(self, q: Array) -> None:
        """Catch up nothing: take joints for led to `q` (n,) [rad]."""
        self._led, self._holds, self._next = q, np.zeros_like(q), np.zeros_like(q)

    def _check(self) -> None:
        """Command the robot to hold still while it must; repeatedly, because a message may be lost."""
        self._commands.log_motion()
        self._controllers.look()
        self._look()
        if self._blind or self._commands.gate.holding:
            self._stay()

    def _look(self) -> None:
        """Find out whether commands can have an effect."""
        gate, fault, before = self._law.gate, self._law.fault, self._blind
        if self._stamp < 0:
            self._blind = f"no valid joint_states yet{self._invalid}"
        elif clock := self.time_trouble():
            self._blind = clock
        elif fault:
            advice = "unless another controller moves it, switch its torque off, which this node cannot"
            if gate.fault:
                others = ros.publishers_of(self, "joint_states")
                more = f", and that only one of {', '.join(others)} publishes it" if len(others) > 1 else ""
                advice = f"check its sensor{more}"
            self._blind = f"{fault}: {advice}, then ~/reset"
        elif not gate.known:
            self._blind = f"{JUMPS} joint_states that agree have not arrived yet"
        elif not gate.fresh(self._now()):
            self._blind = f"no valid joint_states for {self.config.plant.command_timeout:g} s{self._invalid}"
        else:
            self._blind = self._controllers.trouble
        if self._law.active and self._blind not in ("", before):
            self.get_logger().error(f"stopping: {self._blind}")
        self._commands.forbid(self._blind if self._law.active or fault else "")
        self._commands.unable = self._blind if not self._commands.gate.refused else ""

    def _stay(self) -> None:
        """Command the robot to hold still, by the last positions or by zero velocity; later command nothing."""
        if self._last is not None and self._law.active:
            position = self.config.output.interface == "position"
            if not (position and self._controllers.trouble):  # positions in a wrong order are a motion
                self._publish(self._last if position else np.zeros_like(self._last))
            self._rest_at(self._law.goal)
            if self._now() - self._stopped > _REPEATED:
                self._law.end()  # the robot may be switched off and moved by hand

    def _reset(self) -> tuple[bool, str]:
        self._stay()
        self._commands.gate.hold()
        self._law.forget()
        return True, "the next command begins at the measured angles"

    def _now(self) -> float:
        """Return the time by which the robot moves [s]: the steady clock, or /clock with use_sim_time.

        A step back of /clock takes no time.
        """
        time = 1e-9 * self.get_clock().now().nanoseconds if self.uses_sim_time else self.steady()
        self._time += max(time - self._clock_was, 0.0)
        self._clock_was = time
        return self._time

    def _publish(self, values: Array) -> None:
        """Publish commands of the joints (N,) [rad or rad/s] that answer the last state."""
        self._last = values
        o, data = self.config.output, array.array("d", values.tobytes())
        if o.type == "float64_multi_array":
            self._output.publish(Float64MultiArray(data=data))
        elif o.type == "joint_trajectory":
            after = Duration(seconds=self.config.dt).to_msg()
            point = JointTrajectoryPoint(positions=data, time_from_start=after)
            self._output.publish(JointTrajectory(joint_names=list(self._joints), points=[point]))  # stamp 0: at once
        else:
            header = ros.header(self._stamp)
            self._output.publish(JointState(header=header, name=list(self._joints), **{o.interface: data}))

    def _diagnose(self) -> None:
        level, text = self._commands.level()
        if not self.uses_sim_time and self.count_publishers("/clock"):
            own = "/clock is published, but use_sim_time is false: a simulated robot would move at another speed"
            self.get_logger().warning(own, **throttled(30.0))
            level, text = ("WARN", own) if level == "OK" else (level, text)
        values = {"states rejected": self._rejected, "angles rejected": self._law.gate.rejected}
        self.diagnose("plant", self._model.name, level, text, values | self._commands.counts(), max(self._stamp, 0))

    def close(self) -> None:
        """Command the robot to hold still, because its controllers repeat the last command."""
        self._commands.close()
        self._stay()
