"""Tasks that follow a path in time: the CoM from foot to foot, and the swing sole over a via point."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dqwalk_ros.paper.constraints import pose_error
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.kinematics import CenterOfMassOnGround, Feature, Point, Rotation
from dqwalk_ros.paper.tasks import Task
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit

__all__ = ["ComPath", "SwingPath", "com_path", "follow_com_path", "follow_swing_path", "minimum_jerk"]


@jit
def minimum_jerk(s):  # type: ignore[no-untyped-def]
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
    place, slope, bend = minimum_jerk(elapsed / duration)
    way = goal - start
    return start + place * way, slope / duration * way, bend / duration**2 * way


@jit
def follow_com_path(s, a, elapsed, eta):  # type: ignore[no-untyped-def]
    """Return the offset (2,) of the CoM from its path [m], its gradient, and its desired rate (2,) [m/s].

    `s` are the coordinates as in `com_path`, and `a` (4,) the parameters of `ComPath`. The rate is the velocity of the
    path less eta times the saturated offset. The gradient neglects the motion of the goal: the phase holds the feet.
    """
    place, velocity, _ = com_path(s, a[:2], elapsed, a[2])
    e, gradient = s[:2] - place, np.zeros((2, s.shape[0]))
    gradient[0, 0] = gradient[1, 1] = 1.0
    return e, gradient, velocity - eta * min(1.0, a[3] / max(math.sqrt(e @ e), 1e-12)) * e


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
    def parameters(self) -> Array:
        """Start [m], duration and saturation, shape (4,)."""
        return np.array([*self.start, self.duration, self.saturation])

    def value(self, s: Array, elapsed: float) -> tuple[Array, Array]:
        """Offset of the CoM from its path, shape (2,) [m]."""
        e, gradient, _ = follow_com_path(s, self.parameters, elapsed, 0.0)
        return e, gradient

    def rate(self, s: Array, e: Array, elapsed: float, eta: float) -> Array:
        """Return the desired e': the velocity of the path minus the saturated error times eta, shape (2,) [m/s]."""
        back: Array = follow_com_path(s, self.parameters, elapsed, eta)[2]
        return back


@jit
def _swing_path(a, elapsed):  # type: ignore[no-untyped-def]
    """Return position (3,), orientation (4,) and velocity, linear and angular (6,), of a sole on its path.

    `a` (17,) are the parameters of `SwingPath`. The horizontal motion takes place in the middle 80 % of the time, so
    that lift-off and landing are vertical.
    """
    start, way, r_start, half_turn, height, duration = a[:3], a[3:6], a[6:10], a[10:13], a[13], a[14]
    s = min(max(elapsed / duration, 0.0), 1.0)
    place, slope, _ = minimum_jerk((s - 0.1) / 0.8)
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
def follow_swing_path(s, a, elapsed):  # type: ignore[no-untyped-def]
    """Return the error (6,) of a sole from its path [m], its gradient, and its desired rate (6,) [m/s].

    `s` (7,) are the coordinates of the sole, and `a` (17,) the parameters of `SwingPath`. The rate is the velocity of
    the path, angles times the lever, less the convergence times the error.
    """
    p, r, velocity = _swing_path(a, elapsed)
    e, gradient = pose_error(s, p, r, a[16])
    velocity[3:] *= a[16]
    return e, gradient, velocity - a[15] * e


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
    def parameters(self) -> Array:
        """Start and displacement [m], orientation at the start, half the rotation vector, and four numbers, (17,).

        The numbers are height, duration, convergence and lever.
        """
        a, b = DQ(self.start), DQ(self.goal)
        half = 0.5 * (b * a.conj()).rotation_vector()
        p, r = a.translation(), self.start[:4]
        return np.array(
            [*p, *(b.translation() - p), *r, *half, self.height, self.duration, self.convergence, self.lever]
        )

    def value(self, s: Array, elapsed: float) -> tuple[Array, Array]:
        """Error from the path, shape (6,) [m]."""
        e, gradient, _ = follow_swing_path(s, self.parameters, elapsed)
        return e, gradient

    def rate(self, s: Array, e: Array, elapsed: float, eta: float) -> Array:
        """Return the desired e': the velocity of the path minus the error times `convergence`, shape (6,) [m/s]."""
        back: Array = follow_swing_path(s, self.parameters, elapsed)[2]
        return back
