"""Filter of the vertical that an inertial sensor measures, by its angular velocity.

A complementary filter: the vertical of the last state is turned by the measured angular velocity, and approaches the
measured vertical with the time constant T. White noise of the vertical is reduced to the fraction sqrt(dt / 2T); a bias
b of the angular velocity turns the vertical by T b, 0.1 degrees for 1 degree/s.
"""

from __future__ import annotations

import math

import numpy as np

from dqwalk_ros.paper.state import State
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit

__all__ = ["filtered_vertical"]


_T = 0.1
"""Time constant of the filter [s]."""


def filtered_vertical(before: State, state: State) -> Array | None:
    """Return the vertical of `state`, shape (3,), filtered since `before`; None without an inertial sensor.

    Parameters
    ----------
    before : State
        The previous state, with its filtered vertical.
    state : State
        The current state, as measured; without an angular velocity its vertical is returned as it is.
    """
    if before.up is None or before.gyro is None or state.up is None or state.gyro is None:
        return state.up
    up: Array = _filtered(before.up, before.gyro, state.gyro, state.up, state.time - before.time)
    return up


@jit
def _filtered(before: Array, omega: Array, now: Array, measured: Array, dt: float) -> Array:
    """Return the vertical after dt [s] at angular velocities from `omega` to `now` (3,), corrected by the measured."""
    omega = 0.5 * (omega + now)
    turned = before + dt * np.cross(before, omega)  # a vector that is fixed in the world: up' = up x omega
    up = turned + dt / (_T + dt) * (measured - turned)
    return up / math.sqrt(up @ up)
