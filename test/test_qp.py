"""The quadratic programs of whole walks: Karush-Kuhn-Tucker conditions, and comparison with an exact solution."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import quadprog
from robots import legs
from walks import paper_walk, problem_at

from dqwalk_ros.config import load
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.qp import Problem, make_solver
from dqwalk_ros.robot import Foot
from dqwalk_ros.simulation import make_walk
from dqwalk_ros.walk import PhaseKind

DT = 0.005
WALKS = [
    pytest.param("left", True, 25, id="left-flat"),
    *(
        pytest.param(first, flat, 1, marks=pytest.mark.long, id=name)
        for first in ("left", "right")
        for flat, name in ((True, f"{first}-flat-all"), (False, f"{first}-literal-all"))
    ),
]
"""First support foot, flat feet or the literal (8), and the interval between tested quadratic programs."""


def exact(problem: Problem) -> np.ndarray:
    """Goldfarb and Idnani's dual active-set method, on the problem in units of its own gradient."""
    s = np.abs(problem.c).max() / np.abs(problem.H).max()
    n = problem.c.size
    A = np.concatenate([problem.E, problem.G, -np.eye(n), np.eye(n)])
    b = np.concatenate([problem.e, problem.h, -problem.upper, problem.lower]) / s
    H = problem.H / np.abs(problem.H).max()
    c = problem.c / np.abs(problem.c).max()
    return s * quadprog.solve_qp(H, -c, A.T.copy(), b, problem.e.size)[0]


@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("first", "flat", "every"), WALKS)
def test_solutions_along_a_walk_are_exact(first, flat, every):
    """KKT residuals are below 1e-9, and the exact solution agrees to 1e-9; every program of a phase's first second."""
    trace = paper_walk(first, flat)
    solver = make_solver("clarabel")
    starts = [record.start for record in trace.phases]
    worst, deviation, count, limit = 0.0, 0.0, 0, trace.model.velocity_max
    for record, end in zip(trace.phases, [*starts[1:], len(trace) - 1], strict=True):
        phase = make_walk(trace.config, trace.model).phase(
            record.kind, record.support, record.q_start, record.swing_target
        )
        for tick in [*range(record.start, record.start + 200), *range(record.start + 200, end, every)]:
            problem = problem_at(phase, Kinematics(trace.model, trace.q[tick], phase.base), DT, limit)
            solution = solver.solve(problem)
            worst = max(worst, solution.residuals(problem).largest)
            u = exact(problem)
            deviation = max(deviation, np.abs(solution.u - u).max() / np.abs(u).max())
            # and the walk used this solution
            np.testing.assert_allclose(solution.u, trace.u[tick], rtol=0, atol=1e-9 * np.abs(u).max())
            count += 1
    assert count > 2000
    assert worst < 1e-9
    assert deviation < 1e-9


# ---------------------------------------------------------------------- residuals and error messages


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
    l, n = problem.e.size, problem.c.size  # noqa: E741
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
    problem = Problem.of(eye, np.array([-1.0, 1.0, 0.0]), none, np.empty(0), none, np.empty(0), *bounds, names)
    solution = make_solver("clarabel").solve(problem)
    np.testing.assert_allclose(solution.u, [0.5, -0.25, 0.0], atol=1e-10)
    assert solution.active(problem) == ("min/b", "max/a")


@pytest.mark.parametrize("far", [1e2, 1e4])
def test_a_distant_bound_that_becomes_active_is_respected(far):
    """A bound many gradient steps away, made active by a row with a large right-hand side."""
    eye, G = np.eye(2), np.array([[1.0, -1.0]])
    none = np.empty((0, 2))
    bounds = np.full(2, -2.0 * far), np.array([far / 2.0, 2.0 * far])
    names = ("push", "max/a", "max/b", "min/a", "min/b")
    problem = Problem.of(eye, np.array([-1.0, 0.0]), none, np.empty(0), G, np.array([far]), *bounds, names)
    solution = make_solver("clarabel").solve(problem)
    np.testing.assert_allclose(solution.u, exact(problem), rtol=1e-9)
    assert solution.residuals(problem).largest < 1e-9
