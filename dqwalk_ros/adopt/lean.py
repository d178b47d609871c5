"""How the CoM of a robot moves sideways whose pelvis cannot, because no ankle rolls.

A waist moves it, or the trunk leans: it turns with the pelvis about the hip of the leg that stands, and the legs stay
upright.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dqwalk_ros.adopt.skeleton import Skeleton
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import X
from dqwalk_ros.paper.statics import GRAVITY

_ROLLS = 0.8
"""Least component along x of the axis of a hip joint that lets the pelvis lean."""
_SLOWER = 0.8
"""Frequency of the pendulum of such a robot, as a part of sqrt(g/h); that of Poppy, whose trunk leans, is 0.79."""


@dataclass(frozen=True)
class Lean:
    """A pelvis that leans."""

    lever: float
    """How far the CoM moves sideways per angle [m/rad]."""
    most: float
    """The largest angle to both sides that the hips allow [rad]."""

    @classmethod
    def of(cls, skeleton: Skeleton, legs: Mapping[Foot, Sequence[str]], hips: float) -> Lean:
        """Return it for legs whose `hips` are at this height in the skeleton [m]."""
        joints = {joint for leg in legs.values() for joint in leg}
        above = [body for body in skeleton.bodies if not joints & set(skeleton.way(body))]
        share = sum(map(skeleton.mass, above)) / sum(map(skeleton.mass, skeleton.bodies))
        ranges = []
        for leg in legs.values():
            rolls = [skeleton.joints[joint].limit for joint in leg if abs(skeleton.axis(joint) @ X) > _ROLLS]
            ranges.append(sum(max(0.0, min(-limit.lower, limit.upper)) for limit in rolls))
        return cls(share * float(skeleton.com(above)[2] - hips), min(ranges))

    def angle(self, apart: float, height: float, single: float) -> float:
        """Return by how much the trunk leans in a dynamic walk [rad].

        In a single support the CoM moves towards the sole that stands, and back, from the middle between the soles:
        with the distance p of both and c'' = w^2 (c - p), by p (1 - 1 / cosh(w T / 2)).

        Parameters
        ----------
        apart, height, single : float
            Distance of the soles and height of the CoM [m], duration T of the single support [s].
        """
        half = 0.5 * _SLOWER * math.sqrt(GRAVITY / height) * single
        moved = 0.5 * apart * (1.0 - 1.0 / math.cosh(half))
        return moved / self.lever if self.lever > 0.0 else math.inf


def waist_moves(skeleton: Skeleton, waist: Sequence[str]) -> float:
    """Return how far a waist can move the CoM sideways [m].

    The distances that its joints move the CoM are added, each with an angle of up to a right one within its limits.
    """
    moved = 0.0
    for joint in waist:
        carried = [body for body in skeleton.bodies if joint in skeleton.way(body)]
        share = sum(map(skeleton.mass, carried)) / sum(map(skeleton.mass, skeleton.bodies))
        axis, arm = skeleton.axis(joint), skeleton.com(carried) - skeleton.place(joint)
        across, back = np.cross(axis, arm)[1], np.cross(axis, np.cross(axis, arm))[1]
        limit = skeleton.joints[joint].limit
        ends = np.clip([limit.lower, limit.upper], -0.5 * np.pi, 0.5 * np.pi)
        moved += share * float(np.abs(np.sin(ends) * across + (1.0 - np.cos(ends)) * back).max())
    return moved
