"""Vector-field inequalities, section 4 [Urban2020, Marinho2019].

Every signed distance *grows towards safety*, so the package has one inequality: d' >= -eta (d - bound). Where the
paper writes <= (cylinders, upper joint limits) the distance here is its negative. The same distance, held at its
bound by d' = -eta (d - bound), is an equality such as (8).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.geometry import (
    Cylinder,
    Plane,
    point_to_line_squared,
    point_to_line_squared_jacobian,
    point_to_plane,
    point_to_plane_jacobian,
    point_to_wall,
    point_to_wall_jacobian,
)
from dqwalk_ros.kinematics import Kinematics, Point

__all__ = [
    "AxisLevel",
    "Constraint",
    "JointMaximum",
    "JointMinimum",
    "PointInCylinder",
    "PointInsideWall",
    "PointOverPlane",
    "gain",
    "vfi_rows",
]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Constraint(ABC):
    """Keep a signed distance at or above its bound: J u >= -eta (d - bound).

    Attributes
    ----------
    name : str
    eta : float
        Rate at which the bound may be approached [1/s]. In discrete time only eta dt <= 1 keeps it, so the rate
        that is used is `gain`.
    bound : float
        Least distance allowed.
    """

    name: str
    eta: float
    bound: float = 0.0

    @abstractmethod
    def distance(self, kin: Kinematics) -> Array:
        """Signed distances, shape (k,)."""

    @abstractmethod
    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian of `distance`, shape (k, n)."""

    def row_names(self, joint_names: tuple[str, ...]) -> tuple[str, ...]:
        """Name of each of the k rows."""
        return (self.name,)


def gain(eta: float, dt: float) -> float:
    """Return the rate to use at the period `dt` [s]: eta, or 1/dt if that is less.

    Beyond 1/dt one Euler step at full approach would cross the bound.
    """
    return min(eta, 1.0 / dt)


def vfi_rows(constraint: Constraint, kin: Kinematics, dt: float) -> tuple[Array, Array]:
    """Return G (k, n) and h (k,) of G u >= h, the one place where the inequality is written."""
    return constraint.jacobian(kin), -gain(constraint.eta, dt) * (constraint.distance(kin) - constraint.bound)


@dataclass(frozen=True, kw_only=True)
class PointInCylinder(Constraint):
    """Keep a point inside an infinite cylinder at rest, (7) and (14): r^2 - d^2 >= 0 [m^2]."""

    point: Point
    cylinder: Cylinder

    def distance(self, kin: Kinematics) -> Array:
        """Radius squared less the squared distance from the axis, shape (1,) [m^2]."""
        axis = self.cylinder.axis
        return np.array([self.cylinder.radius**2 - point_to_line_squared(self.point.position(kin), axis.l, axis.m)])

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian of `distance`, shape (1, n) [m^2/rad]."""
        axis, p = self.cylinder.axis, self.point
        return -point_to_line_squared_jacobian(p.position(kin), p.jacobian(kin), axis.l, axis.m)[None]


@dataclass(frozen=True, kw_only=True)
class PointOverPlane(Constraint):
    """Keep a point on the positive side of a plane at rest, (11); held at zero it is (8) [m]."""

    point: Point
    plane: Plane

    def distance(self, kin: Kinematics) -> Array:
        """Height of the point over the plane, shape (1,) [m]."""
        return np.array([point_to_plane(self.point.position(kin), self.plane.n, self.plane.d)])

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian of `distance`, shape (1, n) [m/rad]."""
        return point_to_plane_jacobian(self.point.position(kin), self.point.jacobian(kin), self.plane.n)[None]


@dataclass(frozen=True, kw_only=True)
class PointInsideWall(Constraint):
    """Keep a point inside the upright plane through a place at rest and a moving one, (9) and (10) [m].

    Attributes
    ----------
    point : Point
    fixed : ndarray, shape (3,)
        Place on the base foot [m].
    moving : Point
        Place on the end foot; the plane turns with it, and the Jacobian has the residual.
    side : float
        1 where the inside is to the left of the way from `fixed` to `moving`, -1 to the right.
    """

    point: Point
    fixed: Array
    moving: Point
    side: float

    def distance(self, kin: Kinematics) -> Array:
        """Distance of the point from the wall, shape (1,) [m]."""
        return np.array([point_to_wall(self.point.position(kin), self.fixed, self.moving.position(kin), self.side)])

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian of `distance`, shape (1, n) [m/rad], with the residual of the moving plane."""
        p, b = self.point, self.moving
        J = point_to_wall_jacobian(
            p.position(kin), p.jacobian(kin), self.fixed, b.position(kin), b.jacobian(kin), self.side
        )
        return J[None]


@dataclass(frozen=True, kw_only=True)
class AxisLevel(Constraint):
    """The height <z_frame, direction> that a frame's normal has along a horizontal direction at rest [rad].

    Held at zero along x and y it keeps a sole parallel to the ground.
    """

    frame: str
    direction: Array

    def distance(self, kin: Kinematics) -> Array:
        """Height of the direction, shape (1,), for small angles in [rad]."""
        return np.array([self.direction @ kin.direction(self.frame, _UP)])

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian of `distance`, shape (1, n)."""
        return (self.direction @ kin.direction_jacobian(self.frame, _UP))[None]


_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, kw_only=True)
class JointMaximum(Constraint):
    """Upper joint limits, (12): q_max - q >= 0 [rad]."""

    q_max: Array

    def distance(self, kin: Kinematics) -> Array:
        """How far each joint may still turn up, shape (n,) [rad]."""
        return self.q_max - kin.q

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian of `distance`, shape (n, n)."""
        return -np.eye(kin.q.shape[0])

    def row_names(self, joint_names: tuple[str, ...]) -> tuple[str, ...]:
        """One name per joint, such as ``joint_max/l_knee_y``."""
        return tuple(f"{self.name}/{joint}" for joint in joint_names)


@dataclass(frozen=True, kw_only=True)
class JointMinimum(Constraint):
    """Lower joint limits, (13): q - q_min >= 0 [rad]."""

    q_min: Array

    def distance(self, kin: Kinematics) -> Array:
        """How far each joint may still turn down, shape (n,) [rad]."""
        return kin.q - self.q_min

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian of `distance`, shape (n, n)."""
        return np.eye(kin.q.shape[0])

    def row_names(self, joint_names: tuple[str, ...]) -> tuple[str, ...]:
        """One name per joint, such as ``joint_min/l_knee_y``."""
        return tuple(f"{self.name}/{joint}" for joint in joint_names)
