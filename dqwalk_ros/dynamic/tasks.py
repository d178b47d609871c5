"""Tasks that follow what a walk sets anew at every state."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.constraints import pose_error
from dqwalk_ros.kinematics import Feature, Point, Rotation
from dqwalk_ros.tasks import Task

__all__ = ["Follow", "FollowPose", "Target"]

Array = NDArray[np.float64]


@dataclass(slots=True, eq=False)
class Target:
    """Where a task is to be now, and how fast that moves, both (k,).

    For a pose the place is a position and an orientation (7,), the velocity linear and angular (6,).
    """

    place: Array
    velocity: Array

    def set(self, place: Array, velocity: Array) -> None:
        """Set both."""
        self.place, self.velocity = place, velocity


@dataclass(frozen=True, kw_only=True)
class Follow(Task):
    """Coordinates of a feature, or the first or last of them, follow a target: e = A s - place.

    Attributes
    ----------
    feature : Feature
    A : ndarray, shape (k, m)
        Which of its coordinates.
    target : Target
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
        """Offset from the target, shape (k,)."""
        return self.A @ s - self.target.place, self.A

    def rate(self, s: Array, e: Array, elapsed: float, eta: float) -> Array:
        """Return the e' asked for: the target's velocity and the way to it, shape (k,)."""
        back: Array = self.target.velocity - self.convergence * e
        return back


@dataclass(frozen=True, kw_only=True)
class FollowPose(Task):
    """A frame follows a pose: p - p_d [m], and the angle times `lever` [m].

    Attributes
    ----------
    frame : str
    target : Target
        Of a pose.
    convergence : float
        [1/s]
    lever : float
        What an angle of 1 rad counts [m/rad].
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
        """Difference from the target, shape (6,) [m]."""
        place = self.target.place
        e, gradient = pose_error(s, place[:3], place[3:], self.lever)
        return e, gradient

    def rate(self, s: Array, e: Array, elapsed: float, eta: float) -> Array:
        """Return the e' asked for: the target's velocity and the way to it, shape (6,) [m/s]."""
        back = self.target.velocity - self.convergence * e
        back[3:] += (self.lever - 1.0) * self.target.velocity[3:]
        return back
