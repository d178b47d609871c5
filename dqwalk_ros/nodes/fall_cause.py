"""Finds from the topics of a walk why the robot fell, outside of the control loop."""

from __future__ import annotations

import contextlib
from collections import deque

import numpy as np
from sensor_msgs.msg import Imu, JointState

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode
from dqwalk_ros.nodes.phase_log import PhaseLog
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.state import State
from dqwalk_ros.report.causes import causes
from dqwalk_ros.report.metrics import analyse
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import StateError
from dqwalk_ros.support.topics import VELOCITY
from dqwalk_ros.trace import PhaseRecord, PhysicsRecord, Trace

_REMEMBERED = 10.0
"""Time for which the last states are considered [s]."""
_KEPT = 10000
"""Number of messages that are stored of each topic."""


class FallCause:
    """Stores the last states, commands and inertial measurements of a walk, serialised as they arrive.

    Parameters
    ----------
    phases : PhaseLog
        The phases of this walk.
    """

    def __init__(self, node: WalkNode, phases: PhaseLog) -> None:
        self._phases = phases
        self._states: deque[bytes] = deque(maxlen=_KEPT)
        self._commands: deque[bytes] = deque(maxlen=_KEPT)
        self._felt: deque[bytes] = deque(maxlen=_KEPT)
        node.create_subscription(JointState, VELOCITY, self._on_command, ros.best_effort(_KEPT), raw=True)
        node.create_subscription(Imu, "imu", self._on_imu, ros.best_effort(_KEPT), raw=True)

    def _on_command(self, raw: bytes) -> None:
        self._commands.append(raw)

    def _on_imu(self, raw: bytes) -> None:
        self._felt.append(raw)

    def add_state(self, raw: bytes) -> None:
        """Store a message of joint_states."""
        self._states.append(raw)

    def forget(self) -> None:
        """Forget all messages, because time was set back."""
        for kept in (self._states, self._commands, self._felt):
            kept.clear()

    def find(self) -> str:
        """Return the first cause; empty if the walk is not known, or has no inertial sensor."""
        trace = self._trace()
        found = causes(analyse(trace)) if trace is not None else []
        return f"it fell because: {found[0]}" if found else ""

    def _trace(self) -> Trace | None:
        """Return the walk up to the last command that was not zero; None if there is none."""
        log = self._phases
        if log.reader is None or log.config is None or log.model is None:
            return None
        commands, states, felt = {}, dict[int, State](), dict[int, Array]()
        for raw in self._commands:
            with contextlib.suppress(StateError):
                commands[ros.stamp_of(raw)] = log.reader.command(ros.deserialized(raw, JointState)).velocity
        last = max((stamp for stamp, u in commands.items() if u.any()), default=0)
        first, begun = min(log.begun(0, last), default=0), log.begun(last - round(_REMEMBERED * 1e9), last)
        for raw in self._felt:
            with contextlib.suppress(StateError):
                felt[ros.stamp_of(raw)] = ros.inertial_of(ros.deserialized(raw, Imu))[0]
        for raw in self._states:
            with contextlib.suppress(StateError):
                if begun and begun[0] <= (stamp := ros.stamp_of(raw)) <= last:
                    states[stamp] = log.reader.state(ros.deserialized(raw, JointState))
        stamps = [stamp for stamp in sorted(states) if stamp in felt]
        if len(stamps) < 2:
            return None
        records = []
        for began in begun:
            if (known := log.at(began)) is not None:
                phase, start = known[1].phase, int(np.searchsorted(stamps, began))
                records.append(
                    PhaseRecord(
                        phase.name, phase.kind, phase.support, phase.base, start, 1e-9 * (began - first), phase.q_start,
                        phase.swing_target, DQ(1.0).vec8(), known[1].config,
                    )
                )  # fmt: skip
        unknown = np.full(log.model.n, np.nan)
        return Trace(
            config=log.config,
            model=log.model,
            time=1e-9 * (np.array(stamps) - first),
            q=np.array([states[stamp].q for stamp in stamps]),
            u=np.array([commands.get(stamp, unknown) for stamp in stamps]),
            phases=tuple(record for record in records if record.start < len(stamps)),
            solve_time=np.full(len(stamps), np.nan),
            finished=False,
            physics=PhysicsRecord.measured([states[stamp] for stamp in stamps], [felt[stamp] for stamp in stamps]),
        )
