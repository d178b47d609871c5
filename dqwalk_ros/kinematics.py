"""Kinematics seen from the support foot, sections 2.2, 3.4 and 3.5 [Urban2020].

The tree is re-rooted at the sole of one foot: the way from there to the pelvis is the reversed leg, whose joints
turn about their axes the other way. The swing foot's pose is then x_left* x_6^5 x_right of section 3.4 without a
special case, and the foot on the ground carries its part of (4) at rest.

A dual quaternion's derivative under a joint is half the product of the joint's line with it, so all Jacobians are
products with one array of lines.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqwalk_ros import kernels
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.model import Foot, RobotModel

__all__ = ["Kinematics", "Point", "Rooted", "pose_difference", "pose_difference_jacobian", "rooted"]

Array = NDArray[np.float64]

_ORIGIN = np.zeros(3)
_Z = np.array([0.0, 0.0, 1.0])


class Rooted:
    """The constants of a model seen from one sole; get it from `rooted`.

    Attributes
    ----------
    tree, links : ndarray, shapes (bodies, 2) and (bodies, 15)
        What `kernels.forward` asks for.
    size : int
        How many numbers it fills.
    frames : dict of str to (int, ndarray)
        Body and pose (8,) on it of every frame.
    moves : ndarray of bool, shape (bodies, n)
        Which joints move which body.
    """

    def __init__(self, model: RobotModel, base: Foot) -> None:
        sole = model.frames[model.soles[base].frame]
        count = len(model.bodies)
        # x_old[b]: pose of the model's body frame in the re-rooted body's frame, which begins at its joint
        x_old: dict[int, DQ] = {sole.body: DQ(sole.pose).conj()}
        order, parent, joint, origin, axis = [sole.body], [-1], [-1], [DQ(1.0)], [np.zeros(3)]

        def visit(body: int, via: int, index: int, x_joint: DQ, a: Array) -> None:
            order.append(body)
            parent.append(via)
            joint.append(index)
            origin.append(x_joint)
            axis.append(a)

        # the reversed leg, from the sole up to the model's root
        here = sole.body
        while model.bodies[here].parent >= 0:
            body = model.bodies[here]
            visit(body.parent, len(order) - 1, body.joint, x_old[here], -body.axis)
            x_old[body.parent] = DQ(body.origin).conj()
            here = body.parent
        # everything else hangs from it as in the model
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
        self.size = 8 * count + 9 * model.n + 3
        self.moves = np.zeros((count, model.n), dtype=np.bool_)
        for k in range(1, count):
            self.moves[k] = self.moves[parent[k]]
            self.moves[k, joint[k]] = True
        self.frames = {
            name: (place[frame.body], (x_old[frame.body] * DQ(frame.pose)).vec8())
            for name, frame in model.frames.items()
        }


_CACHE: dict[tuple[int, bool], tuple[RobotModel, Rooted]] = {}
_LEFT = Foot.LEFT


def rooted(model: RobotModel, base: Foot) -> Rooted:
    """Return the constants of `model` seen from the sole `base`, worked out once per model."""
    key = (id(model), base is _LEFT)  # hashing a Foot takes longer than everything else here
    entry = _CACHE.get(key)
    if entry is None or entry[0] is not model:
        entry = _CACHE[key] = (model, Rooted(model, base))
    return entry[1]


class Kinematics:
    """A read-only snapshot of the robot at `q`, in the frame of the sole `base`.

    Parameters
    ----------
    model : RobotModel
    q : array_like, shape (n,)
        Joint angles [rad].
    base : Foot
        The sole taken for the world: x forward, z up, ground at z = 0.
    up : array_like, shape (3,), optional
        Unit vector against gravity in the frame of the base sole; z, a level sole, without it.
    elapsed : float
        Time since the phase began [s], for what follows a path; without it the end of every path.

    Attributes
    ----------
    rooted : Rooted
        The constants of the model seen from `base`.
    values : ndarray
        What `kernels.forward` worked out, for compiled functions.
    finite : bool
        Whether every angle is a finite number.
    """

    __slots__ = ("base", "elapsed", "finite", "model", "q", "rooted", "up", "values")

    def __init__(
        self, model: RobotModel, q: ArrayLike, base: Foot, up: ArrayLike | None = None, elapsed: float = math.inf
    ) -> None:
        self.model = model
        self.base = base
        self.up = _Z if up is None else np.asarray(up, dtype=np.float64)
        self.elapsed = elapsed
        self.q: Array = np.asarray(q, dtype=np.float64)
        self.rooted = root = rooted(model, base)
        self.values = values = np.empty(root.size)
        self.finite: bool = kernels.forward(self.q, root.tree, root.links, values)

    def tilted(self, up: ArrayLike) -> Kinematics:
        """Return the same snapshot with gravity against `up` (3,), a unit vector in the frame of the base sole."""
        kin = copy.copy(self)
        kin.up = np.asarray(up, dtype=np.float64)
        return kin

    @property
    def _poses(self) -> Array:
        return self.values[: 8 * len(self.model.bodies)].reshape(-1, 8)

    @property
    def lines(self) -> Array:
        """The joints' Pluecker lines l, m, shape (n, 6); the joints of the reversed leg point the other way."""
        n = len(self.q)
        return self.values[-9 * n - 3 : -3 * n - 3].reshape(n, 6)

    @property
    def com(self) -> Array:
        """Centre of mass (4), the base foot's mass included, shape (3,) [m]."""
        end = len(self.values) - 3 * len(self.q)
        return self.values[end - 3 : end]

    @property
    def com_jacobian(self) -> Array:
        """J_CoM of (5), shape (3, n) [m/rad]."""
        n = len(self.q)
        return self.values[-3 * n :].reshape(3, n)

    @property
    def com_on_ground(self) -> Array:
        """Where the vertical through the CoM meets the plane of the base sole, shape (2,) [m]."""
        p: Array = self.com[:2] - self.com[2] * (self.up[:2] / self.up[2])
        return p

    @property
    def com_on_ground_jacobian(self) -> Array:
        """Jacobian of `com_on_ground` with the base sole at rest, shape (2, n) [m/rad]."""
        if self.up is _Z:
            return self.com_jacobian[:2]
        return self.com_jacobian[:2] - np.outer(self.up[:2] / self.up[2], self.com_jacobian[2])

    @property
    def swing(self) -> str:
        """Frame of the other sole."""
        return self.model.soles[self.base.other].frame

    def _at(self, frame: str) -> tuple[int, Array]:
        body, local = self.rooted.frames[frame]
        pose: Array = kernels.compose(self._poses[body], local)
        return body, pose

    def pose(self, frame: str) -> Array:
        """Pose of a frame, vec8 of a unit dual quaternion (1), shape (8,)."""
        return self._at(frame)[1]

    def pose_jacobian(self, frame: str) -> Array:
        """J with vec8(x') = J q', shape (8, n); for the other sole it is J_swing of section 3.4."""
        body, x = self._at(frame)
        J: Array = kernels.pose_jacobian(self.lines, self.rooted.moves[body], x)
        return J

    def rotation_jacobian(self, frame: str) -> Array:
        """J_r with vec4(r') = J_r q' (section 2.2), shape (4, n)."""
        return self.pose_jacobian(frame)[:4]

    def point(self, frame: str, offset: Array = _ORIGIN) -> Array:
        """Position of the point at `offset` (3,) in a frame, shape (3,) [m]."""
        p: Array = kernels.point(self._at(frame)[1], offset)
        return p

    def point_jacobian(self, frame: str, offset: Array = _ORIGIN) -> Array:
        """J_p with vec3(p') = J_p q' (section 2.2), shape (3, n) [m/rad]."""
        body, x = self._at(frame)
        J: Array = kernels.point_jacobian(self.lines, self.rooted.moves[body], kernels.point(x, offset))
        return J

    def direction(self, frame: str, v: Array) -> Array:
        """Direction `v` (3,) of a frame in the world, shape (3,)."""
        _, x = self._at(frame)
        d: Array = kernels.point(x, v) - kernels.point(x, _ORIGIN)
        return d

    def direction_jacobian(self, frame: str, v: Array) -> Array:
        """Jacobian of `direction`, shape (3, n)."""
        body, _ = self._at(frame)
        J: Array = kernels.line_jacobian(self.lines, self.rooted.moves[body], self.direction(frame, v))
        return J

    def angular_jacobian(self, frame: str) -> Array:
        """Angular velocity of a frame per joint velocity, in world axes, shape (3, n)."""
        body, _ = self.rooted.frames[frame]
        return np.where(self.rooted.moves[body], self.lines[:, :3].T, 0.0)


