"""The bus to position servos that are told velocities: what stands between a `Command` and the goal of a servo.

The commanded position integrates the velocity, bounded around the measured one: an integral action that removes the
sag of a servo under load and cannot wind up. The torque of gravity, where the controller says it, is fed forward as
the sag it would cause.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import ServoConfig

__all__ = ["Servos"]

Array = NDArray[np.float64]


class Servos:
    """One servo per joint.

    Parameters
    ----------
    config : ServoConfig
    q : ndarray, shape (n,)
        Where they stand [rad].
    lower, upper : ndarray, shape (n,)
        Joint limits [rad].
    """

    def __init__(self, config: ServoConfig, q: Array, lower: Array, upper: Array) -> None:
        self._config, self._lower, self._upper = config, lower, upper
        self._wanted = q.copy()
        self._sag = np.zeros_like(q)
        self._output = q.copy()
        self._written = -math.inf
        self._queue: deque[tuple[float, Array]] = deque()

    @property
    def wanted(self) -> Array:
        """Commanded positions before the sag is added, shape (n,) [rad]."""
        return self._wanted

    def command(self, velocity: Array, effort: Array | None, q: Array, time: float, dt: float) -> None:
        """Take a command at `time` [s] for a period `dt` [s].

        Parameters
        ----------
        velocity : ndarray, shape (n,)
            [rad/s]
        effort : ndarray, shape (n,), or None
            Torques fed forward [N m].
        q : ndarray, shape (n,)
            Measured angles that it answers [rad].
        time, dt : float
        """
        c = self._config
        wanted = self._wanted + dt * velocity
        wanted = np.minimum(np.maximum(wanted, q - c.window), q + c.window)
        self._wanted = np.minimum(np.maximum(wanted, self._lower), self._upper)
        if effort is not None and c.assumed_stiffness > 0.0:
            self._sag = effort / c.assumed_stiffness
        if c.rate <= 0.0 or time - self._written >= 1.0 / c.rate - 1e-9:
            self._written = time
            position = self._wanted + self._sag
            if c.resolution > 0.0:
                position = np.rint(position / c.resolution) * c.resolution
            self._queue.append((time + c.latency, position))

    def output(self, time: float) -> tuple[Array, float]:
        """Return the goals (n,) of the servos at `time` [s] [rad], and until when they hold [s]."""
        while self._queue and self._queue[0][0] <= time + 1e-9:
            self._output = self._queue.popleft()[1]
        return self._output, self._queue[0][0] if self._queue else math.inf
