"""A walk in real time whose states and commands all pass through the test, which can change, delay or drop them.

Also a plugin of pytest: `-p chaos` prints the table of all faults at the end.
"""

from __future__ import annotations

import copy
import random
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live import Live
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from dqwalk_ros.config import Config

Policy = Callable[[JointState], Iterator[tuple[float, JointState]]]
"""A message -> messages and by how much each is delayed [s]."""

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
    dice = random.Random(1)
    return lambda msg: iter([] if dice.random() < share else [(0.0, msg)])


def delaying(delay: float) -> Policy:
    return lambda msg: iter([(delay, msg)])


def doubling(msg: JointState) -> Iterator[tuple[float, JointState]]:
    yield 0.0, msg
    yield 0.0, msg


def swapping() -> Policy:
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

    Attributes
    ----------
    states, commands : Policy
        What becomes of a message on its way; `passing` without a fault.
    moved : list of (float, ndarray)
        When a state of the plant came, and its angles.
    """

    def __init__(self, folder: Path, domain: int, config: Config, environment: Mapping[str, str] | None = None) -> None:
        super().__init__(folder, domain, config, environment)
        self.on_states: Policy = passing
        self.on_commands: Policy = passing
        self.moved: list[tuple[float, np.ndarray]] = []
        self._late: list[tuple[float, Any, JointState]] = []
        deep = QoSProfile(depth=50)
        self.to_controller = self.node.create_publisher(JointState, "states_in", deep)
        self.to_plant = self.node.create_publisher(JointState, "joint_velocity_commands", deep)
        self.node.create_subscription(JointState, "joint_states", self._state, deep)
        self.node.create_subscription(JointState, "commands_out", self._command, deep)
        self.node.create_timer(0.005, self._send_late)

    def _state(self, msg: JointState) -> None:
        assert np.isfinite(msg.position).all(), "a state that is not finite left the plant"
        self.moved.append((time.monotonic(), np.array(msg.position)))
        self._relay(self.on_states, self.to_controller, msg)

    def _command(self, msg: JointState) -> None:
        assert np.isfinite(msg.velocity).all(), "a command that is not finite left the controller"
        self._relay(self.on_commands, self.to_plant, msg)

    def _relay(self, policy: Policy, publisher: Any, msg: JointState) -> None:
        for delay, out in policy(msg):
            if delay:
                self.publish_late(delay, publisher, out)
            else:
                publisher.publish(out)

    def publish_late(self, delay: float, publisher: Any, msg: JointState) -> None:
        """Publish a message after a delay [s]."""
        self._late.append((time.monotonic() + delay, publisher, msg))

    def _send_late(self) -> None:
        now = time.monotonic()
        due, self._late = [e for e in self._late if e[0] <= now], [e for e in self._late if e[0] > now]
        for _, publisher, msg in due:
            publisher.publish(msg)

    def begin(self, name: str, *parameters: str) -> None:
        """Start a node with the relays in its way."""
        remap = ["-r", "joint_states:=states_in", "-r", "joint_velocity_commands:=commands_out"]
        extra = [word for parameter in parameters for word in ("-p", parameter)]
        self.processes.start(
            name,
            ["--ros-args", "--params-file", str(self.params), *extra, *(remap if name == "controller" else [])],
        )

    # ------------------------------------------------------------------ what happens

    def speed(self, span: float = 0.3) -> float:
        """Largest motion of a joint within the last `span` [s] of states, [rad]; infinite without states."""
        since = time.monotonic() - span
        recent = [q for at, q in self.moved if at >= since]
        return float(np.ptp(recent, axis=0).max()) if len(recent) > 1 else float("nan")

    def angles(self) -> np.ndarray:
        """Return the angles of the plant's last state [rad]."""
        self.until(lambda: self.moved, 60.0, "a state of the plant")
        return self.moved[-1][1]

    def walking(self) -> bool:
        """Whether the robot moves now."""
        return self.speed() > 1e-5

    def standing(self) -> bool:
        """Whether states come and the robot does not move."""
        return self.speed(0.25) == 0.0

    def walks(self, timeout: float = 30.0) -> None:
        start = len(self.moved)

        def moving() -> bool:
            since = [q for _, q in self.moved[start:]]
            return len(since) > 1 and float(np.ptp(since, axis=0).max()) > 1e-5

        self.until(moving, timeout, "walking")

    def stands(self, timeout: float = 10.0) -> float:
        """Wait until the robot stands; return how long ago it moved last, from now on counted [s]."""
        began = time.monotonic()
        self.until(self.standing, timeout, "standing still")
        q = self.angles()
        stopped = next((at for at, before in reversed(self.moved) if (before != q).any()), began)
        return max(stopped - began, 0.0)

    def said(self, node: str, text: str, timeout: float = 20.0) -> float:
        """Wait until a node says something on /diagnostics; return the time it took [s]."""
        start, began = len(self.got["diagnostics"]), time.monotonic()

        def found() -> bool:
            return any(
                text in s.message and s.name.startswith(f"{node}:")
                for array in self.got["diagnostics"][start:]
                for s in array.status
            )

        self.until(found, timeout, f"{node} saying {text!r}")
        return time.monotonic() - began


def row(fault: str, reaction: str, seconds: float | None, outcome: str) -> None:
    """Add a line to the table."""
    ROWS.append((fault, reaction, "" if seconds is None else f"{seconds:.2f} s", outcome))


@pytest.fixture
def table() -> list[tuple[str, str, str, str]]:
    return ROWS
