"""Tasks: errors that the objective of (6) drives to zero."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.kinematics import Kinematics, Point

__all__ = ["ComOverFoot", "FramePose", "Posture", "Task"]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Task(ABC):
    """An error e(q) with e' = J u; the objective has weight ||J u + eta e||^2.

    Attributes
    ----------
    name : str
    weight : float
    """

    name: str
    weight: float = 1.0

    @abstractmethod
    def error(self, kin: Kinematics) -> Array:
        """Error, shape (k,)."""

    @abstractmethod
    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian of `error`, shape (k, n)."""


@dataclass(frozen=True, kw_only=True)
class ComOverFoot(Task):
    """CoM projection over a point of a foot, section 4.1 [m].

    The foot may slide, so its Jacobian counts: e = (p_CoM - p_foot)_xy, J = (J_CoM - J_foot)_xy.
    """

    foot: Point

    def error(self, kin: Kinematics) -> Array:
        """Horizontal offset of the CoM from the point, shape (2,) [m]."""
        return kin.com[:2] - self.foot.position(kin)[:2]

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian of `error`, shape (2, n) [m/rad]."""
        return kin.com_jacobian[:2] - self.foot.jacobian(kin)[:2]


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

    def error(self, kin: Kinematics) -> Array:
        """Difference of the dual quaternions, shape (8,)."""
        x = kin.pose(self.frame)
        return self._sign(x) * x - self.target

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian of `error`, shape (8, n)."""
        return self._sign(kin.pose(self.frame)) * kin.pose_jacobian(self.frame)

    def _sign(self, x: Array) -> float:
        # x and -x are the same pose
        return 1.0 if x[:4] @ self.target[:4] >= 0.0 else -1.0


@dataclass(frozen=True, kw_only=True)
class Posture(Task):
    """All joints at a posture [rad]; not in the paper."""

    q_ref: Array

    def error(self, kin: Kinematics) -> Array:
        """Offset of every joint, shape (n,) [rad]."""
        return kin.q - self.q_ref

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian of `error`, shape (n, n)."""
        return np.eye(kin.q.shape[0])
