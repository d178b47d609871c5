"""The desired ground reaction force, the torques that it needs, and the commanded motion."""

from __future__ import annotations

import numpy as np

from dqwalk_ros.paper.geometry import moved_inside
from dqwalk_ros.paper.statics import GRAVITY, Soles, ground_torques
from dqwalk_ros.support.arrays import Array, Mask
from dqwalk_ros.support.compiled import jit

_ACCELERATION = 0.01
"""Time constant of the filter of the commanded accelerations [s]."""


@jit
def fed_back(z: Array, due: Array, xi: Array, gain: float, reaction: float, n: Array, d: Array, margin: float) -> Array:
    """Return the commanded zero-moment point (2,): the planned z with feedback of the error of xi, within the soles.

    `due` (2,) is the planned xi, `reaction` [m] the displacement along x by the swing leg; n (m, 2) and d (m,) are the
    edges of the support polygon, and `margin` [m] is the distance that is kept from them.
    """
    z = z + (1.0 + gain) * (xi - due)
    z[0] += reaction
    inside: Array = moved_inside(z, n, d, margin)
    return inside


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
def feedforward(
    acceleration: Array, before: Array, u: Array, passed: float, mass: float, force: Array, pressure: Array,
    inertia: Array, legs: Mask, up: Array, com: Array, J_com: Array, lines: Array, poses: Array, soles: Soles,
) -> Array:  # fmt: skip
    """Return the feedforward torques for a ground reaction force per mass through the zero-moment point, (n,) [N m].

    The joints `legs` (n,) between the base sole and the pelvis carry that force less the weight of the links below
    them: the support leg hardly moves, so the inertial forces act above it. In single support the joints of the swing
    leg have the filtered `acceleration` (n,) [rad/s^2], which is updated, and the `inertia` (n, n) [kg m^2]. The
    commanded velocities have changed from `before` to `u` (n,) [rad/s] in the time `passed` [s], or that is not known
    (0).
    """
    _approach(acceleration, before, u, passed)
    tau: Array = ground_torques(mass * force, pressure, com, J_com, lines, poses, soles)
    tau += mass * _leg_torques(lines, com, J_com, legs, pressure, force, GRAVITY * up)
    if not soles.both:
        tau += inertia @ acceleration
    return tau


@jit
def _approach(acceleration: Array, before: Array, u: Array, passed: float) -> None:
    """Filter the acceleration (n,) after velocities have changed from `before` to `u` (n,) in a time [s], if known."""
    if passed > 0.0:
        acceleration += (u - before - passed * acceleration) / (_ACCELERATION + passed)
    else:
        acceleration[:] = 0.0


@jit
def _leg_torques(
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
