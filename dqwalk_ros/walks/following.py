"""Tasks that follow a path in time, or a target that the walk sets for every state.

The rate of such an error is minus the velocity of the path or of the target.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from dqwalk_ros.paper.constraints import pose_error
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.features import Affine, CenterOfMassOnGround, Feature, JointAngles, Live, Point, Rotation
from dqwalk_ros.paper.tasks import Task
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit


@jit
def minimum_jerk(s: float) -> tuple[float, float, float]:
    """Return the minimum-jerk profile from 0 to 1 at the fraction `s` of the time, and its first two derivatives."""
    s = min(max(s, 0.0), 1.0)
    place = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return place, 30.0 * (s * (1.0 - s)) ** 2, 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)


@jit
def com_path(s: Array, start: Array, elapsed: float, duration: float) -> tuple[Array, Array, Array]:
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
def _com_from_path(s: Array, a: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Return the offset (2,) of the CoM from its path [m], its gradient, and minus the velocity of the path (2,) [m/s].

    `s` are the coordinates as in `com_path`, and `a` (3,) the parameters of `ComPath`. The gradient neglects the motion
    of the goal: the phase holds the feet.
    """
    place, velocity, _ = com_path(s, a[:2], elapsed, a[2])
    gradient = np.zeros((2, s.shape[0]))
    gradient[0, 0] = gradient[1, 1] = 1.0
    return s[:2] - place, gradient, -velocity


@dataclass(frozen=True, kw_only=True)
class ComPath(Task):
    """Moves the projection of the CoM along the vertical to the mean of some points, and keeps it there [m].

    A step in the CoM velocity would tip the robot, so the path begins and ends with zero velocity and acceleration.
    """

    start: Array
    """Projection of the CoM at the start, in the base frame, shape (2,) [m]."""
    over: tuple[Point, ...]
    """Points whose mean is the goal."""
    duration: float
    """Duration of the path [s]."""
    function = _com_from_path

    @property
    def watches(self) -> tuple[Feature, ...]:
        """The projection of the CoM, and the points of its goal."""
        return (CenterOfMassOnGround(), *self.over)

    @cached_property
    def parameters(self) -> Array:
        """Start [m] and duration, shape (3,)."""
        return np.array([*self.start, self.duration])


