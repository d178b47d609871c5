"""Static joint torques of a robot on one or two soles: compensation of gravity, or of any force at the CoM."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics, direction
from dqwalk_ros.support.arrays import Array, Mask
from dqwalk_ros.support.compiled import jit

__all__ = ["GRAVITY", "borne_by_other", "gravity_torques", "ground_torques", "share"]


GRAVITY = 9.80665
"""[m/s^2]"""


def gravity_torques(kin: Kinematics, *, both: bool) -> Array:
    """Return the joint torques (n,) [N m] that compensate gravity; see `ground_torques`."""
    return ground_torques(kin, kin.model.mass * GRAVITY * kin.up, kin.com_on_ground, both=both)


def ground_torques(
    kin: Kinematics, force: Array, pressure: Array, *, both: bool, at: Mapping[Foot, Array] | None = None
) -> Array:
    """Return the joint torques for which the ground applies a given force at the CoM, shape (n,) [N m].

    With both feet on the ground the other sole carries the fraction w of the force F at a point p_o, the base sole the
    fraction 1 - w at p_b, and both the same fractions of the remaining moment m. The fraction w is the position of the
    centre of pressure between the points `at`, and p_o and p_b are as far ahead of these as the centre of pressure is.
    By virtual work, with the base sole at rest,

        tau = F.J_CoM - w (F.J_po + m.J_omega),    m = (c - (1 - w) p_b - w p_o) x F

    Parameters
    ----------
    kin : Kinematics
    force : ndarray, shape (3,)
        Force of the ground on the robot, including the reaction to its weight [N].
    pressure : ndarray, shape (2,)
        Centre of pressure on the ground [m].
    both : bool
        Whether both feet are on the ground.
    at : mapping of Foot to ndarray, shape (3,), optional
        Point of each sole, in its frame, on which it carries all of the force [m]; by default its centre.
    """
    tau: Array = force @ kin.com_jacobian
    if both:
        base, other = (kin.model.soles[foot] for foot in (kin.base, kin.base.other))
        a, b = (base.center, other.center) if at is None else (at[kin.base], at[kin.base.other])
        b, moves = kin.point(other.frame, b), kin.tree.moves[kin.tree.frames[other.frame][0]]
        x_other, half = kin.pose(other.frame), 0.5 * min(base.length, other.length)
        tau -= borne_by_other(force, pressure, kin.com, a, b, half, x_other, kin.lines, moves)
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
def borne_by_other(
    force: Array, pressure: Array, com: Array, a: Array, b: Array, half: float, x_other: Array, lines: Array,
    moves: Mask,
) -> Array:  # fmt: skip
    """Return w (F.J_po + m.J_omega) of `ground_torques`, shape (n,) [N m].

    `a` and `b` (3,) are the points `at` of the base sole and of the other sole, `half` is half of their length [m],
    `x_other` (8,) the pose of the other sole, and `moves` (n,) the joints that move it.
    """
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
