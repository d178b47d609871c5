"""A walk in real time whose states and commands pass through the test, which can change, delay or drop them.

Also a pytest plugin: `-p chaos` prints the table of all faults at the end.
"""

from __future__ import annotations

import copy
import random
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from live import SHORT, Live
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from dqwalk_ros.config import load

QUICK = {**SHORT, "dt": 0.02, "dsp.eta_ground": 25.0, "gait.cycles": 1000, "monitor.tolerance": 1e-3}
"""A walk that lasts longer than its tests."""
BUSY = 2.0
"""Allowed time for a reaction that takes 0.1 s on an idle machine [s]: this one may be heavily loaded."""

Policy = Callable[[JointState], Iterator[tuple[float, JointState]]]
"""A message -> pairs of delay [s] and message."""

ROWS: list[tuple[str, str, str, str]] = []
"""fault, reaction, time to reaction, outcome"""


def pytest_terminal_summary(terminalreporter: Any) -> None:
    if not ROWS:
        return
    widths = [max(len(row[i]) for row in ROWS) for i in range(4)]
    terminalreporter.section("chaos")
    for row in (("fault", "reaction", "time", "outcome"), *ROWS):
        cells = (f"{cell:{width}}" for cell, width in zip(row, widths, strict=True))
        terminalreporter.write_line("  ".join(cells).rstrip())
    terminalreporter.write_line(f"{len(ROWS)} live cases")


def passing(msg: JointState) -> Iterator[tuple[float, JointState]]:
    yield 0.0, msg


def blocking(msg: JointState) -> Iterator[tuple[float, JointState]]:
    yield from ()


def dropping(share: float) -> Policy:
    rng = random.Random(1)
    return lambda msg: iter([] if rng.random() < share else [(0.0, msg)])


def delaying(delay: float) -> Policy:
    return lambda msg: iter([(delay, msg)])


def duplicating(msg: JointState) -> Iterator[tuple[float, JointState]]:
    yield 0.0, msg
    yield 0.0, msg


def reordering() -> Policy:
    kept: list[JointState] = []

    def policy(msg: JointState) -> Iterator[tuple[float, JointState]]:
        kept.append(msg)
        if len(kept) == 2:
            yield 0.0, kept[1]
            yield 0.0, kept[0]
            kept.clear()

    return policy


def changing(change: Callable[[JointState], None]) -> Policy:
    def policy(msg: JointState) -> Iterator[tuple[float, JointState]]:
        out = copy.deepcopy(msg)
        change(out)
        yield 0.0, out

    return policy


class Chaos(Live):
    """Controller, integrator and monitor, with relays between the first two.

    Parameters
    ----------
    values : mapping of str to value
        Changes of the configuration.

    Attributes
    ----------
    on_states, on_commands : Policy
        How messages are relayed; `passing` without a fault.
    moved : list of (float, ndarray)
        Time of receipt of each state of the plant [s], and its angles [rad].
    """

    def __init__(self, folder: Path, domain: int, values: Mapping[str, object]) -> None:
        super().__init__(folder, domain, load("paper").updated({**QUICK, **values}))
        self.on_states: Policy = passing
        self.on_commands: Policy = passing
        self.moved: list[tuple[float, np.ndarray]] = []
        self._delayed: list[tuple[float, Any, JointState]] = []
        deep = QoSProfile(depth=50)
        self.to_controller = self.node.create_publisher(JointState, "states_in", deep)
        self.to_plant = self.node.create_publisher(JointState, "joint_velocity_commands", deep)
        self.node.create_subscription(JointState, "joint_states", self._state, deep)
        self.node.create_subscription(JointState, "commands_out", self._command, deep)
        self.node.create_timer(0.005, self._send_delayed)

    def close(self) -> None:
        """Stop all nodes, also those that a test has frozen."""
        for name in self.processes.reports:
            if self.processes.exit_code(name) is None:
                self.processes.signal(name, signal.SIGCONT)
        super().close()

    def _state(self, msg: JointState) -> None:
        assert np.isfinite(msg.position).all(), "the plant published a state that is not finite"
        self.moved.append((time.monotonic(), np.array(msg.position)))
        self._relay(self.on_states, self.to_controller, msg)

    def _command(self, msg: JointState) -> None:
        assert np.isfinite(msg.velocity).all(), "the controller published a command that is not finite"
        self._relay(self.on_commands, self.to_plant, msg)

    def _relay(self, policy: Policy, publisher: Any, msg: JointState) -> None:
        for delay, out in policy(msg):
            if delay:
                self.publish_delayed(delay, publisher, out)
            else:
                publisher.publish(out)

    def publish_delayed(self, delay: float, publisher: Any, msg: JointState) -> None:
        """Publish a message after a delay [s]."""
        self._delayed.append((time.monotonic() + delay, publisher, msg))

    def _send_delayed(self) -> None:
        now = time.monotonic()
        due, self._delayed = [e for e in self._delayed if e[0] <= now], [e for e in self._delayed if e[0] > now]
        for _, publisher, msg in due:
            publisher.publish(msg)

    def start_relayed(self, name: str, *parameters: str) -> None:
        """Start a node whose topics pass through the relays."""
        remap = ["-r", "joint_states:=states_in", "-r", "joint_velocity_commands:=commands_out"]
        extra = [word for parameter in parameters for word in ("-p", parameter)]
        self.processes.start(
            name,
            ["--ros-args", "--params-file", str(self.params), *extra, *(remap if name == "controller" else [])],
        )

    # ------------------------------------------------------------------ observations

    def speed(self, span: float = 0.3) -> float:
        """Return the largest motion of a joint within the last `span` [s], [rad]; NaN without states."""
        since = time.monotonic() - span
        recent = [q for at, q in self.moved if at >= since]
        return float(np.ptp(recent, axis=0).max()) if len(recent) > 1 else float("nan")

    def angles(self) -> np.ndarray:
        """Return the angles of the last state of the plant [rad]; wait for the first one."""
        self.until(lambda: self.moved, 60.0, "a state of the plant")
        return self.moved[-1][1]

    def walking(self) -> bool:
        """Return whether the robot moves now."""
        return self.speed() > 1e-5

    def standing(self) -> bool:
        """Return whether states arrive and the robot does not move."""
        return self.speed(0.25) == 0.0

    def until_walking(self, timeout: float = 30.0) -> None:
        start = len(self.moved)

        def moving() -> bool:
            since = [q for _, q in self.moved[start:]]
            return len(since) > 1 and float(np.ptp(since, axis=0).max()) > 1e-5

        self.until(moving, timeout, "walking")

    def until_standing(self, timeout: float = 10.0) -> float:
        """Wait until the robot stands; return the time from the call to its last motion [s]."""
        began = time.monotonic()
        self.until(self.standing, timeout, "standing still")
        q = self.angles()
        stopped = next((at for at, before in reversed(self.moved) if (before != q).any()), began)
        return max(stopped - began, 0.0)

    def until_status(self, node: str, text: str, timeout: float = 20.0) -> float:
        """Wait until a node publishes a text on /diagnostics; return the time it took [s]."""
        start, began = len(self.got["diagnostics"]), time.monotonic()

        def found() -> bool:
            return any(
                text in s.message and s.name.startswith(f"{node}:")
                for array in self.got["diagnostics"][start:]
                for s in array.status
            )

        self.until(found, timeout, f"a status of {node} with {text!r}")
        return time.monotonic() - began


def row(fault: str, reaction: str, seconds: float | None, outcome: str) -> None:
    """Add a line to the table."""
    ROWS.append((fault, reaction, "" if seconds is None else f"{seconds:.2f} s", outcome))
