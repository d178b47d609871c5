"""What comes into a node, checked: states with their inertial sensor, commands, cmd_vel.

What the messages say is read by `messages`, whether it counts is decided by `safety`.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from geometry_msgs.msg import Twist, TwistStamped
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Bool

from dqwalk_ros.errors import StateError
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import STEADY, THROTTLE, WalkNode
from dqwalk_ros.nodes.safety import CommandGate, DuplicatePublishers, Watchdog
from dqwalk_ros.robot import RobotModel
from dqwalk_ros.state import Command, State

if TYPE_CHECKING:
    from dqwalk_ros.controller import VelocityController

__all__ = ["EFFORT", "VELOCITY", "CommandInput", "InertialSensor", "Steering"]

VELOCITY, EFFORT = "joint_velocity_commands", "joint_effort_commands"
_LOOK = 0.25
"""Time between two looks at who publishes [s]."""
_LOOK_FOR_TYPES = 2.0
"""Time between two looks at how cmd_vel is published [s]."""
_STILL = (0.0, 0.0, 0.0)


class InertialSensor:
    """joint_states and imu: two messages that make one state.

    In lockstep a state waits for the imu message of its own stamp; in real time the newest one counts, as long as its
    stamp is within ``plant.command_timeout`` of the state's.

    Parameters
    ----------
    node : WalkNode
    frame : str
        Link of the sensor: messages of another frame are refused.
    again : callable
        Called with a state that had to wait.
    """

    def __init__(self, node: WalkNode, frame: str, again: Callable[[JointState], None]) -> None:
        self._node, self._frame, self._again = node, frame, again
        self._newest: Imu | None = None
        self._waiting: JointState | None = None
        node.listen(Imu, "imu", self._on_imu, ros.stream(1, reliable=node.lockstep))

    def _on_imu(self, msg: Imu) -> None:
        self._newest = msg
        waiting = self._waiting
        if waiting is not None and waiting.header.stamp == msg.header.stamp:
            self._waiting = None
            self._again(waiting)

    def join(self, msg: JointState, state: State) -> State | None:
        """Return a state with the newest reading; None in lockstep where that is still to come.

        Raises
        ------
        StateError
            If no reading came, it is too old, or it cannot be used.
        """
        newest = self._newest
        if self._node.lockstep:
            if newest is None or newest.header.stamp != msg.header.stamp:
                self._waiting = msg
                return None
        elif newest is None:
            raise StateError("imu: nothing came yet (plant.imu is true)")
        else:
            age = 1e-9 * abs(ros.nanoseconds(msg.header.stamp) - ros.nanoseconds(newest.header.stamp))
            if age > self._node.config.plant.command_timeout:
                raise StateError(f"imu: its stamp is {age:.3f} s away from the state's")
        if (given := newest.header.frame_id) not in ("", self._frame):
            raise StateError(f"imu: it is in the frame '{given}', and robot.imu is '{self._frame}': they must agree")
        up, gyro, acceleration = ros.inertial_of(newest)
        return dataclasses.replace(state, up=up, gyro=gyro, acceleration=acceleration)


class Steering:
    """cmd_vel steers a standing walk; when it stops coming, the walk stops with the feet together.

    Parameters
    ----------
    node : WalkNode
    controller : Controller
        Of a standing walk without a number of steps.
    clock : callable
        Steady time [s].
    """

    def __init__(
        self, node: WalkNode, controller: VelocityController, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._node, self._controller = node, controller
        self._watchdog = Watchdog(lambda: node.config.gait.cmd_vel_timeout, clock)
        self._asked = self._walked = _STILL
        self._heard = False
        self.rejected = 0
        if node.config.node.stamped_cmd_vel:
            node.listen(TwistStamped, "cmd_vel", lambda msg: self._on_twist(msg.twist), ros.stream(1))
        else:
            node.listen(Twist, "cmd_vel", self._on_twist, ros.stream(1))
        node.create_timer(_LOOK_FOR_TYPES, self._look_for_types, clock=STEADY)

    def _look_for_types(self) -> None:
        """Warn of a publisher whose messages never come, because they are of the other type."""
        stamped = self._node.config.node.stamped_cmd_vel
        other = "geometry_msgs/msg/Twist" if stamped else "geometry_msgs/msg/TwistStamped"
        ends = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name("cmd_vel"))
        if names := [end.node_name for end in ends if end.topic_type == other]:
            text = f"cmd_vel of {', '.join(names)} is a {other}: set node.stamped_cmd_vel to {str(not stamped).lower()}"
            self._node.get_logger().error(text, throttle_duration_sec=10.0, throttle_time_source_type=STEADY)

    def _on_twist(self, msg: Twist) -> None:
        asked = (msg.linear.x, msg.linear.y, msg.angular.z)
        if not all(map(math.isfinite, asked)):
            self.rejected += 1
            self._node.get_logger().error(f"cmd_vel rejected ({self.rejected} so far): not finite", **THROTTLE)
            return
        self._asked = asked
        self._watchdog.feed()

    def apply(self) -> None:
        """Steer the walk by what came last, and not at all where that is too old."""
        silent = self._watchdog.silent
        if silent and self._heard:
            self._node.get_logger().info("cmd_vel fell silent: the feet are put together")
        self._heard = not silent
        asked = _STILL if silent else self._asked
        walked = self._controller.steer(*asked)
        if walked != self._walked:
            self._walked = walked
            off = max(abs(a - b) for a, b in zip(asked, walked, strict=True))
            cut = " (as far as the legs go)" if off > 1e-6 else ""
            x, y, turn = walked
            self._node.get_logger().info(f"steered: {x:.4f} m/s forward, {y:.4f} m/s left, {turn:.4f} rad/s{cut}")

    def values(self) -> dict[str, object]:
        """Return what /diagnostics shows."""
        names = ("forward", "left", "turn")
        asked = {f"cmd_vel/{name}": value for name, value in zip(names, self._asked, strict=True)}
        walked = {f"steered/{name}": value for name, value in zip(names, self._walked, strict=True)}
        return {**asked, **walked, "cmd_vel rejected": self.rejected}


class CommandInput:
    """The one way from a topic of commands to a plant, the same for the simulated ones and the robot.

    Parameters
    ----------
    node : WalkNode
    model : RobotModel
    topic : str
        `VELOCITY`, or `EFFORT` for a plant that takes torques.

    Attributes
    ----------
    gate : CommandGate
    able : bool
        Whether the plant can do what it is told, for all that it knows itself.
    """

    def __init__(self, node: WalkNode, model: RobotModel, topic: str = VELOCITY) -> None:
        self._node, self._topic = node, topic
        self.gate = CommandGate(model, lambda: node.config.plant.command_timeout)
        self._reader = ros.JointReader(model.joint_names)
        self._duplicates = DuplicatePublishers()
        self._publishers, self._resolved = 1, node.resolve_topic_name(topic)
        self._forbidden = ""
        self._moving = False
        self.able = True
        self._said: bool | None = None
        self._ready = node.create_publisher(Bool, "plant_ready", ros.latched()) if topic == VELOCITY else None
        node.create_timer(_LOOK, self._look, clock=STEADY)
        node.add_on_set_parameters_callback(self._on_parameters)

    def forbid(self, reason: str) -> None:
        """Hold for a reason of the plant's own, until it is empty."""
        self._forbidden = reason
        self.gate.refused = reason or self.gate.refused
        self._look()

    def _on_parameters(self, wanted: Sequence[Parameter]) -> SetParametersResult:
        """Let nobody switch the watchdog off while it is needed."""
        now = self._node.config.plant.command_timeout
        longer = any(p.name == "plant.command_timeout" and isinstance(p.value, float) and p.value > now for p in wanted)
        if longer and not self.gate.holding:
            reason = f"'plant.command_timeout' can only be lowered while the robot moves, it is {now:g} s"
            return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def _look(self) -> None:
        """Hold where two controllers command."""
        names = ros.other_publishers(self._node, self._topic)
        duplicates = self._duplicates.judge(names)
        if not duplicates and self.gate.contradicted:
            duplicates = ", ".join(names)
        reason = self._forbidden or (f"two controllers: {duplicates}" if duplicates else "")
        if reason != self.gate.refused:
            self.gate.refused = reason
            log = self._node.get_logger()
            log.error(f"holding still: {reason}") if reason else log.info("commands count")
        self._tell_ready()

    def _tell_ready(self) -> None:
        """Tell the controller whether its commands count, so that it does not walk on without the robot."""
        ready = self.gate.ready and self.able
        if self._ready is not None and not self._node.lockstep and ready is not self._said:
            self._said = ready
            self._ready.publish(Bool(data=ready))

    def read(self, msg: JointState) -> Command | None:
        """Return what a message asks for; None where it is rejected, which leaves everything as it was."""
        try:
            if self._topic == EFFORT:
                return self._reader.torques(msg)
            return self._reader.command(msg)
        except StateError as error:
            self.gate.rejected += 1
            text = f"{self._topic} rejected ({self.gate.rejected} so far): {error}"
            self._node.get_logger().error(text, **THROTTLE)
            return None

    def take(self, msg: JointState, now: int) -> bool:
        """Take in a message; `now` is the stamp of the state published last [ns]. Return whether it counts."""
        # nothing tells who sent a message, but a publisher is known before its first message comes
        if (publishers := self._node.count_publishers(self._resolved)) != self._publishers:
            self._publishers = publishers
            self._look()
        command = self.read(msg)
        if command is None:
            return False
        stamp, clock = ros.nanoseconds(msg.header.stamp), self._node.get_clock().now().nanoseconds
        if self.gate.accept(stamp, command.velocity, now, command.effort, clock=clock):
            return True
        text = f"{self._topic} ignored ({self.gate.late} so far): {self.gate.ignored}"
        self._node.get_logger().warning(text, **THROTTLE)
        return False

    def take_answer(self, msg: JointState, now: int) -> Command | None:
        """Return the command that answers the very state with the stamp `now` [ns]: lockstep; None for any other."""
        if ros.nanoseconds(msg.header.stamp) != now:
            self.gate.late += 1  # the answer to a state that was asked for twice
            return None
        command = self.read(msg)
        if command is None:
            return None  # time stands still
        asked = command.effort if self._topic == EFFORT else command.velocity
        assert asked is not None
        counts = self.gate.accept(now, asked, now, command.effort)
        return command if counts and not self.gate.refused else None

    def log_motion(self) -> None:
        """Log when the plant begins to move or to hold."""
        moving = not self.gate.holding
        self._tell_ready()
        if moving is not self._moving:
            self._moving = moving
            log = self._node.get_logger()
            if moving:
                log.info("commands arrive: moving")
            else:
                timeout = self._node.config.plant.command_timeout
                log.warning(f"holding still: {self.gate.refused or f'no command for {timeout:g} s'}")

    def level(self) -> tuple[str, str]:
        """Return level and text for /diagnostics."""
        if self.gate.refused:
            return "ERROR", f"holding: {self.gate.refused}"
        if self.gate.watchdog.silent:
            text = f"commands are ignored: {self.gate.ignored}" if self.gate.ignored else "no commands"
            return "ERROR" if self.gate.rejected else "WARN", f"holding: {text}"
        return "WARN" if self.gate.rejected else "OK", "moving"

    def counts(self) -> dict[str, object]:
        """Return what happened so far, for /diagnostics."""
        return {"commands rejected": self.gate.rejected, "commands late": self.gate.late}
