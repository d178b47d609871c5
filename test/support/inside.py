"""Runs a node in the process of the test, which passes it messages and records its publications and its log.

There is no executor: the test calls the callbacks itself, and advances the node's clock, so that no result depends on
timing.
"""

from __future__ import annotations

import copy
import functools
import importlib
import time
from collections import UserList
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from stepped_time import SteppedTime

from dqwalk_ros.config import Config, to_yaml
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.command_line import parse
from dqwalk_ros.paper.state import Command
from dqwalk_ros.plants.base import Inertial, Plant
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.node_table import NODES

_yaml = functools.cache(to_yaml)


class Log:
    """Replaces rclpy's logger; throttling is ignored."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, str]] = []

    def __getattr__(self, level: str) -> Any:
        return lambda text, **_: self.lines.append((level, text))

    def __contains__(self, text: str) -> bool:
        return any(text in line for _, line in self.lines)


class Messages(UserList[Any]):
    """Messages as they were when they were published; those of ROS are serialized until a test reads them."""

    def add(self, msg: Any) -> None:
        of_ros = hasattr(msg, "get_fields_and_field_types")
        self.data.append((type(msg), serialize_message(msg)) if of_ros else copy.deepcopy(msg))

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        if isinstance(found := self.data[index], tuple):
            found = self.data[index] = deserialize_message(found[1], found[0])
        return found

    def pop(self, index: int = -1) -> Any:
        found = self[index]
        del self.data[index]
        return found

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Messages | list) and list(self) == list(other)


class RecordingPublisher:
    """A publisher that also records its messages."""

    def __init__(self, real: Any, box: Messages) -> None:
        self._real, self._box = real, box

    def publish(self, msg: Any) -> None:
        self._box.add(msg)
        self._real.publish(msg)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._real, name)


class Inside:
    """One node, its published messages and its log.

    Attributes
    ----------
    node : WalkNode
    got : dict of str to Messages
        Published messages, by topic.
    log : Log
    clock : SteppedTime
        The steady clock of the node.
    """

    def __init__(
        self,
        name: str,
        config: Config | str,
        folder: Path,
        *own: str,
        ros: tuple[str, ...] = (),
        domain: int,
        clock: SteppedTime,
    ) -> None:
        self.got: dict[str, Messages] = {}
        self.clock = clock
        self.log = Log()
        params = folder / f"{name}.yaml"
        params.write_text(config if isinstance(config, str) else _yaml(config), encoding="utf-8")
        module, _, kind = NODES[name].partition(":")
        base = getattr(importlib.import_module(f"dqwalk_ros.{module}"), kind)
        box, log = self.got, self.log

        class RecordingNode(base):  # type: ignore[misc, valid-type]
            steady = clock

            def create_publisher(self, kind: Any, topic: str, *args: Any, **keywords: Any) -> Any:
                real = Node.create_publisher(self, kind, topic, *args, **keywords)
                return RecordingPublisher(real, box.setdefault(topic.lstrip("/"), Messages()))

            def get_logger(self) -> Any:
                return log

        self._domain, self._number = domain, 0
        self._foreign: list[tuple[Context, Node]] = []
        self._beside: list[Node] = []
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        arguments = ["--ros-args", "--params-file", str(params), *ros]
        try:
            self.node = RecordingNode(
                parse(name, [*own, *arguments]), context=self.context, cli_args=arguments, use_global_arguments=False
            )
        except BaseException:
            self.context.try_shutdown()
            raise

    def send(self, topic: str, msg: Any, number: int | None = None) -> None:
        """Pass a message to the callbacks of the subscriptions of a topic.

        `number` is the one that the middleware gives it; by default each message follows the last one.
        """
        self._number = self._number + 1 if number is None else number
        info = {"publication_sequence_number": self._number}
        name = self.node.resolve_topic_name(topic)
        found = [one for one in self.node.subscriptions if one.topic_name == name]
        assert found, f"no subscription to {name}"
        for subscription in found:
            with_info = subscription._callback_type is Subscription.CallbackType.WithMessageInfo
            subscription.callback(msg, info) if with_info else subscription.callback(msg)

    def follow(self, walk: Inside) -> None:
        """Pass on what a controller has published of its walk, robot and phase."""
        for topic in ("walk_config", "robot_description", "phase", "phase_start", "com_target"):
            self.send(topic, walk.got[topic][-1])

    def exchange(
        self, plant: Plant, model: RobotModel, stamp: float, q: Any = None, inertial: Inertial | None = None
    ) -> np.ndarray:
        """Send a controller the state of a plant, and the plant its command; return the velocities [rad/s].

        This takes one period of the node's clock.
        Wrong measurements can be given by `q` and `inertial`.
        """
        self.clock.now += self.node.config.dt
        now, inertial = plant.state, inertial or plant.inertial
        if inertial is not None:
            self.send("imu", ros.imu(round(stamp * 1e9), model.imu, inertial))
        efforts = {} if now.effort is None else {"effort": now.effort}
        self.send(
            "joint_states", state(model.joint_names, now.q if q is None else q, stamp, velocity=now.dq, **efforts)
        )
        answer = self.got["joint_velocity_commands"][-1]
        velocity, effort = np.array(answer.velocity), np.array(answer.effort) if answer.effort else None
        plant.step(Command(stamp, velocity, effort), self.node.config.dt)
        return velocity

    def pass_period(self) -> None:
        """Let one period of a plant in real time pass."""
        self.clock.now += self.node.config.dt
        self.node._on_period()

    def tick(self) -> None:
        """Call the callback of every timer once."""
        for timer in list(self.node.timers):
            timer.callback()

    def call(self, service: str, request: Any) -> Any:
        """Call a service of the node."""
        (found,) = (s for s in self.node.services if s.srv_name.endswith(service))
        return found.callback(request, found.srv_type.Response())

    def beside(self, name: str) -> Node:
        """Return another node in its ROS context; `close` destroys it."""
        self._beside.append(Node(name, context=self.context))
        return self._beside[-1]

    def foreign_node(self, name: str) -> Node:
        """Return a node in another ROS context of the same domain; `close` ends it."""
        context = Context()
        rclpy.init(context=context, domain_id=self._domain)
        self._foreign.append((context, Node(name, context=context)))
        return self._foreign[-1][1]

    def close(self) -> None:
        """Destroy the nodes and shut their contexts down."""
        for node in (*self._beside, self.node):
            node.destroy_node()
        for context in (*(context for context, _ in self._foreign), self.context):
            context.try_shutdown()


def until(happened: Callable[[], Any], timeout: float = 20.0) -> None:
    """Wait until something has happened, such as the discovery of a node."""
    deadline = time.monotonic() + timeout
    while not happened():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def state(names: Any, q: Any, stamp: float, **fields: Any) -> JointState:
    """Return a JointState; `stamp` [s]."""
    msg = JointState(name=list(names), position=[float(x) for x in q])
    for field, values in fields.items():
        setattr(msg, field, [float(x) for x in values])
    msg.header.stamp.sec, msg.header.stamp.nanosec = divmod(round(stamp * 1e9), 1_000_000_000)
    return msg


def values(status: Any) -> Mapping[str, str]:
    """Return the values of a DiagnosticStatus."""
    return {pair.key: pair.value for pair in status.values}


def subscribe(one: Inside, topic: str, kind: Any) -> None:
    """Subscribe to a topic of a node, and wait until the publisher is connected."""
    one.beside("listener").create_subscription(kind, topic, lambda _: None, 10)
    (offered,) = (p for p in one.node.publishers if p.topic_name == topic)
    until(offered.get_subscription_count)
