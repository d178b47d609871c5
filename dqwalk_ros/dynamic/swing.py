"""Path of a swing foot, whose landing position and time may change during the swing."""

from __future__ import annotations

import math

import numpy as np

from dqwalk_ros.arrays import Array
from dqwalk_ros.dual_quaternions import DQ, product
from dqwalk_ros.paths import minimum_jerk

__all__ = ["Swing"]


_LIFT, _LAND = 0.02, 0.06
"""Fractions of the duration at the beginning and at the end without motion along the ground."""
_GENTLE = 2.7
"""Exponent of the height at the end: with 2.5 stiff legs touch the ground too early, with 3 soft ones land late."""
_TOP = 2.0 / (2.0 + _GENTLE)
_SCALE = 1.0 / (_TOP**2 * (1.0 - _TOP) ** _GENTLE)


class Swing:
    """Path of a sole: minimum jerk along the ground, and an arch in height.

    Parameters
    ----------
    start, goal : ndarray, shape (8,)
        Poses in the base frame, as unit dual quaternions.
    height : float
        Largest height of the path [m].
    descent : float
        Duration of a whole swing of which only the descent remains; zero for a swing that starts on the ground [s].

    Attributes
    ----------
    begun : float
        Time of the whole path before its start, on the descent from its largest height; zero if it starts on the
        ground [s].
    goal : ndarray, shape (2,)
        Landing position, which may be changed during the swing [m].
    """

    def __init__(self, start: Array, goal: Array, height: float, descent: float = 0.0) -> None:
        a, b = DQ(start), DQ(goal)
        turn = b.P() * a.P().conj()
        self._half = (turn if turn.vec4()[0] >= 0.0 else -turn).log().vec3()
        self._angle, self._r = float(np.linalg.norm(self._half)), a.vec4()
        self._p, self._above = a.translation()[:2], float(a.translation()[2])
        self.goal = b.translation()[:2]
        self._height = height
        self._s = 0.0
        if descent > 0.0:
            self._s = _descent(self._above / height)
            self._above, self._height = 0.0, self._above / _arch(self._s)[0]
        self.begun = self._elapsed = self._s * descent
        self._v = np.zeros(2)

    def step(self, elapsed: float, duration: float) -> tuple[Array, Array, Array]:
        """Advance to a time and return the motion there.

        Parameters
        ----------
        elapsed : float
            Time since the lift-off; must not decrease [s].
        duration : float
            Current duration of the whole swing [s].

        Returns
        -------
        pose : ndarray, shape (7,)
            Position [m] and unit quaternion.
        velocity : ndarray, shape (6,)
            Linear [m/s] and angular [rad/s].
        acceleration : ndarray, shape (2,)
            Along the ground [m/s^2].
        """
        # the completed fraction of the path increases linearly to 1 at the end
        since, left = elapsed - self._elapsed, max(duration - self._elapsed, 1e-3)
        rate = (1.0 - self._s) / left
        s = min(self._s + rate * since, 1.0)
        rate = (1.0 - s) / max(duration - elapsed, 1e-3) if s < 1.0 else 0.0
        before, (place, slope) = _along(self._s)[0], _along(s)
        if before < 1.0:  # the same fraction of the remaining distance as for a fixed goal
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
    """Return the completed fraction of the distance along the ground at the fraction `s` of the time, and its slope."""
    span = 1.0 - _LIFT - _LAND
    place, slope, _ = minimum_jerk((s - _LIFT) / span)
    return place, slope / span


def _arch(s: float) -> tuple[float, float]:
    """Return the height 0..1 at the fraction `s` of the time, and its slope: s^2 (1 - s)^2.7, scaled.

    It ends without velocity and acceleration: a foot that hits the ground unloads the supporting sole, which slips. A
    foot that comes down more slowly touches the ground too early.
    """
    left = 1.0 - s
    slope = _SCALE * s * left ** (_GENTLE - 1.0) * (2.0 - (2.0 + _GENTLE) * s)
    return _SCALE * s**2 * left**_GENTLE, slope


def _descent(part: float) -> float:
    """Return the fraction of the time at which the arch has come down to a part of its height."""
    s = np.linspace(_TOP, 1.0, 200)
    return float(s[np.argmax(_SCALE * s**2 * (1.0 - s) ** _GENTLE <= max(part, 0.1))]) if part < 1.0 else _TOP
