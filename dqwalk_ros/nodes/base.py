"""What every node of this package is: an rclpy node with the schema as its parameters, diagnostics and an exit code."""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import fcntl
import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.task import Future
from sensor_msgs.msg import JointState

from dqwalk_ros.config import Config
from dqwalk_ros.errors import ConfigError, DqwalkError
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes import parameters, wheels
from dqwalk_ros.nodes.command_line import NODES
from dqwalk_ros.topics import BODY_TOPICS, TOPICS, Topic

__all__ = ["STEADY", "THROTTLE", "WalkNode", "main"]

STEADY = wheels.STEADY

THROTTLE = {"throttle_duration_sec": 2.0, "throttle_time_source_type": STEADY}
"""For a log that may come at every tick: ``self.get_logger().error(text, **THROTTLE)``."""

_DISCOVERED, _HEARD = 0.4, 1.5
"""Time in which other nodes are discovered, and in which one that runs is heard [s]: in lockstep a plant without an
answer publishes twice a second. One that is about to end has as long."""

_ACKNOWLEDGED = {True: 8.0, False: 0.25}
"""Longest wait for acknowledgements at the end, in lockstep, where nothing may be missing from the bag, and in real
time [s], where the plant's watchdog stands in for a last message that was lost."""


class WalkNode(Node):
    """An rclpy node whose parameters are the schema of `dqwalk_ros.config`.

    Parameters
    ----------
    name : str
    options : argparse.Namespace
        From `command_line.parse`.
    **keywords
        As rclpy's `Node` takes them.

    Attributes
    ----------
    config : Config
        Parameters in force.
    done : rclpy.task.Future
        The node is spun until this has a result, its exit code; see `stop`.
    pause : float
        Time between two looks at what has come [s], of a node that is not in the loop of a walk; 0 handles each
        message as it comes.

    Raises
    ------
    ConfigError
        For parameters that cannot be used.
    """

    pause = 0.0

    claims = ""
    """The topic that nobody but one node of this name may publish."""

    def __init__(self, name: str, options: argparse.Namespace, **keywords: Any) -> None:
        try:
            super().__init__(name, **keywords)
        except Exception as error:  # rclpy raises its own, undocumented types
            raise ConfigError(wheels.first_line(error)) from error
        self.config: Config = parameters.declare(self, options.argv, NODES)
        self.add_on_set_parameters_callback(self._on_parameters)
        self._made = time.monotonic()
        self.done = Future()
        self.is_child: bool = options.child
        self._diagnostics = self.advertise("diagnostics") if self.has_diagnostics else None

    has_diagnostics = True

    @property
    def lockstep(self) -> bool:
        """Whether each state waits for its command."""
        return self.config.plant.lockstep

    def _on_parameters(self, wanted: Iterable[Parameter]) -> SetParametersResult:
        changed = parameters.changes(list(wanted))
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
        """Take in parameters that have changed while the node runs.

        Raises
        ------
        ConfigError
            If they cannot be used now.
        """

    def advertise(self, topic: Topic | str) -> Publisher:
        """Create the publisher of one of our topics, as the table in `dqwalk_ros.topics` says."""
        if isinstance(topic, str):
            topic = (TOPICS | BODY_TOPICS)[topic]
        profile = ros.latched(topic.depth) if topic.latched else ros.stream(topic.depth)
        overrides = None if topic.latched else QoSOverridingOptions.with_default_policies()
        kind = ros.message_type(topic.type)
        return self.create_publisher(kind, topic.name, profile, qos_overriding_options=overrides)

    def listen(self, kind: Any, topic: str, callback: Callable[[Any], None], profile: QoSProfile) -> None:
        """Subscribe to a topic whose quality of service may be set by the parameters ``qos_overrides``."""
        overrides = QoSOverridingOptions.with_default_policies()
        self.create_subscription(kind, topic, callback, profile, qos_overriding_options=overrides)

    def diagnose(
        self, what: str, hardware: str, level: str, message: str, values: Mapping[str, object], stamp: int
    ) -> None:
        """Publish one status ``NAMESPACE/NODE: what`` on /diagnostics, with a state's stamp [ns]."""
        assert self._diagnostics is not None
        name, space = self.get_fully_qualified_name().lstrip("/"), self.get_namespace().strip("/")
        status = ros.status(f"{name}: {what}", f"{space}/{hardware}".lstrip("/"), level, message, values)
        self._diagnostics.publish(ros.diagnostics(stamp, status))

    def report(self, event: str, **values: Any) -> None:
        """Print one line of JSON for the program that started this node (see `dqwalk_ros.runner`)."""
        if self.is_child:
            print(json.dumps({"event": event, **values}), flush=True)

    @property
    def uses_sim_time(self) -> bool:
        """Whether the node's time is that of /clock."""
        return bool(self.get_parameter("use_sim_time").value)

    def time_trouble(self) -> str:
        """Return what is wrong with the node's time, which is an error; empty if nothing is."""
        if self.uses_sim_time and not self.get_clock().now().nanoseconds:
            return "use_sim_time is set and nobody publishes /clock"
        return ""

    def refuse_a_second(self) -> None:
        """Refuse to be a node that runs already: the same walk was launched twice.

        On one machine, and for one user, a lock tells, which ends with its process. Elsewhere the middleware does, once
        it has discovered the other; it lists a node that was killed for 20 s more, so one counts only where it still
        publishes.

        Raises
        ------
        ConfigError
            If it runs.
        """
        if not self.claims:
            return
        topic, me = self.resolve_topic_name(self.claims), self.get_fully_qualified_name()
        runs = ConfigError(f"{me} runs already and publishes {topic}: end it first, or use a namespace")
        name = f"dqwalk_ros.domain{self.context.get_domain_id()}{me.replace('/', '.')}.{os.getuid()}.lock"
        with contextlib.suppress(OSError):  # without a folder for it there is no lock
            self._lock = (Path(tempfile.gettempdir()) / name).open("w")
            if not self._within(_HEARD, self._is_locked):
                raise runs
        known_at = self._made + _DISCOVERED
        if not self._within(known_at - time.monotonic(), lambda: ros.other_publishers(self, topic).count(me) > 1):
            return
        heard = self.create_subscription(JointState, topic, lambda msg: None, ros.stream(1, reliable=False), raw=True)
        try:
            with heard.handle:
                if self._within(_HEARD, lambda: heard.handle.take_message(heard.msg_type, True) is not None):
                    raise runs
        finally:
            self.destroy_subscription(heard)

    def _is_locked(self) -> bool:
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    @staticmethod
    def _within(seconds: float, happens: Callable[[], bool]) -> bool:
        """Wait until something happens, at most so long; return whether it has."""
        end = time.monotonic() + seconds
        while not (happened := happens()) and time.monotonic() < end:
            time.sleep(0.02)
        return happened

    def stop(self, exit_code: int = 0) -> None:
        """End this node after the current callback."""
        if not self.done.done():
            self.done.set_result(exit_code)

    def is_drained(self) -> bool:
        """Tell, once the end is asked for, whether what is still under way may be left."""
        return True

    def close(self) -> None:
        """Do what is left to do at the end; the node can still publish."""

    def wait_for_acknowledgements(self) -> None:
        """Wait until reliable subscribers have what was published."""
        deadline = time.monotonic() + _ACKNOWLEDGED[self.lockstep]
        for publisher in self.publishers:
            publisher.wait_for_all_acked(Duration(seconds=max(deadline - time.monotonic(), 0.0)))


