"""The divergent component of motion over footprints, in closed form [Englsberger2015].

A linear inverted pendulum c'' = w^2 (c - z), with the centre of mass c over the ground, the zero-moment point z and one
frequency w for each axis, falls apart into xi' = w (xi - z), which diverges, and c' = w (xi - c), which follows xi by
itself. So only the divergent component xi = c + c'/w needs a plan. It is solved backwards in time, where it is stable,
from a step far ahead to the present one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["Course", "Pressed", "Rest", "before", "single_supports"]

Array = NDArray[np.float64]

_OFFSET = 0.4
"""Where the last step that is planned begins: this part of the way from the middle of both feet to the new one."""
_LAST = 0.25
"""Where the walk's last single support ends: this part of the way from the middle of both feet to the standing one."""


def before(a: Array, b: Array, end: Array, time: float, omega: Array) -> Array:
    """Return xi (2,) a `time` [s] before it is at `end` (2,), while z moves evenly from `a` to `b` (2,) [m].

    The solution of xi' = w (xi - z): with e = exp(-w T) and b = a it is z + e (xi(T) - z).
    """
    if time < 1e-9:
        return end
    e = np.exp(-omega * time)
    xi: Array = e * end + (1.0 - e) * a + (b - a) / (omega * time) * (1.0 - e * (1.0 + omega * time))
    return xi


class Course(Protocol):
    """xi and z of a phase."""

    duration: float

    def at(self, elapsed: float) -> tuple[Array, Array]:
        """Return xi and z (2,) [m], `elapsed` [s] into the phase."""


@dataclass
class Pressed:
    """z moves evenly from `a` to `b` (2,) in `duration` [s], at the end of which xi is at `end` (2,) [m].

    With a = b it is a single support.
    """

    a: Array
    b: Array
    end: Array
    duration: float
    omega: Array

    def at(self, elapsed: float) -> tuple[Array, Array]:
        """Return xi and z (2,) [m], `elapsed` [s] into the phase."""
        left = min(max(self.duration - elapsed, 0.0), self.duration)
        z = self.b - left / self.duration * (self.b - self.a)
        return before(z, self.b, self.end, left, self.omega), z


@dataclass
class Rest:
    """xi moves from `start` to `goal` (2,) in `duration` [s], at rest at both ends."""

    start: Array
    goal: Array
    duration: float
    omega: Array

    def at(self, elapsed: float) -> tuple[Array, Array]:
        """Return xi and z (2,) [m], `elapsed` [s] into the phase."""
        s = min(max(elapsed / self.duration, 0.0), 1.0)
        place, slope = s**3 * (10.0 - 15.0 * s + 6.0 * s**2), 30.0 * (s * (1.0 - s)) ** 2
        way = self.goal - self.start
        xi = self.start + place * way
        return xi, xi - slope / self.duration * way / self.omega


def single_supports(
    aims: Sequence[Array], single: float, double: float, omega: Array, *, ends: bool
) -> list[tuple[Array, Array]]:
    """Return xi at the beginning and at the end of the single support on each aim but the last.

    Parameters
    ----------
    aims : sequence of ndarray, shape (2,)
        Where the zero-moment point is on the foot that stands now, and on those put down after it [m]; two or more.
    single, double : float
        Durations of single and double support [s].
    omega : ndarray, shape (2,)
        [1/s]
    ends : bool
        Whether the walk ends on the last two; else it goes on alike.
    """
    a, b = aims[-2], aims[-1]
    middle = 0.5 * (a + b)
    end = middle + _LAST * (a - middle) if ends else before(a, b, middle + _OFFSET * (b - middle), double, omega)
    out = []
    for k in range(len(aims) - 2, -1, -1):
        start = before(aims[k], aims[k], end, single, omega)
        out.append((start, end))
        if k:
            end = before(aims[k - 1], aims[k], start, double, omega)
    return out[::-1]
