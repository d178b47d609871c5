"""Distances and the vector-field inequality that keeps them, sections 3 and 4 [Urban2020, Marinho2019].

Every signed distance d increases towards the safe side, so that the package has one kind of inequality,
d' >= -eta (d - bound). Where the paper has <= (cylinders, upper joint limits), the distance here is the negative of the
paper's. A distance that is kept equal to its bound by d' = -eta (d - bound) is an equality such as (U8).

A constraint lists the features of the robot that it depends on (`watches`), and its compiled function computes from
their coordinates s the distance d, its gradient dd/ds, and the rate at which d changes by time alone, which is zero for
a constraint at rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.features import (
    Affine,
    CenterOfMass,
    CenterOfMassOnGround,
    Direction,
    Feature,
    JointAngles,
    Live,
    Point,
    Quantity,
    Rotation,
)
from dqwalk_ros.paper.geometry import ConvexPolygon, Cylinder, Plane, Z, point_to_line_squared, point_to_wall
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit

_MARGIN = 1.25
"""Height of a drawn region, relative to the height of the constrained point."""


@dataclass(frozen=True)
class Region:
    """The shape by which pictures show a constraint."""

    kind: Literal["cylinder", "plane", "wall"]
    """``cylinder`` (size: radius, height; along z), ``plane`` (x, y; normal z) or ``wall`` (x, z; normal y)."""
    pose: Array
    """Of its centre, shape (8,)."""
    size: tuple[float, float]
    """[m]"""


class Look(NamedTuple):
    """How pictures show a constraint: its title, by default its name, and the colour of its region, in RGB."""

    title: str = ""
    color: tuple[int, int, int] = (90, 100, 160)


PLAIN = Look()


@jit
def vfi(d: Array, bound: Array, eta: Array, return_speed: Array, dt: float) -> Array:
    """Right-hand side w of W u >= w, the vector-field inequality d' >= -eta (d - bound), shape (k,).

    Parameters
    ----------
    d, bound : ndarray, shape (k,)
        Signed distances and their lower bounds.
    eta : ndarray, shape (k,)
        Rates [1/s], limited to 1/dt here: in discrete time the bound is satisfied only if eta dt <= 1.
    return_speed : ndarray, shape (k,)
        Upper limit of w, for distances below their bound [unit of the distance per second].
    dt : float
        Control period [s].
    """
    return np.minimum(-np.minimum(eta, 1.0 / dt) * (d - bound), return_speed)


@dataclass(frozen=True, kw_only=True)
class Constraint(Quantity):
    """Keep a signed distance at or above its bound: J u >= -eta (d - bound)."""

    eta: float
    """Rate [1/s]: a distance d may approach its bound at the speed eta (d - bound)."""
    bound: float = 0.0
    """Least distance allowed."""
    return_speed: float = math.inf
    """Largest speed at which a distance below its bound is required to return [unit of the distance per second]. It
    keeps the quadratic program feasible after a disturbance that violates the constraint."""
    near: float = math.inf
    """Distance above its bound beyond which an inequality is left out of the quadratic program; by default it never is.
    If the largest joint velocities can close a larger distance within a period, that distance counts."""
    look: Look = PLAIN
    unit: ClassVar[Literal["m", "rad"]] = "m"
    """Of its `margin`, ``m`` or ``rad``."""

    def row_names(self, joint_names: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names of the k rows."""
        return (self.name,)

    def margin(self, d: float) -> float:
        """Return a distance d, which may be in another unit, in [m] or [rad]."""
        return d

    @property
    def full_margin(self) -> float:
        """Margin for which a gauge is full, [m] or [rad]."""
        return 0.1

    def region(self, kin: Kinematics) -> Region | None:
        """Return its shape in the base frame; None if it has none."""
        return None


# ---------------------------------------------------------------------- points, section 3


