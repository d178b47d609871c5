"""Static joint torques of a robot on one or two soles: compensation of gravity, or of any force at the CoM."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics, compose, direction, point, support_tree
from dqwalk_ros.support.arrays import Array, Mask
from dqwalk_ros.support.by_address import BOOLEAN, BOOLEANS, FLOAT, INTEGER, VECTOR, Record
from dqwalk_ros.support.compiled import jit

if TYPE_CHECKING:
    from dqwalk_ros.robot.model import RobotModel

GRAVITY = 9.80665
"""[m/s^2]"""


class Soles(NamedTuple):
    """The soles that carry the robot."""

    both: bool
    """Whether both soles are on the ground; otherwise the base sole is."""
    at: Array
    at_other: Array
    """Point of the base sole and of the other one, each in the frame of its sole, on which it carries all of the force,
    shape (3,) [m]."""
    half: float
    """Half of the length of the shorter sole [m]."""
    body: int
    pose: Array
    moves: Mask
    """`Place` of the other sole."""

    @classmethod
    def of(cls, model: RobotModel, base: Foot, *, both: bool, at: Mapping[Foot, Array] | None = None) -> Self:
        """Return the soles of a robot; by default the points are their centres."""
        sole, other = model.soles[base], model.soles[base.other]
        points = (sole.center, other.center) if at is None else (at[base], at[base.other])
        body, pose, moves = support_tree(model, base).frames[other.frame]
        return cls(both, *points, 0.5 * min(sole.length, other.length), body, pose, moves)


SOLES = Record(Soles, BOOLEAN, VECTOR, VECTOR, FLOAT, INTEGER, VECTOR, BOOLEANS)


def gravity_torques(kin: Kinematics, *, both: bool) -> Array:
    """Return the joint torques (n,) [N m] that compensate gravity, on both soles or on the base sole."""
    force, soles = kin.model.mass * GRAVITY * kin.up, Soles.of(kin.model, kin.base, both=both)
    tau: Array = ground_torques(force, kin.com_on_ground, kin.com, kin.com_jacobian, kin.lines, kin.poses, soles)
    return tau


@jit
def ground_torques(
    force: Array, pressure: Array, com: Array, J_com: Array, lines: Array, poses: Array, soles: Soles
) -> Array:
    """Return the joint torques for which the ground applies a given force at the CoM, shape (n,) [N m].

    With both feet on the ground the other sole carries the fraction w of the force F at a point p_o, the base sole the
    fraction 1 - w at p_b, and both the same fractions of the remaining moment m. The fraction w is the position of the
    centre of pressure between the points `at`, and p_o and p_b are as far ahead of these as the centre of pressure is.
    By virtual work, with the base sole at rest,

        tau = F.J_CoM - w (F.J_po + m.J_omega),    m = (c - (1 - w) p_b - w p_o) x F

    Parameters
    ----------
    force : ndarray, shape (3,)
        Force of the ground on the robot, including the reaction to its weight [N].
    pressure : ndarray, shape (2,)
        Centre of pressure on the ground [m].
    com, J_com, lines, poses : ndarray
        Those of `Kinematics`.
    """
    tau = force @ J_com
    if soles.both:
        tau -= _borne_by_other(force, pressure, com, lines, poses, soles)
    return tau


@jit
def share(pressure: Array, a: Array, b: Array) -> float:
    """Return the fraction of the load at the point `b` (3,) of a sole; that at `a` (3,) carries the rest.

    It is the position of the projected `pressure` (2,) on the line from `a` (0) to `b` (1), clipped to [0, 1].
    """
    x, y = b[0] - a[0], b[1] - a[1]
    w = ((pressure[0] - a[0]) * x + (pressure[1] - a[1]) * y) / (x * x + y * y)
    return float(min(max(w, 0.0), 1.0))


@jit
def _borne_by_other(force: Array, pressure: Array, com: Array, lines: Array, poses: Array, soles: Soles) -> Array:
    """Return w (F.J_po + m.J_omega) of `ground_torques`, shape (n,) [N m]."""
    x_other = compose(poses[soles.body], soles.pose)
    a, b, half, moves = soles.at, point(x_other, soles.at_other), soles.half, soles.moves
    w = share(pressure, a, b)
    offset = pressure - a[:2] - w * (b - a)[:2]
    ahead_a, ahead_b = np.array([1.0, 0.0, 0.0]), direction(x_other, np.array([1.0, 0.0, 0.0]))
    p_a = a + min(max(offset[0], -half), half) * ahead_a
    p_b = b + min(max(offset[0] * ahead_b[0] + offset[1] * ahead_b[1], -half), half) * ahead_b
    m = np.cross(com - (1.0 - w) * p_a - w * p_b, force)
    tau = np.zeros(lines.shape[0])
    for i in range(lines.shape[0]):
        if moves[i]:
            line = lines[i]
            for k in range(3):
                i1, i2 = (k + 1) % 3, (k + 2) % 3
                tau[i] += force[k] * (line[i1] * p_b[i2] - line[i2] * p_b[i1] + line[3 + k]) + m[k] * line[k]
    tau *= w
    return tau
