"""Listens for `dqwalk doctor` to the topics of a robot that stands; it publishes nothing."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Bool, String

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes import wheels
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import StateError
from dqwalk_ros.support.topics import VELOCITY

_DISCOVERY = 5.0
"""Time within which a publisher is discovered [s]."""
_LATCHED = 20.0
"""Longest wait for the latched message of a publisher that was discovered [s]."""


@dataclass
class Heard:
    """The messages that were received."""

    seconds: float
    """Duration of the listening [s]."""
    states: list[tuple[JointState, int]] = field(default_factory=list)
    """With the time of receipt [ns]."""
    imus: list[tuple[Imu, int]] = field(default_factory=list)
    """With the time of receipt [ns]."""
    errors: dict[str, str] = field(default_factory=dict)
    """Messages of /diagnostics at the level ERROR, by name of the status."""
    backs: int = 0
    """How often a message of joint_states had a smaller number of its publisher than the one before it with the same
    joints: once if the publisher was restarted, more often if there are two."""
    ready: bool | None = None
    """Value of plant_ready; None if it is not published."""
    plant: str = ""
    """Last message of the plant on /diagnostics."""
    warning: str = ""
    """Value of plant_warning."""
    publishers: tuple[str, ...] = ()
    subscribers: tuple[str, ...] = ()
    """Nodes that publish joint_states, and that subscribe to the commands."""
    phase: str = ""
    """Last value of `phase`; empty if it is not published."""
    moving: bool = False
    """Whether a command other than zero was received."""
    controllers: tuple[str, ...] = ()
    """Nodes that publish the commands."""
    diagnosed: bool = False
    """Whether a message of /diagnostics was received."""
    unheard: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Latched topics that are published, but of which no message was received, and their publishers."""
    simulated: bool = False
    """Whether the plant is a simulation, whose stamps count its own time."""

    def angles(self, model: RobotModel) -> Array:
        """Return the angles (n,) of the last state [rad].

        Raises
        ------
        StateError
            If no state was received, or it is invalid.
        """
        if not self.states:
            raise StateError("no joint_states received")
        return ros.JointReader(model.joint_names).state(self.states[-1][0]).q


class Doctor(Node):
    """Collects in `heard` what the topics of a robot say."""

    def __init__(self, context: Context, namespace: str = "") -> None:
        super().__init__("doctor", namespace=namespace, context=context)
        self.heard = heard = Heard(0.0)
        self._latched: set[str] = set()  # topics of which a message was received
        best_effort = ros.best_effort(100)
        self._numbers: dict[frozenset[str], int] = {}  # of the last message with these joints
        self.create_subscription(JointState, "joint_states", wheels.numbered(self._on_state), best_effort)
        self.create_subscription(Imu, "imu", partial(self._store, heard.imus), best_effort)
        self.create_subscription(JointState, VELOCITY, self._on_command, best_effort)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)
        ros.hear(self, Bool, "plant_ready", self._on_ready)
        ros.hear(self, String, "plant_warning", self._on_warning)
        ros.hear(self, String, "phase", self._on_phase)

    def _store(self, messages: list[tuple[Any, int]], msg: Any) -> None:
        messages.append((msg, self.get_clock().now().nanoseconds))

    def _on_state(self, msg: JointState, number: int) -> None:
        self._store(self.heard.states, msg)
        joints = frozenset(msg.name)
        self.heard.backs += number < self._numbers.get(joints, number)
        self._numbers[joints] = number

    def _on_ready(self, msg: Bool) -> None:
        self._latched.add("plant_ready")
        self.heard.ready = msg.data

    def _on_warning(self, msg: String) -> None:
        self.heard.warning = msg.data

    def _on_phase(self, msg: String) -> None:
        self._latched.add("phase")
        self.heard.phase = msg.data

    def _on_command(self, msg: JointState) -> None:
        self.heard.moving = self.heard.moving or any(msg.velocity)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            if self._is_of_another(status.name.partition(":")[0]):
                continue
            self.heard.diagnosed = True
            self.heard.errors.pop(status.name, None)
            if status.name.endswith(": plant"):
                self.heard.plant = status.message
            if status.level == DiagnosticStatus.ERROR:
                self.heard.errors[status.name] = status.message

    def _is_of_another(self, name: str) -> bool:
        """Return whether the name of a status begins with another namespace than this robot's, if that has one."""
        own, other = self.get_namespace(), f"/{name.lstrip('/')}".rpartition("/")[0]
        if own == "/" or f"{other}/".startswith(f"{own}/"):
            return False
        return any(other == namespace for _, namespace in self.get_node_names_and_namespaces())

    def unheard(self) -> dict[str, tuple[str, ...]]:
        """Return the latched topics that are published, but of which no message was received, and their publishers."""
        topics = {"phase", "plant_ready"} - self._latched
        return {topic: found for topic in topics if (found := ros.publishers_of(self, topic))}

    def look_around(self) -> None:
        """Store which nodes publish and subscribe."""
        heard = self.heard
        heard.unheard = self.unheard()
        heard.publishers = ros.publishers_of(self, "joint_states")
        heard.controllers = tuple(sorted(set(ros.publishers_of(self, VELOCITY))))
        heard.subscribers = ros.executing(self, VELOCITY)


def listen(seconds: float, namespace: str = "", enough: Callable[[Heard], bool] = lambda heard: False) -> Heard:
    """Receive the messages of a robot for `seconds`, counted from its first state, and for `_DISCOVERY` at least.

    It ends before that when `enough`, called several times a second, is true of what was heard.

    The first state is waited for as long. A walk is under way if its controller says so, so all publishers are to be
    discovered, and the latched messages of the discovered ones are waited for, at most for another `_LATCHED`.

    Raises
    ------
    ConfigError
        If ROS does not start.
    """
    context = Context()
    wheels.initialize(context=context)
    try:
        node = Doctor(context, namespace)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        began = time.monotonic()
        discovered = began + _DISCOVERY
        end = max(began + seconds, discovered)
        started = False
        while (now := time.monotonic()) < end or (now < end + _LATCHED and node.unheard()):
            executor.spin_once(timeout_sec=0.1)
            if enough(node.heard):
                break
            if node.heard.states and not started:
                started, began = True, time.monotonic()
                end = max(began + seconds, discovered)
        node.heard.seconds = round(time.monotonic() - began, 1)
        node.look_around()
        executor.shutdown()
        node.destroy_node()
    finally:
        context.try_shutdown()
    return node.heard
