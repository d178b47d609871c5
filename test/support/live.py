"""Runs real nodes as processes in a separate ROS domain, and a node of the test that communicates with them."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from dqwalk_ros.cli.runner import Processes
from dqwalk_ros.config import Config, to_yaml
from dqwalk_ros.nodes import messages as ros

SHORT = {
    "gait.step_length": 0.02,
    "task.eta": 1.0,
    "dsp.stall_rate": 3e-3,
    "dsp.eta_ground": 100.0,
    "ssp.threshold": 0.02,
}
"""A cycle of 1267 ticks: small steps, a fast task, phases that end early, every constraint kept."""

LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Nodes(Processes):
    """Nodes that a test disturbs."""

    def signal(self, name: str, number: int) -> None:
        """Send a signal to one node."""
        self._running[name].send_signal(number)

    def wait(self, name: str, timeout: float) -> int:
        """Wait for the end of a node, at most for a time [s], and return its exit code."""
        return self._running[name].wait(timeout)


class Live:
    """Starts nodes and records their messages.

    Attributes
    ----------
    got : dict of str to list
        Received messages by topic: phase_log, joint_states, joint_velocity_commands, diagnostics.
    """

    def __init__(self, folder: Path, domain: int, config: Config, name: str = "test") -> None:
        self.config = config
        self.processes = Nodes(folder, domain)
        self.params = folder / "params.yaml"
        self.params.write_text(to_yaml(config), encoding="utf-8")
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = Node(name, context=self._context)
        self._executor: Any = EventsExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.got: dict[str, list[Any]] = {}
        self._clients: dict[str, Any] = {}
        self._listen(String, "phase_log", LATCHED)
        self._listen(JointState, "joint_states", QoSProfile(depth=1000))
        self._listen(JointState, "joint_velocity_commands", QoSProfile(depth=1000))
        self._listen(DiagnosticArray, "/diagnostics", QoSProfile(depth=1000))

    def _listen(self, kind: Any, topic: str, profile: QoSProfile) -> None:
        box = self.got.setdefault(topic.lstrip("/"), [])
        self.node.create_subscription(kind, topic, box.append, profile)

    def start(self, name: str, *arguments: str) -> None:
        """Start a node with the configuration."""
        self.processes.start(name, [*arguments, "--ros-args", "--params-file", str(self.params)])

    def until_started(self, name: str) -> None:
        """Wait until a node has logged its first message."""
        self.until(lambda: "[INFO]" in self.processes.log(name), 60.0, f"the start of {name}")

    def offer(self, kind: Any, topic: str, *listeners: str) -> Any:
        """Create a publisher and wait until the nodes `listeners` are connected, each at a time of its own."""
        publisher = self.node.create_publisher(kind, topic, 10)
        for name in listeners:
            heard = functools.partial(ros.is_heard_by, self.node, publisher, name)
            self.until(heard, 20.0, f"{name} listening to {topic}")
        return publisher

    def spin(self, seconds: float) -> None:
        """Receive messages for a time [s]."""
        self.until(lambda: False, seconds, "")

    def until(self, condition: Callable[[], Any], timeout: float, what: str) -> Any:
        """Receive messages until a condition holds, and return it; a timeout is an error unless `what` is empty."""
        deadline = time.monotonic() + timeout
        while not (result := condition()):
            if time.monotonic() > deadline:
                assert not what, f"{what} did not happen within {timeout} s; {self.logs()}"
                return None
            self._executor.spin_once(timeout_sec=0.05)
        return result

    def logs(self) -> str:
        """Return the logs of all nodes."""
        return "\n".join(f"--- {name}\n{self.processes.log(name)}" for name in self.processes.reports)

    def call(self, service: str) -> Trigger.Response:
        """Call a Trigger service; again without an answer: the middleware drops that to a client it has not found."""
        self.until_ready(service)
        for _ in range(4):
            future = self._clients[service].call_async(Trigger.Request())
            if self.until(future.done, 5.0, ""):
                return future.result()
        raise AssertionError(f"no answer from {service}; {self.logs()}")

    def until_ready(self, service: str) -> None:
        """Wait for a Trigger service."""
        if service not in self._clients:
            self._clients[service] = self.node.create_client(Trigger, service)
        self.until(self._clients[service].service_is_ready, 20.0, f"service {service}")

    def statuses(self, name: str) -> list[Any]:
        """Return the statuses of a node on /diagnostics."""
        return [s for array in self.got["diagnostics"] for s in array.status if s.name.startswith(f"{name}:")]

    def phases(self) -> list[str]:
        """Return the published phases."""
        return [msg.data for msg in self.got["phase_log"]]

    # The last message of a topic; before the first one a value that no test waits for.

    @property
    def phase(self) -> str:
        """The last published phase, or an empty text."""
        msg = self.last("phase_log")
        return "" if msg is None else str(msg.data)

    def last(self, topic: str) -> Any:
        """Return the last message of a topic, or None."""
        return (self.got[topic] or [None])[-1]

    def stamp(self) -> float:
        """Return the stamp of the last state [s]; negative before the first."""
        msg = self.last("joint_states")
        return -1.0 if msg is None else msg.header.stamp.sec + 1e-9 * msg.header.stamp.nanosec

    def speed_of(self, commands: int = 1) -> float:
        """Return the largest joint speed of the last `commands` commands [rad/s]; NaN if there are fewer."""
        last = self.got["joint_velocity_commands"][-commands:]
        return max(abs(v) for msg in last for v in msg.velocity) if len(last) == commands else float("nan")

    def status(self, name: str) -> Any:
        """Return the last status of a node on /diagnostics, or None."""
        for array in reversed(self.got["diagnostics"]):
            for status in array.status:
                if status.name.startswith(f"{name}:"):
                    return status
        return None

    def close(self) -> None:
        """Stop all nodes."""
        self.processes.stop()
        self.node.destroy_node()
        self._executor.shutdown()
        self._context.try_shutdown()
