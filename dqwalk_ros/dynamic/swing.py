"""The path of a swing foot that may be led to another place, and sooner or later, while it is in the air."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.dual_quaternions import DQ, product

__all__ = ["Swing"]

Array = NDArray[np.float64]

_LIFT, _LAND = 0.02, 0.06
"""It moves along the ground but for these parts of its time, at the beginning and at the end."""
_TOP = 4.0 / 7.0
_SCALE = 1.0 / (_TOP**2 * (1.0 - _TOP) ** 1.5)


class Swing:
    """A sole lifts off, moves along the ground at minimum jerk, and lands.

    Parameters
    ----------
    start, goal : ndarray, shape (8,)
        Poses in the base frame.
    height : float
        Of the highest place of its path [m].

    Attributes
    ----------
    goal : ndarray, shape (2,)
        Where it lands; may be changed [m].
    """

    def __init__(self, start: Array, goal: Array, height: float) -> None:
        a, b = DQ(start), DQ(goal)
        turn = b.P() * a.P().conj()
        self._half = (turn if turn.vec4()[0] >= 0.0 else -turn).log().vec3()
        self._angle, self._r = float(np.linalg.norm(self._half)), a.vec4()
        self._p, self._above = a.translation()[:2], float(a.translation()[2])
        self.goal = b.translation()[:2]
        self._height = height
        self._s = self._elapsed = 0.0
        self._v = np.zeros(2)

    def step(self, elapsed: float, duration: float) -> tuple[Array, Array, Array]:
        """Move on, and return pose (7,), velocity (6,) and horizontal acceleration (2,) at a time, to land at another.

        Parameters
        ----------
        elapsed, duration : float
            Time since it lifted off, and of the whole path as it is planned now [s].
        """
        # the fraction of the path that is done goes on evenly towards its end
        since, left = elapsed - self._elapsed, max(duration - self._elapsed, 1e-3)
        rate = (1.0 - self._s) / left
        s = min(self._s + rate * since, 1.0)
        rate = (1.0 - s) / max(duration - elapsed, 1e-3) if s < 1.0 else 0.0
        before, (place, slope) = _along(self._s)[0], _along(s)
        if before < 1.0:  # the same part of what is left to the goal as a path at rest would go
            self._p = self._p + (place - before) / (1.0 - before) * (self.goal - self._p)
        v = slope * rate / (1.0 - place) * (self.goal - self._p) if place < 1.0 - 1e-9 else np.zeros(2)
        acceleration = (v - self._v) / since if since > 0.0 else np.zeros(2)
        self._s, self._elapsed, self._v = s, elapsed, v
        arch, steep = _arch(s)
        z = self._above * (1.0 - s) + self._height * arch
        rise = -self._above + self._height * steep
        sin = math.sin(self._angle * place) / self._angle if self._angle > 0.0 else 0.0
        r = product(math.cos(self._angle * place), *(sin * self._half).tolist(), *self._r.tolist())
        turning = 2.0 * slope * rate * self._half
        return np.array([*self._p, z, *r]), np.array([*v, rise * rate, *turning]), acceleration


def _along(s: float) -> tuple[float, float]:
    """Return the place 0..1 along the ground at a fraction of the time, and its slope."""
    span = 1.0 - _LIFT - _LAND
    x = min(max((s - _LIFT) / span, 0.0), 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2), 30.0 * (x * (1.0 - x)) ** 2 / span


def _arch(s: float) -> tuple[float, float]:
    """Return the height 0..1 at a fraction of the time, and its slope: s^2 (1 - s)^(3/2), scaled.

    It leaves the ground softly and comes down late: a foot that is low for long touches before its time is up, as
    what bears the robot yields by half a millimetre, and takes the pressure out of the sole that stands.
    """
    left = 1.0 - s
    return _SCALE * s**2 * left**1.5, _SCALE * s * left**0.5 * (2.0 - 3.5 * s)
