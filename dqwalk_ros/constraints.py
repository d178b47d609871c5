"""Distances and the vector-field inequality that keeps them, sections 3 and 4 [Urban2020, Marinho2019].

Every signed distance *grows towards safety*, so the package has one inequality, d' >= -eta (d - bound). Where the
paper writes <= (cylinders, upper joint limits) the distance here is its negative. The same distance, held at its
bound by d' = -eta (d - bound), is an equality such as (U8).

A constraint names the features of the robot that it watches, and says from their coordinates s what the distance d
is, and its gradient dd/ds. The Jacobian of the distance is this gradient times the Jacobian of s, by the chain rule
(`walk.Phase.evaluate`).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.compiled import jit
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.geometry import ConvexPolygon, Cylinder, Plane, point_to_line_squared, point_to_wall
from dqwalk_ros.kinematics import (
    CenterOfMass,
    CenterOfMassOnGround,
    Direction,
    Feature,
    JointAngles,
    Kinematics,
    Observer,
    Point,
    Rotation,
)

__all__ = [
    "Affine",
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
    "inside_cylinder",
    "inside_wall",
    "pose_error",
    "vfi",
]

Array = NDArray[np.float64]

_UP = np.array([0.0, 0.0, 1.0])


@jit
def vfi(d, bound, eta, return_speed, dt):  # type: ignore[no-untyped-def]
    """Right-hand side w of W u >= w, the vector-field inequality d' >= -eta (d - bound), shape (k,).

    Parameters
    ----------
    d, bound : ndarray, shape (k,)
        Signed distances and their least values.
    eta : ndarray, shape (k,)
        [1/s]. In discrete time only eta dt <= 1 keeps the bound, so no rate beyond 1/dt is used.
    return_speed : ndarray, shape (k,)
        Where a distance is below its bound, the fastest return that is asked for.
    dt : float
        Control period [s].
    """
    return np.minimum(-np.minimum(eta, 1.0 / dt) * (d - bound), return_speed)


@dataclass(frozen=True, kw_only=True)
class Constraint(ABC):
    """Keep a signed distance at or above its bound: J u >= -eta (d - bound).

    Attributes
    ----------
    name : str
    eta : float
        Rate at which the bound may be approached [1/s].
    bound : float
        Least distance allowed.
    return_speed : float
        A distance below its bound is led back no faster than this, so that the quadratic program stays feasible
        wherever a real robot has been pushed to [unit of the distance per second].
    """

    name: str
    eta: float
    bound: float = 0.0
    return_speed: float = math.inf

    @property
    @abstractmethod
    def watches(self) -> tuple[Feature, ...]:
        """Features of the robot; their coordinates, one after the other, are what `value` is given."""

    @property
    def parameters(self) -> Array:
        """The numbers its compiled function takes, where it has one that `assembly` knows."""
        return np.empty(0)

    @abstractmethod
    def value(self, s: Array) -> tuple[Array | float, Array]:
        """Return the distance, a float or (k,), and its gradient, shape (m,) or (k, m), at the coordinates s (m,)."""

    def row_names(self, joint_names: tuple[str, ...]) -> tuple[str, ...]:
        """Name of each of the k rows."""
        return (self.name,)

    def distance(self, kin: Kinematics) -> Array:
        """Signed distances at one configuration, shape (k,)."""
        s, _ = Observer(self.watches, kin.tree)(kin)
        return np.atleast_1d(self.value(s)[0])

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian of `distance`, shape (k, n)."""
        s, J = Observer(self.watches, kin.tree)(kin)
        return np.atleast_2d(self.value(s)[1]) @ J


class Affine(Constraint):
    """A distance that is affine in what it watches, d = A s - b: its gradient is known once and for all."""

    @property
    @abstractmethod
    def A(self) -> Array:
        """Gradient, shape (k, m)."""

    @property
    @abstractmethod
    def b(self) -> Array | float:
        """Offset, shape (k,) or one for all rows."""

    def value(self, s: Array) -> tuple[Array, Array]:
        """Return A s - b and A."""
        return self.A @ s - self.b, self.A


# ---------------------------------------------------------------------- points, section 3


@jit
def inside_cylinder(s, a):  # type: ignore[no-untyped-def]
    """r^2 - |p x l - m|^2 [m^2] of the point s, and its gradient, with a = (l, m, r): (U7) and (U14)."""
    square, gradient = point_to_line_squared(s, a[:3], a[3:6])
    return a[6] ** 2 - square, -gradient


