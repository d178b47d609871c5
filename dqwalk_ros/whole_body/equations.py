"""The problem of one control period: the equations of sections II to V as a hierarchy, in the paper's order.

The variables are x = (v', (lambda, mu) of each contact, y along x, y along y): the accelerations, base first; the
wrenches, in units of the robot's weight; and for each axis the variables of the preview, y = (c''_0, Z, P).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from dqwalk_ros.config import WholeBodyConfig
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.whole_body.dynamics import Dynamics, FrameMotion, rotation_error
from dqwalk_ros.whole_body.hierarchy import BALANCE, LAW, LIMIT, Hierarchy
from dqwalk_ros.whole_body.objectives import Distance, Objective
from dqwalk_ros.whole_body.preview import PointMass, Preview, Swing, swing_acceleration, swing_jerk

_FACES = 4
"""Number of edges of the friction pyramid."""
_FAR = 500.0
"""Largest bound of the joint accelerations [rad/s^2]."""
_EPS = 1e-9
"""Rounding error of a time [s]."""
_TURN = 0.05
"""Scale of the rows of the swing foot's orientation, for the conditioning."""


@dataclass(frozen=True)
class Layout:
    """Indices of the variables in x."""

    nv: int
    contacts: int
    """Size of v', and number of contacts."""
    preview: int
    """Size of y: 1 + N + K."""

    @property
    def size(self) -> int:
        """Number of variables."""
        return self.nv + self.contacts * (_FACES + 3) + 2 * self.preview

    @property
    def wrenches(self) -> slice:
        """Indices of (lambda, mu) of all contacts."""
        return slice(self.nv, self.nv + self.contacts * (_FACES + 3))

    def force(self, contact: int) -> slice:
        """Return the indices of lambda of a contact."""
        at = self.nv + contact * (_FACES + 3)
        return slice(at, at + _FACES)

    def moment(self, contact: int) -> slice:
        """Return the indices of mu of a contact."""
        at = self.nv + contact * (_FACES + 3) + _FACES
        return slice(at, at + 3)

    def y(self, axis: int) -> slice:
        """Return the indices of the preview along x (0) or y (1)."""
        at = self.wrenches.stop + axis * self.preview
        return slice(at, at + self.preview)


@dataclass(frozen=True)
class Scene:
    """The data from which the problem of one control period is built."""

    dt: float
    """Control period, for which the accelerations are held [s]."""
    dynamics: Dynamics
    mass: PointMass
    weight: float
    """m g [N]."""
    stance: Mapping[Foot, FrameMotion]
    """Soles on the ground."""
    preview: Preview
    support: Array
    """Position of the foot that landed last, from which P is measured, shape (2,) [m]."""
    swing: Swing | None
    sole: FrameMotion | None
    """The swing sole."""
    settled: Array | None
    """Its landing place, once that is fixed, shape (2,) [m]."""

    @property
    def layout(self) -> Layout:
        """Indices of the variables in x."""
        return Layout(self.dynamics.nv, len(self.stance), self.preview.M.shape[1])

    def footsteps(self, x: Array) -> Array:
        """Return the previewed landing places of x, shape (K, 2) [m]."""
        P = np.stack([x[self.layout.y(axis)][self.preview.feet] for axis in (0, 1)], axis=1)
        return self.support + np.cumsum(P, axis=0)

    def wrenches(self, config: WholeBodyConfig, x: Array) -> dict[Foot, Array]:
        """Return force and moment of the ground on each sole of the stance, shape (6,) [N, N m]."""
        edges, at = friction_edges(config.friction), self.layout
        return {
            foot: self.weight * np.concatenate([edges @ x[at.force(k)], x[at.moment(k)]])
            for k, foot in enumerate(self.stance)
        }


class _Rows:
    """Collects rows of A with their bounds and levels, block by block; at most `most` rows of n variables."""

    def __init__(self, most: int, n: int) -> None:
        self._A = np.zeros((most, n))
        self._lower, self._upper = np.full(n + most, -np.inf), np.full(n + most, np.inf)
        self._level = np.full(n + most, LAW)
        self._count, self._n = 0, n

    def add(self, lower: Array | float, upper: Array | float, level: int, count: int) -> Array:
        """Add `count` rows and return their part of A, initially zero, shape (count, n)."""
        begin, self._count = self._count, self._count + count
        at = slice(self._n + begin, self._n + self._count)
        self._lower[at], self._upper[at], self._level[at] = lower, upper, level
        return self._A[begin : self._count]

    def equal(self, value: Array, level: int) -> Array:
        """Add equality rows and return their part of A, initially zero."""
        return self.add(value, value, level, len(value))

    def bound(self, at: slice, lower: Array | float, upper: Array | float, level: int) -> None:
        """Set the bounds of the variables `at`."""
        self._lower[at], self._upper[at], self._level[at] = lower, upper, level

    def hierarchy(self, H: Array, c: Array) -> Hierarchy:
        """Return the hierarchy of all rows, with the cost 1/2 x'Hx + c'x."""
        end = self._n + self._count
        return Hierarchy(H, c, self._A[: self._count], self._lower[:end], self._upper[:end], self._level[:end])


