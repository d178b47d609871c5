"""The vector-field inequality in sampled time: what one period does to each distance, at random states.

The curvature that a row is granted is that of a point over a fixed plane (`rows.sampled`). A wall, (U9) or
(U10), contains a point of the sliding foot, and curves more: commands that use all that the rows allow show it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dqwalk_ros.config import load, with_files
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.paper.qp import make_solver
from dqwalk_ros.paper.qp.problem import Problem
from dqwalk_ros.paper.rows import least_after
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.errors import QPError
from dqwalk_ros.walks.table import make_walk

WALLS = ("tip_plane", "back_plane")


@pytest.mark.parametrize(
    ("of_walk", "count"),
    [
        (True, 60),
        (False, 60),
        pytest.param(True, 25_000, marks=pytest.mark.long),
        pytest.param(False, 500, marks=pytest.mark.long),
    ],
)
@pytest.mark.parametrize(
    ("name", "params"),
    [("paper", []), ("poppy", ["arms"]), ("poppy_dynamic", ["arms"]), ("poppy_dynamic_50hz", ["arms"])],
)
def test_a_period_brings_no_distance_nearer_to_its_bound_than_eta_and_the_curvature_allow(
    name: str, params: list[str], count: int, *, of_walk: bool
) -> None:
    """Whatever the state is in which the bounds are kept (`rows.least_after`), with R the height of the CoM.

    The command is that of the walk, or any other one that the rows allow; then a wall gets three times the curvature.
    """
    config = with_files(load(name), [Path(one) for one in params])
    model, rng, solver, dt = load_model(config.robot), np.random.default_rng(1), make_solver("daqp"), config.dt
    fastest = np.minimum(model.velocity_max, config.joints.velocity or np.inf)
    walk, kept, phases = make_walk(config, model), 0, []
    for kind in (PhaseKind.DOUBLE_SUPPORT, PhaseKind.SINGLE_SUPPORT):
        for foot in Foot:
            ahead = DQ.from_pose(rng.uniform([0.02, -0.01, -0.01], [0.05, 0.01, 0.01]))
            landing = ahead * DQ(Kinematics(model, walk.posture, foot).pose(model.soles[foot.other].frame))
            single = kind is PhaseKind.SINGLE_SUPPORT
            phases.append(walk.phase(kind, foot, walk.posture, landing.vec8() if single else None))
    while kept < count:
        phase = phases[rng.integers(len(phases))]
        q = walk.posture + rng.uniform(0.0, 0.3) * rng.uniform(-1.0, 1.0, model.n)
        now, rows = phase.evaluate(q, dt=dt, velocity=fastest), phase.assembly.rows
        if (now.margins[rows.equalities :] < 0.0).any():
            continue
        of = now.problem
        H, c = (of.H, of.c) if of_walk else (np.eye(model.n), rng.normal(0.0, 10.0, model.n))
        try:  # the inequalities alone: random soles are not on the ground
            u = solver.solve(Problem.of(H, c, of.G, of.h, of.lower, of.upper, names=of.names[rows.equalities :])).u
        except QPError:
            continue
        kept += 1
        turned = np.abs(dt * u).sum()
        least = least_after(now.margins, rows.numbers, rows.near, rows.radius, turned, dt, dt)
        left = phase.evaluate(q + dt * u).margins - least
        if not of_walk:
            left += np.isin(rows.names, WALLS) * rows.radius * turned**2
        assert (left[rows.equalities :] >= -1e-12).all(), rows.names[rows.equalities + left[rows.equalities :].argmin()]
