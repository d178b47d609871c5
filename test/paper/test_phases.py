"""The rows of (U6) to (U14) as written in the paper, from positions alone."""

from __future__ import annotations

import numpy as np
import pytest
from robots import configurations, legs
from walks import problem_at

from dqwalk_ros.config import load
from dqwalk_ros.paper.constraints import vfi
from dqwalk_ros.paper.features import Pose
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.paper.walk import PaperWalk

DT = 0.005
FLAT = load("paper")
LITERAL = FLAT.updated({"dsp.flat_feet": False})


def double(config, support, q_start=None):
    start = np.zeros(10) if q_start is None else q_start
    return PaperWalk(config, legs()).phase(PhaseKind.DOUBLE_SUPPORT, support, start)


def single(config, support):
    walk = PaperWalk(config, legs())
    x_d = walk.footstep(support)
    return walk.phase(PhaseKind.SINGLE_SUPPORT, support, np.zeros(10), x_d), x_d


def points(kin, foot):
    """Tip, heel and centre of a foot, which for the base foot are at rest."""
    sole = kin.model.soles[foot]
    return [kin.point(sole.frame, offset) for offset in (sole.tip, sole.heel, sole.center)]


def upright_distance(p, a, b, inside):
    """Distance of p to the upright plane through a and b, positive on the side of `inside`."""
    n = np.cross([0.0, 0.0, 1.0], b - a)
    n /= np.linalg.norm(n)
    n *= np.sign(n @ (inside - a))
    return n @ (p - a)


def rows_of(problem):
    """Every row as name -> (coefficients, right-hand side)."""
    l, m, n = problem.e.size, problem.h.size, problem.c.size
    A = np.concatenate([problem.E, problem.G, np.eye(n), np.eye(n)])
    b = np.concatenate([problem.e, problem.h, problem.upper, problem.lower])
    assert len(problem.names) == l + m + 2 * n
    return {name: (A[k], b[k]) for k, name in enumerate(problem.names)}


def near_zero(count=20, seed=30):
    """Configurations near the zero posture, as in the paper's walk."""
    return 0.05 * np.random.default_rng(seed).normal(size=(count, 10))


def test_rows_of_double_support(foot):
    start = np.full(10, 0.01)
    phase = double(FLAT, foot, start)
    base, end = foot.other, foot
    assert (phase.base, phase.name) == (base, f"double_support/{foot.value}")
    tip_start = points(Kinematics(legs(), start, base), end)[0]
    for q in near_zero():
        kin = Kinematics(legs(), q, base)
        rows = rows_of(problem_at(phase, kin, DT))
        tip, heel, center = points(kin, end)
        base_tip, base_heel, _ = points(kin, base)
        sliding = np.hypot(*(tip - tip_start)[:2])
        expected = {
            "ground": -5.0 * tip[2],  # (8)
            "sliding": 5.0 * (sliding**2 - 0.04**2),  # (7), times -1
            "tip_plane": -10.0 * upright_distance(kin.com, base_tip, tip, base_heel),  # (9)
            "back_plane": -20.0 * upright_distance(kin.com, base_heel, heel, base_tip),  # (10)
            "pelvis": -200.0 * (kin.point("pelvis")[2] - 0.2),  # (11); 500 1/s is more than 1/dt
        }
        for name, value in expected.items():
            assert rows[name][1] == pytest.approx(value, abs=1e-12), name
        problem = problem_at(phase, kin, DT)
        np.testing.assert_allclose(problem.upper, -10.0 * (q - legs().q_max), atol=1e-12)  # (12)
        np.testing.assert_allclose(problem.lower, -10.0 * (q - legs().q_min), atol=1e-12)  # (13)
        # the task: CoM over the present centre of the end foot
        sole = legs().soles[end]
        J = (kin.com_jacobian - kin.point_jacobian(sole.frame, sole.center))[:2]
        np.testing.assert_allclose(problem.H, J.T @ J + 0.1**2 * np.eye(10), atol=1e-15)
        np.testing.assert_allclose(problem.c, 0.05 * J.T @ (kin.com - center)[:2], atol=1e-15)


