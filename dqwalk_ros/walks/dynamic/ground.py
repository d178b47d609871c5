"""The ground's inclination, which distinguishes a sole that tips from one that stands on a slope.

A push tips the supporting sole on its edge, and with it all that is planned in its axes: a swing foot that lands 95 mm
beside a sole that has tipped by one degree is 1.7 mm too high, and carries no weight when it should. The inertial
sensor measures the inclination of the sole; its mean over several steps is that of the ground. Where soles stand
inclined against it, the ground is uneven.
"""

from __future__ import annotations

import math

import numpy as np

from dqwalk_ros.paper.kinematics import direction, quaternion_product
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.walks.footprint import Footprint

_MEMORY = 2.0
"""Time constant of the mean inclination of the supporting soles [s]."""
_INWARD = 0.17
"""Part of a sole's width by which the CoP is aimed further inside on uneven ground."""
_UNEVEN = math.radians(0.5)
"""Inclination of one of the last two soles above which the ground is uneven; on level ground noise and servos incline a
sole by at most 0.4 degrees when the other foot lands [rad]."""


class Ground:
    """Estimate of the ground's inclination.

    Parameters
    ----------
    up : ndarray, shape (3,)
        The vertical, the unit vector against gravity, in axes of a sole that stands flat on the ground.

    Attributes
    ----------
    vertical : ndarray, shape (3,)
        Its mean.
    """

    def __init__(self, up: Array) -> None:
        self.vertical = up.copy()
        self._inclined = 0.0, 0.0  # inclinations of the last two soles when the other foot landed [rad]

    @property
    def inward(self) -> float:
        """Part of a sole's width by which its CoP is aimed further inside, on uneven ground.

        An overshoot inwards is caught by the next step, one outwards is not.
        """
        return _INWARD if max(self._inclined) > _UNEVEN else 0.0

    def end_step(self, tilt: float) -> None:
        """Include the sole that stood, inclined by `tilt` against the ground [rad], when the other one has landed."""
        self._inclined = self._inclined[1], tilt

    def change_base(self, other: Footprint) -> None:
        """Change to the axes of the other sole; `other` is the footprint of the previous one in these axes."""
        along = other.points(self.vertical[:2]) - other.points(np.zeros(2))
        self.vertical = np.array([*along, self.vertical[2]])

    def inclination(self, up: Array) -> float:
        """Return the inclination of the sole with the vertical `up` (3,) against the ground, if small [rad]."""
        return float(np.linalg.norm(up - self.vertical))

    def tipped(self, up: Array, unsure: float, place: Array) -> Array:
        """Return a pose (7,), position and unit quaternion, of a flat sole in the axes of a tipped one; see `tip`."""
        x: Array = tipped(self.vertical, up, unsure, place)
        return x

    def tip(self, up: Array, unsure: float) -> Array:
        """Return the rotation from a flat sole's axes to those of the sole with the vertical `up` (3,), vec8 (8,).

        It is smaller than the inclination against the ground by the dead zone `unsure` [rad], because a leg deflects
        and the sensor is noisy.
        """
        x: Array = _towards(self.vertical, up, unsure)
        return x


@jit
def include(vertical: Array, up: Array, dt: float) -> None:
    """Include the vertical `up` (3,) in axes of the supporting sole, `dt` [s] after the last one, in the mean (3,)."""
    vertical += dt / (_MEMORY + dt) * (up - vertical)


@jit
def _towards(a: Array, b: Array, less: float) -> Array:
    """Return the rotation that takes the direction of `a` (3,) towards that of `b` (3,), to `less` [rad], vec8 (8,)."""
    axis, x = np.cross(a, b), np.zeros(8)
    size = math.sqrt(axis @ axis)
    half = 0.5 * max(math.atan2(size, a @ b) - less, 0.0)
    x[0], x[1:4] = math.cos(half), math.sin(half) / max(size, 1e-12) * axis
    return x


@jit
def tipped(a: Array, b: Array, less: float, place: Array) -> Array:
    """Return a pose (7,), position and unit quaternion, turned about the origin as `_towards` does."""
    x = _towards(a, b, less)
    r = quaternion_product(x[0], x[1], x[2], x[3], place[3], place[4], place[5], place[6])
    return np.concatenate((direction(x, place[:3]), np.array(r)))
