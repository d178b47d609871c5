"""Prediction of the joint angles at the time when a command takes effect (Smith predictor).

The goals of position servos integrate the commanded velocities u. So the motion that was commanded within the delay T,
and is not measured yet, is S(t) - S(t - T), where S is the integral of u. Measured velocities are not used: they would
close a derivative feedback loop through the delay.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit


class CommandHistory:
    """The integral of the commands over the last `delay`.

    Parameters
    ----------
    delay : float
        T, the time from a measurement to the effect of the command that answers it [s].
    n : int
        Number of joints.

    Attributes
    ----------
    delay : float
        T, which may be changed [s]; without a delay, commands are not kept.
    motion : ndarray, shape (n,)
        S, the integral of all commands [rad].
    """

    def __init__(self, delay: float, n: int) -> None:
        self.delay = delay
        self.motion = np.zeros(n)
        self._sums: deque[tuple[float, Array]] = deque()
        _left(self.motion, self.motion, self.motion, 0.0)  # compiled here, so that the first command is not late

    def add(self, time: float, velocity: Array, dt: float) -> None:
        """Add the command u (n,) [rad/s] that answers the state at `time` [s], for the period `dt` [s]."""
        before = self.motion
        self.motion = before + dt * velocity
        if self.delay == 0.0:
            return
        if not self._sums or self._sums[-1][0] < time - 1e-9:  # no motion was commanded since
            self._sums.append((time, before))
        self._sums.append((time + dt, self.motion))
        self._forget(time - self.delay)

    def pending(self, time: float) -> Array:
        """Return S(t) - S(t - T) at `time` [s]: the motion until the next command takes effect, shape (n,) [rad]."""
        begin, sums = time - self.delay, self._sums
        self._forget(begin)
        if len(sums) < 2:
            return np.zeros(len(self.motion))
        (t0, s0), (t1, s1) = sums[0], sums[1]
        fraction = min(max((begin - t0) / max(t1 - t0, 1e-9), 0.0), 1.0)
        pending: Array = _left(self.motion, s0, s1, fraction)
        return pending

    def motion_of(self, time: float, velocity: Array, dt: float, until: float) -> Array:
        """Add a command as `add` does; return the motion (n,) that takes effect from `time` to `until` [s]."""
        before = self.motion - self.pending(time)
        self.add(time, velocity, dt)
        effective: Array = self.motion - self.pending(until) - before
        return effective

    def _forget(self, begin: float) -> None:
        """Remove the commands that ended before `begin` [s]."""
        while len(self._sums) > 1 and self._sums[1][0] <= begin:
            self._sums.popleft()


@jit
def _left(motion: Array, s0: Array, s1: Array, fraction: float) -> Array:
    """Return what is left of a motion (n,) after a fraction of the way from s0 to s1 (n,)."""
    return motion - (s0 + fraction * (s1 - s0))
