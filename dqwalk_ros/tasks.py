"""Tasks: errors that the objective of (U6) drives to zero, sections 4.1 and 4.2 [Urban2020].

As a constraint does, a task names the features that it watches, and says from their coordinates s what the error is
and its gradient; its Jacobian J_task is that gradient times the Jacobian of s.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.compiled import jit
from dqwalk_ros.kinematics import CenterOfMass, Feature, JointAngles, Kinematics, Observer, Point, Pose

__all__ = ["ComOverFoot", "FramePose", "Posture", "Task"]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Task(ABC):
    """An error e(q) with e' = J u; the objective has weight ||J u - rate||^2.

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
        """Features of the robot; their coordinates, one after the other, are what `value` is given."""

    @property
    def parameters(self) -> Array:
        """The numbers its compiled function takes, where it has one that `assembly` knows."""
        return np.empty(0)

    @abstractmethod
    def value(self, s: Array, elapsed: float) -> tuple[Array, Array]:
        """Return the error (k,) and its gradient (k, m) at the coordinates s (m,), `elapsed` [s] into the phase."""

    def rate(self, s: Array, e: Array, elapsed: float, eta: float) -> Array:
        """Return the e' asked for, shape (k,): -eta e in (U6); a task on a path adds the path's velocity."""
        return -eta * e

    def error(self, kin: Kinematics) -> Array:
        """Error at one configuration, shape (k,)."""
        s, _ = Observer(self.watches, kin.tree)(kin)
        return self.value(s, kin.elapsed)[0]

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian of `error`, shape (k, n)."""
        s, J = Observer(self.watches, kin.tree)(kin)
        return self.value(s, kin.elapsed)[1] @ J


@dataclass(frozen=True, kw_only=True)
class ComOverFoot(Task):
    """CoM projection over a point of a foot, section 4.1 [m].

    The foot may slide, so its Jacobian counts: e = (p_CoM - p_foot)_xy, J = (J_CoM - J_foot)_xy.
    """

    foot: Point

    @property
    def watches(self) -> tuple[Feature, ...]:
        """The CoM and the point of the foot."""
        return (CenterOfMass(), self.foot)

    def value(self, s: Array, elapsed: float) -> tuple[Array, Array]:
        """Horizontal offset of the CoM from the point, shape (2,) [m]."""
        return _COM_LESS_FOOT @ s, _COM_LESS_FOOT


# the task of section 4.1: the CoM less the point of the foot, along x and y
_COM_LESS_FOOT = np.array([[1.0, 0.0, 0.0, -1.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0, -1.0, 0.0]])


@jit
def pose_difference(s, target):  # type: ignore[no-untyped-def]
    """Section 4.2: vec8(x - x_d) of the pose s, with the sign of x that is closer to x_d (8,), and its gradient."""
    sign = 1.0 if s[:4] @ target[:4] >= 0.0 else -1.0  # x and -x are the same pose
    return sign * s - target, sign * np.eye(8)


@dataclass(frozen=True, kw_only=True)
class FramePose(Task):
    """Pose of a frame, section 4.2: e = vec8(x - x_d), with the sign of x that is closer to x_d.

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
        """Difference of the dual quaternions, shape (8,)."""
        e, gradient = pose_difference(s, self.target)
        return e, gradient


@dataclass(frozen=True, kw_only=True)
class Posture(Task):
    """All joints at a posture [rad]; not in the paper."""

    q_ref: Array

    @property
    def watches(self) -> tuple[Feature, ...]:
        """All joint angles."""
        return (JointAngles(),)

    @cached_property
    def _gradient(self) -> Array:
        return np.eye(len(self.q_ref))

    def value(self, s: Array, elapsed: float) -> tuple[Array, Array]:
        """Offset of every joint, shape (n,) [rad]."""
        return s - self.q_ref, self._gradient
