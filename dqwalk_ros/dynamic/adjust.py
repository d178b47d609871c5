"""When and where to put the foot down, from the divergent component as it is measured.

While xi is where the ankle can still bring it to its end in time, by a zero-moment point within the sole, the step is
left alone: this is the dead zone, without which the reaction of the swinging leg alone, grown by exp(w T), would move
the step about. What the ankle cannot do is left over at the landing; the time of the landing is chosen so that this is
small to the side, where a foot without ankle roll cannot be moved, and the place so that it is zero ahead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import DynamicConfig

__all__ = ["Step", "adjusted", "left_over"]

Array = NDArray[np.float64]

_GRID = 0.01
"""Times of landing that are tried are this far apart [s]."""
_AHEAD_PART, _TIME_PART = 0.05, 1e-3
"""What counts beside the square of what is left over to the side: that ahead, and that of the change of time [m/s]."""
_SMOOTH = 0.5
"""The landing place goes this part of its way in one tick."""


@dataclass(frozen=True)
class Step:
    """A single support as it was planned; all in the axes of the base sole [m, s].

    Attributes
    ----------
    z : ndarray, shape (2,)
        Zero-moment point.
    landing : ndarray, shape (2,)
        Zero-moment point of the step after it, on the foot that swings.
    offset : ndarray, shape (2,)
        xi at the end less `landing`.
    duration : float
    omega : ndarray, shape (2,)
    low, high : ndarray, shape (2,)
        Corners of the part of the sole in which the ankle is trusted with the zero-moment point.
    reach : ndarray, shape (2,)
        The landing place is moved by this at most.
    """

    z: Array
    landing: Array
    offset: Array
    duration: float
    omega: Array
    low: Array
    high: Array
    reach: Array


def left_over(step: Step, xi: Array, elapsed: float, left: Array) -> tuple[Array, Array]:
    """Return what the ankle leaves over of xi at the landing, and how the end moves with the time, (k, 2) each [m].

    Parameters
    ----------
    step : Step
    xi : ndarray, shape (2,)
        Measured now.
    elapsed : float
        Since the foot lifted off [s].
    left : ndarray, shape (k,)
        Until it lands [s].
    """
    grown = np.exp(np.multiply.outer(left, step.omega))
    end = np.tile(step.landing + step.offset, (len(left), 1))
    sooner = step.duration - elapsed - left
    shorter = np.exp(-step.omega[0] * sooner)  # an earlier landing is a shorter step
    moved = (shorter - 1.0) * (end[:, 0] - step.z[0])
    end[:, 0] += moved
    needed = (xi * grown - end) / (grown - 1.0)  # xi' = w (xi - z) with z at rest
    over = (needed - np.clip(needed, step.low, step.high)) * (grown - 1.0)
    return over, np.column_stack([moved, np.zeros_like(moved)])


def adjusted(
    step: Step, xi: Array, elapsed: float, duration: float, shift: Array, c: DynamicConfig
) -> tuple[float, Array, Array]:
    """Return duration [s], shift of the landing place (2,) [m] and what is left over (2,) [m] by the state of now.

    Parameters
    ----------
    step : Step
    xi : ndarray, shape (2,)
    elapsed : float
    duration : float
        As it was decided last [s].
    shift : ndarray, shape (2,)
        As it was decided last [m].
    c : DynamicConfig
    """
    soonest = max(c.shortest_step - elapsed, c.settled)
    latest = max(c.longest_step * step.duration - elapsed, soonest)
    left = np.arange(soonest, latest + 1e-9, _GRID)
    over, _ = left_over(step, xi, elapsed, left)
    late = elapsed + left - step.duration
    cost = over[:, 1] ** 2 + _AHEAD_PART * over[:, 0] ** 2 + _TIME_PART * late**2
    best = elapsed + float(left[int(np.argmin(cost))])
    duration += min(max(best - duration, -c.hurry), c.hurry)
    over, moved = left_over(step, xi, elapsed, np.array([duration - elapsed]))
    wanted = np.clip(over[0] + moved[0], -step.reach, step.reach)
    return duration, shift + _SMOOTH * (wanted - shift), over[0]
