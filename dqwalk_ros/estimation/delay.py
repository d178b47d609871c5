"""The state after the delay: where the joints will be when the command of this moment has its effect.

A Smith predictor. The goals of position servos integrate the commanded velocities, so what was commanded within the
delay T and has not been seen yet is S(t) - S(t - T) with S the integral of u. No measured velocity is in it: that would
close a derivative loop through the delay.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

__all__ = ["CommandHistory"]

Array = NDArray[np.float64]


class CommandHistory:
    """The integral of the commands over the last `delay`.

    Parameters
    ----------
    delay : float
        T, from a measurement to the effect of its answer [s].
    n : int
        Number of joints.
    """

    def __init__(self, delay: float, n: int) -> None:
        self._delay = delay
        self._sum = np.zeros(n)
        self._sums: deque[tuple[float, Array]] = deque()

    def add(self, time: float, velocity: Array, dt: float) -> None:
        """Add the command u (n,) [rad/s] that answers the state at `time` [s], for the period `dt` [s]."""
        if not self._sums:
            self._sums.append((time, self._sum))
        self._sum = self._sum + dt * velocity
        self._sums.append((time + dt, self._sum))
        self._forget(time - self._delay)

    def pending(self, time: float) -> Array:
        """Return what the joints will have moved when the command of `time` [s] has its effect, shape (n,) [rad]."""
        begin, sums = time - self._delay, self._sums
        self._forget(begin)
        if len(sums) < 2:
            return np.zeros_like(self._sum)
        (t0, s0), (t1, s1) = sums[0], sums[1]
        part = min(max((begin - t0) / (t1 - t0), 0.0), 1.0)
        ahead: Array = self._sum - (s0 + part * (s1 - s0))
        return ahead

    def _forget(self, begin: float) -> None:
        """Drop what ended before `begin` [s]."""
        while len(self._sums) > 1 and self._sums[1][0] <= begin:
            self._sums.popleft()
