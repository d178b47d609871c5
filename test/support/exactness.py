"""Equations and solutions of the whole-body controller compared with independent computations."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial.transform import Rotation

from dqwalk_ros.config import Config
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.robot.model import RobotModel, load_model
from dqwalk_ros.robot.urdf import Urdf, moves, pose_of
from dqwalk_ros.support.errors import QPError
from dqwalk_ros.whole_body import BodyCommand, BodyState, Scenario, WholeBodyController, WholeBodyTrace, follow
from dqwalk_ros.whole_body.dynamics import Multibody
from dqwalk_ros.whole_body.experiments import make_body_plant
from dqwalk_ros.whole_body.hierarchy import BALANCE, Hierarchy, HierarchySolver
from dqwalk_ros.whole_body.preview import PointMass
from dqwalk_ros.whole_body.rigid_plant import RigidPlant

Array = NDArray[np.float64]


# ---------------------------------------------------------------------- the point mass


def discretized(mass: PointMass) -> tuple[Array, Array, Array]:
    """Return A (3, 3), B (3,), D (3,) of (S10) over T: x+ = A x + B z', z = D x with x = (c, c', c'')."""
    w, T = mass.omega, mass.interval
    sh, ch = math.sinh(w * T), math.cosh(w * T)
    A = np.array([[1.0, sh / w, (ch - 1.0) / w**2], [0.0, ch, sh / w], [0.0, w * sh, ch]])
    return A, np.array([T - sh / w, 1.0 - ch, -w * sh]), np.array([1.0, 0.0, -1.0 / w**2])


def condensed_difference(mass: PointMass) -> float:
    """Return the largest difference between the coefficients of (S14) in its two forms.

    c'_N + c''_N / omega of (S10) stepped N times with A and B is omega e^(omega N T) (xi_0 - sum alpha_k z_k), as
    functions of the initial (c, c', c'') and of each z'_k; both are divided by that factor.
    """
    A, B, D = discretized(mass)
    N, T, w = mass.intervals, mass.interval, mass.omega
    condensed, short = np.empty(3 + N), np.empty(3 + N)
    row = np.array([0.0, 1.0, 1.0 / w]) / (w * math.exp(w * N * T))
    for k in reversed(range(N)):
        condensed[3 + k] = row @ B
        row = row @ A
    condensed[:3] = row
    # xi_0 = c + c'/omega, and z_k = D x_0 + T (z'_0 + ... + z'_{k-1})
    short[:3] = np.array([1.0, 1.0 / w, 0.0]) - mass.alpha.sum() * D
    short[3:] = -T * np.cumsum(mass.alpha[:0:-1])[::-1]
    return float(np.abs(condensed - short).max())


# ---------------------------------------------------------------------- the multibody system


def model_difference(model: RobotModel, motions: int = 8, seed: int = 0) -> tuple[float, float]:
    """Compare `dynamics` with computations that do not use Pinocchio, over random motions.

    Returns
    -------
    forces : float
        H v' + h against Newton's and Euler's laws, link by link [N, N m].
    places : float
        Positions and axes of the soles, and the CoM, against the dual quaternions [m].
    """
    rng = np.random.default_rng(seed)
    soles = {foot: model.soles[foot].frame for foot in Foot}
    body, forces, places = Multibody(model, soles.values()), 0.0, 0.0
    for _ in range(motions):
        x = DQ(0.3 * rng.normal(size=8) * [0, 1, 1, 1, 0, 1, 1, 1]).exp()
        q = model.q_min + rng.random(model.n) * (model.q_max - model.q_min)
        v, a = rng.normal(size=(2, body.nv))
        d = body.at(x.vec8(), q, v)
        expected = inverse_dynamics(model, x.translation(), x.rotation_matrix(), q, v, a, GRAVITY)
        forces = max(forces, float(np.abs(d.H @ a + d.h - expected).max()))
        kin = Kinematics(model, q, Foot.LEFT)
        x_left = x * DQ(kin.pose(model.pelvis)).conj()
        places = max(places, float(np.abs(d.com - x_left.transform_point(kin.com)).max()))
        for frame in soles.values():
            pose = x_left * DQ(kin.pose(frame))
            places = max(places, float(np.abs(d.frames[frame].position - pose.translation()).max()))
            places = max(places, float(np.abs(d.frames[frame].rotation - pose.rotation_matrix()).max()))
    return forces, places


def inverse_dynamics(
    model: RobotModel, position: Array, rotation: Array, q: Array, v: Array, a: Array, gravity: float = GRAVITY
) -> Array:
    """Return the generalized forces H a + h of a motion, shape (6 + n,), by Newton's and Euler's laws link by link.

    It uses neither Pinocchio nor the package's kinematics, and serves as reference for both.

    Parameters
    ----------
    model : RobotModel
    position, rotation : ndarray, shapes (3,), (3, 3)
        Of the root link in the world.
    q : ndarray, shape (n,)
        [rad]
    v, a : ndarray, shape (6 + n,)
        Velocity and acceleration, of the base in its own axes first.
    gravity : float
        [m/s^2]
    """
    robot = Urdf(model.urdf, model.name)
    # v is expressed in rotating axes: its derivative in the world contains w x v in addition to R v'
    linear = rotation @ (a[:3] + np.cross(v[3:6], v[:3])) + [0.0, 0.0, gravity]
    root = _Link(model.root, position, rotation, rotation @ v[3:6], linear, rotation @ a[3:6], ())
    force = np.zeros(6 + model.n)
    for link in _links(robot, model, root, q, v[6:], a[6:]):
        body = robot.links[link.name].inertial
        arm, inertia = link.R @ body.origin[:3, 3], link.R @ body.inertia @ link.R.T
        f = body.mass * (link.linear + np.cross(link.angular, arm) + np.cross(link.w, np.cross(link.w, arm)))
        n = inertia @ link.angular + np.cross(link.w, inertia @ link.w)
        place = link.p + arm
        force[:3] += rotation.T @ f
        force[3:6] += rotation.T @ (n + np.cross(place - position, f))
        for index, axis, at in link.joints:
            force[6 + index] += axis @ (n + np.cross(place - at, f))
    return force


@dataclass(frozen=True)
class _Link:
    """A moving link in the world frame: position, axes, angular velocity, linear and angular acceleration."""

    name: str
    p: Array
    R: Array
    w: Array
    linear: Array
    angular: Array
    joints: tuple[tuple[int, Array, Array], ...]  # index, axis and position of each joint between root and link


def _links(robot: Urdf, model: RobotModel, root: _Link, q: Array, dq: Array, ddq: Array) -> Iterator[_Link]:
    """Yield every link of the model in motion, parents first."""
    waiting = [root]
    while waiting:
        link = waiting.pop()
        yield link
        for joint in robot.joints.values():
            if joint.parent != link.name:
                continue
            origin = pose_of(joint.origin)
            arm, R = link.R @ origin.translation(), link.R @ origin.rotation_matrix()
            p, w, angular, joints = link.p + arm, link.w, link.angular, link.joints
            linear = link.linear + np.cross(angular, arm) + np.cross(w, np.cross(w, arm))
            if moves(joint):
                i, z = model.joint_names.index(joint.name), R @ joint.axis
                R = R @ Rotation.from_rotvec(q[i] * np.asarray(joint.axis)).as_matrix()
                angular = angular + ddq[i] * z + np.cross(w, dq[i] * z)
                w, joints = w + dq[i] * z, (*joints, (i, z, p))
            waiting.append(_Link(joint.child, p, R, w, linear, angular, joints))


# ---------------------------------------------------------------------- the solutions


class CheckedController(WholeBodyController):
    """A controller whose solutions are checked, outside the measured computing times."""

    answers: Answers

    def step(self, state: BodyState, dt: float) -> BodyCommand:
        command = super().step(state, dt)
        self.answers.check(self)
        return command


def checked_walk(config: Config, scenario: Scenario) -> tuple[WholeBodyTrace, Answers]:
    """Simulate a walk and check the accuracy of its solutions; its times are CPU time of this process."""
    model = load_model(config.robot)
    controller = CheckedController(config, model, clock=time.process_time)
    controller.answers = Answers()
    plant = make_body_plant("rigid", config, model, controller.start)
    return follow(controller, plant, scenario), controller.answers


@dataclass
class Answers:
    """Accuracy of the solutions of a walk."""

    every: int = 20
    """Every how many ticks the solution is compared with Clarabel's."""
    ticks: int = 0
    sampled: int = 0
    """Number of ticks checked, and of those compared with Clarabel."""
    equality: float = 0.0
    inequality: float = 0.0
    """Largest residual of an equality and largest violation of an inequality of levels 1 and 2."""
    acceleration: float = 0.0
    """Largest difference from Clarabel's accelerations at tolerance 1e-9 [rad/s^2]."""

    def check(self, controller: WholeBodyController) -> None:
        """Check the last tick; a tick with relaxed constraints is left out."""
        tick = controller.last
        h, answer, nv = tick.problem, tick.answer, tick.scene.layout.nv
        if "relaxed" in answer.method:
            return
        self.ticks += 1
        violation, equal = h.violation(answer.x), h.lower == h.upper
        self.equality = max(self.equality, float(violation[equal].max()))
        self.inequality = max(self.inequality, float(violation[~equal].max()))
        if self.ticks % self.every == 0:
            self.sampled += 1
            off = float(np.abs(answer.x[:nv] - clarabel_solution(h)[:nv]).max())
            self.acceleration = max(self.acceleration, off)

    def joined(self, other: Answers) -> Answers:
        """Return the accuracy over both walks."""
        return Answers(
            self.every,
            self.ticks + other.ticks,
            self.sampled + other.sampled,
            max(self.equality, other.equality),
            max(self.inequality, other.inequality),
            max(self.acceleration, other.acceleration),
        )


def clarabel_solution(h: Hierarchy, tolerance: float = 1e-9) -> Array:
    """Return Clarabel's optimum of level 3 under levels 1 and 2, shape (n,).

    Raises
    ------
    QPError
        If levels 1 and 2 conflict, or Clarabel fails.
    """
    rows = sparse.vstack([sparse.identity(len(h.c)), sparse.csr_matrix(h.A)], format="csr")
    equal = h.lower == h.upper
    above, below = np.isfinite(h.upper) & ~equal, np.isfinite(h.lower) & ~equal
    A = sparse.csc_matrix(sparse.vstack([rows[equal], rows[above], -rows[below]]))
    b = np.concatenate([h.upper[equal], h.upper[above], -h.lower[below]])
    cones = [clarabel.ZeroConeT(int(equal.sum())), clarabel.NonnegativeConeT(int(above.sum() + below.sum()))]
    settings = clarabel.DefaultSettings()
    settings.verbose = settings.presolve_enable = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    P = sparse.triu(sparse.csc_matrix(h.H), format="csc")
    answer = clarabel.DefaultSolver(P, h.c, A, b, cones, settings).solve()
    x, status = np.array(answer.x), str(answer.status)
    if status != "Solved" and not (status == "AlmostSolved" and h.violation(x).max() < 1e-6):
        raise QPError(f"Clarabel finds no answer ({status})", status=status)
    return x


@dataclass(frozen=True)
class Infeasible:
    """Result of a tick whose (S14) is infeasible."""

    method: str
    """How it was solved."""
    level1: float
    """Largest violation of level 1."""
    residual: float
    least: float
    """Residual of level 2, and the least residual possible under level 1, computed independently [m]."""


def infeasible(config: Config, model: RobotModel, away: float = 0.6, when: float = 0.55) -> Infeasible:
    """Solve a tick whose desired capture point is shifted ahead, out of reach.

    Parameters
    ----------
    config : Config
    model : RobotModel
    away : float
        Shift [m].
    when : float
        Time of the tick [s].
    """
    controller = WholeBodyController(config, model)
    plant = RigidPlant(model, controller.start, pushed=config.whole_body.torso)
    for _ in range(round(when / config.dt) + 1):
        plant.step(controller.step(plant.state, config.dt), config.dt)
    h = controller.last.problem
    balance = np.flatnonzero(h.level == BALANCE)
    lower, upper = h.lower.copy(), h.upper.copy()
    lower[balance[0]] += away
    upper[balance[0]] += away
    answer = HierarchySolver().solve(replace(h, lower=lower, upper=upper))
    level1 = float(replace(h, lower=lower, upper=upper).violation(answer.x)[h.level < BALANCE].max())
    # the least ||E x - e||, by Clarabel and without the rows of level 2
    E, e = h.A[balance - len(h.c)], lower[balance]
    kept = h.level[len(h.c) :] < BALANCE
    bounds = np.concatenate([np.full(len(h.c), True), kept])
    nearest = Hierarchy(
        E.T @ E + 1e-9 * np.eye(len(h.c)), -E.T @ e, h.A[kept], lower[bounds], upper[bounds], h.level[bounds]
    )
    least = float(np.linalg.norm(E @ clarabel_solution(nearest, 1e-10) - e))
    return Infeasible(answer.method, level1, answer.residual, least)
