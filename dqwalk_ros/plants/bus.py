"""The bus to position servos that are told velocities: what stands between a `Command` and the goal of a servo.

The commanded position integrates the velocity, bounded around the measured one: an integral action that removes the
sag of a servo under load and cannot wind up. Torques are fed forward as the angle that makes them, by the stiffness
that the servos are assumed to have.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.compiled import jit
from dqwalk_ros.config import ServoConfig
from dqwalk_ros.servos import Drive, Servos

__all__ = ["Bus"]

Array = NDArray[np.float64]


class Bus:
    """Goals for one servo per joint, written at the rate of the bus and late by its latency.

    Parameters
    ----------
    config : ServoConfig
    servos : Servos
    drive : Drive
        What is assumed of them.
    q : ndarray, shape (n,)
        Where they stand [rad].
    lower, upper : ndarray, shape (n,)
        Joint limits [rad].
    effort : ndarray, shape (n,), optional
        Torques that are fed forward before the first command [N m].
    """

    def __init__(
        self,
        config: ServoConfig,
        servos: Servos,
        drive: Drive,
        q: Array,
        lower: Array,
        upper: Array,
        effort: Array | None = None,
    ) -> None:
        self._config, self._drive, self._lower, self._upper = config, drive, lower, upper
        self._step = np.maximum(servos.resolution, 1e-12)
        self._wanted = q.copy()
        self._fed = np.zeros_like(q) if effort is None else drive.angles(effort)
        self._goal = q + self._fed
        self._written = -math.inf
        self._queue: deque[tuple[float, Array]] = deque()

    @property
    def wanted(self) -> Array:
        """Commanded positions before torques are added, shape (n,) [rad]."""
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
        if effort is not None:
            self._fed = self._drive.angles(effort)
        self._wanted, goal = _goals(
            self._wanted, velocity, dt, q, c.window, self._lower, self._upper, self._fed, self._step
        )
        if c.rate <= 0.0 or time - self._written >= 1.0 / c.rate - 1e-9:
            self._written = time
            self._queue.append((time + c.latency, goal))

    def output(self, time: float) -> tuple[Array, float]:
        """Return the goals (n,) that the servos have at `time` [s] [rad], and until when they hold [s]."""
        while self._queue and self._queue[0][0] <= time + 1e-9:
            self._goal = self._queue.popleft()[1]
        return self._goal, self._queue[0][0] if self._queue else math.inf


@jit
def _goals(wanted, velocity, dt, q, window, lower, upper, fed, step):  # type: ignore[no-untyped-def]
    """Return the commanded positions a period later, and the goals in steps of the servos, both (n,)."""
    moved, goal = np.empty_like(q), np.empty_like(q)
    for i in range(q.shape[0]):
        near = min(max(wanted[i] + dt * velocity[i], q[i] - window), q[i] + window)
        moved[i] = min(max(near, lower[i]), upper[i])
        goal[i] = np.rint((moved[i] + fed[i]) / step[i]) * step[i]
    return moved, goal