@jit
def _swing_path(a: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Return position (3,), orientation (4,) and velocity, linear and angular (6,), of a sole on its path.

    `a` (16,) are the parameters of `SwingPath`. The horizontal motion takes place in the middle 80 % of the time, so
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
def _sole_from_path(s: Array, a: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Return the error (6,) of a sole from its path [m], its gradient, and minus the velocity of the path (6,) [m/s].

    `s` (7,) are the coordinates of the sole, and `a` (16,) the parameters of `SwingPath`. Angles are times the lever.
    """
    p, r, velocity = _swing_path(a, elapsed)
    e, gradient = pose_error(s, p, r, a[15])
    velocity[3:] *= a[15]
    return e, gradient, -velocity


@dataclass(frozen=True, kw_only=True)
class SwingPath(Task):
    """Moves a sole along a path that lifts off, passes over a via point and lands.

    The error is p - p_d [m] and the rotation vector times `lever` [m].
    """

    frame: str
    start: Array
    goal: Array
    """Poses in the base frame, shape (8,)."""
    height: float
    """Height of the via point above both [m]."""
    duration: float
    """Duration of the path [s]."""
    lever: float
    """Length that weights angles against distances [m/rad]."""
    function = _sole_from_path

    def at(self, elapsed: float) -> tuple[Array, Array]:
        """Return place (3,) [m] and velocity, linear and angular, (6,) of the path `elapsed` [s] after its start."""
        place, _, velocity = _swing_path(self.parameters, elapsed)
        return place, velocity

    @property
    def watches(self) -> tuple[Feature, ...]:
        """Position and orientation of the sole."""
        return (Point(self.frame), Rotation(self.frame))

    @cached_property
    def parameters(self) -> Array:
        """Start and displacement [m], orientation at the start, half the rotation vector, and three numbers, (16,).

        The numbers are height, duration and lever.
        """
        a, b = DQ(self.start), DQ(self.goal)
        half = 0.5 * (b * a.conj()).rotation_vector()
        p, r = a.translation(), self.start[:4]
        return np.array([*p, *(b.translation() - p), *r, *half, self.height, self.duration, self.lever])


class Target:
    """Current target of a task.

    Parameters
    ----------
    place : ndarray, shape (k,)
        Desired value; for a pose (7,), position [m] and unit quaternion.
    velocity : ndarray, shape (k,)
        Its velocity; for a pose (6,), linear [m/s] and angular [rad/s].

    Attributes
    ----------
    numbers : ndarray, shape (2 k,) or (13,)
        Place and velocity, which the assembly reads for every state.
    """

    __slots__ = ("_size", "numbers")

    def __init__(self, place: Array, velocity: Array) -> None:
        self._size, self.numbers = len(place), np.concatenate([place, velocity])

    def set(self, place: Array | float, velocity: Array | float) -> None:
        """Set place and velocity, of the shapes that they began with, or one number for all coordinates."""
        self.numbers[: self._size], self.numbers[self._size :] = place, velocity


@dataclass(frozen=True, kw_only=True)
class Follow(Affine, Task):
    """Task that coordinates of a feature s follow a target: e = A s - place, whose rate is minus the velocity."""

    feature: Feature
    """With m coordinates."""
    selects: Array = field(default_factory=lambda: np.eye(2))
    """The matrix A, shape (k, m)."""
    target: Target
    """Of k coordinates."""

    @property
    def A(self) -> Array:
        """Selects the coordinates that follow, shape (k, m)."""
        return self.selects

    @property
    def live(self) -> Array:
        """Place and velocity of the target, shape (2 k,)."""
        return self.target.numbers

    @property
    def parameters(self) -> Array:
        """Target and A, shape (2 k + k m,)."""
        return np.concatenate([self.live, self.A.ravel()])


@dataclass(frozen=True, kw_only=True)
class AtRest(Live, Affine, Task):
    """Task that keeps joints at rest where they are, while it is on; at first it is off."""

    selects: Array
    """The rows of the identity for the joints, shape (k, n)."""
    eta: float | None = 0.0
    watches = (JointAngles(),)

    def __post_init__(self) -> None:
        self.switch(False)

    @property
    def A(self) -> Array:
        """The selected joints, shape (k, n)."""
        return self.selects

    def switch(self, on: bool) -> None:
        """Switch the task on, or off: then its rows are zero."""
        self.parameters[2 * len(self.selects) :] = on * self.selects.ravel()


@jit
def _frame_from_target(s: Array, a: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Return the pose error (6,) [m], its gradient, and minus the velocity of the target (6,) [m/s].

    `s` (7,) are the coordinates of the frame, and `a` (14,) the parameters of `FollowPose`. Angles are times the lever.
    """
    e, gradient = pose_error(s, a[:3], a[3:7], a[13])
    rate = -a[7:13]
    rate[3:] *= a[13]
    return e, gradient, rate


@dataclass(frozen=True, kw_only=True)
class FollowPose(Task):
    """Task that a frame follows a pose: the error is p - p_d [m], and the rotation error times `lever` [m]."""

    frame: str
    target: Target
    """A pose."""
    lever: float
    """Length that an angle of 1 rad is equivalent to [m/rad]."""
    function = _frame_from_target

    @property
    def watches(self) -> tuple[Feature, ...]:
        """Position and orientation of the frame."""
        return (Point(self.frame), Rotation(self.frame))

    @property
    def live(self) -> Array:
        """Place and velocity of the target, shape (13,)."""
        return self.target.numbers

    @property
    def parameters(self) -> Array:
        """Target and lever, shape (14,)."""
        return np.append(self.live, self.lever)
