"""Footprints: planar poses of soles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.support.arrays import Array


@dataclass(frozen=True)
class Footprint:
    """A planar pose on level ground, SE(2) as complex numbers: real part ahead, imaginary part to the left.

    A rotation is a product with a number of absolute value one.
    """

    place: complex = 0.0
    """Position [m]."""
    ahead: complex = 1.0
    """Direction, of absolute value one."""

    @classmethod
    def of(cls, x: Array) -> Self:
        """Return the projection of a pose (8,) to the ground."""
        a, b, c, d = x[:4].tolist()
        p, ahead = DQ(x).translation(), complex(a * a + b * b - c * c - d * d, 2.0 * (b * c + a * d))
        return cls(complex(p[0], p[1]), ahead / abs(ahead))

    @property
    def pose(self) -> Array:
        """Pose of a sole that stands on it, shape (8,)."""
        half = self.ahead**0.5
        return DQ.from_pose([self.place.real, self.place.imag, 0.0], [half.real, 0.0, 0.0, half.imag]).vec8()

    def then(self, other: Footprint) -> Footprint:
        """Return the footprint `other`, given relative to this one, in the frame of this one's coordinates."""
        return Footprint(self.place + self.ahead * other.place, self.ahead * other.ahead)

    def points(self, p: Array) -> Array:
        """Return the points `p` (..., 2), given relative to this footprint, in the frame of its coordinates [m]."""
        x, y = p[..., 0], p[..., 1]
        out = np.empty(p.shape)
        out[..., 0] = self.place.real + self.ahead.real * x - self.ahead.imag * y
        out[..., 1] = self.place.imag + self.ahead.imag * x + self.ahead.real * y
        return out


def flat(x: Array, height: float = 0.0) -> Array:
    """Return the pose (8,) with a height z [m] and vertical z axis that is nearest to `x` (8,)."""
    pose = Footprint.of(x).pose
    return (DQ.from_pose([0.0, 0.0, height]) * DQ(pose)).vec8() if height else pose