def test_rows_of_single_support(foot):
    phase, x_d = single(FLAT, foot)
    assert phase.base is foot
    for q in near_zero(seed=31):
        kin = Kinematics(legs(), q, foot)
        problem = problem_at(phase, kin, DT)
        rows = rows_of(problem)
        distance = np.hypot(*(kin.com - legs().soles[foot].center)[:2])
        assert rows["com_cylinder"][1] == pytest.approx(5.0 * (distance**2 - 0.05**2), abs=1e-12)  # (14), times -1
        assert rows["pelvis"][1] == pytest.approx(-200.0 * (kin.point("pelvis")[2] - 0.2), abs=1e-12)
        x = kin.pose(kin.swing)
        assert x[:4] @ x_d[:4] > 0.0
        J = Pose(kin.swing).jacobian(kin)
        np.testing.assert_allclose(problem.H, J.T @ J + 0.1**2 * np.eye(10), atol=1e-15)
        np.testing.assert_allclose(problem.c, 0.05 * J.T @ (x - x_d), atol=1e-15)
        assert problem.e.size == 0


def test_row_names():
    limits = [f"joint_{end}/{joint}" for end in ("max", "min") for joint in legs().joint_names]
    inequalities = ["sliding", "tip_plane", "back_plane", "pelvis"]
    assert list(double(LITERAL, Foot.LEFT).assembly.rows.names) == ["ground", *inequalities, *limits]
    flat = ["ground", "flat_pitch", "flat_roll"]
    assert list(double(FLAT, Foot.LEFT).assembly.rows.names) == [*flat, *inequalities, *limits]
    assert list(single(FLAT, Foot.LEFT)[0].assembly.rows.names) == ["com_cylinder", "pelvis", *limits]


def test_the_posture_task_is_optional():
    assert len(double(FLAT, Foot.LEFT).tasks) == 1
    weighted = double(FLAT.updated({"task.posture_weight": 0.02}), Foot.LEFT)
    assert [(task.name, task.weight) for task in weighted.tasks] == [("com", 1.0), ("posture", 0.02)]


def test_the_rate_is_capped_where_eta_dt_is_more_than_one():
    d, zero, free = np.array([0.01, 0.01]), np.zeros(2), np.full(2, np.inf)
    eta = np.array([500.0, 5.0])
    np.testing.assert_allclose(vfi(d, zero, eta, free, 0.005), [-2.0, -0.05])
    np.testing.assert_allclose(vfi(d, zero, eta, free, 0.001), [-5.0, -0.05])
    # at the capped rate one Euler step ends on the bound, not beyond it
    assert d[0] + 0.005 * vfi(d, zero, eta, free, 0.005)[0] == pytest.approx(0.0, abs=1e-17)
    np.testing.assert_allclose(vfi(-d, zero, eta, np.full(2, 0.03), 0.005), [0.03, 0.03])


def test_margins_move_the_joint_limits():
    config = FLAT.updated({"joints.margin": 0.01})
    q = configurations(legs(), 1)[0]
    wide, narrow = (problem_at(double(c, Foot.LEFT), Kinematics(legs(), q, Foot.RIGHT), DT) for c in (FLAT, config))
    np.testing.assert_allclose(wide.upper - narrow.upper, 0.1, atol=1e-12)
    np.testing.assert_allclose(narrow.lower - wide.lower, 0.1, atol=1e-12)


def test_a_walk_begins_inside_every_constraint(foot):
    """Section 5: "start inside the allowable regions to ensure the feasibility of (6)"."""
    phase = double(FLAT, foot)
    distances = phase.distances(np.zeros(10))
    for row in phase.constraints:
        assert distances[row.name] > 0.0, row.name
    for row in phase.equalities:
        assert distances[row.name] == pytest.approx(0.0, abs=1e-12)


def test_single_support_without_a_target_is_refused():
    with pytest.raises(ValueError, match="needs a swing target"):
        PaperWalk(FLAT, legs()).phase(PhaseKind.SINGLE_SUPPORT, Foot.LEFT, np.zeros(10))
