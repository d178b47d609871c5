"""Input of the plants: joint commands, checked on arrival.

`messages` decodes the messages, `command_gate` decides which are accepted.
"""

from __future__ import annotations

from collections.abc import Sequence

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode, throttled
from dqwalk_ros.nodes.command_gate import CommandGate
from dqwalk_ros.nodes.publishers import DuplicatePublishers
from dqwalk_ros.paper.state import Command
from dqwalk_ros.plants.base import stands_still
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.errors import ConfigError, StateError
from dqwalk_ros.support.topics import EFFORT, VELOCITY

_CHECK = 0.25
"""Period of the check for duplicate publishers [s]."""


class CommandInput:
    """Input of a plant: checks the messages of a command topic; the same for simulated plants and a real robot.

    Parameters
    ----------
    topic : str
        `VELOCITY`, or `EFFORT` for a plant that takes torques.

    Attributes
    ----------
    gate : CommandGate
    unable : str
        Why the plant cannot execute commands, although it does not refuse them; set by the plant.

    Raises
    ------
    ConfigError
        If ``plant.command_timeout`` is less than two periods in real time.
    """

    def __init__(self, node: WalkNode, model: RobotModel, topic: str = VELOCITY) -> None:
        if why := stands_still(node.config):
            raise ConfigError(why)
        self._node, self._topic = node, topic
        self.gate = CommandGate(model, lambda: node.config.plant.command_timeout, node.steady)
        self._reader = ros.JointReader(model.joint_names)
        self._duplicates = DuplicatePublishers(node.steady)
        self._publishers, self._resolved = 1, node.resolve_topic_name(topic)
        self._forbidden = self.unable = ""
        self._moving = False
        self._published_ready: bool | None = None
        reports = topic == VELOCITY and not node.lockstep  # where a plant holds, and says so
        self._ready = node.create_publisher(Bool, "plant_ready", ros.watched()) if reports else None
        self._warned = ""
        self._warnings = node.advertise("plant_warning") if topic == VELOCITY else None
        node.create_timer(_CHECK, self._check)
        node.add_on_set_parameters_callback(self._on_parameters)

    def forbid(self, reason: str) -> None:
        """Hold for a reason given by the plant; an empty reason allows motion again."""
        if reason == self._forbidden:
            return
        self._forbidden = reason
        self.gate.refused = reason or self.gate.refused
        self._check()

    def warn(self, reason: str) -> None:
        """Ask for the end of the walk, before the plant has to hold in mid-step; an empty reason withdraws it."""
        if reason == self._warned or self._warnings is None:
            return
        if not (reason and self._warned):
            log = self._node.get_logger()
            log.warning(f"the walk should end: {reason}") if reason else log.info("a walk may begin again")
        self._warned = reason
        self._warnings.publish(String(data=reason))

    def _on_parameters(self, wanted: Sequence[Parameter]) -> SetParametersResult:
        """Refuse a longer command timeout while the robot moves, and one with which it would never move."""
        now = self._node.config.plant.command_timeout
        for p in wanted:
            if p.name == "plant.command_timeout" and isinstance(p.value, float):
                timeout = min(max(p.value, 0.0), 10.0)  # else the schema refuses it
                if why := stands_still(self._node.config.updated({p.name: timeout})):
                    return SetParametersResult(successful=False, reason=why)
        longer = any(p.name == "plant.command_timeout" and isinstance(p.value, float) and p.value > now for p in wanted)
        if longer and not self.gate.holding:
            reason = f"'plant.command_timeout' can only be lowered while the robot moves, it is {now:g} s"
            return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def _check(self) -> None:
        """Hold while two controllers send commands."""
        names = ros.publishers_of(self._node, self._topic)
        duplicates = self._duplicates.judge(names)
        if not duplicates and self.gate.contradicted:
            duplicates = ", ".join(names)
        reason = self._forbidden or (f"two controllers: {duplicates}" if duplicates else "")
        if reason != self.gate.refused:
            self.gate.refused = reason
            log = self._node.get_logger()
            log.error(f"holding still: {reason}") if reason else log.info("commands are accepted")
        self._publish_ready()

    def close(self) -> None:
        """Say that no command is executed any more, of a robot that stays where it is without this node."""
        self.unable = "shut down"
        self._publish_ready()

    def _publish_ready(self) -> None:
        """Publish whether commands are executed, so that the controller does not continue without the robot."""
        ready = self.gate.ready and not self.unable
        if self._ready is not None and ready is not self._published_ready:
            self._published_ready = ready
            self._ready.publish(Bool(data=ready))

    def read(self, msg: JointState) -> Command | None:
        """Return the command of a message; None if the message is invalid, which has no effect but a log entry."""
        try:
            if self._topic == EFFORT:
                return self._reader.torques(msg)
            return self._reader.command(msg)
        except StateError as error:
            self.gate.rejected += 1
            text = f"{self._topic} rejected ({self.gate.rejected} so far): {error}"
            self._node.get_logger().error(text, **throttled())
            return None

    def take(self, msg: JointState, now: int) -> bool:
        """Process a message; `now` is the stamp of the last published state [ns]. Return whether it was accepted."""
        # a message does not contain its sender, but a publisher is discovered before its first message arrives
        if (publishers := self._node.count_publishers(self._resolved)) != self._publishers:
            self._publishers = publishers
            self._check()
        command = self.read(msg)
        if command is None:
            return False
        stamp, clock = ros.nanoseconds(msg.header.stamp), self._node.get_clock().now().nanoseconds
        if self.gate.accept(stamp, command.velocity, now, command.effort, clock=clock):
            return True
        text = f"{self._topic} ignored ({self.gate.late} so far): {self.gate.ignored}"
        self._node.get_logger().warning(text, **throttled())
        return False

    def take_answer(self, msg: JointState, now: int) -> Command | None:
        """Return a command in lockstep, which must have the stamp `now` of the last state [ns]; else None."""
        if ros.nanoseconds(msg.header.stamp) != now:
            self.gate.late += 1  # a second answer to a state that was published twice
            return None
        command = self.read(msg)
        if command is None:
            return None  # simulated time does not advance
        asked = command.effort if self._topic == EFFORT else command.velocity
        assert asked is not None
        accepted = self.gate.accept(now, asked, now, command.effort)
        return command if accepted and not self.gate.refused else None

    def log_motion(self) -> None:
        """Log when the plant begins to move or to hold."""
        moving = not self.gate.holding
        self._publish_ready()
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
        if self.unable:
            return "WARN", self.unable
        if self.gate.refused:
            return "ERROR", f"holding: {self.gate.refused}"
        if self.gate.watchdog.silent:
            if self._node.lockstep and not self.gate.rejected:  # simulated time stands still
                return ("OK", "lockstep") if self.gate.watchdog.age < 2.0 else ("WARN", "waiting for a command")
            text = f"commands are ignored: {self.gate.ignored}" if self.gate.ignored else "no commands"
            return "ERROR" if self.gate.rejected else "WARN", f"holding: {text}"
        if self._warned:
            return "WARN", f"the walk should end: {self._warned}"
        return "WARN" if self.gate.rejected else "OK", "moving"

    def counts(self) -> dict[str, object]:
        """Return the counters shown on /diagnostics."""
        return {"commands rejected": self.gate.rejected, "commands late": self.gate.late}
