"""Motion of the CoM, from the joint velocities and the inertial sensor."""

from __future__ import annotations

from typing import Any

import numpy as np

from dqwalk_ros.paper.kinematics import Kinematics, Place, direction_at, jacobian, point_at
from dqwalk_ros.paper.state import State
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit

NOT_MEASURED = np.empty(0)
"""Stands for an angular velocity that is not measured."""


def com_and_xi(kin: Kinematics, state: State, omega: Array, share: float = 0.0) -> tuple[Array, Array]:
    """Return the projection c (2,) of the CoM on the ground along the vertical, and xi = c + c'/w (2,) [m].

    `omega` (2,) are the frequencies w of the pendulum [1/s]; `share` as in `velocity`.
    """
    c, xi = projected(kin.up, omega, share, *measured(kin, state))
    return c, xi


def measured(kin: Kinematics, state: State) -> tuple[Any, ...]:
    """Return what the velocity of the CoM is computed from, as `projected` takes it."""
    frames = kin.tree.frames
    places = tuple(frames[kin.swing]), tuple(frames[kin.model.imu])
    return kin.com, kin.com_jacobian, kin.lines, kin.poses, *places, *rates(state)


def rates(state: State) -> tuple[Array, Array]:
    """Return the joint velocities (n,), zero if they are unknown, and the angular velocity, empty if not measured."""
    if state.dq is None:
        return np.zeros(len(state.q)), NOT_MEASURED
    return state.dq, NOT_MEASURED if state.gyro is None else state.gyro


@jit
def projected(
    up: Array, omega: Array, share: float, com: Array, J_com: Array, lines: Array, poses: Array, swing: tuple[Any, ...],
    sensor: tuple[Any, ...], dq: Array, gyro: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """Return c and xi (2,) of `com_and_xi`."""
    v, along = velocity(share, com, J_com, lines, poses, swing, sensor, dq, gyro), up[:2]
    c = com[:2] - com[2] / up[2] * along
    return c, c + (v[:2] - v[2] / up[2] * along) / omega


@jit
def velocity(
    share: float, com: Array, J_com: Array, lines: Array, poses: Array, swing: tuple[Any, ...],
    sensor: tuple[Any, ...], dq: Array, gyro: Array,
) -> Array:  # fmt: skip
    """Return the velocity of the CoM, shape (3,) [m/s]; `swing` and `sensor` are places.

    Each sole is assumed at rest in proportion to the weight it bears; `share` is the fraction on the other one. So a
    base sole that has lost contact with uneven ground in double support, and moves, is not assumed at rest.
    """
    other, imu = Place(*swing), Place(*sensor)
    v: Array = moving_com(com, J_com, lines, poses, imu, dq, gyro)
    if share > 0.0:
        p, J = point_at(poses, other.body, other.pose, np.zeros(3)), np.empty(J_com.shape)
        jacobian(lines, other.moves, p, 1.0, J)
        v -= share * moving_com(p, J, lines, poses, imu, dq, gyro)
    return v


@jit
def moving_com(com: Array, J_com: Array, lines: Array, poses: Array, sensor: Place, dq: Array, gyro: Array) -> Array:
    """Return the velocity of the CoM, or of another point, including that by a rotation of the base sole, (3,) [m/s].

    Without a measured angular velocity `gyro` (empty) the base sole is assumed to be at rest.
    """
    v = J_com @ dq
    if gyro.shape[0] > 0:
        # the angular velocity of the base sole is that of the sensor minus that by the joints
        omega = direction_at(poses, sensor.body, sensor.pose, gyro)
        for i in range(lines.shape[0]):
            if sensor.moves[i]:
                for k in range(3):
                    omega[k] -= dq[i] * lines[i, k]
        v += np.cross(omega, com)
    return v
