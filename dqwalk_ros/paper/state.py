"""The state that a plant measures, and the command that it receives."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dqwalk_ros.support.arrays import Array


@dataclass(slots=True, eq=False)
class State:
    """A measured state.

    Attributes
    ----------
    time : float
        Time of the measurement [s].
    q : ndarray, shape (n,)
        Joint angles, in the order of the model [rad].
    dq : ndarray, shape (n,), or None
        Joint velocities [rad/s].
    up : ndarray, shape (3,), or None
        Unit vector against gravity in the frame of the inertial sensor; None without such a sensor.
    gyro : ndarray, shape (3,), or None
        Angular velocity of the inertial sensor in its frame [rad/s].
    acceleration : ndarray, shape (3,), or None
        Specific force, as an accelerometer measures it, in the same frame: 9.81 upwards at rest [m/s^2]. Only the
        odometry uses it.
    effort : ndarray, shape (n,), or None
        Joint torques [N m], such as the present load of a servo; the load of each foot is estimated from them,
        unless it is measured.
    forces : ndarray, shape (2,), or None
        Force of the ground on the left and on the right sole, as sensors of the feet measure it [N].
    loads : ndarray, shape (2,), or None
        Force of the ground on the left and on the right sole along its vertical [N], which the controller fills in;
        None if it is not known.
    elapsed : float
        Time since the phase began [s], for the walk, which the controller fills in.
    """

    time: float
    q: Array
    dq: Array | None = None
    up: Array | None = None
    gyro: Array | None = None
    acceleration: Array | None = None
    effort: Array | None = None
    forces: Array | None = None
    loads: Array | None = None
    elapsed: float = math.inf


@dataclass(slots=True, eq=False)
class Command:
    """A command to the joints; it holds until the next one.

    Attributes
    ----------
    time : float
        Time of the state that the command answers [s].
    velocity : ndarray, shape (n,)
        Joint velocities [rad/s].
    effort : ndarray, shape (n,), or None
        Feedforward torques, for a drive that accepts them [N m].
    """

    time: float
    velocity: Array
    effort: Array | None = None
