"""Features of the robot, such as a point or the CoM, and the quantities that are functions of them.

Tasks and constraints are quantities: errors and distances that are computed from the coordinates s of features, with
their gradient. The chain rule turns a gradient into a Jacobian: dd/dq = dd/ds ds/dq.

Each class names one compiled function, which is all that runs: of a feature it fills s and ds/dq, of a quantity it
returns d, dd/ds and the rate of d by time alone. A class of your own does the same; nothing else lists the classes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.paper.kinematics import (
    Bodies,
    Kinematics,
    SupportTree,
    direction,
    jacobian,
    multiply,
    on_ground,
    point,
    pose_jacobian,
    rotate,
)
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.by_address import (
    FLOAT,
    INTEGER,
    INTEGERS,
    MASK,
    MATRIX,
    NOTHING,
    TABLE,
    VECTOR,
    Record,
    Signature,
)
from dqwalk_ros.support.compiled import jit

_ORIGIN = np.zeros(3)

BODIES = Record(Bodies, VECTOR, VECTOR, MASK, MATRIX, MATRIX, VECTOR, MATRIX)
_FEATURE = Signature(NOTHING, BODIES, INTEGER, VECTOR, VECTOR, MATRIX)
QUANTITY = Signature((VECTOR, MATRIX, VECTOR), VECTOR, VECTOR, FLOAT)
"""Type of the functions of quantities: (s, parameters, elapsed) -> value, gradient, rate."""


# ---------------------------------------------------------------------- coordinates and their Jacobians


@jit
def _com(at: Bodies, body: int, local: Array, s: Array, J: Array) -> None:
    """Fill s with the CoM (3,) and J with its Jacobian (3, n)."""
    s[:], J[:] = at.com, at.com_jacobian


@jit
def _com_on_ground(at: Bodies, body: int, local: Array, s: Array, J: Array) -> None:
    """Fill s with the projection (2,) of the CoM along the vertical, and J (2, n)."""
    s[:] = on_ground(at.com, at.up)
    for i in range(2):
        J[i] = at.com_jacobian[i] - at.up[i] / at.up[2] * at.com_jacobian[2]


@jit
def _point(at: Bodies, body: int, local: Array, s: Array, J: Array) -> None:
    """Fill s with the point (3,) at `local` in the frame of the body, and J (3, n)."""
    s[:] = point(at.poses[body], local[:3])
    jacobian(at.lines, at.moves[body], s, 1.0, J)


@jit
def _direction(at: Bodies, body: int, local: Array, s: Array, J: Array) -> None:
    """Fill s with the direction (3,) `local` of the body, and J (3, n)."""
    rotate(at.poses[body], local[:3], s)
    jacobian(at.lines, at.moves[body], s, 0.0, J)


@jit
def _pose(at: Bodies, body: int, local: Array, s: Array, J: Array) -> None:
    """Fill s with the pose (8,) of the frame at `local` (8,) in that of the body, and J (8, n)."""
    multiply(at.poses[body], local, s)
    pose_jacobian(at.lines, at.moves[body], s, J)


@jit
def _rotation(at: Bodies, body: int, local: Array, s: Array, J: Array) -> None:
    """Fill s with the orientation (4,) of a frame, and J (4, n): the first half of `_pose`."""
    x, J_x = np.empty(8), np.empty((8, J.shape[1]))
    _pose(at, body, local, x, J_x)
    s[:], J[:] = x[:4], J_x[:4]


@jit
def _joint_angles(at: Bodies, body: int, local: Array, s: Array, J: Array) -> None:
    """Fill s with the joint angles (n,), and J with the identity (n, n)."""
    s[:], J[:] = at.q, 0.0
    for i in range(s.shape[0]):
        J[i, i] = 1.0


# ---------------------------------------------------------------------- features


@dataclass(frozen=True)
class Feature:
    """A quantity of the robot, such as a point or the CoM, whose coordinates tasks and constraints are functions of.

    `function` fills its coordinates s and their Jacobian, and `size` is their number; 0 stands for the number of
    joints.
    """

    function: ClassVar[Callable[..., None]]
    size: ClassVar[int] = 3

    def placed(self, tree: SupportTree) -> tuple[int, Array]:
        """Return the body it belongs to, and its pose (8,), offset (3,) or direction (3,) in the body's frame."""
        return 0, _ORIGIN

    def value(self, kin: Kinematics) -> Array:
        """Return the coordinates, shape (m,)."""
        return Observer([self], kin.tree)(kin)[0]

    def jacobian(self, kin: Kinematics) -> Array:
        """Return the Jacobian of the coordinates, shape (m, n)."""
        return Observer([self], kin.tree)(kin)[1]


