"""Base class of every node: an rclpy node with the schema as its parameters, diagnostics and an exit code."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import SetParametersResult
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_policy_name_from_kind
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.timer import Timer
from std_srvs.srv import Trigger

from dqwalk_ros.config import OF_RCLPY, Config
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes import parameters, wheels
from dqwalk_ros.support.errors import ConfigError, DqwalkError
from dqwalk_ros.support.imports import not_imported
from dqwalk_ros.support.interrupts import end_with
from dqwalk_ros.support.own_folder import lock
from dqwalk_ros.support.topics import BODY_TOPICS, OTHERS, PHASE_LOG, TOPICS
from dqwalk_ros.support.wording import one_line

_TOPICS = TOPICS | BODY_TOPICS | {PHASE_LOG.name: PHASE_LOG}
_DISCOVERED, _HEARD = 0.4, 1.5
"""Time to discover other nodes, and to receive a message of one that is running [s]: in lockstep a plant that waits
for a command publishes twice a second. A node that is shutting down has the same time to end."""

_STANDS_STILL = 0.5
"""Time without a later time of /clock after which it stands still [s]: slow simulations publish some a second."""

_CHECK_TYPES = 2.0
"""Period of the check for topics that others use with another type [s]."""

_ACKNOWLEDGED = {True: 12.0, False: 0.25}
"""`WalkNode.patience`: in lockstep, where the bag must be complete, and in real time, where the plant's watchdog stops
the robot even if the last message is lost."""


class WalkNode(Node):
    """An rclpy node whose parameters are the schema of `dqwalk_ros.config`.

    Parameters
    ----------
    options : argparse.Namespace
        From `command_line.parse`.
    **keywords
        As rclpy's `Node` takes them.

    Attributes
    ----------
    config : Config
        Current parameters.
    done : rclpy.task.Future
        The node spins until this has a result, its exit code; see `stop`.
    pause : float
        Time between two rounds of handling messages [s], for a node outside the control loop; 0 handles each message
        on arrival.
    has_diagnostics : bool
        Whether the node publishes on /diagnostics.

    Raises
    ------
    ConfigError
        For parameters that cannot be used.
    """

    pause = 0.0
    has_diagnostics = True
    steady: Callable[[], float] = staticmethod(time.monotonic)
    """The time [s] by which the node measures ages and periods; steps of the system's clock do not change it."""
    claims = ""
    """Topic that only one node of this name may publish; see `refuse_a_second`."""

    def __init__(self, name: str, options: argparse.Namespace, **keywords: Any) -> None:
        try:
            super().__init__(name, **keywords)
        except Exception as error:  # rclpy raises its own, undocumented types
            raise ConfigError(wheels.first_line(error)) from error
        self.config: Config = parameters.declare(self, options.argv)
        if self.claims and all(name.split(".")[0] in OF_RCLPY for name in self._parameter_overrides):
            self.get_logger().warning("no parameters given, using the defaults: is --ros-args --params-file missing?")
        self.add_on_set_parameters_callback(self._on_parameters)
        self._made, self._recorded = time.monotonic(), False
        self._sim_time = 0, -math.inf  # the last time of /clock [ns], and since when it has been it, by `steady` [s]
        self.done = Future()
        self.is_child: bool = options.child
        self._diagnostics = self.advertise("diagnostics") if self.has_diagnostics else None
        self.create_timer(_CHECK_TYPES, self.check_types)

    @property
    def lockstep(self) -> bool:
        """Whether each state waits for its command."""
        return self.config.plant.lockstep

    @property
    def patience(self) -> float:
        """Longest wait at shutdown for those who are to receive what was published [s]."""
        return _ACKNOWLEDGED[self.lockstep]

    def _on_parameters(self, wanted: Iterable[Parameter]) -> SetParametersResult:
        changed = {p.name: p.value for p in wanted if p.name.split(".")[0] not in OF_RCLPY}
        if not changed:
            return SetParametersResult(successful=True)
        try:
            config = self.config.updated(changed)
            self.tune(config)
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        before, now = self.config.flat(), config.flat()
        for name in changed:
            self.get_logger().info(f"{name}: {before[name]} -> {now[name]}")
        self.config = config
        return SetParametersResult(successful=True)

    def tune(self, config: Config) -> None:
        """Apply parameters that were changed while the node runs.

        Raises
        ------
        ConfigError
            If they cannot be applied now.
        """

    def create_timer(self, *args: Any, **keywords: Any) -> Timer:
        """Create a timer as rclpy does, but by default on the steady clock (`wheels.STEADY`)."""
        return super().create_timer(*args, **{"clock": wheels.STEADY, **keywords})

    def advertise(self, name: str) -> Publisher:
        """Create the publisher of a topic, with the type and the quality of service of `support.topics`."""
        topic = _TOPICS[name]
        profile = ros.latched(topic.depth) if topic.latched else topic.depth
        overrides = None if topic.latched else QoSOverridingOptions.with_default_policies()
        kind = ros.message_type(topic.type)
        return self.create_publisher(kind, topic.name, profile, qos_overriding_options=overrides)

    def listen(
        self, kind: Any, topic: str, callback: Callable[[Any], None], profile: QoSProfile | int, *, raw: bool = False
    ) -> None:
        """Subscribe to a topic of any publisher, be it reliable or best effort, as sensors often are.

        A reliable subscription becomes best effort when a publisher is discovered that offers no more. The parameters
        ``qos_overrides`` may set the quality of service, which then stays as it is set.
        """
        asked = QoSProfile(depth=profile) if isinstance(profile, int) else profile
        name = self.resolve_topic_name(topic)
        fixed = f"qos_overrides.{name}.subscription.reliability" in self._parameter_overrides
        made: list[Subscription] = []

        def lower(event: Any) -> None:
            lacks = qos_policy_name_from_kind(event.last_policy_kind)
            if lacks != "RELIABILITY" or fixed or not made:
                self.get_logger().warning(f"a publisher of {name} is not heard: it offers another {lacks.lower()}")
                return
            self.destroy_subscription(made.pop())
            offered = QoSProfile(
                depth=asked.depth, durability=asked.durability, reliability=ReliabilityPolicy.BEST_EFFORT
            )
            self.create_subscription(kind, topic, callback, offered, raw=raw)
            self.get_logger().info(f"a publisher of {name} is best effort, and so is the subscription now")

        made.append(
            self.create_subscription(
                kind,
                topic,
                callback,
                asked,
                raw=raw,
                qos_overriding_options=QoSOverridingOptions.with_default_policies(),
                event_callbacks=SubscriptionEventCallbacks(incompatible_qos=lower),
            )
        )

    def check_types(self) -> None:
        """Log an error about the topics of this node that others use with another type."""
        several = {topic for topic, types in self.get_topic_names_and_types() if len(types) > 1}
        ends: list[Any] = [*self.publishers, *self.subscriptions] if several else []
        own = {end.topic_name: end.msg_type for end in ends if end.topic_name in several}
        if found := [text for topic, kind in own.items() if (text := ros.of_another_type(self, topic, kind))]:
            self.get_logger().error("; ".join(found), **throttled(10.0))

    def diagnose(
        self, what: str, hardware: str, level: str, message: str, values: Mapping[str, object], stamp: int
    ) -> None:
        """Publish one status ``NAMESPACE/NODE: what`` [REP-107] on /diagnostics, with a state's stamp [ns].

        Its level is OK, WARN, ERROR or STALE; numbers are written with all digits.
        """
        assert self._diagnostics is not None
        texts = {key: repr(float(v)) if isinstance(v, float) else str(v) for key, v in values.items()}
        status = DiagnosticStatus(
            level=getattr(DiagnosticStatus, level),
            name=f"{self.get_fully_qualified_name().lstrip('/')}: {what}",
            hardware_id=f"{self.get_namespace().strip('/')}/{hardware}".lstrip("/"),
            message=message,
            values=[KeyValue(key=key, value=text) for key, text in texts.items()],
        )
        self._diagnostics.publish(DiagnosticArray(header=ros.header(stamp), status=[status]))

    def report(self, **values: Any) -> None:
        """Print one line of JSON for the program that started this node (see `dqwalk_ros.cli.runner`)."""
        if self.is_child:
            print(json.dumps(values), flush=True)

    @property
    def uses_sim_time(self) -> bool:
        """Whether the node takes its time from /clock."""
        return bool(self.get_parameter("use_sim_time").value)

    def time_trouble(self) -> str:
        """Return an error message about the node's clock; empty if there is no error. It is asked for repeatedly."""
        if not self.uses_sim_time:
            return ""
        time, now = self.get_clock().now().nanoseconds, self.steady()
        if not time:
            return "use_sim_time is set, but no node publishes /clock"
        if time != self._sim_time[0]:
            self._sim_time = time, now
        return "use_sim_time is set, but /clock stands still" if now - self._sim_time[1] > _STANDS_STILL else ""

    def is_recorded(self) -> bool:
        """Return whether the recorder has subscribed to every topic of this node that it records."""
        # instead of `phase` it records `phase_log`
        names = {*(topic.name for topic in _TOPICS.values()), *OTHERS} - {"phase"}
        recorded = {self.resolve_topic_name(name) for name in names}
        return all(ros.is_heard_by(self, end, "recorder") for end in self.publishers if end.topic_name in recorded)

    def may_publish(self, within: float = 0.0) -> bool:
        """Return whether what is published now is recorded, if it is to be: with ``node.wait_for_recorder``.

        It is waited for up to `within` [s]. Once this is true it remains so, also after the recorder has ended.
        """
        wanted = self.config.node.wait_for_recorder
        self._recorded = self._recorded or not wanted or self._within(within, self.is_recorded)
        return self._recorded

    def offer(self, service: str, act: Callable[[], tuple[bool, str]]) -> None:
        """Offer a service of the type Trigger, whose answer is that of `perform`."""

        def serve(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            response.success, response.message = self.perform(act)
            return response

        self.create_service(Trigger, service, serve)

    def perform(self, act: Callable[[], tuple[bool, str]]) -> tuple[bool, str]:
        """Do something; log and return whether it succeeded, and what follows or why not. An error is no success."""
        try:
            success, message = act()
            self.get_logger().info(message)
        except DqwalkError as error:
            success, message = False, str(error)
            self.get_logger().error(message)
        return success, message

    def refuse_a_second(self) -> None:
        """Refuse to start if a node of this name is already running, because the same walk was launched twice.

        For the same user on the same machine it is detected by a lock, which ends with its process. Otherwise it is
        detected by discovery; a node that was killed remains listed for 20 s, so a node counts as running only if it
        still publishes.

        Raises
        ------
        ConfigError
            If it is running.
        """
        if not self.claims:
            return
        topic, me = self.resolve_topic_name(self.claims), self.get_fully_qualified_name()
        runs = ConfigError(f"{me} is already running and publishes {topic}: stop it, or use a namespace")
        with contextlib.suppress(OSError):  # no lock if there is no folder for it
            if not self._within(_HEARD, self._is_locked):
                raise runs
        known_at = self._made + _DISCOVERED
        if not self._within(known_at - time.monotonic(), lambda: ros.publishers_of(self, topic).count(me) > 1):
            return
        (own,) = (end for end in self.publishers if end.topic_name == topic)
        heard = self.create_subscription(own.msg_type, topic, lambda msg: None, ros.best_effort(1), raw=True)
        try:
            with heard.handle:
                if self._within(_HEARD, lambda: heard.handle.take_message(heard.msg_type, True) is not None):
                    raise runs
        finally:
            self.destroy_subscription(heard)

    def _is_locked(self) -> bool:
        me = self.get_fully_qualified_name().replace("/", ".")
        self._lock = lock(f"domain{self.context.get_domain_id()}{me}")
        return self._lock is not None

    @staticmethod
    def _within(seconds: float, happens: Callable[[], bool]) -> bool:
        """Wait until `happens` returns true, at most for `seconds`; return whether it did."""
        end = time.monotonic() + seconds
        while not (happened := happens()) and time.monotonic() < end:
            time.sleep(0.02)
        return happened

    def stop(self, exit_code: int = 0) -> None:
        """End this node after the current callback."""
        if not self.done.done():
            self.done.set_result(exit_code)

    def is_drained(self) -> bool:
        """Return whether the node may shut down; asked repeatedly after shutdown was requested."""
        return True

    def close(self) -> None:
        """Clean up at shutdown; the node can still publish, and report with `stop` that it has failed."""

    def wait_for_acknowledgements(self) -> None:
        """Wait until all reliable subscribers have received every message."""
        deadline = time.monotonic() + self.patience
        for publisher in self.publishers:
            publisher.wait_for_all_acked(Duration(seconds=max(deadline - time.monotonic(), 0.0)))


def throttled(seconds: float = 2.0) -> dict[str, Any]:
    """Return the keywords of a log message that could be repeated at every tick: ``error(text, **throttled())``."""
    return {"throttle_duration_sec": seconds, "throttle_time_source_type": wheels.STEADY}


def main(kind: Callable[[argparse.Namespace], WalkNode], options: argparse.Namespace) -> int:
    """Run one node until it stops; return the exit code.

    Parameters
    ----------
    kind : callable
        Creates the node from `options`; raises a `DqwalkError` for invalid parameters.
    options : argparse.Namespace
        From `command_line.parse`; the ROS arguments of its ``argv`` apply.

    Returns
    -------
    int
        0 after a signal or when the node has finished, 1 after a failed walk, 2 for invalid arguments.
    """
    parent = os.getppid()
    if options.child:
        end_with(parent, signal.SIGTERM)
    node: WalkNode | None = None
    code = 1
    try:
        signals = wheels.init(options.argv)
        node = made = kind(options)
        if made.config.node.end_with_parent:
            end_with(parent, signal.SIGTERM)
        made.refuse_a_second()
        wheels.spin(made, lambda: (signals or made.done.done()) and made.is_drained(), pause=made.pause)
        code = 0
    except (DqwalkError, NameValidationException, ImportError) as error:  # topic and plant may be parameters
        if not (why := not_imported(error) if isinstance(error, ImportError) else one_line(str(error))):
            raise
        print(f"{options.argv[0]}: {why}", file=sys.stderr)
        code = 2
    finally:
        try:
            if node is not None:
                node.close()
                node.wait_for_acknowledgements()
        finally:
            if node is not None and not code and node.done.done():
                code = node.done.result()
            wheels.shutdown(node, code)
    return code
