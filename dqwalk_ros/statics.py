"""The joint torques that hold a standing robot against gravity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.compiled import jit
from dqwalk_ros.kinematics import Kinematics, direction

__all__ = ["GRAVITY", "borne_by_other", "gravity_torques", "ground_torques", "share"]

Array = NDArray[np.float64]

GRAVITY = 9.80665
"""[m/s^2]"""


def gravity_torques(kin: Kinematics, *, both: bool) -> Array:
    """Return the joint torques (n,) [N m] that hold the robot against gravity; see `ground_torques`."""
    return ground_torques(kin, kin.model.mass * GRAVITY * kin.up, kin.com_on_ground, both=both)


def ground_torques(kin: Kinematics, force: Array, pressure: Array, *, both: bool) -> Array:
    """Return the joint torques by which the ground bears a force at the CoM, shape (n,) [N m].

    With both feet on the ground the other sole bears the part w of the force F at a point p_o, the base sole the rest
    at p_b, and each its part of the moment m that is left; w is where the pressure is on the way from sole to sole, and
    both points are as far ahead of the soles' centres as the pressure is. By virtual work, with the base sole at rest,

        tau = F.J_CoM - w (F.J_po + m.J_omega),    m = (c - (1 - w) p_b - w p_o) x F

    Parameters
    ----------
    kin : Kinematics
    force : ndarray, shape (3,)
        What the ground pushes with, weight included [N].
    pressure : ndarray, shape (2,)
        Centre of pressure on the ground [m].
    both : bool
        Whether both feet are on the ground.
    """
    tau: Array = force @ kin.com_jacobian
    if both:
        base, other = (kin.model.soles[foot] for foot in (kin.base, kin.base.other))
        a, b = base.center, kin.point(other.frame, other.center)
        moves, x_other = kin.tree.moves[kin.tree.frames[other.frame][0]], kin.pose(other.frame)
        half = 0.5 * min(base.length, other.length)
        tau -= borne_by_other(force, pressure, kin.com, a, b, half, x_other, kin.lines, moves)
    return tau


@jit
def share(pressure, a, b):  # type: ignore[no-untyped-def]
    """Return the part of the load on the sole centred at `b` (3,), the rest is on that at `a`: how far on the way."""
    x, y = b[0] - a[0], b[1] - a[1]
    w = ((pressure[0] - a[0]) * x + (pressure[1] - a[1]) * y) / (x * x + y * y)
    return min(max(w, 0.0), 1.0)


@jit
def borne_by_other(force, pressure, com, a, b, half, x_other, lines, moves):  # type: ignore[no-untyped-def]
    """Return w (F.J_po + m.J_omega) (n,); `a` and `b` are the soles' centres, `half` is half of their length."""
    w = share(pressure, a, b)
    aside = pressure - a[:2] - w * (b - a)[:2]
    ahead_a, ahead_b = np.array([1.0, 0.0, 0.0]), direction(x_other, np.array([1.0, 0.0, 0.0]))
    p_a = a + min(max(aside[0], -half), half) * ahead_a
    p_b = b + min(max(aside[0] * ahead_b[0] + aside[1] * ahead_b[1], -half), half) * ahead_b
    m = np.cross(com - (1.0 - w) * p_a - w * p_b, force)
    tau = np.zeros(lines.shape[0])
    for i in range(lines.shape[0]):
        if moves[i]:
            line = lines[i]
            for k in range(3):
                i1, i2 = (k + 1) % 3, (k + 2) % 3
                tau[i] += force[k] * (line[i1] * p_b[i2] - line[i2] * p_b[i1] + line[3 + k]) + m[k] * line[k]
    return w * tau