class CenterOfMass(Feature):
    """The centre of mass; coordinates (3,) [m]."""

    function = _com


class CenterOfMassOnGround(Feature):
    """Intersection of the vertical through the CoM with the plane of the base sole; coordinates (2,) [m]."""

    function, size = _com_on_ground, 2


@dataclass(frozen=True)
class Point(Feature):
    """The point at `offset` (3,) in a frame; coordinates (3,) [m]."""

    frame: str
    offset: Array = field(default_factory=lambda: _ORIGIN)
    function = _point

    def placed(self, tree: SupportTree) -> tuple[int, Array]:
        """Return body, and the point in its frame (3,) [m]."""
        place = tree.frames[self.frame]
        return place.body, point(place.pose, self.offset)


@dataclass(frozen=True)
class Direction(Feature):
    """The direction `v` (3,) of a frame; coordinates (3,)."""

    frame: str
    v: Array
    function = _direction

    def placed(self, tree: SupportTree) -> tuple[int, Array]:
        """Return body, and the direction in its frame (3,)."""
        place = tree.frames[self.frame]
        return place.body, direction(place.pose, self.v)


@dataclass(frozen=True)
class Rotation(Feature):
    """The orientation r of a frame; coordinates vec4(r), (4,)."""

    frame: str
    function, size = _rotation, 4

    def placed(self, tree: SupportTree) -> tuple[int, Array]:
        """Return body, and the pose of the frame on it (8,)."""
        return tree.frames[self.frame][:2]


@dataclass(frozen=True)
class Pose(Feature):
    """The pose x of a frame; coordinates vec8(x), (8,). The Jacobian for the other sole is J_swing of section 3.4."""

    frame: str
    function, size = _pose, 8

    def placed(self, tree: SupportTree) -> tuple[int, Array]:
        """Return body, and the pose of the frame on it (8,)."""
        return tree.frames[self.frame][:2]


class JointAngles(Feature):
    """All joint angles; coordinates (n,) [rad]."""

    function, size = _joint_angles, 0


class Watched(NamedTuple):
    """Features in the form that compiled code evaluates."""

    functions: NDArray[np.int64]
    """Their compiled functions, shape (k,)."""
    places: NDArray[np.int64]
    """Their bodies, and the beginning and the end of their coordinates in s (m,), shape (k, 3)."""
    local: Array
    """Pose, offset or direction in the frame of the body, shape (k, 8)."""
    s: Array
    """Coordinates, which `observe` fills in, shape (m,)."""
    J: Array
    """Their Jacobian, too, shape (m, n)."""

    @classmethod
    def of(cls, watches: Iterable[Sequence[Feature]], tree: SupportTree) -> tuple[Self, list[slice]]:
        """Return the features that several quantities watch, in the frame of a sole, and the coordinates of each in s.

        A feature that several of them watch is computed once.
        """
        n = tree.moves.shape[1]
        made: list[tuple[Callable[..., None], int, int, tuple[float, ...]]] = []
        ends, columns = [0], []
        for features in watches:
            placed = [(type(one).function, one.size or n, *one.placed(tree)) for one in features]
            wanted = [(function, size, body, tuple(local.tolist())) for function, size, body, local in placed]
            count = len(wanted)
            at = next((k for k in range(len(made)) if made[k : k + count] == wanted), len(made))
            made[at : at + count] = wanted
            for _, size, *_ in made[len(ends) - 1 :]:
                ends.append(ends[-1] + size)
            columns.append(slice(ends[at], ends[at + count]))
        functions, _, bodies, parts = zip(*made, strict=True)
        local = np.array([(*part, *[0.0] * (8 - len(part))) for part in parts])
        places = np.array([*zip(bodies, ends[:-1], ends[1:], strict=True)])
        s, J = np.empty(ends[-1]), np.empty((ends[-1], n))
        return cls(_FEATURE.table(functions), places, local, s, J), columns

    def first(self, count: int) -> Self:
        """Return the first features, in the same memory."""
        end = int(self.places[count - 1, 2])
        return type(self)(self.functions[:count], self.places[:count], self.local[:count], self.s[:end], self.J[:end])


