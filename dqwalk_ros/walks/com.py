"""Motion of the CoM, from the joint velocities and the inertial sensor."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dqwalk_ros.paper.kinematics import Kinematics, SupportTree, compose, direction
from dqwalk_ros.paper.state import State
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit

__all__ = ["NOT_MEASURED", "Sensor", "com_and_xi", "com_velocity", "moving_com"]


NOT_MEASURED = np.empty(0)
"""Stands for an angular velocity that is not measured."""


class Sensor(NamedTuple):
    """Place of the inertial sensor: its body, its pose on that body (8,), and which joints (n,) move it."""

    body: int
    pose: Array
    moves: Array

    @classmethod
    def of(cls, model: RobotModel, tree: SupportTree) -> Sensor:
        """Return the place of the sensor of `model` in the tree from the base sole."""
        body, pose = tree.frames[model.imu]
        return cls(body, pose, tree.moves[body])


def com_velocity(kin: Kinematics, state: State, share: float = 0.0) -> Array:
    """Return the velocity of the CoM, shape (3,) [m/s]; zero if the joint velocities are unknown.

    Each sole is at rest as far as it bears the weight, of which the other sole has the fraction `share`. So a base sole
    that has left uneven ground in double support, and moves, is not taken to be at rest.
    """
    if state.dq is None:
        return np.zeros(3)
    sensor, gyro = Sensor.of(kin.model, kin.tree), NOT_MEASURED if state.gyro is None else state.gyro
    v: Array = moving_com(kin.com, kin.com_jacobian, kin.lines, kin.poses, sensor, state.dq, gyro)
    if share > 0.0:
        p, J = kin.point(kin.swing), kin.point_jacobian(kin.swing)
        v -= share * moving_com(p, J, kin.lines, kin.poses, sensor, state.dq, gyro)
    return v


@jit
def moving_com(com: Array, J_com: Array, lines: Array, poses: Array, sensor: Sensor, dq: Array, gyro: Array) -> Array:
    """Return the velocity of the CoM, or of another point, including that by a rotation of the base sole, (3,) [m/s].

    Without a measured angular velocity `gyro` (empty) the base sole is assumed to be at rest.
    """
    v = J_com @ dq
    if gyro.shape[0] > 0:
        # the angular velocity of the base sole is that of the sensor minus that by the joints
        omega = direction(compose(poses[sensor.body], sensor.pose), gyro)
        for i in range(lines.shape[0]):
            if sensor.moves[i]:
                omega -= dq[i] * lines[i, :3]
        v += np.cross(omega, com)
    return v


def com_and_xi(kin: Kinematics, state: State, omega: Array, share: float = 0.0) -> tuple[Array, Array]:
    """Return the projection c (2,) of the CoM on the ground along the vertical, and xi = c + c'/w (2,) [m].

    `omega` (2,) are the frequencies w of the pendulum [1/s]; `share` as in `com_velocity`.
    """
    c, v = _along_ground(kin.com, com_velocity(kin, state, share), kin.up)
    return c, c + v / omega


@jit
def _along_ground(com: Array, velocity: Array, up: Array) -> tuple[Array, Array]:
    """Return the projections (2,) of the CoM (3,) and of its velocity (3,) on the ground along the vertical (3,)."""
    along = up[:2]
    return com[:2] - com[2] / up[2] * along, velocity[:2] - velocity[2] / up[2] * along
