"""The desired ground reaction force, the torques that it needs, and the commanded motion."""

from __future__ import annotations

import numpy as np

from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.support.arrays import Array, Mask
from dqwalk_ros.support.compiled import jit

__all__ = ["approached", "converging", "ground_force", "leg_torques"]


_ACCELERATION = 0.01
"""Time constant of the filter of the commanded accelerations [s]."""


@jit
def ground_force(c: Array, z: Array, omega: Array, up: Array) -> Array:
    """Return the ground reaction force per mass (3,) [m/s^2] of the pendulum with the zero-moment point z (2,)."""
    a = omega**2 * (c - z)
    force: Array = GRAVITY * up + np.array([a[0], a[1], -(a[0] * up[0] + a[1] * up[1]) / up[2]])
    return force


@jit
def converging(c: Array, xi: Array, later: Array, omega: Array, time: float) -> tuple[Array, Array]:
    """Return position and velocity (2,) of the CoM after a `time` [s] in which xi (2,) moves to `later` (2,)."""
    c = c + (1.0 - np.exp(-omega * time)) * (0.5 * (xi + later) - c)  # c' = w (xi - c)
    return c, omega * (later - c)


@jit
def approached(acceleration: Array, before: Array, u: Array, passed: float) -> Array:
    """Return the filtered acceleration (n,) after velocities have changed from `before` to `u` (n,) in a time [s]."""
    return acceleration + (u - before - passed * acceleration) / (_ACCELERATION + passed)


@jit
def leg_torques(
    lines: Array, com: Array, J_com: Array, legs: Mask, pressure: Array, force: Array, weight: Array
) -> Array:
    """Return the torques of the leg joints from the difference between the ground force at z and at c, per mass (n,).

    The joints `legs` (n,) carry the force through the zero-moment point z instead of the CoM c, on which a = f - g up
    acts: with (l x z).f = l.(z x f), (l x z + m).f - (l x c + m).(g up) - a.J_CoM.
    """
    z, a = np.array([pressure[0], pressure[1], 0.0]), force - weight
    moment = np.cross(z, force) - np.cross(com, weight)
    tau = lines @ np.concatenate((moment, a)) - a @ J_com
    return legs * tau
