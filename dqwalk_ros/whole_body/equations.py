"""One tick of the whole-body controller as a hierarchy: every equation of sections II to V, in the paper's order.

The variables are x = (v', (lambda, mu) per contact, c''_0, Z, P): the accelerations, base first; the wrenches, in units
of the robot's weight; the CoM's acceleration along x and y; the N previewed CoPs relative to the middle of their feet,
x of all and then y; and the K displacements of the feet, the same way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import WholeBodyConfig
from dqwalk_ros.qp import Problem
from dqwalk_ros.robot import RobotModel
from dqwalk_ros.whole_body.dynamics import Dynamics, FrameMotion, rotation_error
from dqwalk_ros.whole_body.hierarchy import Hierarchy
from dqwalk_ros.whole_body.objectives import Distance, Objective
from dqwalk_ros.whole_body.preview import PointMass, Preview, Swing, swing_acceleration, swing_jerk

__all__ = ["FACES", "Layout", "Scene", "friction_edges", "hierarchy", "joint_bounds", "wrenches"]

Array = NDArray[np.float64]

FACES = 4
"""Edges of the friction pyramid."""
_FAR = 500.0
"""Joint accelerations beyond this are no sensible bound [rad/s^2]."""
_TURN = 0.05
"""Scale of the rows of the swing foot's orientation, for the conditioning."""


@dataclass(frozen=True)
class Layout:
    """Where the variables are.

    Attributes
    ----------
    nv, contacts, intervals, steps : int
        Sizes of v', number of wrenches, N and K.
    """

    nv: int
    contacts: int
    intervals: int
    steps: int

    @property
    def com(self) -> int:
        """Where c''_0 begins."""
        return self.nv + self.contacts * (FACES + 3)

    @property
    def size(self) -> int:
        """Number of variables."""
        return self.com + 2 + 2 * self.intervals + 2 * self.steps

    def wrench(self, contact: int) -> slice:
        """(lambda, mu) of a contact."""
        at = self.nv + contact * (FACES + 3)
        return slice(at, at + FACES + 3)

    def cops(self, axis: int) -> slice:
        """Z along x (0) or y (1)."""
        at = self.com + 2 + axis * self.intervals
        return slice(at, at + self.intervals)

    def feet(self, axis: int) -> slice:
        """P along x (0) or y (1)."""
        at = self.com + 2 + 2 * self.intervals + axis * self.steps
        return slice(at, at + self.steps)


@dataclass(frozen=True)
class Scene:
    """Everything one tick is made of.

    Attributes
    ----------
    dynamics : Dynamics
    mass : PointMass
    weight : float
        m g [N].
    stance : tuple of FrameMotion
        Soles on the ground.
    preview : Preview
    support : ndarray, shape (2,)
        The foot that landed last: P counts from here [m].
    swing : Swing or None
    sole : FrameMotion or None
        The sole that swings.
    settled : ndarray, shape (2,), or None
        Where it lands, once that is settled [m].
    """

    dynamics: Dynamics
    mass: PointMass
    weight: float
    stance: tuple[FrameMotion, ...]
    preview: Preview
    support: Array
    swing: Swing | None
    sole: FrameMotion | None
    settled: Array | None


@cache
def friction_edges(mu: float) -> Array:
    """Return G of (4): unit vectors along the edges of the friction pyramid, shape (3, FACES)."""
    angle = 2.0 * math.pi * np.arange(FACES) / FACES + 0.25 * math.pi
    G = np.stack([mu * np.cos(angle), mu * np.sin(angle), np.ones(FACES)])
    unit: Array = G / np.linalg.norm(G, axis=0)
    return unit


