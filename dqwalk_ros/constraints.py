"""Vector-field inequalities, section 4 [Urban2020, Marinho2019].

Every signed distance *grows towards safety*, so the package has one inequality: d' >= -eta (d - bound). Where the
paper writes <= (cylinders, upper joint limits) the distance here is its negative. The same distance, held at its
bound by d' = -eta (d - bound), is an equality such as (8).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.geometry import (
    ConvexPolygon,
    Cylinder,
    Plane,
    point_to_line_squared,
    point_to_line_squared_jacobian,
    point_to_plane,
    point_to_plane_jacobian,
    point_to_wall,
    point_to_wall_jacobian,
)
from dqwalk_ros.kinematics import Kinematics, Point, pose_difference, pose_difference_jacobian

__all__ = [
    "DEPENDENT",
    "AxisLevel",
    "ComInsideEdges",
    "Constraint",
    "FrameHeld",
    "JointMaximum",
    "JointMinimum",
    "PointInCylinder",
    "PointInsideWall",
    "PointOverPlane",
    "PointsOverPlane",
    "gain",
    "hold_rows",
    "vfi_rows",
]

Array = NDArray[np.float64]


DEPENDENT = 5e-3
"""Equality rows with a singular value below this part of the largest are taken for dependent."""


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
    recovery : float
        Beyond its bound a distance is led back no faster than this, so that the quadratic program stays feasible
        wherever a real robot has been pushed to [unit of the distance per second].
    """

    name: str
    eta: float
    bound: float = 0.0
    recovery: float = math.inf

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
    """Return G (k, n) and h (k,) of G u >= h, the one place where the inequality is written.

    An equality is G u = h, whose h `hold_rows` clips on both sides.
    """
    h = -gain(constraint.eta, dt) * (constraint.distance(kin) - constraint.bound)
    return constraint.jacobian(kin), np.minimum(h, constraint.recovery)


def hold_rows(constraint: Constraint, kin: Kinematics, dt: float) -> tuple[Array, Array]:
    """Return E (k, n) and e (k,) of E u = e that hold a distance at its bound.

    Several rows are turned into independent ones (by their singular values), and what no joint can move is left out:
    two feet without ankle roll leave the six rows of a held sole with rank five.
    """
    E, e = vfi_rows(constraint, kin, dt)
    e = np.maximum(e, -constraint.recovery)
    if len(e) == 1:
        return E, e
    U, s, V = np.linalg.svd(E, full_matrices=False)
    kept = s > DEPENDENT * s[0]
    return (s * kept)[:, None] * V, np.where(kept, U.T @ e, 0.0)


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


@dataclass(frozen=True, kw_only=True)
class ComInsideEdges(Constraint):
    """Keep the vertical through the CoM inside a convex polygon on the base sole's plane, one row per edge [m].

    "As many planes as necessary", section 3.1.

    Attributes
    ----------
    polygon : ConvexPolygon
        At rest in the base frame.
    """

    polygon: ConvexPolygon

    def distance(self, kin: Kinematics) -> Array:
        """Signed distances, shape (k,)."""
        n, d = self.polygon.edges()
        return n @ kin.com_on_ground - d

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian, shape (k, n)."""
        n, _ = self.polygon.edges()
        return n @ kin.com_on_ground_jacobian

    def row_names(self, joint_names: tuple[str, ...]) -> tuple[str, ...]:
        """Name of each row."""
        return tuple(f"{self.name}/{k}" for k in range(len(self.polygon.vertices)))


@dataclass(frozen=True, kw_only=True)
class PointsOverPlane(Constraint):
    """Keep points of a frame, such as the corners of a sole, on the positive side of a plane at rest, one row each [m].

    Attributes
    ----------
    frame : str
    points : ndarray, shape (k, 3)
        In the frame [m].
    plane : Plane
    """

    frame: str
    points: Array
    plane: Plane

    def distance(self, kin: Kinematics) -> Array:
        """Signed distances, shape (k,)."""
        return DQ(kin.pose(self.frame)).transform_point(self.points) @ self.plane.n - self.plane.d

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian, shape (k, n)."""
        return np.array([self.plane.n @ kin.point_jacobian(self.frame, p) for p in self.points])

    def row_names(self, joint_names: tuple[str, ...]) -> tuple[str, ...]:
        """Name of each row."""
        return tuple(f"{self.name}/{k}" for k in range(len(self.points)))


@dataclass(frozen=True, kw_only=True)
class FrameHeld(Constraint):
    """Six rows that are zero where a frame is at a pose: p - p_d [m] and 2 Im(r r_d*), near it the angle [rad].

    Attributes
    ----------
    frame : str
    pose : ndarray, shape (8,)
        x_d in the base frame.
    """

    frame: str
    pose: Array

    def distance(self, kin: Kinematics) -> Array:
        """Signed distances, shape (k,)."""
        return pose_difference(kin.pose(self.frame), self.pose)

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian, shape (k, n)."""
        return pose_difference_jacobian(kin, self.frame, self.pose)

    def row_names(self, joint_names: tuple[str, ...]) -> tuple[str, ...]:
        """Name of each row."""
        return tuple(f"{self.name}/{axis}" for axis in range(6))
