"""Tasks that track a target, which the walk updates for every state."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dqwalk_ros.paper.constraints import pose_error
from dqwalk_ros.paper.kinematics import Feature, Point, Rotation
from dqwalk_ros.paper.tasks import Task
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit

__all__ = ["Follow", "FollowPose", "Target", "follow", "follow_pose"]


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
        Place and velocity; `assembly` reads them for every state.
    """

    __slots__ = ("_size", "numbers")

    def __init__(self, place: Array, velocity: Array) -> None:
        self._size, self.numbers = len(place), np.concatenate([place, velocity])

    def set(self, place: Array, velocity: Array) -> None:
        """Set place and velocity."""
        self.numbers[: self._size], self.numbers[self._size :] = place, velocity


@jit
def follow(x, a):  # type: ignore[no-untyped-def]
    """Return the error e = x - place (k,), and its desired rate, velocity - convergence e; `a` as in `Follow`."""
    k = x.shape[0]
    e = x - a[:k]
    return e, a[k : 2 * k] - a[2 * k] * e


@dataclass(frozen=True, kw_only=True)
class Follow(Task):
    """Task that coordinates of a feature s follow a target: e = A s - place, e' = velocity - convergence e.

    Attributes
    ----------
    feature : Feature
        With m coordinates.
    A : ndarray, shape (k, m)
        Selects the coordinates.
    target : Target
        Of k coordinates.
    convergence : float
        [1/s]
    """

    feature: Feature
    A: Array = field(default_factory=lambda: np.eye(2))
    target: Target
    convergence: float

    @property
    def watches(self) -> tuple[Feature, ...]:
        """The feature."""
        return (self.feature,)

    @property
    def parameters(self) -> Array:
        """Target and convergence, shape (2 k + 1,)."""
        return np.append(self.target.numbers, self.convergence)

    def value(self, s: Array, elapsed: float) -> tuple[Array, Array]:
        """Return e = A s - place, shape (k,), and its gradient A, shape (k, m)."""
        return follow(self.A @ s, self.parameters)[0], self.A

    def rate(self, s: Array, e: Array, elapsed: float, eta: float) -> Array:
        """Return the desired rate of A s: velocity of the target less convergence e, shape (k,)."""
        back: Array = follow(self.A @ s, self.parameters)[1]
        return back


@jit
def follow_pose(s, a):  # type: ignore[no-untyped-def]
    """Return the pose error (6,) [m], its gradient, and its desired rate (6,) [m/s].

    `s` (7,) are the coordinates of the frame, and `a` (15,) the parameters of `FollowPose`. The rate is the velocity of
    the target, angles times the lever, less the convergence times the error.
    """
    e, gradient = pose_error(s, a[:3], a[3:7], a[14])
    rate = a[7:13] - a[13] * e
    rate[3:] += (a[14] - 1.0) * a[10:13]
    return e, gradient, rate


@dataclass(frozen=True, kw_only=True)
class FollowPose(Task):
    """Task that a frame follows a pose: the error is p - p_d [m], and the rotation error times `lever` [m].

    Attributes
    ----------
    frame : str
    target : Target
        A pose.
    convergence : float
        [1/s]
    lever : float
        Length that an angle of 1 rad is equivalent to [m/rad].
    """

    frame: str
    target: Target
    convergence: float
    lever: float

    @property
    def watches(self) -> tuple[Feature, ...]:
        """Position and orientation of the frame."""
        return (Point(self.frame), Rotation(self.frame))

    @property
    def parameters(self) -> Array:
        """Target, convergence and lever, shape (15,)."""
        return np.array([*self.target.numbers, self.convergence, self.lever])

    def value(self, s: Array, elapsed: float) -> tuple[Array, Array]:
        """Return the pose error (6,) [m], and its gradient with respect to the features."""
        e, gradient, _ = follow_pose(s, self.parameters)
        return e, gradient

    def rate(self, s: Array, e: Array, elapsed: float, eta: float) -> Array:
        """Return the desired rate: velocity of the target, rotation times lever, less convergence e, (6,) [m/s]."""
        back: Array = follow_pose(s, self.parameters)[2]
        return back
