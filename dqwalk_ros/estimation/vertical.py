"""Filters of the vertical and of the angular velocity that an inertial sensor measures.

That of the vertical is complementary: the vertical of the last state is turned by the measured angular velocity, and
approaches the measured vertical with the time constant T. White noise of the vertical is reduced to the fraction
sqrt(dt / 2T); a bias b of the angular velocity turns the vertical by T b, 0.1 degrees for 1 degree/s.
"""

from __future__ import annotations

import math

import numpy as np

from dqwalk_ros.paper.state import State
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit

_T = 0.1
"""Time constant of the filter [s]."""


def filtered_vertical(before: Array | None, gyro: Array | None, state: State, dt: float) -> Array | None:
    """Return the vertical of `state`, shape (3,), filtered since the state before; None without an inertial sensor.

    Parameters
    ----------
    before, gyro : ndarray, shape (3,), optional
        Filtered vertical and measured angular velocity [rad/s] of the state before.
    state : State
        The current state, as measured; without an angular velocity its vertical is returned as it is.
    dt : float
        Time between the states [s].
    """
    if before is None or gyro is None or state.up is None or state.gyro is None:
        return state.up
    up: Array = _filtered(before, gyro, state.gyro, state.up, dt)
    return up


def low_passed(before: Array | None, gyro: Array | None, time_constant: float, dt: float) -> Array | None:
    """Return an angular velocity (3,) [rad/s] after a low-pass, as that of measured joint velocities.

    The velocity of the CoM subtracts the joint velocities from the angular velocity of the trunk, to know that of the
    base sole. If only one of them is low-passed, a sole at rest seems to turn whenever a joint accelerates.

    Parameters
    ----------
    before : ndarray, shape (3,), optional
        The result of the state before, `dt` [s] ago.
    gyro : ndarray, shape (3,), optional
        The measured angular velocity; None stays None.
    time_constant : float
        Of the low-pass [s]; 0: none.
    """
    if before is None or gyro is None or time_constant <= 0.0:
        return gyro
    return gyro + math.exp(-dt / time_constant) * (before - gyro)


@jit
def turning(up: Array, omega: Array) -> Array:
    """Return up' = up x omega (3,) [1/s] of a vertical `up` (3,) in axes that turn by `omega` (3,) [rad/s]."""
    return np.cross(up, omega)


@jit
def _filtered(before: Array, omega: Array, now: Array, measured: Array, dt: float) -> Array:
    """Return the vertical after dt [s] at angular velocities from `omega` to `now` (3,), corrected by the measured."""
    omega = 0.5 * (omega + now)
    turned = before + dt * turning(before, omega)
    up: Array = turned + dt / (_T + dt) * (measured - turned)
    return up / math.sqrt(up @ up)