@dataclass(frozen=True, kw_only=True)
class PointInCylinder(Constraint):
    """Keep a point inside an infinite cylinder at rest, (U7) and (U14): r^2 - d^2 >= 0 [m^2]."""

    point: Point | CenterOfMass
    cylinder: Cylinder

    @property
    def watches(self) -> tuple[Feature, ...]:
        """The point."""
        return (self.point,)

    @cached_property
    def parameters(self) -> Array:
        """Direction and moment of the axis, and the radius, shape (7,)."""
        return np.array([*self.cylinder.axis.l, *self.cylinder.axis.m, self.cylinder.radius])

    def value(self, s: Array) -> tuple[float, Array]:
        """Radius squared less the squared distance from the axis [m^2]."""
        d, gradient = inside_cylinder(s, self.parameters)
        return d, gradient


@dataclass(frozen=True, kw_only=True)
class PointOverPlane(Affine):
    """Keep a point on the positive side of a plane at rest, (U11); held at zero it is (U8) [m]."""

    point: Point | CenterOfMass
    plane: Plane

    @property
    def watches(self) -> tuple[Feature, ...]:
        """The point."""
        return (self.point,)

    @cached_property
    def A(self) -> Array:
        """The normal of the plane: d = <p, n> - d_plane, (U8) and (U11)."""
        return self.plane.n[None]

    @property
    def b(self) -> float:
        """Distance of the plane from the origin [m]."""
        return self.plane.d


@jit
def inside_wall(s, a):  # type: ignore[no-untyped-def]
    """Distance of p from the upright plane through a[:3] and b, s = (p, b), on the side a[3]: (U9) and (U10) [m]."""
    return point_to_wall(s, a[:3], a[3])


@dataclass(frozen=True, kw_only=True)
class PointInsideWall(Constraint):
    """Keep a point inside the upright plane through a place at rest and a moving one, (U9) and (U10) [m].

    Attributes
    ----------
    point : Point or CenterOfMass
    fixed : ndarray, shape (3,)
        Place on the base foot [m].
    moving : Point
        Place on the end foot; the plane turns with it.
    side : float
        1 where the inside is to the left of the way from `fixed` to `moving`, -1 to the right.
    """

    point: Point | CenterOfMass
    fixed: Array
    moving: Point
    side: float

    @property
    def watches(self) -> tuple[Feature, ...]:
        """The point, and the moving place."""
        return (self.point, self.moving)

    @cached_property
    def parameters(self) -> Array:
        """The place at rest, and the side, shape (4,)."""
        return np.array([*self.fixed, self.side])

    def value(self, s: Array) -> tuple[float, Array]:
        """Distance of the point from the wall [m]; the gradient at b is the residual of [Marinho2019]."""
        d, gradient = inside_wall(s, self.parameters)
        return d, gradient


@dataclass(frozen=True, kw_only=True)
class PointsOverPlane(Affine):
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

    @cached_property
    def watches(self) -> tuple[Feature, ...]:
        """The points."""
        return tuple(Point(self.frame, p) for p in self.points)

    @cached_property
    def A(self) -> Array:
        """The normal of the plane, once per point."""
        return np.asarray(np.kron(np.eye(len(self.points)), self.plane.n), dtype=np.float64)

    @property
    def b(self) -> float:
        """Distance of the plane from the origin [m]."""
        return self.plane.d

    def row_names(self, joint_names: tuple[str, ...]) -> tuple[str, ...]:
        """One name per point."""
        return tuple(f"{self.name}/{k}" for k in range(len(self.points)))


@dataclass(frozen=True, kw_only=True)
class ComInsideEdges(Affine):
    """Keep the vertical through the CoM inside a convex polygon on the base sole's plane, one row per edge [m].

    "As many planes as necessary", section 3.1.

    Attributes
    ----------
    polygon : ConvexPolygon
        At rest in the base frame.
    """

    polygon: ConvexPolygon

    @property
    def watches(self) -> tuple[Feature, ...]:
        """The CoM along the vertical."""
        return (CenterOfMassOnGround(),)

    @property
    def A(self) -> Array:
        """Inward normals of the edges."""
        return self.polygon.edges()[0]

    @property
    def b(self) -> Array:
        """Offsets of the edges [m]."""
        return self.polygon.edges()[1]

    def row_names(self, joint_names: tuple[str, ...]) -> tuple[str, ...]:
        """One name per edge."""
        return tuple(f"{self.name}/{k}" for k in range(len(self.polygon.vertices)))


