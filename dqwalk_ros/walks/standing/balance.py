"""Feedforward torques of the standing walk: gravity compensation, and feedback that balances the CoM on its path.

A robot on position servos is an inverted pendulum on springs. Commanded velocities, which the servos integrate, act too
late to balance it; feedforward torques act immediately.
"""

from __future__ import annotations

import math

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.paper.constraints import ComInsideEdges
from dqwalk_ros.paper.geometry import moved_inside
from dqwalk_ros.paper.kinematics import Kinematics, _point, compose, direction, support_tree
from dqwalk_ros.paper.paths import ComPath, com_path
from dqwalk_ros.paper.state import State
from dqwalk_ros.paper.statics import GRAVITY, borne_by_other, gravity_torques
from dqwalk_ros.paper.walk import Phase, PhaseKind
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit

__all__ = ["Balance", "com_velocity"]


_NONE = np.empty(0)
_NO_EDGES = np.empty((0, 2)), _NONE


class Balance:
    """Computes the feedforward torques of one phase; call it with the kinematics and the state.

    Parameters
    ----------
    phase : Phase
    config : Config
    """

    def __init__(self, phase: Phase, config: Config) -> None:
        model, standing = phase.model, config.standing
        tree = support_tree(model, phase.base)
        self.phase, self._both = phase, phase.kind is not PhaseKind.SINGLE_SUPPORT
        path = next((task for task in phase.tasks if isinstance(task, ComPath)), None)
        self._path = path if standing.balance > 0.0 else None
        edges = next((constraint for constraint in phase.inequalities if isinstance(constraint, ComInsideEdges)), None)
        base, other = (model.soles[foot] for foot in (phase.base, phase.base.other))
        body, pose = tree.frames[model.imu]
        self._imu = body, pose, tree.moves[body]
        body, pose = tree.frames[other.frame]
        self._soles = base.center, other.center, 0.5 * min(base.length, other.length), body, pose, tree.moves[body]
        if path is not None:
            over = [goal.placed(tree) for goal in path.over]
            self._goals = np.array([body for body, _ in over]), np.array([offset for _, offset in over])
            self._path_parameters = path.start, path.duration
        self._edges = edges.polygon.edges() if edges is not None else _NO_EDGES
        self._gains = standing.balance, standing.pressure_margin, model.mass

    def __call__(self, kin: Kinematics, state: State) -> Array:
        """Return the joint torques (n,) [N m] that compensate gravity and accelerate the CoM towards its path.

        The desired acceleration is that of a linear inverted pendulum with feedback of its divergent component,
        a = a_d - w^2 k (c - c_d) - w (1 + k) (v - v_d). The centre of pressure that it requires, c - a/w^2, is first
        moved into the support polygon.
        """
        if self._path is None:
            return gravity_torques(kin, both=self._both)
        dq, gyro = state.dq, state.gyro
        if dq is None:
            dq, gyro = np.zeros(kin.q.shape), None
        tau: Array = _torques(
            kin.com, kin.com_jacobian, kin.lines, kin.poses, kin.up, *self._imu, dq, _NONE if gyro is None else gyro,
            kin.elapsed, *self._path_parameters, *self._goals, *self._edges, *self._gains, self._both, *self._soles,
        )  # fmt: skip
        return tau


@jit
def com_velocity(com, J_com, lines, poses, imu, x_imu, moves, dq, gyro):  # type: ignore[no-untyped-def]
    """Return the velocity of the CoM, including that by a rotation of the base sole, shape (3,) [m/s].

    `imu` is the body of the inertial sensor, `x_imu` (8,) its pose on that body, `moves` (n,) the joints that move it.
    Without a measured angular velocity `gyro` (empty) the base sole is assumed to be at rest.
    """
    v = J_com @ dq
    if gyro.shape[0] > 0:
        # the angular velocity of the base sole is that of the sensor minus that by the joints
        omega = direction(compose(poses[imu], x_imu), gyro)
        for i in range(lines.shape[0]):
            if moves[i]:
                omega -= dq[i] * lines[i, :3]
        v += np.cross(omega, com)
    return v


@jit
def _torques(  # type: ignore[no-untyped-def]
    com, J_com, lines, poses, up, imu, x_imu, moves_imu, dq, gyro, elapsed, start, duration, over, offsets, n, d, k,
    margin, mass, both, center, other_center, half, other, x_other, moves,
):  # fmt: skip
    """Return the joint torques (n,) [N m] of `Balance`."""
    v = com_velocity(com, J_com, lines, poses, imu, x_imu, moves_imu, dq, gyro)
    goals = np.zeros(2 + 3 * over.shape[0])
    for j in range(over.shape[0]):
        goals[2 + 3 * j : 5 + 3 * j] = _point(poses[over[j]], offsets[j])
    c_d, v_d, a_d = com_path(goals, start, elapsed, duration)
    a, pressure = _com_acceleration(com, up, v, c_d, v_d, a_d, n, d, k, margin)
    force = mass * (GRAVITY * up + a)
    tau = force @ J_com
    if both:
        x = compose(poses[other], x_other)
        tau -= borne_by_other(force, pressure, com, center, _point(x, other_center), half, x, lines, moves)
    return tau


@jit
def _com_acceleration(com, up, v, c_d, v_d, a_d, n, d, k, margin):  # type: ignore[no-untyped-def]
    """Return the horizontal acceleration (3,) of the CoM towards its path, and its centre of pressure (2,)."""
    w2 = GRAVITY / max(up[0] * com[0] + up[1] * com[1] + up[2] * com[2], 0.05)
    w = math.sqrt(w2)
    c, pressure = np.empty(2), np.empty(2)
    for i in range(2):
        c[i] = com[i] - com[2] * (up[i] / up[2])
        a = a_d[i] - w2 * k * (c[i] - c_d[i]) - w * (1.0 + k) * (v[i] - v_d[i])
        pressure[i] = c[i] - a / w2
    pressure = moved_inside(pressure, n, d, margin)
    a0, a1 = w2 * (c[0] - pressure[0]), w2 * (c[1] - pressure[1])
    return np.array([a0, a1, -(a0 * up[0] + a1 * up[1]) / up[2]]), pressure