@cache
def friction_edges(mu: float) -> Array:
    """Return G of (S4): unit vectors along the edges of the friction pyramid, shape (3, _FACES)."""
    angle = 2.0 * math.pi * np.arange(_FACES) / _FACES + 0.25 * math.pi
    G = np.stack([mu * np.cos(angle), mu * np.sin(angle), np.ones(_FACES)])
    unit: Array = G / np.linalg.norm(G, axis=0)
    return unit


def joint_bounds(model: RobotModel, q: Array, dq: Array, T: float) -> tuple[Array, Array]:
    """Return bounds of the joint accelerations that keep the joints within their limits (S9), shapes (n,) [rad/s^2].

    A joint that moves towards its limit so fast that (S9) would not stop it in time gets the deceleration that stops it
    at the limit instead.
    """

    def most(gap: Array, speed: Array) -> Array:
        near = (gap > 1e-9) & (speed * T > 2.0 * gap)
        # (S9) q + T q' + T^2/2 q'' <= q_max
        return np.where(near, -(speed**2) / np.maximum(2.0 * gap, 1e-9), 2.0 * gap / T**2 - 2.0 * speed / T)

    upper = np.clip(np.minimum(most(model.q_max - q, dq), (model.velocity_max - dq) / T), -_FAR, _FAR)
    lower = np.clip(np.maximum(-most(q - model.q_min, -dq), -(model.velocity_max + dq) / T), -_FAR, _FAR)
    middle = 0.5 * (lower + upper)
    crossed = lower > upper
    return np.where(crossed, middle, lower), np.where(crossed, middle, upper)


def hierarchy(
    config: WholeBodyConfig,
    model: RobotModel,
    scene: Scene,
    objectives: Sequence[Objective],
    distances: Sequence[Distance] = (),
) -> Hierarchy:
    """Return the hierarchy of one control period, with its three levels."""
    kept = [distance.rows(scene.dynamics) for distance in distances]
    contacts = len(scene.stance)
    rows = _Rows(6 + 12 * contacts + model.n + 3 + 6 + 2 + sum(len(h) for _, h in kept), scene.layout.size)
    _whole_body(config, model, scene, rows)
    _balance(config, scene, rows)
    if scene.swing is not None and scene.sole is not None:
        _swing_foot(config, scene, scene.swing, scene.sole, rows)
    for G, h in kept:
        rows.add(h, np.inf, LIMIT, len(h))[:, : scene.layout.nv] = G
    return rows.hierarchy(*_objectives(config, scene, objectives))


def _whole_body(config: WholeBodyConfig, model: RobotModel, scene: Scene, rows: _Rows) -> None:
    """Add the rows of section II: equations of motion, contact constraints, limits of joints and torques."""
    d, at, weight = scene.dynamics, scene.layout, scene.weight
    edges = friction_edges(config.friction)
    half = 0.5 * np.array([config.cop_width, config.cop_length])
    lever = np.append(half, config.friction * math.hypot(*half))[:, None]
    base = rows.equal(-d.h[:6] / weight, LAW)
    base[:, : at.nv] = d.H[:6] / weight  # (S2) H_2 v' + h_2 = J_c,2' f, divided by m g
    most = np.minimum(model.effort_max, config.effort)
    torque = rows.add(-1.0 - d.h[6:] / most, 1.0 - d.h[6:] / most, LIMIT, model.n)
    torque[:, : at.nv] = d.H[6:] / most[:, None]  # (S1) tau = H_1 v' + h_1 - J_c,1' f, in units of its limit
    for k, sole in enumerate(scene.stance.values()):
        lam, mu, J = at.force(k), at.moment(k), sole.jacobian
        base[:, lam] = -J[:3, :6].T @ edges  # (S4) f = G lambda
        base[:, mu] = -J[3:, :6].T  # (S3) a wrench: force and moment
        torque[:, lam] = -weight * (J[:3, 6:] / most).T @ edges
        torque[:, mu] = -weight * (J[3:, 6:] / most).T
        rows.bound(lam, 0.0, np.inf, LAW)  # (S5)
        # (S7) |mu_x| <= w f_z, |mu_y| <= l f_z and (S6) |mu_z| <= gamma f_z
        for sign in (1.0, -1.0):
            cone = rows.add(0.0, np.inf, LAW, 3)
            cone[:, lam], cone[:, mu] = lever * edges[2], sign * np.eye(3)
        # (S8) J_c v' + J'_c v = 0, and a residual velocity decays
        rows.equal(-sole.drift - config.contact_damping * sole.velocity, LAW)[:, : at.nv] = J
    rows.bound(slice(6, at.nv), *joint_bounds(model, d.q, d.v[6:], config.limit_time), LIMIT)


