"""The paths of a walk that stands: the CoM from foot to foot, a sole over a via point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.compiled import jit
from dqwalk_ros.constraints import pose_error
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.kinematics import CenterOfMassOnGround, Feature, Point, Rotation
from dqwalk_ros.tasks import Task

__all__ = ["ComPath", "SwingPath", "com_path"]

Array = NDArray[np.float64]


@jit
def _minimum_jerk(s):  # type: ignore[no-untyped-def]
    """Return the place 0..1 at the fraction `s` of the time, its slope and its bend: at rest at both ends."""
    s = min(max(s, 0.0), 1.0)
    place = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return place, 30.0 * (s * (1.0 - s)) ** 2, 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)


@jit
def com_path(s, start, elapsed, duration):  # type: ignore[no-untyped-def]
    """Return place, velocity and acceleration (2,) of the path from `start` (2,) to the mean of the points in s[2:]."""
    goal, count = np.zeros(2), (s.shape[0] - 2) // 3
    for k in range(count):
        goal += s[2 + 3 * k : 4 + 3 * k] / count
    place, slope, bend = _minimum_jerk(elapsed / duration)
    way = goal - start
    return start + place * way, slope / duration * way, bend / duration**2 * way


@dataclass(frozen=True, kw_only=True)
class ComPath(Task):
    """The vertical through the CoM moves to the middle of some points and stays there [m].

    A step in CoM velocity tips a robot, so the target leaves `start` and arrives with no acceleration.

    Attributes
    ----------
    start : ndarray, shape (2,)
        Where the CoM began, in the base frame [m].
    over : tuple of Point
        Its goal is the mean of these.
    duration : float
        [s]
    saturation : float
        Larger errors are answered like this one [m].
    """

    start: Array
    over: tuple[Point, ...]
    duration: float
    saturation: float

    @property
    def watches(self) -> tuple[Feature, ...]:
        """The CoM along the vertical, and the points of its goal."""
        return (CenterOfMassOnGround(), *self.over)

    @cached_property
    def _gradient(self) -> Array:
        # feet that a phase holds do not move, and where they do the error follows them
        return np.eye(2, 2 + 3 * len(self.over))

    def value(self, s: Array, elapsed: float) -> tuple[Array, Array]:
        """Offset of the CoM from its path, shape (2,) [m]."""
        place, _, _ = com_path(s, self.start, elapsed, self.duration)
        return s[:2] - place, self._gradient

    def rate(self, s: Array, e: Array, elapsed: float, eta: float) -> Array:
        """Return the e' asked for: the path's velocity and the way back to it, shape (2,) [m/s]."""
        _, velocity, _ = com_path(s, self.start, elapsed, self.duration)
        size = float(e @ e) ** 0.5
        back: Array = velocity - eta * min(1.0, self.saturation / max(size, 1e-12)) * e
        return back


@jit
def _swing_path(elapsed, duration, height, start, way, r_start, half_turn):  # type: ignore[no-untyped-def]
    """Return position (3,), orientation (4,) and velocity, linear and angular (6,), of a sole on its path.

    It moves along the ground in the middle 80 % of the time, so that lift-off and landing are upright.
    """
    s = min(max(elapsed / duration, 0.0), 1.0)
    place, slope, _ = _minimum_jerk((s - 0.1) / 0.8)
    bump, rise = 64.0 * (s * (1.0 - s)) ** 3, 192.0 * (s * (1.0 - s)) ** 2 * (1.0 - 2.0 * s)
    up = np.array([0.0, 0.0, height])
    velocity = np.concatenate((slope / 0.8 * way + rise * up, 2.0 * slope / 0.8 * half_turn)) / duration
    angle = np.sqrt(half_turn @ half_turn)
    a, v = np.cos(place * angle), place * np.sinc(place * angle / np.pi) * half_turn
    r = np.empty(4)  # exp(place half_turn) r_start
    r[0] = a * r_start[0] - v @ r_start[1:]
    r[1:] = a * r_start[1:] + r_start[0] * v + np.cross(v, r_start[1:])
    return start + place * way + bump * up, r, velocity


@dataclass(frozen=True, kw_only=True)
class SwingPath(Task):
    """A sole lifts off, passes over a via point and lands: p - p_d [m], and the angle times `lever` [m].

    Attributes
    ----------
    frame : str
    start, goal : ndarray, shape (8,)
        Poses in the base frame.
    height : float
        Of the via point above both [m].
    duration : float
        [s]
    convergence : float
        Rate at which it returns to the path [1/s].
    lever : float
        What an angle of 1 rad counts [m/rad].
    """

    frame: str
    start: Array
    goal: Array
    height: float
    duration: float
    convergence: float
    lever: float

    @property
    def watches(self) -> tuple[Feature, ...]:
        """Position and orientation of the sole."""
        return (Point(self.frame), Rotation(self.frame))

    @cached_property
    def _ends(self) -> tuple[Array, Array, Array, Array]:
        """Start, way to the goal (3,) [m], orientation at the start, and the logarithm of the turn."""
        a, b = DQ(self.start), DQ(self.goal)
        turn = b.P() * a.P().conj()
        half = (turn if turn.vec4()[0] >= 0.0 else -turn).log().vec3()
        return a.translation(), b.translation() - a.translation(), self.start[:4].copy(), half.copy()

    def at(self, elapsed: float) -> tuple[Array, Array, Array]:
        """Position (3,), orientation (4,) and velocity, linear and angular (6,), on the path."""
        path: tuple[Array, Array, Array] = _swing_path(elapsed, self.duration, self.height, *self._ends)
        return path

    def value(self, s: Array, elapsed: float) -> tuple[Array, Array]:
        """Difference from the path, shape (6,) [m]."""
        p, r, _ = self.at(elapsed)
        e, gradient = pose_error(s, p, r, self.lever)
        return e, gradient

    def rate(self, s: Array, e: Array, elapsed: float, eta: float) -> Array:
        """Return the e' asked for: the path's velocity and the way back to it, shape (6,) [m/s]."""
        _, _, velocity = self.at(elapsed)
        velocity[3:] *= self.lever
        back: Array = velocity - self.convergence * e
        return back
