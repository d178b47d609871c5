"""Feedforward torques of the standing walk: gravity compensation, and feedback that balances the CoM on its path.

A robot on position servos is an inverted pendulum on springs. Commanded velocities, which the servos integrate, act too
late to balance it; feedforward torques act immediately.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.paper.constraints import ComInsideEdges
from dqwalk_ros.paper.geometry import moved_inside
from dqwalk_ros.paper.kinematics import PLACE, Kinematics, Place, point, support_tree
from dqwalk_ros.paper.phase import Phase
from dqwalk_ros.paper.state import Estimate
from dqwalk_ros.paper.statics import GRAVITY, SOLES, Soles, gravity_torques, ground_torques
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.by_address import FLOAT, INTEGERS, MATRIX, VECTOR, Record
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.walks.com import moving_com, rates
from dqwalk_ros.walks.following import ComPath, com_path

_NO_EDGES = np.empty((0, 2)), np.empty(0)


class _Given(NamedTuple):
    """What is constant in a phase."""

    start: Array
    """Of the path of the CoM, shape (2,) [m]."""
    duration: float
    """Of the path [s]."""
    bodies: NDArray[np.int64]
    points: Array
    """Bodies (k,) and points of them (k, 3), whose mean is the end of the path [m]."""
    n: Array
    d: Array
    """Inward normals (k, 2) and offsets (k,) of the edges of the support polygon [m]."""
    gain: float
    """k, of the feedback."""
    margin: float
    """Distance of the centre of pressure from the edges [m]."""
    mass: float
    sensor: Place
    soles: Soles


_GIVEN = Record(_Given, VECTOR, FLOAT, INTEGERS, MATRIX, MATRIX, VECTOR, FLOAT, FLOAT, FLOAT, PLACE, SOLES)
_opened = _GIVEN.opened


class Balance:
    """Computes the feedforward torques of one phase; call it with the kinematics and the state."""

    def __init__(self, phase: Phase, config: Config) -> None:
        model, standing = phase.model, config.standing
        tree = support_tree(model, phase.base)
        self.phase, self._given, self._table = phase, None, None
        path = next((task for task in phase.tasks if isinstance(task, ComPath)), None)
        if path is None or not standing.balance > 0.0:
            return
        over = [goal.placed(tree) for goal in path.over]
        bodies, points = np.array([body for body, _ in over]), np.array([offset for _, offset in over])
        edges = next((constraint for constraint in phase.inequalities if isinstance(constraint, ComInsideEdges)), None)
        polygon = edges.polygon.edges() if edges is not None else _NO_EDGES
        gain, margin, soles = standing.balance, standing.pressure_margin, Soles.of(model, phase.base, both=phase.double)
        self._given = _Given(
            path.start, path.duration, bodies, points, *polygon, gain, margin, model.mass, tree.frames[model.imu], soles
        )
        self._table = _GIVEN.table(self._given)

    def __call__(self, kin: Kinematics, state: Estimate) -> Array:
        """Return the joint torques (n,) [N m] that compensate gravity and accelerate the CoM towards its path.

        The desired acceleration is that of a linear inverted pendulum with feedback of its divergent component,
        a = a_d - w^2 k (c - c_d) - w (1 + k) (v - v_d). The centre of pressure that it requires, c - a/w^2, is first
        moved into the support polygon.
        """
        if self._table is None:
            return gravity_torques(kin, both=self.phase.double)
        robot = kin.com, kin.com_jacobian, kin.lines, kin.poses, kin.up
        tau: Array = _torques(self._table, *robot, *rates(state), state.elapsed)
        return tau


@jit
def _torques(
    table: Array, com: Array, J_com: Array, lines: Array, poses: Array, up: Array, dq: Array, gyro: Array,
    elapsed: float,
) -> Array:  # fmt: skip
    """Return the joint torques (n,) [N m] of `Balance`; the `table` is that of what is `_Given`."""
    to = _opened(table)
    v = moving_com(com, J_com, lines, poses, to.sensor, dq, gyro)
    s = np.zeros(2 + 3 * to.bodies.shape[0])
    for j in range(to.bodies.shape[0]):
        s[2 + 3 * j : 5 + 3 * j] = point(poses[to.bodies[j]], to.points[j])
    c_d, v_d, a_d = com_path(s, to.start, elapsed, to.duration)
    a, pressure = _com_acceleration(com, up, v, c_d, v_d, a_d, to.n, to.d, to.gain, to.margin)
    force = to.mass * (GRAVITY * up + a)
    tau: Array = ground_torques(force, pressure, com, J_com, lines, poses, to.soles)
    return tau


@jit
def _com_acceleration(
    com: Array, up: Array, v: Array, c_d: Array, v_d: Array, a_d: Array, n: Array, d: Array, k: float, margin: float
) -> tuple[Array, Array]:
    """Return the horizontal acceleration (3,) of the CoM towards its path, and its centre of pressure (2,).

    `k` is the gain of the feedback; n, d and margin as in `_Given`.
    """
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
