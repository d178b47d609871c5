"""The state that a plant measures and a controller estimates, and the command that the plant receives."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dqwalk_ros.support.arrays import Array


@dataclass(slots=True, eq=False)
class State:
    """A measured state."""

    time: float
    """Time of the measurement [s]."""
    q: Array
    """Joint angles, in the order of the model, shape (n,) [rad]."""
    dq: Array | None = None
    """Joint velocities, shape (n,) [rad/s]."""
    up: Array | None = None
    """Unit vector against gravity in the frame of the inertial sensor, shape (3,); None without such a sensor."""
    gyro: Array | None = None
    """Angular velocity of the inertial sensor in its frame, shape (3,) [rad/s]."""
    acceleration: Array | None = None
    """Specific force, as an accelerometer measures it, in the same frame, shape (3,): 9.81 upwards at rest [m/s^2].
    Only the odometry uses it."""
    effort: Array | None = None
    """Joint torques [N m], such as the present load of a servo, shape (n,); the load of each foot is estimated from
    them, unless it is measured."""
    forces: Array | None = None
    """Force of the ground on the left and on the right sole, as sensors of the feet measure it, shape (2,) [N]."""


@dataclass(slots=True, eq=False)
class Estimate(State):
    """A state as the controller knows it: filtered, and with what a walk needs besides the measurements."""

    loads: Array | None = None
    """Force of the ground on the left and on the right sole along its vertical, shape (2,) [N]; None if not known."""
    elapsed: float = math.inf
    """Time since the phase began [s]."""


@dataclass(slots=True, eq=False)
class Command:
    """A command to the joints; it holds until the next one."""

    time: float
    """Time of the state that the command answers [s]."""
    velocity: Array
    """Joint velocities, shape (n,) [rad/s]."""
    effort: Array | None = None
    """Feedforward torques, for a drive that accepts them, shape (n,) [N m]."""
