"""Kinematics seen from the support foot, sections 2.2, 3.4 and 3.5 [Urban2020].

The kinematic tree is re-rooted at the sole of one foot, the base: the chain from there to the pelvis is that leg
reversed, whose joints turn about the opposite axes. The swing foot's pose is then x_left* x_6^5 x_right of section 3.4
without a special case, and the base foot contributes to (U4) as a body at rest.

The axis of a joint is a line l + eps m in the base frame. The joint turns all bodies after it about this line, so every
Jacobian is a product with the lines: x' = 1/2 (l + eps m) x q' of a pose, p' = (l x p + m) q' of a point,
v' = (l x v) q' of a direction.

Tasks and constraints are functions of features of the robot, such as a point or the CoM, which `features` computes from
the poses and the lines.
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqwalk_ros.paper.dual_quaternions import DQ, product
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import Z
from dqwalk_ros.support.arrays import Array, Mask
from dqwalk_ros.support.by_address import BOOLEANS, INTEGER, VECTOR, Record
from dqwalk_ros.support.compiled import jit

if TYPE_CHECKING:
    from dqwalk_ros.robot.model import RobotModel

_ORIGIN = np.zeros(3)


class Bodies(NamedTuple):
    """What the features of the robot are computed from, in the base frame."""

    q: Array
    """Joint angles, shape (n,) [rad]."""
    up: Array
    """Unit vector against gravity, shape (3,)."""
    moves: Mask
    """Whether a joint moves a body, shape (b, n)."""
    poses: Array
    """Poses of the bodies, shape (b, 8)."""
    lines: Array
    """Lines (l, m) of the joint axes, shape (n, 6)."""
    com: Array
    """Centre of mass, shape (3,) [m]."""
    com_jacobian: Array
    """Shape (3, n) [m/rad]."""


class Place(NamedTuple):
    """Where a frame is in a tree: its body, its pose (8,) in the frame of the body, and which joints (n,) move it.

    Compiled functions that Python calls take such records as plain tuples, which numba reads in a third of the time.
    """

    body: int
    pose: Array
    moves: Mask


PLACE = Record(Place, INTEGER, VECTOR, BOOLEANS)


# ---------------------------------------------------------------------- compiled functions

quaternion_product = jit(product)


@jit
def multiply(a: Array, b: Array, out: Array) -> None:
    """Fill `out` with the product of dual quaternions (8,): P(a)P(b) + eps (P(a)D(b) + D(a)P(b))."""
    out[0], out[1], out[2], out[3] = quaternion_product(a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3])
    s = quaternion_product(a[0], a[1], a[2], a[3], b[4], b[5], b[6], b[7])
    t = quaternion_product(a[4], a[5], a[6], a[7], b[0], b[1], b[2], b[3])
    for k in range(4):
        out[4 + k] = s[k] + t[k]


@jit
def rotate(x: Array, v: Array, out: Array) -> None:
    """Fill `out` (3,) with P(x) v P(x)*: the direction v (3,) of the frame x (8,) in the base frame."""
    s = quaternion_product(x[0], x[1], x[2], x[3], 0.0, v[0], v[1], v[2])
    t = quaternion_product(s[0], s[1], s[2], s[3], x[0], -x[1], -x[2], -x[3])
    out[0], out[1], out[2] = t[1], t[2], t[3]


@jit
def _translation(x: Array, out: Array) -> None:
    """Fill `out` (3,) with the position p = 2 D(x) P(x)* of the pose x = r + eps 1/2 p r (U1)."""
    t = quaternion_product(x[4], x[5], x[6], x[7], x[0], -x[1], -x[2], -x[3])
    out[0], out[1], out[2] = 2.0 * t[1], 2.0 * t[2], 2.0 * t[3]  # (U1)


@jit
def jacobian_column(line: Array, p: Array, factor: float, out: Array) -> None:
    """Fill `out` (3,) with l x p + factor m: the derivative of `p` (3,) with respect to the joint on the line (6,).

    The factor is 1 for a point and 0 for a direction. For a mass-weighted sum of points it is the sum of the weights.
    """
    out[0] = line[1] * p[2] - line[2] * p[1] + factor * line[3]
    out[1] = line[2] * p[0] - line[0] * p[2] + factor * line[4]
    out[2] = line[0] * p[1] - line[1] * p[0] + factor * line[5]


@jit
def forward(
    q: Array, tree: NDArray[np.int64], links: Array, poses: Array, lines: Array, p_com: Array, J_com: Array
) -> bool:
    """Fill poses (b, 8), joint lines (n, 6), the CoM (3,) of (U4) and its Jacobian (3, n) of (U5).

    Return whether all joint angles q (n,) are finite. Parents come before children, body 0 is at rest; the columns of
    `tree` (b, 2) are parent and joint, those of `links` (b, 15) origin (8), axis (3), mass divided by the total, and
    centre of mass (3).
    """
    count = tree.shape[0]
    half, x, p, c = np.zeros(8), np.empty(8), np.empty(3), np.empty(3)
    subtree = np.empty((count, 4))  # over a body and all bodies after it: sum of m_k p_ck / M, and of m_k / M
    poses[0, :] = 0.0
    poses[0, 0] = 1.0
    for b in range(count):
        link, pose = links[b], poses[b]
        if b > 0:
            i = tree[b, 1]
            multiply(poses[tree[b, 0]], link[:8], x)
            half[0], sine = math.cos(0.5 * q[i]), math.sin(0.5 * q[i])
            for k in range(3):
                half[1 + k] = sine * link[8 + k]
            multiply(x, half, pose)
            line = lines[i]
            rotate(pose, link[8:11], line[:3])  # l
            _translation(pose, p)
            line[3] = p[1] * line[2] - p[2] * line[1]  # m = p x l
            line[4] = p[2] * line[0] - p[0] * line[2]
            line[5] = p[0] * line[1] - p[1] * line[0]
        _translation(pose, p)
        rotate(pose, link[12:15], c)
        for k in range(3):
            subtree[b, k] = link[11] * (p[k] + c[k])  # (U2): the CoM of a body is the translation of x_i x_ci^i
        subtree[b, 3] = link[11]
    for b in range(count - 1, 0, -1):
        i = tree[b, 1]
        subtree[tree[b, 0]] += subtree[b]
        # (U5): the joint moves the masses after it, 1/M sum m_k (l x p_ck + m)
        jacobian_column(lines[i], subtree[b], subtree[b, 3], J_com[:, i])
    p_com[:] = subtree[0, :3]  # (U4): 1/M sum m_i p_ci
    finite = True
    for i in range(q.shape[0]):
        finite = finite and math.isfinite(q[i])
    return finite


@jit
def compose(a: Array, b: Array) -> Array:
    """Return the product of two dual quaternions (8,)."""
    out = np.empty(8)
    multiply(a, b, out)
    return out


@jit
def point(x: Array, offset: Array) -> Array:
    """Return the point (3,) at `offset` (3,) [m] in the frame `x` (8,), in the base frame."""
    p, c = np.empty(3), np.empty(3)
    _translation(x, p)
    rotate(x, offset, c)
    return p + c


@jit
def direction(x: Array, v: Array) -> Array:
    """Return the direction `v` (3,) of the frame `x` (8,), in the base frame."""
    out = np.empty(3)
    rotate(x, v, out)
    return out


@jit
def point_at(poses: Array, body: int, pose: Array, offset: Array) -> Array:
    """Return the point (3,) at `offset` (3,) [m] in the frame at a `Place`; `poses` (b, 8) are those of the bodies."""
    p: Array = point(compose(poses[body], pose), offset)
    return p


@jit
def direction_at(poses: Array, body: int, pose: Array, v: Array) -> Array:
    """Return the direction `v` (3,) of the frame at a `Place`; `poses` (b, 8) are those of the bodies."""
    d: Array = direction(compose(poses[body], pose), v)
    return d


@jit
def jacobian(lines: Array, moves: Mask, p: Array, factor: float, J: Array) -> None:
    """Fill J (3, n) with the columns l x p + m of the joints that move the point `p` (3,); l x p for a direction."""
    J[:] = 0.0
    for i in range(lines.shape[0]):
        if moves[i]:
            jacobian_column(lines[i], p, factor, J[:, i])


@jit
def pose_jacobian(lines: Array, moves: Mask, x: Array, J: Array) -> None:
    """Fill J (8, n) with the columns 1/2 H-8(x) vec8(l + eps m) (U3) of the joints that move the frame `x` (8,)."""
    J[:] = 0.0
    line, column = np.zeros(8), np.empty(8)
    for i in range(lines.shape[0]):
        if moves[i]:
            for k in range(3):
                line[1 + k], line[5 + k] = 0.5 * lines[i, k], 0.5 * lines[i, 3 + k]  # (U3)
            multiply(line, x, column)
            J[:, i] = column


@jit
def on_ground(v: Array, up: Array) -> Array:
    """Return the projection (2,) of a vector (3,) along the vertical `up` (3,) to the plane z = 0 of the base sole."""
    projection: Array = v[:2] - up[:2] / up[2] * v[2]
    return projection


# ---------------------------------------------------------------------- the tree rooted at a sole


class SupportTree:
    """The kinematic tree of a model re-rooted at one sole: constants only; `support_tree` returns it.

    Attributes
    ----------
    tree : ndarray of int, shape (bodies, 2)
        Parent body and joint of every body, parents first.
    links : ndarray, shape (bodies, 15)
        Origin (8), axis (3), mass as a fraction of the total, and centre of mass (3) of every body.
    frames : dict of str to Place
        Place of every frame.
    swing : str
        Name of the frame of the other sole.
    moves : ndarray of bool, shape (bodies, n)
        Whether a joint moves a body.
    """

    def __init__(self, model: RobotModel, base: Foot) -> None:
        sole = model.frames[model.soles[base].frame]
        count = len(model.bodies)
        # x_old[b]: pose of the model's body frame in the frame of the re-rooted body, whose origin is at its joint
        x_old: dict[int, DQ] = {sole.body: DQ(sole.pose).conj()}
        order, parent, joint, origin, axis = [sole.body], [-1], [-1], [DQ(1.0)], [np.zeros(3)]

        def visit(body: int, via: int, index: int, x_joint: DQ, a: Array) -> None:
            order.append(body)
            parent.append(via)
            joint.append(index)
            origin.append(x_joint)
            axis.append(a)

        # the reversed leg, from the sole up to the model's root
        for child in model.chain(sole.body)[:0:-1]:
            body = model.bodies[child]
            visit(body.parent, len(order) - 1, body.joint, x_old[child], -body.axis)
            x_old[body.parent] = DQ(body.origin).conj()
        # all other bodies keep the parent that they have in the model
        for b, body in enumerate(model.bodies):
            if b not in x_old:
                x_old[b] = DQ(1.0)
                visit(b, order.index(body.parent), body.joint, x_old[body.parent] * DQ(body.origin), body.axis)

        place = {b: k for k, b in enumerate(order)}
        self.tree = np.array([parent, joint], dtype=np.int64).T.copy()
        self.links = np.array(
            [
                [*x.vec8(), *a, model.bodies[b].mass / model.mass, *x_old[b].transform_point(model.bodies[b].com)]
                for x, a, b in zip(origin, axis, order, strict=True)
            ]
        )
        self.moves = np.zeros((count, model.n), dtype=np.bool_)
        for k in range(1, count):
            self.moves[k] = self.moves[parent[k]]
            self.moves[k, joint[k]] = True
        self.frames = {
            name: Place(k := place[frame.body], (x_old[frame.body] * DQ(frame.pose)).vec8(), self.moves[k])
            for name, frame in model.frames.items()
        }
        self.swing = model.soles[base.other].frame


@functools.lru_cache(maxsize=16)
def support_tree(model: RobotModel, base: Foot) -> SupportTree:
    """Return the tree of `model` re-rooted at the sole `base`; computed once per model and foot."""
    return SupportTree(model, base)


class Kinematics:
    """Poses, CoM and Jacobians of the robot at the joint angles `q`, in the frame of the sole `base`.

    Parameters
    ----------
    q : array_like, shape (n,)
        Joint angles [rad].
    base : Foot
        The foot whose sole is the base frame: x forward, z up, ground at z = 0.
    up : array_like, shape (3,), optional
        Unit vector against gravity in the base frame; by default z, a level sole.

    Attributes
    ----------
    tree : SupportTree
        The model's tree re-rooted at the sole `base`.
    poses : ndarray, shape (bodies, 8)
        Poses of all bodies of the tree.
    lines : ndarray, shape (n, 6)
        Pluecker lines (l, m) of the joint axes; those of the reversed leg have the opposite direction.
    com : ndarray, shape (3,)
        Centre of mass (U4), including the base foot [m].
    com_jacobian : ndarray, shape (3, n)
        J_CoM of (U5) [m/rad].
    finite : bool
        Whether all joint angles are finite.
    """

    def __init__(self, model: RobotModel, q: ArrayLike, base: Foot, up: ArrayLike | None = None) -> None:
        self.model = model
        self.base = base
        self.tree = tree = support_tree(model, base)
        self.q: Array = np.array(q, dtype=np.float64)
        self.up: Array = Z if up is None else np.array(up, dtype=np.float64)
        n = self.q.shape[0]
        self.poses, self.lines = np.empty((tree.tree.shape[0], 8)), np.empty((n, 6))
        self.com, self.com_jacobian = np.empty(3), np.empty((3, n))
        self.finite: bool = forward(self.q, tree.tree, tree.links, self.poses, self.lines, self.com, self.com_jacobian)

    @classmethod
    def measured(cls, model: RobotModel, q: ArrayLike, base: Foot, vertical: Array | None) -> Kinematics:
        """Return the kinematics at `q` with the vertical (3,) that the inertial sensor measures in its frame.

        Without a sensor (None) the base sole is assumed to be level.
        """
        kin = cls(model, q, base)
        if vertical is not None:
            kin.up = kin.direction(model.imu, vertical)
        return kin

    @property
    def bodies(self) -> Bodies:
        """What features are computed from."""
        return Bodies(self.q, self.up, self.tree.moves, self.poses, self.lines, self.com, self.com_jacobian)

    @property
    def com_on_ground(self) -> Array:
        """Intersection of the vertical through the CoM with the plane of the base sole, shape (2,) [m]."""
        c: Array = on_ground(self.com, self.up)
        return c

    @property
    def swing(self) -> str:
        """Name of the frame of the other sole."""
        return self.tree.swing

    def pose(self, frame: str) -> Array:
        """Pose of a frame, vec8 of a unit dual quaternion (U1), shape (8,); KeyError if the model has no such frame."""
        place = self.tree.frames[frame]
        x: Array = compose(self.poses[place.body], place.pose)
        return x

    def point(self, frame: str, offset: Array = _ORIGIN) -> Array:
        """Position of the point at `offset` (3,) in a frame, shape (3,) [m]."""
        body, pose, _ = self.tree.frames[frame]
        p: Array = point_at(self.poses, body, pose, offset)
        return p

    def point_jacobian(self, frame: str, offset: Array = _ORIGIN) -> Array:
        """J_p with vec3(p') = J_p q' (section 2.2), shape (3, n) [m/rad]."""
        J = np.empty((3, len(self.q)))
        jacobian(self.lines, self.tree.frames[frame].moves, self.point(frame, offset), 1.0, J)
        return J

    def direction(self, frame: str, v: Array) -> Array:
        """Direction `v` (3,) of a frame, in the base frame, shape (3,)."""
        body, pose, _ = self.tree.frames[frame]
        d: Array = direction_at(self.poses, body, pose, v)
        return d

    def angular_jacobian(self, frame: str) -> Array:
        """Jacobian of the angular velocity of a frame, in axes of the base frame, shape (3, n)."""
        return np.where(self.tree.frames[frame].moves, self.lines[:, :3].T, 0.0)
