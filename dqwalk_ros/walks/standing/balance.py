"""Feedforward torques of the standing walk: gravity compensation, and feedback that balances the CoM on its path.

A robot on position servos is an inverted pendulum on springs. Commanded velocities, which the servos integrate, act too
late to balance it; feedforward torques act immediately.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.paper.constraints import ComInsideEdges
from dqwalk_ros.paper.geometry import moved_inside
from dqwalk_ros.paper.kinematics import Kinematics, Place, point, support_tree
from dqwalk_ros.paper.phase import Phase
from dqwalk_ros.paper.state import State
from dqwalk_ros.paper.statics import GRAVITY, Soles, gravity_torques, ground_torques
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.walks.com import moving_com, rates
from dqwalk_ros.walks.following import ComPath, com_path

_NO_EDGES = np.empty((0, 2)), np.empty(0)


class _Goal(NamedTuple):
    """Path of the CoM: its start (2,) [m], its duration [s], and points (k, 3) of bodies, whose mean is its end."""

    start: Array
    duration: float
    bodies: Array
    points: Array


class Balance:
    """Computes the feedforward torques of one phase; call it with the kinematics and the state."""

    def __init__(self, phase: Phase, config: Config) -> None:
        model, standing = phase.model, config.standing
        tree = support_tree(model, phase.base)
        self.phase, self._both = phase, phase.double
        path = next((task for task in phase.tasks if isinstance(task, ComPath)), None)
        self._goal: tuple[Any, ...] | None = None  # the fields of `_Goal`
        if path is not None and standing.balance > 0.0:
            over = [goal.placed(tree) for goal in path.over]
            bodies, points = np.array([body for body, _ in over]), np.array([offset for _, offset in over])
            self._goal = path.start, path.duration, bodies, points
        edges = next((constraint for constraint in phase.inequalities if isinstance(constraint, ComInsideEdges)), None)
        self._edges = edges.polygon.edges() if edges is not None else _NO_EDGES
        self._gain, self._margin, self._mass = standing.balance, standing.pressure_margin, model.mass
        self._sensor = tuple(tree.frames[model.imu])
        self._soles = tuple(Soles.of(model, phase.base, both=self._both))

    def __call__(self, kin: Kinematics, state: State) -> Array:
        """Return the joint torques (n,) [N m] that compensate gravity and accelerate the CoM towards its path.

        The desired acceleration is that of a linear inverted pendulum with feedback of its divergent component,
        a = a_d - w^2 k (c - c_d) - w (1 + k) (v - v_d). The centre of pressure that it requires, c - a/w^2, is first
        moved into the support polygon.
        """
        if self._goal is None:
            return gravity_torques(kin, both=self._both)
        tau: Array = _torques(
            kin.com, kin.com_jacobian, kin.lines, kin.poses, kin.up, self._sensor, *rates(state), state.elapsed,
            self._goal, *self._edges, self._gain, self._margin, self._mass, self._soles,
        )  # fmt: skip
        return tau


@jit
def _torques(
    com: Array, J_com: Array, lines: Array, poses: Array, up: Array, sensor: tuple[Any, ...], dq: Array, gyro: Array,
    elapsed: float, goal: tuple[Any, ...], n: Array, d: Array, gain: float, margin: float, mass: float,
    soles: tuple[Any, ...],
) -> Array:  # fmt: skip
    """Return the joint torques (n,) [N m] of `Balance`.

    `n` and `d` are the edges of the support polygon, and `margin` [m] is the distance of the pressure from them;
    `sensor` is a `Place`, `goal` a `_Goal`, and `soles` are `Soles`.
    """
    v, to = moving_com(com, J_com, lines, poses, Place(*sensor), dq, gyro), _Goal(*goal)
    s = np.zeros(2 + 3 * to.bodies.shape[0])
    for j in range(to.bodies.shape[0]):
        s[2 + 3 * j : 5 + 3 * j] = point(poses[to.bodies[j]], to.points[j])
    c_d, v_d, a_d = com_path(s, to.start, elapsed, to.duration)
    a, pressure = _com_acceleration(com, up, v, c_d, v_d, a_d, n, d, gain, margin)
    force = mass * (GRAVITY * up + a)
    tau: Array = ground_torques(force, pressure, com, J_com, lines, poses, Soles(*soles))
    return tau


@jit
def _com_acceleration(
    com: Array, up: Array, v: Array, c_d: Array, v_d: Array, a_d: Array, n: Array, d: Array, k: float, margin: float
) -> tuple[Array, Array]:
    """Return the horizontal acceleration (3,) of the CoM towards its path, and its centre of pressure (2,).

    `k` is the gain of the feedback; n, d and margin as in `_torques`.
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