@jit
def inside_cylinder(s: Array, a: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Return r^2 - |p x l - m|^2 [m^2] of p = s (3,) and its gradient, with a (7,) = (l, m, r): (U7) and (U14)."""
    square, gradient = point_to_line_squared(s, a[:3], a[3:6])
    return np.array([a[6] ** 2 - square]), -gradient.reshape(1, 3), np.zeros(1)


@dataclass(frozen=True, kw_only=True)
class PointInCylinder(Constraint):
    """Keep a point inside a fixed infinite cylinder, (U7) and (U14): r^2 - d^2 >= 0 [m^2], d from the axis."""

    point: Point | CenterOfMass
    cylinder: Cylinder
    function = inside_cylinder

    @cached_property
    def parameters(self) -> Array:
        """Direction and moment of the axis, and the radius, shape (7,)."""
        return np.array([*self.cylinder.axis.l, *self.cylinder.axis.m, self.cylinder.radius])

    def margin(self, d: float) -> float:
        """Return the distance r - sqrt(r^2 - d) to the cylinder's surface [m]."""
        r = self.cylinder.radius
        return r - math.sqrt(max(0.0, r * r - d))

    @property
    def full_margin(self) -> float:
        """The radius [m]."""
        return self.cylinder.radius

    def region(self, kin: Kinematics) -> Region:
        """Return the cylinder, from the ground to above the point."""
        axis, p = self.cylinder.axis, self.point.value(kin)
        foot = np.cross(axis.l, axis.m)  # the axis' point closest to the origin
        height = max(0.012, _MARGIN * abs(float((p - foot) @ axis.l)))
        middle = DQ.facing(axis.l, foot + 0.5 * height * axis.l)
        return Region("cylinder", middle.vec8(), (self.cylinder.radius, height))


@dataclass(frozen=True, kw_only=True)
class PointOverPlane(Affine, Constraint):
    """Keep a point on the positive side of a fixed plane, (U11) [m]; as an equality it is (U8)."""

    point: Point | CenterOfMass
    plane: Plane

    @cached_property
    def A(self) -> Array:
        """The normal of the plane, shape (1, 3): d = <p, n> - d_plane, (U8) and (U11)."""
        return self.plane.n[None]

    @property
    def b(self) -> float:
        """Distance of the plane from the origin [m]."""
        return self.plane.d

    @property
    def full_margin(self) -> float:
        """The distance of the plane from the origin [m]."""
        return max(abs(self.plane.d), 0.05)

    def region(self, kin: Kinematics) -> Region:
        """Return a part of the plane, below the point."""
        plane, p = self.plane, self.point.value(kin)
        center = p - (float(plane.n @ p) - plane.d) * plane.n
        return Region("plane", DQ.facing(plane.n, center).vec8(), (0.26, 0.26))


@jit
def inside_wall(s: Array, a: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Distance of p from the vertical plane through a[:3] and b, side a[3], s (6,) = (p, b): (U9) and (U10) [m]."""
    d, gradient = point_to_wall(s, a[:3], a[3])
    return np.array([d]), gradient.reshape(1, 6), np.zeros(1)


@dataclass(frozen=True, kw_only=True)
class PointInsideWall(Constraint):
    """Keep a point on one side of the vertical plane through a fixed and a moving point, (U9) and (U10) [m].

    The gradient with respect to the moving point gives the residual of [Marinho2019].
    """

    point: Point | CenterOfMass
    fixed: Array
    """Point of the base foot, shape (3,) [m]."""
    moving: Point
    """Point of the end foot, with which the plane moves."""
    side: float
    """1 if the allowed side is to the left of the line from `fixed` to `moving`, -1 if it is to the right."""
    depth: float
    """Of the allowed region [m]."""
    function = inside_wall

    @cached_property
    def parameters(self) -> Array:
        """The fixed point of the plane, and the side, shape (4,)."""
        return np.array([*self.fixed, self.side])

    @property
    def full_margin(self) -> float:
        """Half of the depth [m]."""
        return 0.5 * self.depth

    def region(self, kin: Kinematics) -> Region:
        """Return the wall between the two points, from the ground to above the constrained one."""
        a, b = self.fixed, self.moving.value(kin)
        t = (b - a)[:2]
        height = max(0.02, _MARGIN * float(self.point.value(kin)[2]))
        center = np.append(0.5 * (a + b)[:2], 0.5 * height)
        yaw = float(np.arctan2(t[1], t[0]))
        pose = DQ.from_pose(center, [np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)]).vec8()
        return Region("wall", pose, (float(np.hypot(*t)) + 0.12, height))


@dataclass(frozen=True, kw_only=True)
class PointsOverPlane(Affine, Constraint):
    """Keep points of a frame, such as corners of a sole, on the positive side of a fixed plane, one row each [m]."""

    frame: str
    points: Array
    """Coordinates in the frame, shape (k, 3) [m]."""
    plane: Plane

    @cached_property
    def watches(self) -> tuple[Feature, ...]:
        """The points."""
        return tuple(Point(self.frame, p) for p in self.points)

    @cached_property
    def A(self) -> Array:
        """The normal of the plane, in one row per point, shape (k, 3 k)."""
        return (np.eye(len(self.points))[:, :, None] * self.plane.n).reshape(len(self.points), -1)

    @property
    def b(self) -> float:
        """Distance of the plane from the origin [m]."""
        return self.plane.d

    def row_names(self, joint_names: tuple[str, ...]) -> tuple[str, ...]:
        """One name per point."""
        return tuple(f"{self.name}/{k}" for k in range(len(self.points)))


@dataclass(frozen=True, kw_only=True)
class ComInsideEdges(Affine, Constraint):
    """Keep the vertical through the CoM inside a convex polygon in the base sole's plane, one row per edge [m].

    Each edge is a plane; section 3.1 allows "as many planes as necessary".
    """

    polygon: ConvexPolygon
    """Fixed in the base frame."""
    watches = (CenterOfMassOnGround(),)

    @property
    def A(self) -> Array:
        """Inward normals of the edges, shape (k, 2)."""
        return self.polygon.edges()[0]

    @property
    def b(self) -> Array:
        """Offsets of the edges, shape (k,) [m]."""
        return self.polygon.edges()[1]

    def row_names(self, joint_names: tuple[str, ...]) -> tuple[str, ...]:
        """One name per edge."""
        return tuple(f"{self.name}/{k}" for k in range(len(self.polygon.vertices)))


# ---------------------------------------------------------------------- frames


@dataclass(frozen=True, kw_only=True)
class AxisLevel(Affine, Constraint):
    """Inner product of a frame's z axis with a fixed direction: for small angles, the inclination along it [rad].

    As an equality along x and along y it keeps a sole parallel to the ground.
    """

    frame: str
    direction: Array
    """Unit vector in the base frame, shape (3,)."""

    @property
    def watches(self) -> tuple[Feature, ...]:
        """The z axis of the frame."""
        return (Direction(self.frame, Z),)

    @property
    def A(self) -> Array:
        """The direction, shape (1, 3)."""
        return self.direction[None]


@jit
def pose_error(s: Array, p_d: Array, r_d: Array, lever: float) -> tuple[Array, Array]:
    """Pose error (p - p_d, 2 lever Im(r r_d*)) [m, rad times `lever`], and its gradient.

    `s` (7,) are the coordinates of a `Point` and a `Rotation`, p (3,) and r (4,), in which the error is affine. For
    small errors 2 Im(r r_d*) is the rotation vector from r_d to r [rad].

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


@jit
def held(s: Array, a: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Return the pose error (6,) from p_d = a[:3] and r_d = a[3:], and its gradient (6, 7)."""
    e, gradient = pose_error(s, a[:3], a[3:], 1.0)
    return e, gradient, np.zeros(6)


@dataclass(frozen=True, kw_only=True)
class FrameHeld(Live, Constraint):
    """Pose error of a frame, six rows: p - p_d [m] and 2 Im(r r_d*), for small errors the rotation vector [rad].

    As an equality it holds the frame at the pose.
    """

    frame: str
    pose: Array
    """x_d in the base frame, until `hold` replaces it, shape (8,)."""
    function = held

    def hold(self, place: Array) -> None:
        """Hold the frame at another place (7,), position [m] and unit quaternion, from the next state on."""
        self.parameters[:] = place

    @property
    def watches(self) -> tuple[Feature, ...]:
        """Position and orientation of the frame."""
        return (Point(self.frame), Rotation(self.frame))

    @cached_property
    def parameters(self) -> Array:
        """Position and orientation, shape (7,)."""
        return np.array([*DQ(self.pose).translation(), *self.pose[:4]])

    def row_names(self, joint_names: tuple[str, ...]) -> tuple[str, ...]:
        """One name per axis, translation first."""
        return tuple(f"{self.name}/{axis}" for axis in range(6))


# ---------------------------------------------------------------------- joints


@jit
def below_maximum(q: Array, q_max: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Return q_max - q of (U12), shape (n,) [rad], and its gradient."""
    return q_max - q, -np.eye(q.shape[0]), np.zeros(q.shape[0])


@jit
def above_minimum(q: Array, q_min: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Return q - q_min of (U13), shape (n,) [rad], and its gradient."""
    return q - q_min, np.eye(q.shape[0]), np.zeros(q.shape[0])


class _OfAllJoints(Constraint):
    """A constraint with one row per joint [rad]."""

    watches = (JointAngles(),)
    unit = "rad"

    def row_names(self, joint_names: tuple[str, ...]) -> tuple[str, ...]:
        """One name per joint, such as ``joint_max/l_knee_y``."""
        return tuple(f"{self.name}/{joint}" for joint in joint_names)


@dataclass(frozen=True, kw_only=True)
class JointMaximum(_OfAllJoints):
    """Upper joint limits `q_max` (n,), (U12): q_max - q >= 0 [rad]."""

    q_max: Array
    function = below_maximum

    @property
    def parameters(self) -> Array:
        """The limits, shape (n,) [rad]."""
        return self.q_max


@dataclass(frozen=True, kw_only=True)
class JointMinimum(_OfAllJoints):
    """Lower joint limits `q_min` (n,), (U13): q - q_min >= 0 [rad]."""

    q_min: Array
    function = above_minimum

    @property
    def parameters(self) -> Array:
        """The limits, shape (n,) [rad]."""
        return self.q_min