def joint_bounds(model: RobotModel, q: Array, dq: Array, T: float) -> tuple[Array, Array]:
    """Bounds of the joint accelerations that keep the joints within their limits (9), shapes (n,) [rad/s^2].

    Where a joint that moves towards its limit could not stop in time under (9), the deceleration that stops it at the
    limit takes its place.
    """

    def most(gap: Array, speed: Array) -> Array:
        near = (gap > 1e-9) & (speed * T > 2.0 * gap)
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
) -> tuple[Hierarchy, Layout]:
    """Return the three levels of one tick, and where their variables are."""
    d = scene.dynamics
    layout = Layout(d.nv, len(scene.stance), config.intervals, scene.preview.steps)
    E, e, soft_e = _equalities(config, layout, scene)
    G, h, soft_g = _inequalities(config, model, layout, scene, distances)
    lower, upper = _bounds(config, model, layout, scene)
    H, c = _objectives(config, layout, scene, objectives)
    soft = np.zeros(layout.size, dtype=np.bool_)
    soft[6 : d.nv] = True
    E2, e2 = _capturability(layout, scene)
    if not config.capturability:
        E2, e2 = E2[:0], e2[:0]
    return Hierarchy(Problem.of(H, c, E, e, G, h, lower, upper), E2, e2, soft_e, soft_g, soft), layout


def _equalities(config: WholeBodyConfig, layout: Layout, scene: Scene) -> tuple[Array, Array, NDArray[np.bool_]]:
    """(2), (8), the CoM's height, (15) and (16)."""
    d, nv = scene.dynamics, layout.nv
    count = 6 + 6 * layout.contacts + 3 + (6 if scene.swing is not None else 0)
    E, e = np.zeros((count, layout.size)), np.zeros(count)
    soft = np.zeros(count, dtype=np.bool_)
    edges = friction_edges(config.friction)
    # (2) H_2 v' + h_2 = J_c,2' f, divided by m g
    E[:6, :nv] = d.H[:6] / scene.weight
    e[:6] = -d.h[:6] / scene.weight
    at = 6
    for k, sole in enumerate(scene.stance):
        J = sole.jacobian
        w = layout.wrench(k).start
        E[:6, w : w + FACES] = -J[:3, :6].T @ edges  # (3), (4)
        E[:6, w + FACES : w + FACES + 3] = -J[3:, :6].T
        # (8) J_c v' + J'_c v = 0, and what is left of a velocity decays
        E[at : at + 6, :nv] = J
        e[at : at + 6] = -sole.drift - config.contact_damping * sole.velocity
        at += 6
    # (15) J_com v' + J'_com v = c''_0, and the height that (10) takes for constant
    E[at : at + 3, :nv] = d.com_jacobian
    E[at, layout.com] = E[at + 1, layout.com + 1] = -1.0
    e[at : at + 3] = -d.com_drift
    kd = 2.0 * math.sqrt(config.com_kp)
    e[at + 2] += config.com_kp * (scene.mass.height - d.com[2]) - kd * d.com_velocity[2]
    soft[at + 2] = True
    at += 3
    if scene.swing is not None and scene.sole is not None:
        _swing_rows(config, layout, scene, scene.swing, scene.sole, E[at:], e[at:])
        soft[at:] = True
    return E, e, soft


def _swing_rows(
    config: WholeBodyConfig, layout: Layout, scene: Scene, swing: Swing, sole: FrameMotion, E: Array, e: Array
) -> None:
    """(16): the swing foot follows a cubic to where it lands, and stays level."""
    J, nv = sole.jacobian, layout.nv
    a, b = swing_acceleration(swing.remaining)
    if scene.settled is None:
        # J v' + J' v = a (p + dP - s) - b s', divided by a as long as dP is free: for the conditioning
        E[:2, :nv] = J[:2] / a
        E[0, layout.feet(0).start] = E[1, layout.feet(1).start] = -1.0
        e[:2] = (-sole.drift[:2] - b * sole.velocity[:2]) / a + scene.support - sole.position[:2]
    else:
        E[:2, :nv] = J[:2]
        e[:2] = a * (scene.settled - sole.position[:2]) - b * sole.velocity[:2] - sole.drift[:2]
    up = 0.5 * config.single_support - swing.elapsed
    rising = up >= 0.005 - 1e-9  # to the middle of the step first, then down; rounding decides nothing
    a, b = swing_acceleration(up if rising else swing.remaining)
    E[2, :nv] = J[2]
    e[2] = a * ((config.step_height if rising else 0.0) - sole.position[2]) - b * sole.velocity[2] - sole.drift[2]
    kd = 2.0 * math.sqrt(config.foot_kp)
    turn = -config.foot_kp * rotation_error(sole.rotation) - kd * sole.velocity[3:]
    E[3:6, :nv] = _TURN * J[3:]
    e[3:6] = _TURN * (turn - sole.drift[3:])