@dataclass(frozen=True)
class Point:
    """A point that moves with the robot: at `offset` in a frame, or the centre of mass where `frame` is empty."""

    frame: str = ""
    offset: Array = field(default_factory=lambda: _ORIGIN)

    def position(self, kin: Kinematics) -> Array:
        """Position in the base frame, shape (3,) [m]."""
        return kin.point(self.frame, self.offset) if self.frame else kin.com

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian of `position`, shape (3, n) [m/rad]."""
        return kin.point_jacobian(self.frame, self.offset) if self.frame else kin.com_jacobian


def pose_difference(x: Array, x_d: Array) -> Array:
    """Return p - p_d [m] and 2 Im(r r_d*) of two poses (8,), shape (6,): zero where they are the same."""
    a, b = DQ(x), DQ(x_d)
    r = (a.P() * b.P().conj()).vec4()
    sign = 1.0 if r[0] >= 0.0 else -1.0  # x and -x are the same pose
    return np.concatenate([a.translation() - b.translation(), 2.0 * sign * r[1:]])


def pose_difference_jacobian(kin: Kinematics, frame: str, x_d: Array) -> Array:
    """Jacobian of `pose_difference` of a frame to a pose at rest, shape (6, n)."""
    r = (DQ(kin.pose(frame)).P() * DQ(x_d).P().conj()).vec4()
    r = r if r[0] >= 0.0 else -r
    # r' = 1/2 w r, so (2 Im r)' = r_0 w - v x w
    v = r[1:]
    turn = r[0] * np.eye(3) - np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.concatenate([kin.point_jacobian(frame), turn @ kin.angular_jacobian(frame)])
