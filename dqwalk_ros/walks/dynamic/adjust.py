"""Adjusts time and position of the landing to the measured divergent component of motion xi.

The step is not changed while a zero-moment point within the sole can bring xi to its planned value at the landing. This
dead zone is necessary because the reaction of the swinging leg, amplified by exp(w T), would otherwise change the step.
Otherwise an error of xi remains at the landing. The time of the landing is chosen such that the lateral error, which a
foot without ankle roll joint cannot compensate, is small, and the position such that the error along x is zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dqwalk_ros.config import DynamicConfig
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.walks.dynamic.plan import Pressed, before

HURRY = 0.03
"""Largest change of the landing time, and of a double support's end, in one control period [s]."""
_LONGEST_STEP = 1.5
"""Longest adjusted swing, as a multiple of the planned one."""
_GRID = 0.01
"""Resolution of the search for the landing time [s]."""
_AHEAD_PART, _TIME_PART = 0.05, 1e-3
"""Weights of the squared error along x and of the squared change of time [m^2/s^2], relative to the lateral error."""
_SMOOTH = 0.5
"""Fraction by which the landing position approaches its new value in one control period."""

_LONGEST_TRANSFER = 0.3
"""Longest remaining time of a double support that is tried, unless more is planned [s]."""


@dataclass(frozen=True)
class Step:
    """A single support as planned, in the axes of the base sole."""

    z: Array
    """Zero-moment point, shape (2,) [m]."""
    landing: Array
    """Zero-moment point of the next step, on the swing foot after its landing, shape (2,) [m]."""
    offset: Array
    """xi at the end, relative to `landing`, shape (2,) [m]."""
    duration: float
    """Planned duration [s]."""
    omega: Array
    """Frequencies of the pendulum along x and y, shape (2,) [1/s]."""
    low: Array
    high: Array
    """Corners of the rectangle within the sole to which the zero-moment point is limited, shape (2,) [m]."""
    reach: Array
    """Largest displacement of the landing position, shape (2,) [m]."""

    @cached_property
    def constants(self) -> tuple[Array, ...]:
        """Zero-moment point, planned end of xi, omega, low and high, shape (2,) each."""
        return self.z, self.landing + self.offset, self.omega, self.low, self.high


def left_over(step: Step, xi: Array, elapsed: float, left: float) -> tuple[Array, Array]:
    """Return the error of xi that the ankle cannot compensate until the landing.

    With a constant zero-moment point z, the solution of xi' = w (xi - z) determines the z that brings xi to its planned
    end; the error is due to the part of z outside `step.low` and `step.high`.

    Parameters
    ----------
    step : Step
    xi : ndarray, shape (2,)
        Measured divergent component [m].
    elapsed : float
        Time since the lift-off [s].
    left : float
        Time until the landing [s].

    Returns
    -------
    error : ndarray, shape (2,)
        Error of xi at the landing [m].
    displacement : ndarray, shape (2,)
        Displacement of the planned end by the change of the landing time [m].
    """
    over, moved = _left_over(*step.constants, xi, step.duration - elapsed, left)
    return over, moved


@jit
def _left_over(
    z: Array, end: Array, omega: Array, low: Array, high: Array, xi: Array, planned: float, left: float
) -> tuple[Array, Array]:
    """Return error and displacement (2,) of `left_over`; `planned` is the planned time until the landing [s]."""
    over, moved = np.empty(2), np.zeros(2)
    moved[0] = (math.exp(-omega[0] * (planned - left)) - 1.0) * (end[0] - z[0])  # an earlier landing shortens the step
    for i in range(2):
        grown = math.exp(left * omega[i])
        needed = (xi[i] * grown - (end[i] + moved[i])) / (grown - 1.0)  # xi' = w (xi - z) with constant z
        over[i] = (needed - min(max(needed, low[i]), high[i])) * (grown - 1.0)
    return over, moved


@jit
def _best_time(
    z: Array, end: Array, omega: Array, low: Array, high: Array, xi: Array, planned: float, soonest: float,
    latest: float,
) -> float:  # fmt: skip
    """Return the time until the landing, between two times [s], with the least cost."""
    best, least = soonest, math.inf
    for i in range(int((latest - soonest) / _GRID + 1e-7) + 1):
        left = soonest + i * _GRID
        over, _ = _left_over(z, end, omega, low, high, xi, planned, left)
        cost = over[1] ** 2 + _AHEAD_PART * over[0] ** 2 + _TIME_PART * (left - planned) ** 2
        if cost < least:
            best, least = left, cost
    return best


def adjusted(
    step: Step, xi: Array, elapsed: float, duration: float, shift: Array, c: DynamicConfig
) -> tuple[float, Array, Array]:
    """Return the duration and landing position of a step for the measured divergent component.

    Parameters
    ----------
    step : Step
    xi : ndarray, shape (2,)
        Measured divergent component [m].
    elapsed : float
        Time since the lift-off [s].
    duration : float
        Previous duration [s].
    shift : ndarray, shape (2,)
        Previous displacement of the landing position [m].
    c : DynamicConfig

    Returns
    -------
    duration : float
        [s]
    shift : ndarray, shape (2,)
        Displacement of the landing position [m].
    error : ndarray, shape (2,)
        Error of xi at the landing that the ankle cannot compensate [m].
    """
    soonest = max(c.shortest_step - elapsed, c.settled)
    latest = max(_LONGEST_STEP * step.duration - elapsed, soonest)
    best = elapsed + _best_time(*step.constants, xi, step.duration - elapsed, soonest, latest)
    duration += min(max(best - duration, -HURRY), HURRY)
    over, moved = left_over(step, xi, elapsed, duration - elapsed)
    wanted = np.clip(over + moved, -step.reach, step.reach)
    return duration, shift + _SMOOTH * (wanted - shift), over


def transfer_time(reference: Pressed, z: Array, xi: Array, least: float) -> float:
    """Return the remaining time of a double support after which xi is at its planned end to the side.

    Parameters
    ----------
    reference : Pressed
        The double support, with its zero-moment point at the end.
    z : ndarray, shape (2,)
        Present zero-moment point; from there it moves linearly [m].
    xi : ndarray, shape (2,)
        Measured divergent component [m].
    least : float
        Least remaining time [s].
    """
    return float(_transfer_time(z, reference.b, reference.end, reference.omega, xi[1], max(least, _GRID)))


@jit
def _transfer_time(z: Array, b: Array, end: Array, omega: Array, y: float, first: float) -> float:
    """Return the time of `transfer_time`, from `first` [s] on, for the divergent component `y` to the side [m]."""
    best, least = first, math.inf
    for i in range(max(math.ceil((_LONGEST_TRANSFER - first) / _GRID), 1)):
        missed = abs(before(z, b, end, first + i * _GRID, omega)[1] - y)
        if missed < least:
            best, least = first + i * _GRID, missed
    return best
