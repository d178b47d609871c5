"""Conversion of commands (velocities and torques) to goal positions of servos, with rate and latency of the bus.

The goal integrates the commanded velocity and is limited to a window around the position at which the command will find
the joint, the measured one plus the motion commanded within the delay: an integral action with anti-windup, which
compensates the deflection of a servo under load. With a small window a leg yields to a force that is not fed forward,
such as that of a stone under its sole. Feedforward torques are converted to an offset of the goal by the assumed
stiffness of the servos.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from dqwalk_ros.config import ServoConfig
from dqwalk_ros.estimation.delay import CommandHistory
from dqwalk_ros.robot.servos import Drive, Servos
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit

__all__ = ["Bus"]


class Bus:
    """Computes the goals of one servo per joint, written at the rate of the bus and effective after its latency.

    Parameters
    ----------
    drive : Drive
        Assumed model of the servos.
    q : ndarray, shape (n,)
        Initial joint angles [rad].
    lower, upper : ndarray, shape (n,)
        Joint limits [rad].
    effort : ndarray, shape (n,), optional
        Feedforward torques before the first command [N m].
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
        self._offset = np.zeros_like(q) if effort is None else drive.angles(effort)
        self._goal = q + self._offset
        self._history = CommandHistory(drive.delay, len(q))
        self._written = -math.inf
        self._queue: deque[tuple[float, Array]] = deque()

    @property
    def wanted(self) -> Array:
        """Commanded positions without the offsets by feedforward torques, shape (n,) [rad]."""
        return self._wanted

    def command(self, velocity: Array, effort: Array | None, q: Array, time: float, dt: float) -> None:
        """Process a command.

        Parameters
        ----------
        velocity : ndarray, shape (n,)
            Joint velocities [rad/s].
        effort : ndarray, shape (n,), or None
            Feedforward torques [N m]; None: those of the last command.
        q : ndarray, shape (n,)
            Measured angles that the command answers [rad].
        time, dt : float
            Time of the command, and the period for which it holds [s].
        """
        c = self._config
        if effort is not None:
            self._offset = self._drive.angles(effort)
        expected = q + self._history.pending(time)
        self._history.add(time, velocity, dt)
        self._wanted, goal = _goals(
            self._wanted, velocity, dt, expected, c.window, self._lower, self._upper, self._offset, self._step
        )
        if c.rate <= 0.0 or time - self._written >= 1.0 / c.rate - 1e-9:
            self._written = time
            self._queue.append((time + c.latency, goal))

    def output(self, time: float) -> tuple[Array, float]:
        """Return the goals (n,) of the servos at `time` [s] [rad], and the time at which they change next [s]."""
        while self._queue and self._queue[0][0] <= time + 1e-9:
            self._goal = self._queue.popleft()[1]
        return self._goal, self._queue[0][0] if self._queue else math.inf


@jit
def _goals(wanted, velocity, dt, expected, window, lower, upper, offset, step):  # type: ignore[no-untyped-def]
    """Return the commanded positions after one period, and the goals rounded to the servos' steps, both (n,) [rad]."""
    moved, goal = np.empty_like(wanted), np.empty_like(wanted)
    for i in range(wanted.shape[0]):
        near = min(max(wanted[i] + dt * velocity[i], expected[i] - window), expected[i] + window)
        moved[i] = min(max(near, lower[i]), upper[i])
        goal[i] = np.rint((moved[i] + offset[i]) / step[i]) * step[i]
    return moved, goal