def main(kind: Callable[[argparse.Namespace], WalkNode], options: argparse.Namespace) -> int:
    """Run one node until it is told to stop; return the exit code.

    Parameters
    ----------
    kind : callable
        Makes the node of `options`; it raises a `DqwalkError` for parameters that cannot be used.
    options : argparse.Namespace
        From `command_line.parse`; the ROS arguments of its ``argv`` apply.

    Returns
    -------
    int
        0 after a signal or a node that has done its work, 1 after a failed walk, 2 for arguments that cannot be used.
    """
    if options.child:
        _end_with_parent()
    node: WalkNode | None = None
    code = 1
    try:
        stopped = wheels.init(options.argv)
        node = made = kind(options)
        made.refuse_a_second()
        wheels.spin(made, lambda: (stopped.is_set() or made.done.done()) and made.is_drained(), pause=made.pause)
        code = made.done.result() if made.done.done() else 0
    except DqwalkError as error:
        print(f"{options.argv[0]}: {error}", file=sys.stderr)
        code = 2
    finally:
        try:
            if node is not None:
                node.close()
                node.wait_for_acknowledgements()
        finally:
            wheels.shutdown(node, code)
    return code


def _end_with_parent() -> None:
    """Ask the kernel for SIGTERM when the parent dies: no robot may walk on unwatched."""
    with contextlib.suppress(OSError, AttributeError):  # not a Linux
        ctypes.CDLL(None).prctl(1, signal.SIGTERM)  # PR_SET_PDEATHSIG