def _inequalities(
    config: WholeBodyConfig, model: RobotModel, layout: Layout, scene: Scene, distances: Sequence[Distance]
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """(6), (7), the joint torques, and the distances."""
    d, nv, n = scene.dynamics, layout.nv, model.n
    cones = 6 * layout.contacts
    rows = [distance.rows(d) for distance in distances]
    count = cones + 2 * n + sum(len(h) for _, h in rows)
    G, h = np.zeros((count, layout.size)), np.zeros(count)
    edges = friction_edges(config.friction)
    half_l, half_w = 0.5 * config.cop_length, 0.5 * config.cop_width
    # |mu_x| <= w f_z, |mu_y| <= l f_z (7); |mu_z| <= gamma f_z (6)
    lever = np.array([half_w, half_l, config.friction * math.hypot(half_l, half_w)])
    for k in range(layout.contacts):
        w = layout.wrench(k).start
        G[6 * k : 6 * k + 6, w : w + FACES] = np.tile(lever, 2)[:, None] * edges[2]
        G[6 * k : 6 * k + 3, w + FACES : w + FACES + 3] = -np.eye(3)
        G[6 * k + 3 : 6 * k + 6, w + FACES : w + FACES + 3] = np.eye(3)
    # tau = H_1 v' + h_1 - J_c,1' f, in units of the greatest torque
    most = np.minimum(model.effort_max, config.effort)
    tau = G[cones : cones + n]
    tau[:, :nv] = d.H[6:]
    for k, sole in enumerate(scene.stance):
        w = layout.wrench(k).start
        tau[:, w : w + FACES] = -scene.weight * (sole.jacobian[:3, 6:].T @ edges)
        tau[:, w + FACES : w + FACES + 3] = -scene.weight * sole.jacobian[3:, 6:].T
    tau /= most[:, None]
    G[cones + n : cones + 2 * n] = -tau
    h[cones : cones + n] = -1.0 - d.h[6:] / most
    h[cones + n : cones + 2 * n] = -1.0 + d.h[6:] / most
    at = cones + 2 * n
    for J, least in rows:
        G[at : at + len(least), :nv], h[at : at + len(least)] = J, least
        at += len(least)
    soft = np.ones(count, dtype=np.bool_)
    soft[:cones] = False
    return G, h, soft


def _bounds(config: WholeBodyConfig, model: RobotModel, layout: Layout, scene: Scene) -> tuple[Array, Array]:
    """(5), (9), (11) and (12)."""
    d, preview = scene.dynamics, scene.preview
    lower, upper = np.full(layout.size, -np.inf), np.full(layout.size, np.inf)
    lower[6 : layout.nv], upper[6 : layout.nv] = joint_bounds(model, d.q, d.v[6:], config.limit_time)
    for k in range(layout.contacts):
        w = layout.wrench(k).start
        lower[w : w + FACES] = 0.0
    for axis in (0, 1):
        lower[layout.cops(axis)], upper[layout.cops(axis)] = -preview.half[:, axis], preview.half[:, axis]
        lower[layout.feet(axis)], upper[layout.feet(axis)] = preview.lower[:, axis], preview.upper[:, axis]
        if scene.settled is not None:
            first = layout.feet(axis).start
            lower[first] = upper[first] = scene.settled[axis] - scene.support[axis]
    return lower, upper


def _capturability(layout: Layout, scene: Scene) -> tuple[Array, Array]:
    """(14): sum alpha_k z_k = xi_0 with z_0 = c_0 - zeta c''_0 and z_k = V0_k + V_k P + Z_k."""
    d, mass, preview = scene.dynamics, scene.mass, scene.preview
    alpha, xi = mass.alpha, mass.capture_point(d.com, d.com_velocity)
    E, e = np.zeros((2, layout.size)), np.zeros(2)
    for axis in (0, 1):
        E[axis, layout.com + axis] = -alpha[0] * mass.zeta
        E[axis, layout.cops(axis)] = alpha[1:]
        E[axis, layout.feet(axis)] = alpha[1:] @ preview.V
        e[axis] = xi[axis] - alpha[0] * d.com[axis] - alpha[1:] @ preview.V0[:, axis]
    return E, e


def _objectives(
    config: WholeBodyConfig, layout: Layout, scene: Scene, objectives: Sequence[Objective]
) -> tuple[Array, Array]:
    """(17) to (22) as 1/2 x'Hx + c'x."""
    d, mass, preview = scene.dynamics, scene.mass, scene.preview
    H, c = np.zeros((layout.size, layout.size)), np.zeros(layout.size)
    # (17) to (19), and whatever else is wanted of the accelerations
    rows = [(objective.jacobian(d), objective.acceleration(d), objective.weight) for objective in objectives]
    J, pi = np.vstack([row[0] for row in rows]), np.concatenate([row[1] for row in rows])
    weighted = J * np.repeat([row[2] for row in rows], [len(row[1]) for row in rows])[:, None]
    H[: d.nv, : d.nv] = J.T @ weighted
    c[: d.nv] = -(weighted.T @ pi)
    diagonal = np.full(layout.size, config.regularization)
    diagonal[d.nv : layout.com] += config.wrench_weight
    # (20) s''' = -a (p + dP - s) + b s'
    if scene.swing is not None and scene.sole is not None and scene.settled is None:
        a, b = swing_jerk(scene.swing.remaining)
        for axis in (0, 1):
            at = layout.feet(axis).start
            rest = a * (scene.sole.position[axis] - scene.support[axis]) + b * scene.sole.velocity[axis]
            diagonal[at] += config.jerk_weight * a * a
            c[at] -= config.jerk_weight * a * rest
    # (21) Z is counted from the middle of the feet
    diagonal[layout.cops(0).start : layout.cops(1).stop] += config.cop_weight
    # (22) z' over every interval, of z = offset + M (c''_0, Z, P)
    N = layout.intervals
    M = np.zeros((N + 1, 1 + N + layout.steps))
    M[0, 0] = -mass.zeta
    M[1:, 1 : N + 1] = np.eye(N)
    M[1:, N + 1 :] = preview.V
    D = np.diff(M, axis=0) / mass.interval
    HD = config.cop_velocity_weight * D.T @ D
    for axis in (0, 1):
        cops, feet = layout.cops(axis), layout.feet(axis)
        parts = ((layout.com + axis,), range(cops.start, cops.stop), range(feet.start, feet.stop))
        index = np.array([at for part in parts for at in part])
        offset = np.diff(np.append(d.com[axis], preview.V0[:, axis])) / mass.interval
        H[np.ix_(index, index)] += HD
        c[index] += config.cop_velocity_weight * (D.T @ offset)
    H[np.diag_indices_from(H)] += diagonal
    return H, c


def wrenches(config: WholeBodyConfig, layout: Layout, weight: float, x: Array) -> list[tuple[Array, Array]]:
    """Return force and moment of each contact (3), (4) [N, N m]."""
    edges = friction_edges(config.friction)
    found = []
    for k in range(layout.contacts):
        values = weight * x[layout.wrench(k)]
        found.append((edges @ values[:FACES], values[FACES:]))
    return found
