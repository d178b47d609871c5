"""Simulated sensors with delay, quantization, noise, bias and mounting error."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from dqwalk_ros.config import SensorsConfig
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.kinematics import direction, quaternion_product
from dqwalk_ros.plants.base import Inertial
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit


@dataclass(slots=True, eq=False)
class Reading(Inertial):
    """Measurements of all sensors at one time; the orientation of the inertial sensor is that in a level world."""

    q: Array
    dq: Array
    effort: Array
    """Angles [rad], velocities [rad/s] and torques [N m] of the joints, shape (n,)."""


class Sensors:
    """Computes measurements from the true values."""

    def __init__(self, config: SensorsConfig) -> None:
        self._config = c = config
        self.exact = c == SensorsConfig(seed=c.seed)
        self._random = np.random.default_rng(c.seed)
        self._mounting = self._rotation(c.misalignment)
        self._leaning = self._rotation(c.attitude_bias, level=True)
        self._biases = np.array([np.zeros(3), *(self._direction(b) for b in (c.gyro_bias, c.accelerometer_bias))])
        self._noise = np.array([[c.attitude_noise], [c.gyro_noise], [c.accelerometer_noise]])
        self._under_way: deque[tuple[float, Reading]] = deque()
        self._arrived: Reading | None = None
        self._read: tuple[float, Reading] | None = None

    def measure(self, time: float, true: Reading) -> Reading:
        """Return the latest measurement available at `time` [s]; `true` are the true values at this time."""
        if self.exact:
            return true
        c = self._config
        last = self._read
        if last is None or c.rate <= 0.0 or time - last[0] >= 1.0 / c.rate - 1e-9:
            reading = self._faulty(time, true)
            self._read = time, reading
            self._under_way.append((time + c.age, reading))
        while self._under_way and (self._arrived is None or self._under_way[0][0] <= time + 1e-9):
            self._arrived = self._under_way.popleft()[1]
        assert self._arrived is not None  # the first reading arrives at once
        return self._arrived

    def _faulty(self, time: float, true: Reading) -> Reading:
        """Return the measurement of the true values, with all errors except the delay."""
        c = self._config
        orientation, gyro, acceleration = _disturbed(
            self._leaning.vec4(), self._mounting.vec4(), true.orientation, true.gyro, true.acceleration,
            self._biases + self._noise * self._random.normal(size=(3, 3)),
        )  # fmt: skip
        q = np.rint(true.q / c.encoder) * c.encoder if c.encoder > 0.0 else true.q
        dq = self._filtered(time, q) if c.velocity_filter > 0.0 else true.dq
        return Reading(orientation, gyro, acceleration, q, dq, true.effort)

    def _filtered(self, time: float, q: Array) -> Array:
        """Return the filtered differences (n,) [rad/s] of measured angles."""
        if self._read is None:
            return np.zeros(len(q))
        before, last = self._read
        keep = math.exp(-(time - before) / self._config.velocity_filter)
        return keep * last.dq + (1.0 - keep) * (q - last.q) / (time - before)

    def _direction(self, size: float, *, level: bool = False) -> Array:
        """Return a vector of the given norm in a random direction, horizontal if `level`, shape (3,)."""
        v = self._random.normal(size=3) * (1.0, 1.0, 0.0 if level else 1.0)
        out: Array = size * v / np.linalg.norm(v)
        return out

    def _rotation(self, angle: float, *, level: bool = False) -> DQ:
        return self._small(self._direction(angle, level=level))

    @staticmethod
    def _small(v: Array) -> DQ:
        """Return the rotation by |v| about v."""
        angle = float(np.linalg.norm(v))
        return DQ.rotation_about(angle, v / angle if angle > 0.0 else v)


@jit
def _disturbed(
    leaning: Array, mounting: Array, orientation: Array, gyro: Array, acceleration: Array, errors: Array
) -> tuple[Array, Array, Array]:
    """Return orientation (4,), angular velocity and specific force (3,) as a sensor with errors measures them.

    The rotations `leaning` and `mounting` (4,) are those of the level and of the sensor on its link. The rows of
    `errors` (3, 3) are a rotation vector, and what is added to the angular velocity and to the specific force.
    """
    size = math.sqrt(errors[0] @ errors[0])
    shaken = np.concatenate((np.array([math.cos(0.5 * size)]), 0.5 * np.sinc(0.5 * size / math.pi) * errors[0]))
    r = _product(_product(_product(leaning, shaken), orientation), mounting)
    to_sensor = np.array([mounting[0], -mounting[1], -mounting[2], -mounting[3]])
    return r, direction(to_sensor, gyro) + errors[1], direction(to_sensor, acceleration) + errors[2]


@jit
def _product(a: Array, b: Array) -> Array:
    """Return the product of two quaternions (4,)."""
    return np.array(quaternion_product(a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3]))
