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
from dqwalk_ros.kinematics import Kinematics, _point, compose, direction, support_tree
from dqwalk_ros.standing.paths import ComPath, com_path
from dqwalk_ros.state import State
from dqwalk_ros.statics import GRAVITY, borne_by_other, gravity_torques
from dqwalk_ros.walk import Phase, PhaseKind

__all__ = ["Balance", "com_velocity"]

Array = NDArray[np.float64]

_NONE = np.empty(0)
_NO_EDGES = np.empty((0, 2)), _NONE


class Balance:
    """The torques of one phase.

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
        edges = next((row for row in phase.inequalities if isinstance(row, ComInsideEdges)), None)
        base, other = (model.soles[foot] for foot in (phase.base, phase.base.other))
        self._imu = (*tree.frames[model.imu], tree.moves[tree.frames[model.imu][0]]) if model.imu in tree.frames else ()
        body, pose = tree.frames[other.frame]
        self._soles = base.center, other.center, 0.5 * min(base.length, other.length), body, pose, tree.moves[body]
        if path is not None:
            over = [goal.placed(tree) for goal in path.over]
            self._goals = np.array([body for body, _ in over]), np.array([offset for _, offset in over])
            self._way = path.start, path.duration
        self._kept = edges.polygon.edges() if edges is not None else _NO_EDGES
        self._gains = standing.balance, standing.pressure_margin, model.mass

    def __call__(self, kin: Kinematics, state: State) -> Array:
        """Return joint torques (n,) [N m]: gravity, and the CoM drawn to its path.

        The acceleration asked for is that of a linear inverted pendulum under feedback of its divergent component,
        a = a_d - w^2 k (c - c_d) - w (1 + k) (v - v_d); the centre of pressure it needs, c - a/w^2, is moved into the
        support polygon first.
        """
        if self._path is None:
            return gravity_torques(kin, both=self._both)
        v = np.zeros(3)
        if state.dq is not None:
            gyro = _NONE if state.gyro is None else state.gyro
            v = com_velocity(kin.com, kin.com_jacobian, kin.lines, kin.poses, *self._imu, state.dq, gyro)
        tau: Array = _torques(
            kin.com, kin.com_jacobian, kin.lines, kin.poses, kin.up, v, kin.elapsed, *self._way, *self._goals,
            *self._kept, *self._gains, self._both, *self._soles,
        )  # fmt: skip
        return tau


@jit
def com_velocity(com, J_com, lines, poses, imu, x_imu, moves, dq, gyro):  # type: ignore[no-untyped-def]
    """Return the velocity of the CoM, the turning of a sole that tips included, shape (3,) [m/s].

    `imu` is the body of the inertial sensor, `x_imu` (8,) its pose there, `moves` (n,) are the joints that move it.
    """
    v = J_com @ dq
    if gyro.shape[0] > 0:
        # what the inertial sensor turns besides the joints is the base sole
        turning = direction(compose(poses[imu], x_imu), gyro)
        for i in range(lines.shape[0]):
            if moves[i]:
                turning -= dq[i] * lines[i, :3]
        v += np.cross(turning, com)
    return v


@jit
def _torques(  # type: ignore[no-untyped-def]
    com, J_com, lines, poses, up, v, elapsed, start, duration, over, offsets, n, d, k, margin, mass, both,
    center, other_center, half, other, x_other, moves,
):  # fmt: skip
    goals = np.zeros(2 + 3 * over.shape[0])
    for j in range(over.shape[0]):
        goals[2 + 3 * j : 5 + 3 * j] = _point(poses[over[j]], offsets[j])
    c_d, v_d, a_d = com_path(goals, start, elapsed, duration)
    a, pressure = _drawn(com, up, v, c_d, v_d, a_d, n, d, k, margin)
    force = mass * (GRAVITY * up + a)
    tau = force @ J_com
    if both:
        x = compose(poses[other], x_other)
        tau -= borne_by_other(force, pressure, com, center, _point(x, other_center), half, x, lines, moves)
    return tau


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
