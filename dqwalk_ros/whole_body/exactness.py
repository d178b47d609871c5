"""Are the equations and the answers what they should be? Each figure beside something computed another way."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.qp import Problem
from dqwalk_ros.robot import Foot, RobotModel
from dqwalk_ros.whole_body.controller import WholeBodyController
from dqwalk_ros.whole_body.dynamics import GRAVITY, Multibody
from dqwalk_ros.whole_body.hierarchy import HierarchySolver
from dqwalk_ros.whole_body.newton_euler import inverse_dynamics
from dqwalk_ros.whole_body.preview import PointMass
from dqwalk_ros.whole_body.reference import solve_reference
from dqwalk_ros.whole_body.rigid_plant import RigidPlant

__all__ = ["Answers", "Infeasible", "condensed_difference", "infeasible", "model_difference"]

Array = NDArray[np.float64]


def condensed_difference(mass: PointMass) -> float:
    """Return the largest difference between the coefficients of (14) in its two forms.

    c'_N + c''_N / omega of (10) stepped N times with A and B is omega e^(omega N T) (xi_0 - sum alpha_k z_k), as
    functions of the initial (c, c', c'') and of each z'_k; both are divided by that factor.
    """
    A, B, D = mass.matrices()
    N, T, w = mass.intervals, mass.interval, mass.omega
    last = np.array([0.0, 1.0, 1.0 / w]) / (w * math.exp(w * N * T))
    condensed = np.empty(3 + N)
    row = last
    for k in reversed(range(N)):
        condensed[3 + k] = row @ B
        row = row @ A
    condensed[:3] = row
    # xi_0 = c + c'/omega, and z_k = D x_0 + T (z'_0 + ... + z'_{k-1})
    short = np.empty(3 + N)
    short[:3] = np.array([1.0, 1.0 / w, 0.0]) - mass.alpha.sum() * D
    short[3:] = -T * np.cumsum(mass.alpha[:0:-1])[::-1]
    return float(np.abs(condensed - short).max())


def model_difference(model: RobotModel, motions: int = 8, seed: int = 0) -> tuple[float, float]:
    """Compare `dynamics` with what does not use pinocchio, over random motions.

    Returns
    -------
    forces : float
        H v' + h against Newton and Euler, link by link [N, N m].
    places : float
        Soles' places, axes and the CoM against the dual quaternions [m].
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


@dataclass
class Answers:
    """Watches a walk and says how exact its answers were.

    Attributes
    ----------
    every : int
        Clarabel is asked in every so many ticks.
    ticks, sampled : int
        How many were looked at, and how many of them compared with Clarabel.
    equality, inequality : float
        Largest residual of an equality and largest violation of an inequality of levels 1 and 2.
    acceleration : float
        Largest difference to the accelerations of Clarabel at 1e-9 [rad/s^2].
    """

    every: int = 20
    ticks: int = 0
    sampled: int = 0
    equality: float = 0.0
    inequality: float = 0.0
    acceleration: float = 0.0

    def __call__(self, controller: WholeBodyController) -> None:
        """Look at the last tick; one whose levels 1 and 2 could not both hold is not judged here."""
        h, answer, layout = controller.hierarchy, controller.answer, controller.layout
        if h is None or answer is None or layout is None or "relaxed" in answer.method:
            return
        problem, x = h.problem(), answer.x
        self.ticks += 1
        self.equality = max(self.equality, float(np.abs(problem.E @ x - problem.e).max()))
        self.inequality = max(self.inequality, _violation(problem, x))
        if self.ticks % self.every == 0:
            self.sampled += 1
            sure = solve_reference(problem, 1e-9).u
            off = float(np.abs(x[: layout.nv] - sure[: layout.nv]).max())
            self.acceleration = max(self.acceleration, off)

    def joined(self, other: Answers) -> Answers:
        """Return what both saw."""
        return Answers(
            self.every,
            self.ticks + other.ticks,
            self.sampled + other.sampled,
            max(self.equality, other.equality),
            max(self.inequality, other.inequality),
            max(self.acceleration, other.acceleration),
        )


@dataclass(frozen=True)
class Infeasible:
    """What became of a tick whose (14) is out of reach.

    Attributes
    ----------
    method : str
        How it was solved.
    level1 : float
        Largest violation of level 1.
    residual, least : float
        ||E x - e|| of the answer, and the least there is under level 1, found another way [m].
    """

    method: str
    level1: float
    residual: float
    least: float


def infeasible(config: Config, model: RobotModel, away: float = 0.6, when: float = 0.55) -> Infeasible:
    """Solve a tick whose capture point is moved away from the robot.

    Parameters
    ----------
    config : Config
    model : RobotModel
    away : float
        By how much, ahead [m].
    when : float
        Time of the tick [s].
    """
    controller = WholeBodyController(config, model)
    plant = RigidPlant(model, controller.start, pushed=config.whole_body.torso)
    for _ in range(round(when / config.dt) + 1):
        plant.step(controller.step(plant.state, config.dt), config.dt)
    assert controller.hierarchy is not None  # it has just made a step
    h = controller.hierarchy
    far = replace(h, e=h.e + np.array([away, 0.0]))
    answer = HierarchySolver().solve(far)
    p = h.level1
    level1 = max(float(np.abs(p.E @ answer.x - p.e).max()), _violation(p, answer.x))
    closest = replace(p, H=h.E.T @ h.E + 1e-9 * np.eye(len(p.c)), c=-h.E.T @ far.e)
    least = float(np.linalg.norm(h.E @ solve_reference(closest, 1e-10).u - far.e))
    return Infeasible(answer.method, level1, answer.residual, least)


def _violation(problem: Problem, x: Array) -> float:
    off = np.concatenate([problem.h - problem.G @ x, problem.lower - x, x - problem.upper])
    return max(0.0, float(off.max()))
