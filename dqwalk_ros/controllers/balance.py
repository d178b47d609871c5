"""Torques that keep a biped standing: gravity, and the centre of mass drawn to its path within what the soles bear.

A robot on position servos is an inverted pendulum on springs. Velocities alone, integrated by the servos, answer too
late; torques fed forward answer at once.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import StandingConfig
from dqwalk_ros.constraints import ComInsideEdges
from dqwalk_ros.controllers import State
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.phases import Phase, PhaseKind
from dqwalk_ros.tasks import ComPath

__all__ = ["balance_torques", "com_velocity", "gravity_torques"]

Array = NDArray[np.float64]

GRAVITY = 9.80665
"""[m/s^2]"""


def gravity_torques(kin: Kinematics, kind: PhaseKind) -> Array:
    """Return the joint torques of statics, shape (n,) [N m].

    Seen from the base sole the ground pushes the other sole with a part w of the weight, so that virtual work gives
    tau = M g up.(J_CoM - w J_p). With both feet on the ground w is where the CoM is on the way from sole to sole, and p
    lies as far from the other sole's centre as the CoM from the line between both.
    """
    model, up = kin.model, kin.up
    tau: Array = up @ kin.com_jacobian
    if kind is not PhaseKind.SINGLE_SUPPORT:
        sole = model.soles[kin.base.other]
        a, b = model.soles[kin.base].center[:2], kin.point(sole.frame, sole.center)[:2]
        way, com = b - a, kin.com_on_ground
        share = float(np.clip((com - a) @ way / (way @ way), 0.0, 1.0))
        aside = com - (a + share * way)
        ahead = kin.direction(sole.frame, np.array([1.0, 0.0, 0.0]))[:2]
        half = 0.5 * sole.length
        point = sole.center + np.array([np.clip(aside @ ahead, -half, half), 0.0, 0.0])
        tau = tau - share * (up @ kin.point_jacobian(sole.frame, point))
    return model.mass * GRAVITY * tau


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


def balance_torques(phase: Phase, kin: Kinematics, state: State, config: StandingConfig, imu: str) -> Array:
    """Return joint torques (n,) [N m]: gravity, and the CoM drawn to its path.

    The acceleration asked for is that of a linear inverted pendulum under feedback of its divergent component,
    a = a_d - w^2 k (c - c_d) - w (1 + k) (v - v_d); the centre of pressure it needs, c - a/w^2, is moved into the
    support polygon first.
    """
    tau = gravity_torques(kin, phase.kind)
    path = next((task for task in phase.tasks if isinstance(task, ComPath)), None)
    if path is None or config.balance <= 0.0:
        return tau
    w = math.sqrt(GRAVITY / max(float(kin.up @ kin.com), 0.05))
    k = config.balance
    e, v_d, a_d = path.error(kin), path.velocity(kin), path.acceleration(kin)
    v = com_velocity(kin, state, imu)[:2]
    a = a_d - w**2 * k * e - w * (1.0 + k) * (v - v_d)
    pressure = kin.com_on_ground - a / w**2
    edges = next((row for row in phase.rows if isinstance(row, ComInsideEdges)), None)
    if edges is not None:
        n, d = edges.polygon.edges()
        for _ in range(3):  # towards the inside, edge by edge
            short = d + config.pressure_margin - n @ pressure
            pressure = pressure + np.maximum(short, 0.0) @ n
    a = w**2 * (kin.com_on_ground - pressure)
    return tau + kin.model.mass * (a @ kin.com_on_ground_jacobian)
