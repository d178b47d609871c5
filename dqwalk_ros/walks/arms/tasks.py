"""The tasks of the arms: joints that follow angles and the legs, and hands that follow poses in the trunk."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.features import Affine, Direction, Feature, Live, Point
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.tasks import Task
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit


@dataclass(frozen=True, kw_only=True)
class Beside(Live, Affine, Task):
    """Task e = A s - b of which all numbers may change with every state."""

    features: tuple[Feature, ...]
    """With m coordinates s."""
    numbers: Array
    """b, its derivative by time, and the rows of A, shape (k (m + 2),)."""
    size: int
    """Number k of errors."""

    @property
    def watches(self) -> tuple[Feature, ...]:
        """The features."""
        return self.features

    @property
    def parameters(self) -> Array:
        """The numbers."""
        return self.numbers

    @property
    def A(self) -> Array:
        """The present gradient, shape (k, m)."""
        return parts(self.numbers, self.size)[2]


def parts(numbers: Array, size: int) -> tuple[Array, Array, Array]:
    """Return views of b (k,), its derivative (k,) and A (k, m) of the numbers of `Beside`."""
    return numbers[:size], numbers[size : 2 * size], numbers[2 * size :].reshape(size, -1)


@jit
def _hand_in_trunk(s: Array, a: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Return the error (9,) of a hand in its trunk [m], its gradient (9, 21), and minus the rate of the target (9,).

    `s` (21,) are position and first two axes of the hand, origin and axes l_k of the trunk. The errors are
    l_k . (p - o) - p_k, and those of the two axes times a lever. `a` (14,) are the desired position and axes in the
    trunk, the velocity of that position, the lever, and 1, or 0 for no task.
    """
    w, lever, on = s[:3] - s[9:12], a[12], a[13]
    e, G, rate = np.zeros(9), np.zeros((9, 21)), np.zeros(9)
    for k in range(3):
        at = 12 + 3 * k
        axis = s[at : at + 3]
        e[k] = on * (axis @ w - a[k])
        G[k, :3], G[k, 9:12], G[k, at : at + 3] = on * axis, -on * axis, on * w
        rate[k] = -on * a[9 + k]
        for j in range(2):
            row, own = 3 + 3 * j + k, 3 + 3 * j
            of_hand = s[own : own + 3]
            e[row] = on * lever * (axis @ of_hand - a[own + k])
            G[row, own : own + 3], G[row, at : at + 3] = on * lever * axis, on * lever * of_hand
    return e, G, rate


@dataclass(frozen=True, kw_only=True)
class HandInTrunk(Live, Task):
    """Task that a hand follows a pose in the trunk, which may change with every state."""

    hand: str
    trunk: str
    """Links."""
    numbers: Array
    """Parameters of `_hand_in_trunk`, shape (14,)."""
    function = _hand_in_trunk

    @property
    def parameters(self) -> Array:
        """The numbers."""
        return self.numbers

    @property
    def watches(self) -> tuple[Feature, ...]:
        """Position and two axes of the hand, position and three axes of the trunk."""
        of_hand = (Direction(self.hand, axis) for axis in np.eye(3)[:2])
        return Point(self.hand), *of_hand, Point(self.trunk), *(Direction(self.trunk, axis) for axis in np.eye(3))


@dataclass(eq=False)
class Hand:
    """A hand, and the pose that it follows."""

    link: str
    trunk: str
    """Link that carries the arm."""
    joints: NDArray[np.intp]
    """Which of the joints of `Arms` move the hand against the trunk, shape (k,)."""
    pose: DQ | None = None
    """The pose it follows, in the trunk or, if `fixed`, in the base sole; None without a command."""
    fixed: bool = False
    since: float = math.nan
    """Time of the first state after the command [s]."""
    numbers: Array = field(default_factory=lambda: np.zeros(14))
    """Parameters of `HandInTrunk`, shape (14,)."""

    def set(self, kin: Kinematics, dq: Array | None, lever: float) -> None:
        """Set the task for a state with the joint velocities `dq` (n,) [rad/s].

        A pose on the ground moves in the trunk, with the velocity that its point of the trunk has, reversed.
        """
        self.numbers[:] = 0.0
        if self.pose is None:
            return
        trunk = DQ(kin.pose(self.trunk))
        x = trunk.conj() * self.pose if self.fixed else self.pose
        p = x.translation()
        self.numbers[:9] = *p, *x.rotation_matrix().T[:2].ravel()
        if self.fixed and dq is not None:
            self.numbers[9:12] = -trunk.rotation_matrix().T @ kin.point_jacobian(self.trunk, p) @ dq
        self.numbers[12:] = lever, 1.0

    def distance(self, kin: Kinematics) -> float:
        """Return the distance of the hand from its position [m]."""
        p = DQ(kin.pose(self.trunk)).conj().transform_point(kin.point(self.link))
        return float(np.linalg.norm(p - self.numbers[:3]))
