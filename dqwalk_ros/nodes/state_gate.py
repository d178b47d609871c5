"""Decides which measured states a controller accepts: every number is compared with what is possible.

The nodes need no other check of a state. One impossible value is rejected and counted; `safety.jumps` in a row are a
fault that only ``~/reset`` clears.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable

import numpy as np

from dqwalk_ros.nodes.inertial_gate import InertialGate
from dqwalk_ros.nodes.velocity_gate import VelocityGate
from dqwalk_ros.nodes.watchdog import Clock, ClockSteps, FaultCounter, Watchdog
from dqwalk_ros.paper.state import State
from dqwalk_ros.robot.limits import FASTEST, named_angles, outside_limits, unreachable
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import StateError


class StateGate:
    """Decides which measured states a controller accepts, and at what time of the walk.

    Every number of a state is compared with what is possible since the last accepted one. The time of the walk advances
    by the stamps, and where those jump, because a clock was set, by the time of receipt.

    Parameters
    ----------
    dt : float
        Period of the states [s].
    timeout : callable
        Returns the timeout of the states [s].
    outside : float
        Largest excess over the joint limits of an accepted state [rad].
    jumps : int
        Consecutive impossible states after which every state is rejected until `reset`.
    by_stamp : bool
        In lockstep: time is measured by the stamps, not by the steady clock.

    Attributes
    ----------
    watchdog : Watchdog
        Fed by accepted states only.
    impossible : FaultCounter
        Of states with impossible joint angles or velocities.
    inertial : InertialGate
    velocities : VelocityGate
    overtaken : int
        Number of states ignored because of their stamp.
    stepped : float
        By how much the stamp of the last accepted state had jumped, because a clock was set [s]; 0 if it had not.
    """

    repeats = 5
    """Number of consecutive states with the stamp of the last one that indicates stamps which do not advance."""
    soon = 0.25
    """Part of a period; a state that follows the last one sooner is ignored, because no velocity follows from it."""
    late = 2.0
    """Periods by which a message may arrive earlier than it should, because the one before was late."""
    may_repeat = False
    """Whether the plant publishes a state again until it is answered."""

    def __init__(
        self,
        model: RobotModel,
        dt: float,
        timeout: Callable[[], float],
        *,
        outside: float = 0.1,
        jumps: int = 3,
        by_stamp: bool = False,
        clock: Clock = time.monotonic,
    ) -> None:
        self._model, self._dt, self._outside, self._by_stamp = model, dt, outside, by_stamp
        self._speed = np.minimum(model.velocity_max, FASTEST)
        self._timeout = timeout
        self.watchdog = Watchdog(timeout, clock)
        self.impossible = FaultCounter(jumps)
        since = (lambda: math.inf) if by_stamp else (lambda: self.watchdog.age + self.late * dt)
        self.inertial = InertialGate(jumps, timeout, since)
        self.velocities = VelocityGate(model.joint_names, jumps)
        self.overtaken = 0
        self.reset()

    def reset(self) -> None:
        """Accept any state next, as the first one."""
        self.impossible.reset()
        self.inertial.reset()
        self.velocities.reset()
        self.watchdog.starve()
        self._q: Array | None = None
        self._stamp = -1
        self._repeated = 0  # consecutive states with this stamp
        self._steps = ClockSteps()
        self._offset = 0  # of the stamps from the time of the walk [ns]
        self._passed = 0.0  # from the last accepted state to the first impossible one after it [s]
        self.stepped = 0.0

    @property
    def fault(self) -> str:
        """Why every state is rejected until `reset`; empty if that is not so."""
        return self.impossible.reason or self.inertial.impossible.reason

    def is_new(self, stamp: int) -> bool:
        """Return whether a stamp [ns] follows the last accepted one, or a clock was set.

        All other states have overtaken each other, or have a wrong stamp. After a timeout any stamp but the last one is
        accepted.
        """
        repeated = stamp == self._stamp and not self.may_repeat
        self._repeated = self._repeated + 1 if repeated else 0
        passed = 1e-9 * (stamp - self._stamp)
        follows = self.soon * self._dt <= passed <= self._farthest
        follows = follows or self._stamp < 0 or (self.watchdog.silent and not repeated)
        elsewhere = not 0.0 <= passed <= self._farthest
        if (follows or elsewhere) and self._steps.accepts(stamp, follows=follows):
            return True
        self.overtaken += 1
        return False

    @property
    def _farthest(self) -> float:
        """Longest time by which the stamps can have advanced since the last accepted state [s]."""
        return self.watchdog.age + self._timeout()

    @property
    def stuck(self) -> str:
        """Why every state is ignored, if the stamps do not advance while states arrive; empty otherwise."""
        if self._repeated < self.repeats:
            return ""
        return (
            f"they all have the stamp {1e-9 * self._stamp:.9g}: set header.stamp to the time of the measurement, "
            "a new one for each state"
        )

    def accept(self, stamp: int, state: State) -> State:
        """Return a state with the time of the walk, without velocities that are wrong; or raise and change nothing.

        Parameters
        ----------
        stamp : int
            [ns]
        state : State
            As measured, all numbers finite.

        Raises
        ------
        StateError
            If it is outside the joint limits, further from the last one than the joints can move, or has velocities
            that are not those of the angles; the message names the joints.
        """
        if self.impossible:
            raise StateError(self.impossible.reason)
        elapsed = self._elapsed(stamp)
        passed, q = 1e-9 * elapsed, state.q
        if outside := outside_limits(q, self._model, self._outside):
            raise self._reject(f"outside the joint limits: {outside} ({self._outside:g} rad are tolerated)")
        moved = np.zeros(self._model.n) if self._q is None else q - self._q
        if self._q is not None:
            reach = passed if self._by_stamp else max(passed, self.watchdog.age)
            if self.impossible.count:  # waiting does not make a jump plausible
                reach = min(reach, self._passed)
            self._passed = reach
            beyond = unreachable(q, self._q, reach, self._speed, self._dt * self._speed)
            if far := named_angles(self._model, np.abs(moved), beyond):
                raise self._reject(f"a jump that the velocity limits do not allow: {far}")
        if state.dq is not None and not self.velocities.wrong:
            wrong = unreachable(state.dq, moved / max(passed, self._dt), 1.0, self._speed, 0.0)
            if wrong.any():
                turning = ", ".join(f"{self._model.joint_names[i]} {state.dq[i]:.3g}" for i in np.flatnonzero(wrong))
                raise self._reject(f"joint velocities that are not those of the angles: {turning} rad/s")
        self.impossible.good()
        step = stamp - self._stamp - elapsed
        self._offset, self.stepped = self._offset + step, 1e-9 * step
        self._q, self._stamp = q, stamp
        self.watchdog.feed()
        dq = self.velocities.use(q, state.dq, passed)
        return dataclasses.replace(state, time=self.time_of(stamp), dq=dq)

    def time_of(self, stamp: int) -> float:
        """Return the time of the walk [s] of a stamp [ns], by the clock of the last accepted state."""
        return 1e-9 * (stamp - self._offset)

    def _elapsed(self, stamp: int) -> int:
        """Return the time since the last accepted state, until one with a stamp [ns]: by receipt if a clock was set."""
        passed = stamp - self._stamp
        if self._by_stamp or 0 < passed <= self._farthest * 1e9:
            return passed
        age = self.watchdog.age
        return round(1e9 * (max(age, self._dt) if age < math.inf else self._dt))  # infinite before the first state

    def _reject(self, why: str) -> StateError:
        """Count an impossible state and return its error."""
        if self._q is None:  # nothing moves yet
            return StateError(why)
        latched = self.impossible.fault(f"{why}; {self.impossible.limit} in a row, rejecting all states until ~/reset")
        return StateError(self.impossible.reason if latched else why)
