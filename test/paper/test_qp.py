"""Residuals and error messages of a quadratic program; `test_paper_walk.py` has the programs of a whole walk."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from robots import legs
from walks import exact, problem_at, problem_of

from dqwalk_ros.config import load
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.paper.qp import make_solver
from dqwalk_ros.paper.qp.clarabel import ClarabelSolver
from dqwalk_ros.paper.qp.problem import Problem
from dqwalk_ros.support.errors import QPError
from dqwalk_ros.walks.table import make_walk

DT = 0.005


def example_problem():
    config = load("paper")
    phase = make_walk(config, legs()).phase(PhaseKind.DOUBLE_SUPPORT, Foot.LEFT, np.full(10, 0.01))
    return problem_at(phase, Kinematics(legs(), np.full(10, 0.01), Foot.RIGHT), DT)


@pytest.mark.parametrize("residual", ["stationarity", "primal", "dual", "complementarity"])
def test_residuals_detect_a_wrong_solution(residual):
    problem = example_problem()
    right = make_solver("clarabel").solve(problem)
    assert right.residuals(problem).largest < 1e-9
    z = right.z.copy()
    l, n = problem.e.size, problem.c.size
    if residual == "stationarity":
        wrong = dataclasses.replace(right, u=right.u * 1.01)
    elif residual == "primal":
        wrong = dataclasses.replace(right, u=right.u + 1e-3 * np.linalg.pinv(problem.E)[:, 0])
    else:
        # a multiplier on an inactive row: of the wrong sign, or of the right one
        slack = problem.upper - right.u
        z[l + problem.h.size + int(np.argmax(slack[:n]))] += -0.1 if residual == "dual" else 0.1
        wrong = dataclasses.replace(right, z=z)
    assert getattr(wrong.residuals(problem), residual) > 1e-5


def test_active_rows_are_named():
    """Minimise |u - (1, -1, 0)|^2 with u_0 <= 1/2 and u_1 >= -1/4; both are active, the second more strongly."""
    none, eye = np.empty((0, 3)), np.eye(3)
    names = tuple(f"{end}/{k}" for end in ("max", "min") for k in "abc")
    bounds = np.array([-9.0, -0.25, -9.0]), np.array([0.5, 9.0, 9.0])
    problem = problem_of(eye, np.array([-1.0, 1.0, 0.0]), none, np.empty(0), none, np.empty(0), *bounds, names)
    solution = make_solver("clarabel").solve(problem)
    np.testing.assert_allclose(solution.u, [0.5, -0.25, 0.0], atol=1e-10)
    assert solution.active(problem) == ("min/b", "max/a")


def test_problems_of_other_sizes_do_not_disturb_a_careful_solution(monkeypatch):
    """A program of another number of inequalities must not be reused, even where only the third attempt succeeds."""
    attempt, careful_ones = ClarabelSolver._solved, []

    def only_careful(self, problem, s, curvature, chosen, *, careful=False):
        if not careful:
            raise QPError("", status="NotOptimal")
        careful_ones.append(problem.shape)
        return attempt(self, problem, s, curvature, chosen, careful=True)

    monkeypatch.setattr(ClarabelSolver, "_solved", only_careful)
    rng, solver, n = np.random.default_rng(0), make_solver("clarabel"), 6
    for m in (13, 4, 13, 2, 4):  # decreasing first: a larger program than that of the cache could crash the test
        G = rng.normal(size=(m, n))
        none, bounds = np.empty((0, n)), np.full(n, 3.0)
        rows = none, np.empty(0), G, -0.01 * np.ones(m)
        names = tuple(map(str, range(m + 2 * n)))
        problem = problem_of(np.eye(n), rng.normal(size=n), *rows, -bounds, bounds, names)
        np.testing.assert_allclose(solver.solve(problem).u, make_solver("clarabel").solve(problem).u, atol=1e-9)
        np.testing.assert_allclose(solver.solve(problem).u, exact(problem), atol=1e-7)
    assert len(careful_ones) == 15
    sizes = {program.posed[3].size for program in solver._programs.values()}  # of b
    assert sizes == {m + 2 * n for m in (13, 4, 2)}


@pytest.mark.parametrize("name", ["no_progress", "almost_solved"])
def test_a_problem_that_has_a_solution_is_solved_whatever_clarabels_status(name):
    """Of Poppy with free arms in double and in single support, after a push."""
    with np.load(Path(__file__).parents[1] / "data" / f"{name}.npz") as of:
        names = tuple(map(str, range(len(of["w"]) + 2 * len(of["c"]))))
        problem = Problem.of(**dict(of) | {"equalities": int(of["equalities"]), "names": names})
    np.testing.assert_allclose(make_solver("clarabel").solve(problem).u, exact(problem), atol=1e-6)


@pytest.mark.parametrize("far", [1e2, 1e4])
def test_a_distant_bound_that_becomes_active_is_respected(far):
    """A bound many gradient steps away, made active by a row with a large right-hand side."""
    eye, G = np.eye(2), np.array([[1.0, -1.0]])
    none = np.empty((0, 2))
    bounds = np.full(2, -2.0 * far), np.array([far / 2.0, 2.0 * far])
    names = ("push", "max/a", "max/b", "min/a", "min/b")
    problem = problem_of(eye, np.array([-1.0, 0.0]), none, np.empty(0), G, np.array([far]), *bounds, names)
    solution = make_solver("clarabel").solve(problem)
    np.testing.assert_allclose(solution.u, exact(problem), rtol=1e-9)
    assert solution.residuals(problem).largest < 1e-9


def test_unequal_bounds_that_are_all_far_away_do_not_keep_a_problem_from_being_solved():
    """Of joints with unequal speed limits at rest: clarabel alone fails at one of nine."""
    rng, n = np.random.default_rng(0), 6
    for equalities in (0, 1, 2, 3) * 10:
        J, E, none = rng.normal(size=(3, n)), rng.normal(size=(equalities, n)), np.empty((0, n))
        bounds, small = rng.choice([1.0, 2.0, 6.0], n, p=[0.7, 0.15, 0.15]), 1e-6 * rng.normal(size=n + equalities)
        rows = E, small[n:], none, np.empty(0)
        names = tuple(map(str, range(equalities + 2 * n)))
        problem = problem_of(J.T @ J + 1e-3 * np.eye(n), small[:n], *rows, -bounds, bounds, names)
        solution = make_solver("clarabel").solve(problem)
        assert solution.residuals(problem).largest < 1e-7
