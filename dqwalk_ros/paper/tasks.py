"""Tasks: errors that the objective of (U6) drives to zero, sections 4.1 and 4.2 [Urban2020].

Like a constraint, a task lists the features of the robot that it depends on (`watches`), and computes from their
coordinates s the error e and its gradient de/ds. Its Jacobian is this gradient times the Jacobian of s.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dqwalk_ros.paper.kinematics import CenterOfMass, Feature, JointAngles, Point, Pose
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit

__all__ = ["ComOverFoot", "FramePose", "Posture", "Task"]


@dataclass(frozen=True, kw_only=True)
class Task(ABC):
    """An error e(q) with e' = J u; the objective of (U6) contains weight ||J u - rate||^2.

    Attributes
    ----------
    name : str
    weight : float
    """

    name: str
    weight: float = 1.0

    @property
    @abstractmethod
    def watches(self) -> tuple[Feature, ...]:
        """Features that the error depends on; `value` takes their stacked coordinates s."""

    @property
    def parameters(self) -> Array:
        """Numbers that its compiled function takes, for the classes that `assembly` evaluates in compiled code."""
        return np.empty(0)

    @abstractmethod
    def value(self, s: Array, elapsed: float) -> tuple[Array, Array]:
        """Return the error (k,) and its gradient (k, m) at s (m,); `elapsed` is the time since the phase began [s]."""

    def rate(self, s: Array, e: Array, elapsed: float, eta: float) -> Array:
        """Return the desired e', shape (k,): -eta e as in (U6); a task that follows a path adds the path's velocity."""
        return -eta * e


@dataclass(frozen=True, kw_only=True)
class ComOverFoot(Task):
    """Brings the projection of the CoM over a point of a foot, section 4.1 [m].

    The foot may slide, so the Jacobian contains its motion: e = (p_CoM - p_foot)_xy, J = (J_CoM - J_foot)_xy.
    """

    foot: Point

    @property
    def watches(self) -> tuple[Feature, ...]:
        """The CoM and the point of the foot."""
        return (CenterOfMass(), self.foot)

    def value(self, s: Array, elapsed: float) -> tuple[Array, Array]:
        """Horizontal offset of the CoM from the point, shape (2,) [m]."""
        return _COM_LESS_FOOT @ s, _COM_LESS_FOOT


# the task of section 4.1: the CoM minus the point of the foot, along x and y
_COM_LESS_FOOT = np.array([[1.0, 0.0, 0.0, -1.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0, -1.0, 0.0]])


@jit
def pose_difference(s, target):  # type: ignore[no-untyped-def]
    """Return vec8(x - x_d) of section 4.2 (8,) and its gradient; s (8,) is x or -x, of which the closer one is used."""
    sign = 1.0 if s[:4] @ target[:4] >= 0.0 else -1.0  # x and -x are the same pose
    return sign * s - target, sign * np.eye(8)


@dataclass(frozen=True, kw_only=True)
class FramePose(Task):
    """Moves a frame to a pose, section 4.2: e = vec8(x - x_d), with the sign of x that is closer to x_d.

    Attributes
    ----------
    frame : str
    target : ndarray, shape (8,)
        x_d in the base frame.
    """

    frame: str
    target: Array

    @property
    def parameters(self) -> Array:
        """The target, shape (8,)."""
        return self.target

    @property
    def watches(self) -> tuple[Feature, ...]:
        """The pose."""
        return (Pose(self.frame),)

    def value(self, s: Array, elapsed: float) -> tuple[Array, Array]:
        """Difference of the unit dual quaternions, shape (8,)."""
        e, gradient = pose_difference(s, self.target)
        return e, gradient


@dataclass(frozen=True, kw_only=True)
class Posture(Task):
    """Moves all joints to a posture `q_ref` (n,) [rad]; not in the paper."""

    q_ref: Array
    watches = (JointAngles(),)

    @cached_property
    def _gradient(self) -> Array:
        return np.eye(len(self.q_ref))

    def value(self, s: Array, elapsed: float) -> tuple[Array, Array]:
        """Difference of the joint angles from the posture, shape (n,) [rad]."""
        return s - self.q_ref, self._gradient
