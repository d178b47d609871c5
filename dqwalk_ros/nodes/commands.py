"""Commands as every plant takes them, velocities or torques: checked, watched, and clamped at last."""

from __future__ import annotations

from rclpy.node import Node
from sensor_msgs.msg import JointState

from dqwalk_ros.controllers import Command
from dqwalk_ros.errors import StateError
from dqwalk_ros.model import RobotModel
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.parameters import Parameters
from dqwalk_ros.nodes.runtime import STEADY, Throttle
from dqwalk_ros.safety import CommandGate, Rivals

__all__ = ["Commands"]

_LOOK = 0.25
"""Time between two looks at who publishes [s]."""


class Commands:
    """The one way from the topic to a plant, the same for the integrator, the physics and the robot.

    Parameters
    ----------
    node : rclpy.node.Node
    model : RobotModel
    parameters : Parameters
    topic : str
        ``joint_velocity_commands``, or ``joint_effort_commands`` for a plant that takes torques.

    Attributes
    ----------
    gate : CommandGate
    """

    def __init__(
        self, node: Node, model: RobotModel, parameters: Parameters, topic: str = "joint_velocity_commands"
    ) -> None:
        self._node, self._parameters, self._topic = node, parameters, topic
        self.gate = CommandGate(model, lambda: parameters.config.plant.command_timeout)
        self._reader = ros.JointReader(model.joint_names)
        self._rivals = Rivals()
        self._forbidden = ""
        self._moving = False
        self._warn_now = Throttle(2.0)
        node.create_timer(_LOOK, self._look, clock=STEADY)

    def forbid(self, reason: str) -> None:
        """Hold for a reason of the plant's own, until it is empty."""
        self._forbidden = reason
        self.gate.refused = reason or self.gate.refused
        self._look()

    def _look(self) -> None:
        """Hold where two controllers command."""
        names = ros.others(self._node, self._topic)
        rivals = self._rivals.judge(names)
        if not rivals and self.gate.contradicted:
            rivals = ", ".join(names)
        reason = self._forbidden or (f"two controllers: {rivals}" if rivals else "")
        if reason != self.gate.refused:
            self.gate.refused = reason
            log = self._node.get_logger()
            log.error(f"holding still: {reason}") if reason else log.info("commands count")

    def checked(self, msg: JointState) -> Command | None:
        """Return what a message asks for; None where it is rejected, which leaves everything as it was."""
        try:
            if self._topic == "joint_effort_commands":
                return self._reader.torques(msg)
            return self._reader.command(msg)
        except StateError as error:
            self.gate.rejected += 1
            if self._warn_now():
                self._node.get_logger().error(f"{self._topic} rejected ({self.gate.rejected} so far): {error}")
            return None

    def take(self, msg: JointState, now: int) -> bool:
        """Take in a message; `now` is the stamp of the state published last [ns]. Return whether it counts."""
        command = self.checked(msg)
        if command is None:
            return False
        return self.gate.accept(ros.nanoseconds(msg.header.stamp), command.velocity, now, command.effort)

    def note_motion(self) -> bool:
        """Log when the plant begins to move or to hold; return whether it holds."""
        moving = not self.gate.holding
        if moving is not self._moving:
            self._moving = moving
            log = self._node.get_logger()
            if moving:
                log.info("commands arrive: moving")
            else:
                timeout = self._parameters.config.plant.command_timeout
                log.warning(f"holding still: {self.gate.refused or f'no command for {timeout:g} s'}")
        return not moving

    def level(self) -> tuple[str, str]:
        """Return level and text for /diagnostics."""
        if self.gate.refused:
            return "ERROR", f"holding: {self.gate.refused}"
        if self.gate.watchdog.silent:
            return "ERROR" if self.gate.rejected else "WARN", "holding: no commands"
        return "WARN" if self.gate.rejected else "OK", "moving"

    def counts(self) -> dict[str, object]:
        """Return what happened so far, for /diagnostics."""
        return {"commands rejected": self.gate.rejected, "commands late": self.gate.late}