# ---------------------------------------------------------------------- frames


@dataclass(frozen=True, kw_only=True)
class AxisLevel(Affine):
    """The height <z_frame, direction> that a frame's normal has along a horizontal direction at rest [rad].

    Held at zero along x and y it keeps a sole parallel to the ground.
    """

    frame: str
    direction: Array

    @property
    def watches(self) -> tuple[Feature, ...]:
        """The frame's normal."""
        return (Direction(self.frame, _UP),)

    @property
    def A(self) -> Array:
        """The direction."""
        return self.direction[None]

    @property
    def b(self) -> float:
        """Zero."""
        return 0.0


@jit
def pose_error(s, p_d, r_d, lever):  # type: ignore[no-untyped-def]
    """Difference of a pose from p_d (3,) and r_d (4,): p - p_d [m] and 2 Im(r r_d*) times `lever`; zero where equal.

    Near r_d the second is the angle [rad]. It is linear in `s` (7,), the coordinates of a `Point` and a `Rotation`.

    Returns
    -------
    error : ndarray, shape (6,)
    gradient : ndarray, shape (6, 7)
    """
    w, x, y, z = r_d
    sign = 1.0 if s[3] * w + s[4] * x + s[5] * y + s[6] * z >= 0.0 else -1.0  # r and -r are the same orientation
    gradient = np.zeros((6, 7))
    gradient[0, 0] = gradient[1, 1] = gradient[2, 2] = 1.0
    imaginary = np.array([[-x, w, -z, y], [-y, z, w, -x], [-z, -y, x, w]])  # Im of H-4(r_d*)
    gradient[3:, 3:] = 2.0 * sign * lever * imaginary
    error = gradient @ s
    error[:3] -= p_d
    return error, gradient


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

    @property
    def watches(self) -> tuple[Feature, ...]:
        """Position and orientation of the frame."""
        return (Point(self.frame), Rotation(self.frame))

    @cached_property
    def parameters(self) -> Array:
        """Position and orientation, shape (7,)."""
        return np.array([*DQ(self.pose).translation(), *self.pose[:4]])

    def value(self, s: Array) -> tuple[Array, Array]:
        """Difference from the pose, shape (6,)."""
        e, gradient = pose_error(s, self.parameters[:3], self.parameters[3:], 1.0)
        return e, gradient

    def row_names(self, joint_names: tuple[str, ...]) -> tuple[str, ...]:
        """One name per axis, translations first."""
        return tuple(f"{self.name}/{axis}" for axis in range(6))


# ---------------------------------------------------------------------- joints


@dataclass(frozen=True, kw_only=True)
class JointMaximum(Affine):
    """Upper joint limits, (U12): q_max - q >= 0 [rad]."""

    q_max: Array

    @property
    def watches(self) -> tuple[Feature, ...]:
        """All joint angles."""
        return (JointAngles(),)

    @cached_property
    def A(self) -> Array:
        """Minus one: d = -q - (-q_max), (U12)."""
        return -np.eye(len(self.q_max))

    @property
    def b(self) -> Array:
        """The limits with their sign changed [rad]."""
        return -self.q_max

    def row_names(self, joint_names: tuple[str, ...]) -> tuple[str, ...]:
        """One name per joint, such as ``joint_max/l_knee_y``."""
        return tuple(f"{self.name}/{joint}" for joint in joint_names)


@dataclass(frozen=True, kw_only=True)
class JointMinimum(Affine):
    """Lower joint limits, (U13): q - q_min >= 0 [rad]."""

    q_min: Array

    @property
    def watches(self) -> tuple[Feature, ...]:
        """All joint angles."""
        return (JointAngles(),)

    @cached_property
    def A(self) -> Array:
        """One: d = q - q_min, (U13)."""
        return np.eye(len(self.q_min))

    @property
    def b(self) -> Array:
        """The limits [rad]."""
        return self.q_min

    def row_names(self, joint_names: tuple[str, ...]) -> tuple[str, ...]:
        """One name per joint, such as ``joint_min/l_knee_y``."""
        return tuple(f"{self.name}/{joint}" for joint in joint_names)
