"""Decides which measurements of the inertial sensor a controller uses."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dqwalk_ros.estimation.vertical import turning
from dqwalk_ros.nodes.watchdog import FaultCounter
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import StateError


class Felt(NamedTuple):
    """What an inertial sensor measures, in its frame."""

    up: Array
    """Unit vector against gravity, shape (3,)."""
    gyro: Array
    """Angular velocity, shape (3,) [rad/s]."""
    acceleration: Array | None
    """Specific force, shape (3,) [m/s^2]."""


class InertialGate:
    """Decides which measurements of the inertial sensor a controller uses, and what it uses instead of the others.

    Instead of an impossible one it uses the last one, with the vertical turned by its angular velocity. Within the one
    or two periods for which this lasts, the angular velocity hardly changes, so the vertical is as exact as a measured
    one; without a vertical the balance would be interrupted, and without an answer the walk.

    Parameters
    ----------
    limit : int
        Consecutive impossible measurements that are a fault.
    longest : callable
        Returns the time between two measurements above which nothing follows from the first about the second [s].
    since : callable, optional
        Returns the longest time that can have passed since the last state, whatever the stamps say [s].

    Attributes
    ----------
    impossible : FaultCounter
        Of vertical and angular velocity.
    rejected : int
        Number of impossible measurements.
    reason : str
        Why the last measurement is not used as it is; empty if it is.
    resumed : str
        By how much the vertical turned while nothing was measured, if the last measurement ended such a gap; else
        empty.
    """

    tilt, turn = 0.1, 2.0
    """Accepted difference of the vertical from the last one turned by the gyroscope [rad], and per time [rad/s].
    Walks with noise, and falls, remain below 0.025 rad."""
    rate, jolt, angular = 35.0, 3.0, 200.0
    """Largest angular velocity, 2000 degrees/s [rad/s]; accepted change [rad/s], and per time [rad/s^2]. Falls remain
    below 2 rad/s in 5 ms."""
    strongest = 16.0 * GRAVITY
    """Largest acceleration, the range of the usual sensors [m/s^2]; only the odometry uses it."""

    def __init__(self, limit: int, longest: Callable[[], float], since: Callable[[], float] = lambda: math.inf) -> None:
        self._longest, self._since = longest, since
        self.impossible, self._too_strong = FaultCounter(limit), FaultCounter(limit)
        self.rejected = 0
        self.reset()

    def reset(self) -> None:
        """Accept any measurement next, as the first one."""
        self.impossible.reset()
        self._too_strong.reset()
        self.reason = self.resumed = self._strong = ""
        self._judged = self._accepted = -1  # stamps of the last measurement, and of the last accepted one [ns]
        self._last: Felt | None = None  # accepted
        self._used: Felt | None = None

    def use(self, stamp: int, felt: Felt | StateError) -> Felt:
        """Return the measurement to be used for the one with a stamp [ns], which may be given again.

        Parameters
        ----------
        felt : Felt or StateError
            What was measured, all numbers finite, or why the message is invalid.

        Raises
        ------
        StateError
            If it is impossible and cannot be replaced, because it is the first one, or one of too many in a row.
        """
        if stamp == self._judged and self._used is not None:
            return self._used
        self._judged, passed = stamp, 1e-9 * (stamp - self._accepted)
        last = self._last if abs(passed) <= self._longest() else None  # it may be late, so that it follows a newer one
        self.resumed = ""
        if isinstance(felt, StateError):
            self.reason = str(felt)
        else:
            felt = felt._replace(acceleration=self._possible(felt.acceleration))
            self.reason = self._why(last, felt, passed)
            if self.impossible:  # the walk has ended; whether the robot lies is still of interest
                return Felt(felt.up, np.zeros(3), None)
            if not self.reason:
                self.impossible.good()
                self.resumed = self._after_a_gap(felt, passed) if last is None else ""
                self._accepted = stamp
                self._last = self._used = felt
                return felt
        self.rejected, self._used = self.rejected + 1, None
        if self._last is None:  # nothing has been measured yet
            raise StateError(self.reason)
        if self.impossible.fault(f"{self.reason}; {self.impossible.limit} in a row, until ~/reset"):
            raise StateError(self.impossible.reason)
        if last is None:
            raise StateError(self.reason)
        most = self._since()
        self._used = last._replace(up=_turned(last.up, last.gyro, min(max(passed, -most), most)))
        return self._used

    def _why(self, last: Felt | None, felt: Felt, passed: float) -> str:
        """Return why a measurement is impossible, `passed` [s] after the last accepted one; empty if it is possible."""
        if not (fastest := float(np.abs(felt.gyro).max())) <= self.rate:
            return f"the inertial sensor turns at {fastest:.3g} rad/s, beyond {self.rate:g} rad/s"
        if last is None:
            return ""
        time = min(abs(passed), self._since())  # within which it can have changed
        if not (change := float(np.abs(felt.gyro - last.gyro).max())) <= self.jolt + time * self.angular:
            return f"the angular velocity of the inertial sensor jumped by {change:.3g} rad/s"
        expected = _turned(last.up, 0.5 * (last.gyro + felt.gyro), passed)
        if not (off := float(np.linalg.norm(felt.up - expected))) <= self.tilt + time * self.turn:
            return (
                f"the vertical of the inertial sensor jumped by {math.degrees(off):.0f} degrees, "
                "which its gyroscope does not confirm"
            )
        return ""

    def _after_a_gap(self, felt: Felt, passed: float) -> str:
        """Return by how much the vertical has turned since the last measurement, `passed` [s] ago, or ""."""
        off = 0.0 if self._last is None else float(np.linalg.norm(felt.up - self._last.up))
        if off <= self.tilt:
            return ""
        return (
            f"imu: its vertical turned by {math.degrees(off):.0f} degrees in {abs(passed):.3g} s without a measurement"
            ": was the robot moved, or does a sensor that was restarted take its posture for upright?"
        )

    def _possible(self, acceleration: Array | None) -> Array | None:
        """Return an acceleration, or instead of a single impossible one the last one; None if there are more."""
        if acceleration is None or (strongest := float(np.abs(acceleration).max())) <= self.strongest:
            self._too_strong.good()
            return acceleration
        self.rejected += 1
        most = f"{self.strongest:.0f} m/s^2 is the most"
        self._strong = f"imu: an acceleration of {strongest:.3g} m/s^2, where {most}: check its unit"
        self._too_strong.fault(f"{self._strong}; the odometry does without")
        return None if self._too_strong or self._last is None else self._last.acceleration

    @property
    def warning(self) -> str:
        """What is wrong with the accelerometer; empty if nothing is."""
        return self._too_strong.reason

    @property
    def rejection(self) -> str:
        """Why the last message that was rejected was, and what is used instead of it."""
        wrong = self.reason or self._strong
        return self.warning if not self.reason and self.warning else f"{wrong}; the last one is used instead"


def _turned(up: Array, omega: Array, time: float) -> Array:
    """Return the vertical `up` (3,) in a frame that turns by the angular velocity `omega` (3,) for a `time` [s]."""
    turned = up + time * turning(up, omega)
    out: Array = turned / math.sqrt(float(turned @ turned))
    return out
