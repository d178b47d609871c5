"""Path-following tasks of the standing walk: the CoM from foot to foot, and the swing sole over a via point."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dqwalk_ros.arrays import Array
from dqwalk_ros.compiled import jit
from dqwalk_ros.constraints import pose_error
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.kinematics import CenterOfMassOnGround, Feature, Point, Rotation
from dqwalk_ros.tasks import Task

__all__ = ["ComPath", "SwingPath", "com_path"]


@jit
def _minimum_jerk(s):  # type: ignore[no-untyped-def]
    """Return the minimum-jerk profile from 0 to 1 at the fraction `s` of the time, and its first two derivatives."""
    s = min(max(s, 0.0), 1.0)
    place = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return place, 30.0 * (s * (1.0 - s)) ** 2, 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)


@jit
def com_path(s, start, elapsed, duration):  # type: ignore[no-untyped-def]
    """Return position, velocity and acceleration (2,) on the path from `start` (2,) to the mean of the points in s[2:].

    `s` (2 + 3 k,) are the coordinates of the projected CoM and of k points.
    """
    goal, count = np.zeros(2), (s.shape[0] - 2) // 3
    for k in range(count):
        goal += s[2 + 3 * k : 4 + 3 * k] / count
    place, slope, bend = _minimum_jerk(elapsed / duration)
    way = goal - start
    return start + place * way, slope / duration * way, bend / duration**2 * way


@jit
def _com_rate(s, e, start, elapsed, duration, eta, saturation):  # type: ignore[no-untyped-def]
    """Return the velocity of the path less eta times the saturated error e, shape (2,) [m/s]."""
    _, velocity, _ = com_path(s, start, elapsed, duration)
    return velocity - eta * min(1.0, saturation / max(math.sqrt(e @ e), 1e-12)) * e


@dataclass(frozen=True, kw_only=True)
class ComPath(Task):
    """Moves the projection of the CoM along the vertical to the mean of some points, and keeps it there [m].

    A step in the CoM velocity would tip the robot, so the path begins and ends with zero velocity and acceleration.

    Attributes
    ----------
    start : ndarray, shape (2,)
        Projection of the CoM at the start, in the base frame [m].
    over : tuple of Point
        Points whose mean is the goal.
    duration : float
        Duration of the path [s].
    saturation : float
        Norm at which the error is saturated [m].
    """

    start: Array
    over: tuple[Point, ...]
    duration: float
    saturation: float

    @property
    def watches(self) -> tuple[Feature, ...]:
        """The projection of the CoM, and the points of its goal."""
        return (CenterOfMassOnGround(), *self.over)

    @cached_property
    def _gradient(self) -> Array:
        # the motion of the goal is neglected in the gradient: the phase holds the feet at rest
        return np.eye(2, 2 + 3 * len(self.over))

    def value(self, s: Array, elapsed: float) -> tuple[Array, Array]:
        """Offset of the CoM from its path, shape (2,) [m]."""
        place, _, _ = com_path(s, self.start, elapsed, self.duration)
        return s[:2] - place, self._gradient

    def rate(self, s: Array, e: Array, elapsed: float, eta: float) -> Array:
        """Return the desired e': the velocity of the path minus the saturated error times eta, shape (2,) [m/s]."""
        back: Array = _com_rate(s, e, self.start, elapsed, self.duration, eta, self.saturation)
        return back


@jit
def _swing_path(elapsed, duration, height, start, way, r_start, half_turn):  # type: ignore[no-untyped-def]
    """Return position (3,), orientation (4,) and velocity, linear and angular (6,), of a sole on its path.

    The horizontal motion takes place in the middle 80 % of the time, so that lift-off and landing are vertical.
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


@jit
def _swing_error(s, path, lever):  # type: ignore[no-untyped-def]
    """Return the error (6,) of a sole with the coordinates s (7,) from its path, and the gradient (6, 7)."""
    p, r, _ = _swing_path(*path)
    return pose_error(s, p, r, lever)


@jit
def _swing_rate(e, path, lever, convergence):  # type: ignore[no-untyped-def]
    """Return the velocity of the path, angles times `lever`, less `convergence` times the error e, shape (6,) [m/s]."""
    _, _, velocity = _swing_path(*path)
    velocity[3:] *= lever
    return velocity - convergence * e


@dataclass(frozen=True, kw_only=True)
class SwingPath(Task):
    """Moves a sole along a path that lifts off, passes over a via point and lands.

    The error is p - p_d [m] and the rotation vector times `lever` [m].

    Attributes
    ----------
    frame : str
    start, goal : ndarray, shape (8,)
        Poses in the base frame.
    height : float
        Height of the via point above both [m].
    duration : float
        Duration of the path [s].
    convergence : float
        Rate at which the sole converges to the path [1/s].
    lever : float
        Length that weights angles against distances [m/rad].
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
        """Start (3,) [m], displacement (3,) [m], orientation at the start (4,), and half the rotation vector (3,)."""
        a, b = DQ(self.start), DQ(self.goal)
        turn = b.P() * a.P().conj()
        half = (turn if turn.vec4()[0] >= 0.0 else -turn).log().vec3()
        return a.translation(), b.translation() - a.translation(), self.start[:4].copy(), half.copy()

    def value(self, s: Array, elapsed: float) -> tuple[Array, Array]:
        """Error from the path, shape (6,) [m]."""
        e, gradient = _swing_error(s, (elapsed, self.duration, self.height, *self._ends), self.lever)
        return e, gradient

    def rate(self, s: Array, e: Array, elapsed: float, eta: float) -> Array:
        """Return the desired e': the velocity of the path minus the error times `convergence`, shape (6,) [m/s]."""
        path = elapsed, self.duration, self.height, *self._ends
        back: Array = _swing_rate(e, path, self.lever, self.convergence)
        return back
