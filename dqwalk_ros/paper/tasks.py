"""Tasks: errors that the objective of (U6) drives to zero, sections 4.1 and 4.2 [Urban2020]."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dqwalk_ros.paper.features import Affine, CenterOfMass, Feature, JointAngles, Point, Pose, Quantity
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit


@jit
def converge(e: Array, eta: float, saturation: float) -> Array:
    """Return the desired derivative of an error e (k,) by time, -eta e of (U6); the norm of e is saturated."""
    return -eta * min(1.0, saturation / max(math.sqrt(e @ e), 1e-12)) * e


@dataclass(frozen=True, kw_only=True)
class Task(Quantity):
    """An error e(q) with e' = J u; the objective of (U6) contains weight ||J u + eta e||^2.

    If the error changes by time alone, because it is the distance from a path, that rate is subtracted.
    """

    weight: float = 1.0
    eta: float | None = None
    """Rate at which the error converges [1/s]; by default that of the phase."""
    saturation: float = math.inf
    """Norm at which the error is saturated, so that it converges at most at eta times this speed."""


# (p_CoM - p_foot)_xy of section 4.1
_COM_LESS_FOOT = np.hstack([np.eye(2, 3), -np.eye(2, 3)])


@dataclass(frozen=True, kw_only=True)
class ComOverFoot(Affine, Task):
    """Brings the projection of the CoM over a point of a foot, section 4.1 [m].

    The foot may slide, so the Jacobian contains its motion: e = (p_CoM - p_foot)_xy, J = (J_CoM - J_foot)_xy.
    """

    foot: Point

    @property
    def watches(self) -> tuple[Feature, ...]:
        """The CoM and the point of the foot."""
        return (CenterOfMass(), self.foot)

    @property
    def A(self) -> Array:
        """Selects the horizontal offset of the CoM from the point, shape (2, 6)."""
        return _COM_LESS_FOOT


@jit
def pose_difference(s: Array, target: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Return vec8(x - x_d) of section 4.2 (8,) and its gradient; s (8,) is x or -x, of which the closer one is used."""
    sign = 1.0 if s[:4] @ target[:4] >= 0.0 else -1.0  # x and -x are the same pose
    return sign * s - target, sign * np.eye(8), np.zeros(8)


@dataclass(frozen=True, kw_only=True)
class FramePose(Task):
    """Moves a frame to a pose, section 4.2: e = vec8(x - x_d), with the sign of x that is closer to x_d."""

    frame: str
    target: Array
    """x_d in the base frame, shape (8,)."""
    function = pose_difference

    @property
    def watches(self) -> tuple[Feature, ...]:
        """The pose."""
        return (Pose(self.frame),)

    @property
    def parameters(self) -> Array:
        """The target, shape (8,)."""
        return self.target


@dataclass(frozen=True, kw_only=True)
class Posture(Affine, Task):
    """Moves all joints to a posture `q_ref` (n,) [rad]; not in the paper."""

    q_ref: Array
    watches = (JointAngles(),)

    @cached_property
    def A(self) -> Array:
        """The identity, shape (n, n)."""
        return np.eye(len(self.q_ref))

    @property
    def b(self) -> Array:
        """The posture, shape (n,) [rad]."""
        return self.q_ref
