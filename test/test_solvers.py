"""Clarabel and DAQP: equal and optimal solutions, and the same error for infeasible programs."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import clarabel
import numpy as np
import pytest
from test_assembly import DT, KINDS, phase_of, setting
from walks import problem_at

from dqwalk_ros.errors import QPError
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.qp import ClarabelSolver, DaqpSolver, Problem, _ClarabelProgram, make_solver
from dqwalk_ros.simulation import make_controller
from dqwalk_ros.state import State

SOLVERS = {"clarabel": ClarabelSolver, "daqp": DaqpSolver}


def walked(kind, foot, count=15):
    """Problems along a short way into a phase."""
    model, phase = setting()[1], phase_of(kind, foot)
    q, solver = phase.q_start, ClarabelSolver()
    for _ in range(count):
        problem = problem_at(phase, Kinematics(model, q, phase.base), DT)
        yield problem
        q = q + 20 * DT * solver.solve(problem).u


def random_problem(rng, n=8, equalities=2, inequalities=12, scale=1.0):
    """A feasible problem with rows that matter: a random point satisfies all of it."""
    A, u = rng.normal(size=(3, n)), scale * rng.normal(size=n)
    E, G = rng.normal(size=(equalities, n)), rng.normal(size=(inequalities, n))
    H = A.T @ A + 0.01 * np.eye(n)
    slack = scale * rng.uniform(0.0, 0.5, inequalities) * (rng.random(inequalities) < 0.7)
    margin = scale * rng.uniform(0.0, 1.0, (2, n))
    c = scale * rng.normal(size=n) * 10.0
    names = tuple(f"row{k}" for k in range(equalities + inequalities + 2 * n))
    return Problem.of(H, c, E, E @ u, G, G @ u - slack, u - margin[0], u + margin[1], names)


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize(("kind", "foot"), KINDS)
def test_answers_are_optimal_on_the_way(kind, foot, name):
    solver = SOLVERS[name]()
    for problem in walked(kind, foot):
        solution = solver.solve(problem)
        assert solution.residuals(problem).largest < 1e-9
        assert np.abs(solution.u - ClarabelSolver().solve(problem).u).max() < 1e-9 * np.abs(solution.u).max()


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e3])
def test_answers_are_optimal_whatever_the_scale(name, scale):
    rng, solver = np.random.default_rng(3), SOLVERS[name]()
    for _ in range(40):
        problem = random_problem(rng, scale=scale)
        assert solver.solve(problem).residuals(problem).largest < 1e-7


@pytest.mark.parametrize("name", SOLVERS)
def test_rounding_is_no_motion_that_is_asked_for(name):
    rng, solver = np.random.default_rng(5), SOLVERS[name]()
    for _ in range(40):
        problem = random_problem(rng, n=12, equalities=6)
        still = dataclasses.replace(
            problem, c=np.zeros(12), w=np.minimum(problem.w, -0.1), lower=np.full(12, -0.3), upper=np.full(12, 0.3)
        )
        still.w[:6] = 1e-16 * rng.normal(size=6)
        assert np.abs(solver.solve(still).u).max() < 1e-12


@pytest.mark.parametrize("name", SOLVERS)
def test_no_answer_names_rows(name):
    solver, rng = SOLVERS[name](), np.random.default_rng(5)
    problem = random_problem(rng, equalities=0)
    solver.solve(problem)
    W, w = problem.W.copy(), problem.w.copy()
    W[1], w[1] = -W[0], 5.0 - w[0]
    with pytest.raises(QPError, match="row0") as caught:
        solver.solve(dataclasses.replace(problem, W=W, w=w))
    assert "row1" in caught.value.rows
    assert solver.solve(problem).residuals(problem).largest < 1e-7  # and it goes on


@pytest.mark.parametrize("name", SOLVERS)
def test_numbers_that_are_none_are_refused(name):
    if name == "daqp":
        pytest.importorskip("daqp")
    problem = random_problem(np.random.default_rng(5))
    for key in ("H", "c", "W", "w", "lower", "upper"):
        array = getattr(problem, key).copy()
        array.flat[-1] = np.nan
        with pytest.raises(QPError) as caught:
            SOLVERS[name]().solve(dataclasses.replace(problem, **{key: array}))
        assert caught.value.status == "NotFinite"


@pytest.mark.parametrize("lie", ["a bad status with good numbers", "a good status with bad numbers"])
def test_an_answer_counts_only_with_its_status_and_its_residuals(lie, monkeypatch):
    """A solver that ran out of time has plausible numbers, and one that says Solved may be wrong."""
    problem = random_problem(np.random.default_rng(5))
    solve = _ClarabelProgram.solve

    def lying(self):
        true, spent = solve(self)
        x, status = np.array(true.x), true.status
        if lie.startswith("a bad status"):
            status = clarabel.SolverStatus.MaxTime
        else:
            x += 1e-3
        return SimpleNamespace(status=status, x=x.tolist(), z=true.z, iterations=true.iterations), spent

    solver = ClarabelSolver()
    assert solver.solve(problem).residuals(problem).largest < 1e-7
    monkeypatch.setattr(_ClarabelProgram, "solve", lying)
    with pytest.raises(QPError) as caught:
        solver.solve(problem)
    assert ("MaxTime" in caught.value.status) is lie.startswith("a bad status")


def test_a_row_that_seemed_too_far_away_counts():
    """A valley takes the answer many gradient steps down, to a wall; the nearer walls say nothing."""
    problem = Problem.of(
        np.diag([1.0 + 1e-6, 1e-6, 1e-6]), np.array([-1.0, -1e-2, 0.0]), np.empty((0, 3)), np.empty(0),
        np.array([[0.0, -1.0, 0.0]]), np.array([-500.0]), np.array([-1e3, -1e3, -1.0]), np.array([1e3, 1e3, 1.0]),
        ("wall", *(f"{side} {i}" for side in ("upper", "lower") for i in range(3))),
    )  # fmt: skip
    solver = ClarabelSolver()
    solution = solver.solve(problem)
    assert solver.whole == 1
    np.testing.assert_allclose(solution.u, [1.0 / (1.0 + 1e-6), 500.0, 0.0], atol=1e-6)
    assert solution.active(problem) == ("wall",)
    assert solution.residuals(problem).largest < 1e-7


def test_a_walk_seldom_asks_for_all_rows():
    config, model = setting()
    solver = ClarabelSolver()
    controller, plant = make_controller(config, model), KinematicPlant(model)
    controller._solver = solver
    for _ in range(1000):
        plant.step(controller.step(plant.state, DT), DT)
    assert solver.whole <= 10


def test_walks_do_not_depend_on_the_solver():
    config, model = setting()
    ways = []
    for name in ("clarabel", "daqp"):
        controller = make_controller(config.updated({"qp.solver": name}), model)
        plant = KinematicPlant(model)
        state = State(0.0, np.zeros(model.n))
        for _ in range(2000):
            state = plant.step(controller.step(state, DT), DT)
        ways.append(state.q)
    assert np.abs(ways[0] - ways[1]).max() < 1e-12
    assert np.abs(ways[0]).max() > 1e-3


def test_daqp_answers_itself():
    solver = make_solver("daqp")
    for kind, foot in KINDS:
        for problem in walked(kind, foot, 5):
            solver.solve(problem)
    assert solver.fallbacks == 0
