"""Tasks that track a target, which the walk updates for every state."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dqwalk_ros.arrays import Array
from dqwalk_ros.constraints import pose_error
from dqwalk_ros.kinematics import Feature, Point, Rotation
from dqwalk_ros.tasks import Task

__all__ = ["Follow", "FollowPose", "Target"]


@dataclass(slots=True, eq=False)
class Target:
    """Current target of a task.

    Attributes
    ----------
    place : ndarray, shape (k,)
        Desired value; for a pose (7,), position [m] and unit quaternion.
    velocity : ndarray, shape (k,)
        Its velocity; for a pose (6,), linear [m/s] and angular [rad/s].
    """

    place: Array
    velocity: Array

    def set(self, place: Array, velocity: Array) -> None:
        """Set `place` and `velocity`."""
        self.place, self.velocity = place, velocity


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

    def value(self, s: Array, elapsed: float) -> tuple[Array, Array]:
        """Return e = A s - place, shape (k,), and its gradient A, shape (k, m)."""
        return self.A @ s - self.target.place, self.A

    def rate(self, s: Array, e: Array, elapsed: float, eta: float) -> Array:
        """Return the desired rate of A s: velocity of the target less convergence e, shape (k,)."""
        back: Array = self.target.velocity - self.convergence * e
        return back


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

    def value(self, s: Array, elapsed: float) -> tuple[Array, Array]:
        """Return the pose error (6,) [m], and its gradient with respect to the features."""
        place = self.target.place
        e, gradient = pose_error(s, place[:3], place[3:], self.lever)
        return e, gradient

    def rate(self, s: Array, e: Array, elapsed: float, eta: float) -> Array:
        """Return the desired rate: velocity of the target, rotation times lever, less convergence e, (6,) [m/s]."""
        back = self.target.velocity - self.convergence * e
        back[3:] += (self.lever - 1.0) * self.target.velocity[3:]
        return back
