"""Position servos that are told velocities: what stands between a `Command` and the torque at a joint.

The commanded position integrates the velocity, bounded around the measured one: an integral action that removes the
sag of a servo under load and cannot wind up. The torque of gravity, where the controller says it, is fed forward as
the sag it would cause.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import ServoConfig
from dqwalk_ros.controllers import Command

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
        self._written = -np.inf
        self._queue: list[tuple[float, Array]] = []

    @property
    def wanted(self) -> Array:
        """Commanded positions before the sag is added, shape (n,) [rad]."""
        return self._wanted

    def command(self, command: Command, q: Array, time: float, dt: float) -> None:
        """Take a command at `time` [s] that answers the measured angles `q` (n,) [rad], for a period `dt` [s]."""
        c = self._config
        self._wanted = np.clip(self._wanted + dt * command.velocity, q - c.window, q + c.window)
        self._wanted = np.clip(self._wanted, self._lower, self._upper)
        if command.effort is not None and c.assumed_stiffness > 0.0:
            self._sag = command.effort / c.assumed_stiffness
        if time - self._written >= 1.0 / c.rate - 1e-9 if c.rate > 0.0 else True:
            self._written = time
            position = self._wanted + self._sag
            if c.resolution > 0.0:
                position = np.round(position / c.resolution) * c.resolution
            self._queue.append((time + c.latency, position))

    def output(self, time: float) -> Array:
        """Return the positions the servos hold at `time` [s], shape (n,) [rad]."""
        while self._queue and self._queue[0][0] <= time + 1e-9:
            self._output = self._queue.pop(0)[1]
        return self._output
