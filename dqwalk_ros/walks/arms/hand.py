"""A hand, and the pose that it follows."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.support.arrays import Array


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
    """Parameters of `tasks.HandInTrunk`, shape (14,)."""

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