def _balance(config: WholeBodyConfig, scene: Scene, rows: _Rows) -> None:
    """Add the rows of section III, and the coupling of the CoM (S15)."""
    d, at, mass, preview = scene.dynamics, scene.layout, scene.mass, scene.preview
    xi = mass.capture_point(d.com, d.com_velocity)
    for axis in (0, 1):
        y = at.y(axis)
        rows.bound(y, preview.lower[:, axis], preview.upper[:, axis], LAW)
        if scene.settled is not None:
            first, place = y.start + preview.feet.start, scene.settled[axis] - scene.support[axis]
            rows.bound(slice(first, first + 1), place, place, LAW)
        # (S15) J_com v' + J'_com v = c''_0
        com = rows.equal(-d.com_drift[axis : axis + 1], LAW)
        com[0, : at.nv], com[0, y.start] = d.com_jacobian[axis], -1.0
        if config.capturability:
            # (S14) sum alpha_k z_k = xi_0
            stop = rows.equal(xi[axis : axis + 1] - mass.alpha @ preview.offset[:, axis : axis + 1], BALANCE)
            stop[0, y] = mass.alpha @ preview.M
    # the CoM height, which the point-mass model assumes to be constant
    kd = 2.0 * math.sqrt(config.com_kp)
    wanted = config.com_kp * (mass.height - d.com[2:]) - kd * d.com_velocity[2:] - d.com_drift[2:]
    rows.equal(wanted, LIMIT)[:, : at.nv] = d.com_jacobian[2:]


def _at_least(dt: float, remaining: float) -> float:
    """Return the remaining time of a motion, but at least one control period, both [s].

    The acceleration is held for a period, in which the gains of a shorter time r would amplify errors by (dt/r)^2.
    """
    return remaining if remaining >= dt - _EPS else dt


def _swing_foot(config: WholeBodyConfig, scene: Scene, swing: Swing, sole: FrameMotion, rows: _Rows) -> None:
    """Add the rows of section IV: the swing foot follows a cubic to its landing place and is kept level (S16)."""
    at, J, v, drift = scene.layout, sole.jacobian, sole.velocity, sole.drift
    remaining = _at_least(scene.dt, swing.remaining)
    a, b = swing_acceleration(remaining)
    if scene.settled is None:
        # (S16) J v' + J' v = a (p + dP - s) - b s', divided by a while dP is a variable, for better conditioning
        across = rows.equal((-drift[:2] - b * v[:2]) / a + scene.support - sole.position[:2], LIMIT)
        across[:, : at.nv] = J[:2] / a
        for axis in (0, 1):
            across[axis, at.y(axis).start + scene.preview.feet.start] = -1.0
    else:
        wanted = a * (scene.settled - sole.position[:2]) - b * v[:2]
        rows.equal(wanted - drift[:2], LIMIT)[:, : at.nv] = J[:2]
    up = 0.5 * config.single_support - swing.elapsed
    rising = up >= scene.dt - _EPS  # up to the middle of the step, then down
    a, b = swing_acceleration(up if rising else remaining)
    height = config.step_height if rising else 0.0
    rows.equal(a * (height - sole.position[2:]) - b * v[2:3] - drift[2:3], LIMIT)[:, : at.nv] = J[2:3]
    turn = -config.foot_kp * rotation_error(sole.rotation) - 2.0 * math.sqrt(config.foot_kp) * v[3:]
    rows.equal(_TURN * (turn - drift[3:]), LIMIT)[:, : at.nv] = _TURN * J[3:]


def _objectives(config: WholeBodyConfig, scene: Scene, objectives: Sequence[Objective]) -> tuple[Array, Array]:
    """Return H (n, n) and c (n,) of the cost 1/2 x'Hx + c'x of section V."""
    d, at, preview = scene.dynamics, scene.layout, scene.preview
    H, c = np.zeros((at.size, at.size)), np.zeros(at.size)
    diagonal = H.reshape(-1)[:: at.size + 1]
    # the hand, the torso, the joints, and every other objective of the accelerations
    for objective in objectives:
        J, wanted = objective.jacobian(d), objective.acceleration(d)
        H[: at.nv, : at.nv] += objective.weight * J.T @ J
        c[: at.nv] -= objective.weight * J.T @ wanted
    D = np.diff(preview.M, axis=0) / scene.mass.interval
    damping = config.cop_velocity_weight * D.T @ D
    for axis in (0, 1):
        y = at.y(axis)
        if scene.swing is not None and scene.sole is not None and scene.settled is None:
            a, b = swing_jerk(_at_least(scene.dt, scene.swing.remaining))
            rest = -a * (scene.support[axis] - scene.sole.position[axis]) + b * scene.sole.velocity[axis]
            first = y.start + preview.feet.start
            diagonal[first] += config.jerk_weight * a * a  # (S20) s''' = -a dP + rest
            c[first] -= config.jerk_weight * a * rest
        diagonal[y][preview.cops] += config.cop_weight  # (S21) Z is relative to the middle of its foot
        H[y, y] += damping  # (S22) z' = D y + offset' over every interval
        c[y] += config.cop_velocity_weight * D.T @ np.diff(preview.offset[:, axis]) / scene.mass.interval
    diagonal[at.wrenches] += config.wrench_weight
    diagonal += config.regularization
    return H, c