WATCHED = Record(Watched, INTEGERS, TABLE, MATRIX, VECTOR, MATRIX)
_call = _FEATURE.call


@jit
def observe(bodies: Bodies, watched: Watched) -> None:
    """Fill the coordinates s (m,) of features, and their Jacobian J (m, n)."""
    for k in range(watched.places.shape[0]):
        body, begin, end = watched.places[k]
        _call(watched.functions[k], bodies, body, watched.local[k], watched.s[begin:end], watched.J[begin:end])


class Observer:
    """Computes the stacked coordinates of features, and their Jacobian."""

    def __init__(self, features: Sequence[Feature], tree: SupportTree) -> None:
        self._given = features, tree
        self._watched, _ = Watched.of([features], tree)
        self.size = len(self._watched.s)

    def __call__(self, kin: Kinematics) -> tuple[Array, Array]:
        """Return the coordinates s (m,) and their Jacobian (m, n) for the joint angles of `kin`."""
        watched = self._watched._replace(s=np.empty_like(self._watched.s), J=np.empty_like(self._watched.J))
        observe(kin.bodies, watched)
        return watched.s, watched.J

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._given  # the addresses of functions are those of this process


# ---------------------------------------------------------------------- functions of features


@dataclass(frozen=True, kw_only=True)
class Quantity(ABC):
    """The error of a `Task` or distance of a `Constraint`: a function of the coordinates s of features, and of time."""

    name: str
    function: ClassVar[Callable[[Array, Array, float], tuple[Array, Array, Array]]]
    """Compiled function of the class: (s, parameters, elapsed) -> value (k,), gradient dvalue/ds (k, m), and rate (k,),
    the derivative by time for features at rest. Arrays are float64; `elapsed` is the time since the phase began [s]."""

    @property
    def watches(self) -> tuple[Feature, ...]:
        """Features whose stacked coordinates are s (m,); by default those among the fields, in their order."""
        values = (getattr(self, part.name) for part in fields(self))
        return tuple(value for value in values if isinstance(value, Feature))

    @property
    def parameters(self) -> Array:
        """Numbers that `function` takes, in its order, one-dimensional."""
        return np.empty(0)

    @property
    def live(self) -> Array | None:
        """The first of `parameters`, where the walk changes them during a phase; None if they are constant."""
        return None

    def evaluate(self, s: Array, elapsed: float = 0.0) -> tuple[Array, Array, Array]:
        """Return value, gradient and rate at s (m,)."""
        return type(self).function(np.array(s, dtype=np.float64), np.array(self.parameters, dtype=np.float64), elapsed)


class Live(Quantity):
    """A quantity all of whose parameters the walk may change with every state."""

    @property
    def live(self) -> Array:
        """All parameters."""
        return self.parameters


@jit
def affine(s: Array, a: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Return A s - b (k,), A (k, m), and -b'; `a` consists of b (k,), b' (k,) and A."""
    m = s.shape[0]
    k = a.shape[0] // (m + 2)
    A = a[2 * k :].reshape(k, m)
    return A @ s - a[:k], A, -a[k : 2 * k]


class Affine(Quantity):
    """A quantity that is affine in the coordinates of its features, A s - b, with constant A and b."""

    function = affine

    @property
    @abstractmethod
    def A(self) -> Array:
        """Gradient, shape (k, m)."""

    @property
    def b(self) -> Array | float:
        """Offset, shape (k,), or one number for all rows."""
        return 0.0

    @cached_property
    def parameters(self) -> Array:
        """Offset, its derivative by time, which is zero, and gradient, shape (2 k + k m,)."""
        A: Any = self.A
        zero = np.zeros(len(A))
        return np.concatenate([zero + self.b, zero, np.ravel(A)])
