"""Torques that keep a biped standing: gravity, and the centre of mass drawn to its path within what the soles bear.

A robot on position servos is an inverted pendulum on springs. Velocities alone, integrated by the servos, answer too
late; torques fed forward answer at once.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.compiled import jit
from dqwalk_ros.config import Config
from dqwalk_ros.constraints import ComInsideEdges
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.standing.paths import ComPath
from dqwalk_ros.state import State
from dqwalk_ros.statics import GRAVITY, gravity_torques, ground_torques
from dqwalk_ros.walk import Phase, PhaseKind

__all__ = ["balance_torques", "com_velocity"]

Array = NDArray[np.float64]


def com_velocity(kin: Kinematics, state: State, imu: str) -> Array:
    """Return the velocity of the CoM, the turning of a sole that tips included, shape (3,) [m/s]."""
    if state.dq is None:
        return np.zeros(3)
    v: Array = kin.com_jacobian @ state.dq
    if state.gyro is not None:
        # what the inertial sensor turns besides the joints is the base sole
        turning = kin.direction(imu, state.gyro) - kin.angular_jacobian(imu) @ state.dq
        (a, b, c), (x, y, z) = turning, kin.com
        v = v + np.array([b * z - c * y, c * x - a * z, a * y - b * x])
    return v


def balance_torques(phase: Phase, kin: Kinematics, state: State, config: Config) -> Array:
    """Return joint torques (n,) [N m]: gravity, and the CoM drawn to its path.

    The acceleration asked for is that of a linear inverted pendulum under feedback of its divergent component,
    a = a_d - w^2 k (c - c_d) - w (1 + k) (v - v_d); the centre of pressure it needs, c - a/w^2, is moved into the
    support polygon first.
    """
    standing, both = config.standing, phase.kind is not PhaseKind.SINGLE_SUPPORT
    path = next((task for task in phase.tasks if isinstance(task, ComPath)), None)
    if path is None or standing.balance <= 0.0:
        return gravity_torques(kin, both=both)
    edges = next((row for row in phase.inequalities if isinstance(row, ComInsideEdges)), None)
    n, d = edges.polygon.edges() if edges is not None else _NO_EDGES
    v = com_velocity(kin, state, kin.model.imu)
    a, pressure = _drawn(kin.com, kin.up, v, *path.reference(kin), n, d, standing.balance, standing.pressure_margin)
    return ground_torques(kin, kin.model.mass * (GRAVITY * kin.up + a), pressure, both=both)


_NO_EDGES = np.empty((0, 2)), np.empty(0)


@jit
def _drawn(com, up, v, c_d, v_d, a_d, n, d, k, margin):  # type: ignore[no-untyped-def]
    """Return the acceleration (3,) that draws the CoM back along the ground, and its centre of pressure (2,)."""
    w2 = GRAVITY / max(up[0] * com[0] + up[1] * com[1] + up[2] * com[2], 0.05)
    w = math.sqrt(w2)
    c, pressure = np.empty(2), np.empty(2)
    for i in range(2):
        c[i] = com[i] - com[2] * (up[i] / up[2])
        a = a_d[i] - w2 * k * (c[i] - c_d[i]) - w * (1.0 + k) * (v[i] - v_d[i])
        pressure[i] = c[i] - a / w2
    for _ in range(3):  # towards the inside, all edges at once
        x, y = pressure[0], pressure[1]
        for j in range(d.shape[0]):
            short = max(d[j] + margin - (n[j, 0] * x + n[j, 1] * y), 0.0)
            pressure[0] += short * n[j, 0]
            pressure[1] += short * n[j, 1]
    a0, a1 = w2 * (c[0] - pressure[0]), w2 * (c[1] - pressure[1])
    return np.array([a0, a1, -(a0 * up[0] + a1 * up[1]) / up[2]]), pressure
