"""What a plant measures, and what it is asked to do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Command", "State"]

Array = NDArray[np.float64]


@dataclass(slots=True, eq=False)
class State:
    """What is measured.

    Attributes
    ----------
    time : float
        [s]
    q : ndarray, shape (n,)
        Joint angles, in the order of the model [rad].
    dq : ndarray, shape (n,), or None
        Joint velocities [rad/s].
    up : ndarray, shape (3,), or None
        Unit vector against gravity in the frame of the inertial sensor, where there is one.
    gyro : ndarray, shape (3,), or None
        Angular velocity of the inertial sensor in its frame [rad/s].
    acceleration : ndarray, shape (3,), or None
        Against free fall, in the same frame: 9.81 upwards at rest [m/s^2]; for the odometry only.
    effort : ndarray, shape (n,), or None
        Torques of the joints [N m]; to tell the cause of a fall only.
    """

    time: float
    q: Array
    dq: Array | None = None
    up: Array | None = None
    gyro: Array | None = None
    acceleration: Array | None = None
    effort: Array | None = None


@dataclass(slots=True, eq=False)
class Command:
    """What is asked of the joints until the next command.

    Attributes
    ----------
    time : float
        Time of the state it answers [s].
    velocity : ndarray, shape (n,)
        [rad/s]
    effort : ndarray, shape (n,), or None
        Torques fed forward, for a drive that can take them [N m].
    """

    time: float
    velocity: Array
    effort: Array | None = None
