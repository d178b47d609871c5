"""Infeasible quadratic programs: which rows conflict, and the return of a state that violates a constraint."""

from __future__ import annotations

import numpy as np
import pytest
from walks import problem_of

from dqwalk_ros.config import load
from dqwalk_ros.paper.qp import make_solver
from dqwalk_ros.paper.qp.infeasible import conflicts, explained, lead_back
from dqwalk_ros.paper.qp.problem import Problem
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.robot.model import RobotModel, load_model
from dqwalk_ros.support.errors import QPError
from dqwalk_ros.walks.table import make_controller


def problem(
    G: list[list[float]], h: list[float], E: list[list[float]] | None = None, e: list[float] | None = None
) -> Problem:
    n = len(G[0])
    eq = np.array(E or []).reshape(-1, n)
    names = [f"hold{i}" for i in range(len(eq))] + [f"row{i}" for i in range(len(G))]
    names += [f"max{i}" for i in range(n)] + [f"min{i}" for i in range(n)]
    return problem_of(
        np.eye(n),
        np.zeros(n),
        eq,
        np.array(e or []),
        np.array(G),
        np.array(h),
        np.full(n, -7.0),
        np.full(n, 7.0),
        tuple(names),
    )


def test_consistent_rows_have_no_conflict() -> None:
    assert conflicts(problem([[1.0, 0.0], [0.0, 1.0]], [-1.0, 0.5])) is None


def test_two_conflicting_rows_are_named_with_their_gap() -> None:
    """u0 >= 1 and -u0 >= -0.4 conflict by 0.6; u1 is not involved."""
    found = conflicts(problem([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]], [1.0, -0.4, 0.2]))
    assert found is not None
    assert sum(found.short.values()) == pytest.approx(0.6, abs=1e-8)
    assert {*found.short, *found.against} == {"row0", "row1"}
    assert "short by 0.6" in str(found)


def test_an_equality_in_conflict_with_a_bound() -> None:
    found = conflicts(problem([[0.0, 1.0]], [0.0], E=[[2.0, 0.0]], e=[20.0]))
    assert found is not None
    assert found.short == {"hold0": pytest.approx(6.0)} or found.short == {"max0": pytest.approx(3.0)}
    assert {*found.short, *found.against} == {"hold0", "max0"}


def test_the_error_contains_the_conflicting_rows() -> None:
    bad = problem([[1.0], [-1.0]], [1.0, -0.4])
    with pytest.raises(QPError) as caught:
        make_solver("clarabel").solve(bad)
    error = explained(caught.value, bad)
    assert set(error.rows) == {"row0", "row1"}
    assert sum(error.short.values()) == pytest.approx(0.6, abs=1e-8)
    assert "short by" in str(error)
    assert error.status == caught.value.status


def test_nonfinite_numbers_keep_the_solver_error() -> None:
    bad = problem([[1.0]], [float("nan")])
    error = QPError("x", status="NotFinite")
    assert explained(error, bad) is error
    with pytest.raises(QPError, match="no way back"):
        lead_back(bad)


def test_the_return_is_as_fast_as_the_limits_allow() -> None:
    """u0 >= 20 with |u0| <= 7: a fraction of 0.35 is feasible, and 0.9 of that is used."""
    relaxed, t = lead_back(problem([[1.0]], [20.0]))
    assert t == pytest.approx(0.9 * 0.35)
    u = make_solver("clarabel").solve(relaxed).u
    assert u[0] == pytest.approx(0.9 * 7.0, rel=1e-6)


def test_the_return_keeps_satisfied_rows() -> None:
    """u0 >= 2 is violated, u0 <= 0.5 is satisfied."""
    relaxed, t = lead_back(problem([[1.0], [-1.0]], [2.0, -0.5]))
    assert t == pytest.approx(0.9 * 0.25)
    np.testing.assert_allclose(relaxed.h, [2.0 * t, -0.5])


def test_an_infeasible_return_is_an_error() -> None:
    with pytest.raises(QPError, match="no way back"):
        lead_back(problem([[1.0], [-1.0]], [2.0, 0.0]))


# ---------------------------------------------------------------------- the robot


@pytest.fixture(scope="module")
def model() -> RobotModel:
    return load_model(load("paper").robot)


@pytest.mark.parametrize("joint", ["l_hip_x", "r_hip_x", "l_hip_z", "r_hip_z", "l_ankle_y", "r_ankle_y"])
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("beyond", [1e-9, 0.05])
def test_a_start_outside_a_limit_returns_inside(model: RobotModel, joint: str, side: float, beyond: float) -> None:
    """The violation never grows, and the velocity limits are kept."""
    config = load("paper")
    q = np.zeros(model.n)
    i = model.joint_names.index(joint)
    q[i] = model.q_max[i] + beyond if side > 0.0 else model.q_min[i] - beyond
    controller, plant = make_controller(config, model), KinematicPlant(model, q)
    out = beyond
    for _ in range(120):
        plant.step(controller.step(plant.state, config.dt), config.dt)
        now = float(np.maximum(plant.state.q - model.q_max, model.q_min - plant.state.q).max())
        assert now <= out + 1e-12
        out = max(now, 0.0)
    assert out <= beyond * np.exp(-0.9 * 0.6 * config.joints.eta) + 1e-6


@pytest.mark.parametrize("below", [1e-9, 1e-3, 0.03])
def test_a_start_below_the_pelvis_plane_rises_above_it(model: RobotModel, below: float) -> None:
    config = load("paper")
    from dqwalk_ros.paper.foot import Foot
    from dqwalk_ros.paper.kinematics import Kinematics

    q = np.zeros(model.n)
    for side in ("l", "r"):  # knees bent, so that the pelvis can rise
        for joint, angle in (("hip_y", -0.5), ("knee_y", 1.0), ("ankle_y", -0.5)):
            q[model.joint_names.index(f"{side}_{joint}")] = angle

    def height(q: np.ndarray) -> float:
        return float(Kinematics(model, q, Foot.RIGHT).point(model.pelvis)[2])

    config = config.updated({"pelvis.height": height(q) + below})
    controller, plant = make_controller(config, model), KinematicPlant(model, q)
    short = below
    for _ in range(60):
        plant.step(controller.step(plant.state, config.dt), config.dt)
        now = config.pelvis.height - height(plant.state.q)
        assert now <= short + 1e-6
        short = max(now, 0.0)
    assert short < 1e-5


def test_an_infeasible_posture_names_the_conflicting_rows(model: RobotModel) -> None:
    """Double support with one leg raised is infeasible."""
    q = np.zeros(model.n)
    i = model.joint_names.index("l_hip_y")
    q[i] = model.q_min[i]
    config = load("paper")
    controller, plant = make_controller(config, model), KinematicPlant(model, q)

    def walk() -> None:
        for _ in range(400):
            plant.step(controller.step(plant.state, config.dt), config.dt)

    with pytest.raises(QPError, match=r"short by .* against") as caught:
        walk()
    assert caught.value.short
    assert set(caught.value.short) <= set(controller.phase.assembly.rows.names)
