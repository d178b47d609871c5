"""What a simulated plant knows besides the state: its inertial sensor in full, and what no sensor measures."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.model import Foot

__all__ = ["Inertial", "Truth", "upward"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Inertial:
    """What the inertial sensor says.

    Attributes
    ----------
    orientation : ndarray, shape (4,)
        Unit quaternion (real part first) of the sensor's frame in the world.
    gyro : ndarray, shape (3,)
        Angular velocity in its frame [rad/s].
    acceleration : ndarray, shape (3,)
        Acceleration against free fall in its frame: 9.81 upwards at rest [m/s^2].
    """

    orientation: Array
    gyro: Array
    acceleration: Array


def upward(w: float, i: float, j: float, k: float) -> Array:
    """Return the unit vector against gravity in a frame whose orientation is the quaternion w + i + j + k, shape (3,).

    Its yaw makes no difference, nor does its norm.
    """
    size = math.sqrt(w * w + i * i + j * j + k * k)
    w, i, j, k = w / size, i / size, j / size, k / size
    return np.array([2.0 * (i * k - w * j), 2.0 * (j * k + w * i), 1.0 - 2.0 * (i * i + j * j)])


@dataclass(frozen=True)
class Truth:
    """What no sensor of the robot measures.

    Attributes
    ----------
    pelvis : ndarray, shape (8,)
        Its pose in the world.
    soles : dict of Foot to ndarray, shape (8,)
        Poses of the soles in the world.
    wrenches : dict of Foot to ndarray, shape (6,)
        Force [N] and torque [N m] of the ground on each sole, about its origin, in its axes.
    com : ndarray, shape (3,)
        In the world [m].
    """

    pelvis: Array
    soles: dict[Foot, Array]
    wrenches: dict[Foot, Array]
    com: Array

    @property
    def cop(self) -> Array | None:
        """Centre of pressure of both feet in the world, shape (3,) [m]; None in the air."""
        total, moment = 0.0, np.zeros(3)
        for foot, w in self.wrenches.items():
            if w[2] > 1e-3:
                total += w[2]
                moment += w[2] * DQ(self.soles[foot]).transform_point([-w[4] / w[2], w[3] / w[2], 0.0])
        return moment / total if total > 1e-2 else None
