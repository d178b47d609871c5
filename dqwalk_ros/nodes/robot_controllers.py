"""The controllers of a robot, such as those of ros2_control, as the node `drive` finds them on its topic."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.task import Future

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.publishers import UNKNOWN, DuplicatePublishers
from dqwalk_ros.nodes.watchdog import Clock
from dqwalk_ros.plants.robot_output import misunderstood

_CHECK = 0.25
"""Period of the check for duplicate publishers [s]."""
_PATIENCE = 1.0
"""Time after which a node that has not answered is asked again [s]: an answer may be lost."""
_TRUSTED = 3.0
"""Time after which a node without a service for its parameters is trusted [s]; it may be on another machine."""
_MANAGER = "/controller_manager"


class RobotControllers:
    """Decides whether those who subscribe to the commands of a robot may be sent any: by one node only.

    A Float64MultiArray has neither names nor units: in another order it moves wrong joints, and an angle is no
    velocity. The controllers of ros2_control have both in their parameters ``joints`` and ``interface_name``, which are
    asked for one by one, because a node in C++ that lacks one of those asked for answers none. A node without such
    parameters is trusted. One that its controller_manager reports on /diagnostics as not active ignores its commands.

    Parameters
    ----------
    output : Publisher
        Of the commands.
    joints : sequence of str
        Joints of the commands in their order; empty for a type of message that has names.
    interface : str
        ``position`` or ``velocity``.
    clock : callable
        Steady time [s].

    Attributes
    ----------
    wrong : dict of str to str
        What is wrong with each controller that would misunderstand the commands, by the name of its node.
    """

    def __init__(self, node: Node, output: Publisher, joints: Sequence[str], interface: str, clock: Clock) -> None:
        self._node, self._output, self._clock = node, output, clock
        self._expected: dict[str, tuple[str, ...]] = {"joints": tuple(joints), "interface_name": (interface,)}
        if not joints:
            self._expected = {}
        self._found: dict[tuple[str, bytes], _Controller] = {}
        self._cleared = False  # all have answered, and none that is confirmed has gone since
        self._had_one = False  # a confirmed one, without which nothing is sent any more
        self.wrong: dict[str, str] = {}
        self._states: dict[str, str] = {}  # active, inactive, ..., by the name of the controller
        self._listening: set[str] = set()  # names of the nodes that subscribe
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._duplicates = DuplicatePublishers(clock)
        self._others, self._counted = "", -math.inf  # who else publishes the commands, and when it was looked for [s]

    @property
    def trouble(self) -> str:
        """Why nothing may be sent, or ""; a listener that comes later, and is being asked, stops no robot."""
        topic = self._output.topic_name
        if not self._output.get_subscription_count():
            if other := ros.of_another_type(self._node, topic, self._output.msg_type):
                return f"{other}: set output.type"
            return f"no node subscribes to {topic}: is the robot's controller active?"
        if self._others:
            return f"more than one node commands {topic}: {self._others}"
        known = {name: self._states[name] for name in sorted(self._listening) if name in self._states}
        if known and "active" not in known.values():
            name, state = next(iter(known.items()))
            return f"the controller {name} is {state}: `ros2 control set_controller_state {name} active`"
        if not self._expected:
            return ""
        if self.wrong:
            return "; ".join(self.wrong.values())
        if self._cleared:
            return ""
        names = ", ".join(sorted({name for (name, _), one in self._found.items() if one.left}))
        if self._had_one and not names:
            return f"the robot's controller does not subscribe to {topic} any more: is it active?"
        return f"asking {names or f'the controller on {topic}'} for its parameters joints and interface_name"

    def look(self) -> None:
        """Find out who subscribes, and ask those that have not answered; and who else publishes."""
        if self._clock() - self._counted > _CHECK:
            self._counted = self._clock()
            self._others = self._duplicates.judge(ros.publishers_of(self._node, self._output.topic_name))
        ends = self._node.get_subscriptions_info_by_topic(self._output.topic_name)
        self._listening = {end.node_name for end in ends}
        if not self._expected:
            return
        names = {(ros.node_of(end), bytes(end.endpoint_gid)) for end in ends}
        for gone in self._found.keys() - names:
            one = self._found.pop(gone)
            one.forget(self._node)
            self._cleared &= not one.confirmed
            self.wrong.pop(gone[0], None)
        for new in names - self._found.keys():
            self._found[new] = _Controller(new[0], set(self._expected), self._clock())
        for one in self._found.values():
            if one.left and self._clock() >= one.next:
                self._ask(one)
        there = any(one.confirmed for one in self._found.values())
        self._had_one |= there
        asked = not any(one.left for one in self._found.values())
        self._cleared = (self._cleared or asked) and (there or (bool(self._found) and not self._had_one))

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        """Note the states of controllers; not of several managers, because they have no namespace there."""
        managers = [
            name for name in ros.publishers_of(self._node, "/diagnostics") if name.endswith((_MANAGER, UNKNOWN))
        ]
        for status in msg.status if len(managers) == 1 else ():
            if status.name == f"{_MANAGER[1:]}: Controllers Activity":
                found = (value for value in status.values if value.key.endswith(".state"))
                self._states = {value.key.removesuffix(".state"): value.value for value in found}

    def _ask(self, one: _Controller) -> None:
        if one.name == UNKNOWN:
            return
        one.client = one.client or self._node.create_client(GetParameters, f"{one.name}/get_parameters")
        if not one.client.service_is_ready():
            if self._clock() > one.since + _TRUSTED:
                one.left.clear()
            return
        one.next = self._clock() + _PATIENCE
        for parameter in one.left:
            asked = one.client.call_async(GetParameters.Request(names=[parameter]))
            asked.add_done_callback(partial(self._on_answer, one, parameter))

    def _on_answer(self, one: _Controller, parameter: str, answer: Future) -> None:
        if (result := answer.result()) is None or parameter not in one.left:  # withdrawn, or answered twice
            return
        one.left.discard(parameter)
        values = [[*value.string_array_value, value.string_value] for value in result.values]
        found, expected = tuple(text for texts in values for text in texts if text), self._expected[parameter]
        one.confirmed |= found == expected
        if found and (text := misunderstood(one.name, parameter, found, expected)):
            self.wrong[one.name] = text
            self._node.get_logger().error(text)


class _Controller:
    """One subscriber: the parameters `left` to be asked for, and the times of its discovery and the next question."""

    def __init__(self, name: str, left: set[str], now: float) -> None:
        self.name, self.left, self.since, self.next = name, left, now, now
        self.client: Client | None = None
        self.confirmed = False  # it has a parameter as expected

    def forget(self, node: Node) -> None:
        """Destroy its client."""
        if self.client is not None:
            node.destroy_client(self.client)
