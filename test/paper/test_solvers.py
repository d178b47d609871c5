"""The solvers: equal and optimal solutions, and the same error for infeasible programs."""

from __future__ import annotations

import sys
from functools import partial
from types import SimpleNamespace

import clarabel
import numpy as np
import pytest
from walks import DT, KINDS, phase_of, problem_at, problem_of, setting

from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.qp import make_solver
from dqwalk_ros.paper.qp.clarabel import ClarabelSolver, _ClarabelProgram
from dqwalk_ros.paper.state import State
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.support.errors import ConfigError, QPError
from dqwalk_ros.walks.table import make_controller

SOLVERS = {name: partial(make_solver, name) for name in ("clarabel", "daqp", "nnls")}


def walked(kind, foot, count=15):
    """Yield the problems of the first ticks of a phase."""
    model, phase = setting()[1], phase_of(kind, foot)
    q, solver = phase.q_start, ClarabelSolver()
    for _ in range(count):
        problem = problem_at(phase, Kinematics(model, q, phase.base), DT)
        yield problem
        q = q + 20 * DT * solver.solve(problem).u


def random_problem(rng, n=8, equalities=2, inequalities=12, scale=1.0):
    """Return a feasible problem, satisfied by a random point, with active rows."""
    A, u = rng.normal(size=(3, n)), scale * rng.normal(size=n)
    E, G = rng.normal(size=(equalities, n)), rng.normal(size=(inequalities, n))
    H = A.T @ A + 0.01 * np.eye(n)
    slack = scale * rng.uniform(0.0, 0.5, inequalities) * (rng.random(inequalities) < 0.7)
    margin = scale * rng.uniform(0.0, 1.0, (2, n))
    c = scale * rng.normal(size=n) * 10.0
    names = tuple(f"row{k}" for k in range(equalities + inequalities + 2 * n))
    return problem_of(H, c, E, E @ u, G, G @ u - slack, u - margin[0], u + margin[1], names)


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize(("kind", "foot"), KINDS)
def test_solutions_along_a_phase_are_optimal(kind, foot, name):
    solver = SOLVERS[name]()
    for problem in walked(kind, foot):
        solution = solver.solve(problem)
        assert solution.residuals(problem).largest < 1e-9
        assert np.abs(solution.u - ClarabelSolver().solve(problem).u).max() < 1e-9 * np.abs(solution.u).max()
    assert getattr(solver, "fallbacks", 0) == 0


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e3])
def test_solutions_are_optimal_at_every_scale(name, scale):
    rng, solver = np.random.default_rng(3), SOLVERS[name]()
    for _ in range(40):
        problem = random_problem(rng, scale=scale)
        assert solver.solve(problem).residuals(problem).largest < 1e-7


@pytest.mark.parametrize("name", SOLVERS)
def test_rounding_errors_cause_no_motion(name):
    rng, solver = np.random.default_rng(5), SOLVERS[name]()
    for _ in range(40):
        problem = random_problem(rng, n=12, equalities=6)
        still = problem.replaced(
            c=np.zeros(12), w=np.minimum(problem.w, -0.1), lower=np.full(12, -0.3), upper=np.full(12, 0.3)
        )
        still.w[:6] = 1e-16 * rng.normal(size=6)
        assert np.abs(solver.solve(still).u).max() < 1e-12


@pytest.mark.parametrize("name", SOLVERS)
def test_an_infeasible_problem_names_its_rows(name):
    solver, rng = SOLVERS[name](), np.random.default_rng(5)
    problem = random_problem(rng, equalities=0)
    solver.solve(problem)
    W, w = problem.W.copy(), problem.w.copy()
    W[1], w[1] = -W[0], 5.0 - w[0]
    with pytest.raises(QPError, match="row0") as caught:
        solver.solve(problem.replaced(W=W, w=w))
    assert "row1" in caught.value.rows
    assert solver.solve(problem).residuals(problem).largest < 1e-7  # the next problem is solved


def test_a_missing_daqp_is_explained(monkeypatch):
    monkeypatch.setitem(sys.modules, "daqp", None)
    with pytest.raises(ConfigError, match=r"daqp, which is not installed: pip install daqp, or --set qp.solver=clar"):
        make_solver("daqp")


def test_without_clarabel_scipy_solves(monkeypatch, caplog):
    """As on a machine with Ubuntu's packages only; also what DAQP cannot solve."""
    for module in ("clarabel", "dqwalk_ros.paper.qp.clarabel"):
        monkeypatch.setitem(sys.modules, module, None)
    assert make_solver("clarabel").name == "nnls"
    assert caplog.messages == [
        "clarabel is not installed (pip install clarabel): scipy's nnls solves the quadratic programs"
    ]
    solver, problem = make_solver("daqp"), random_problem(np.random.default_rng(5))
    W, w = problem.W.copy(), problem.w.copy()
    W[3], w[3] = -W[2], 5.0 - w[2]
    with pytest.raises(QPError, match="row2"):
        solver.solve(problem.replaced(W=W, w=w))
    assert solver.fallbacks == 1


@pytest.mark.parametrize("name", SOLVERS)
def test_nan_in_a_problem_is_an_error(name):
    if name == "daqp":
        pytest.importorskip("daqp")
    problem = random_problem(np.random.default_rng(5))
    for key in ("H", "c", "W", "w", "lower", "upper"):
        array = getattr(problem, key).copy()
        array.flat[-1] = np.nan
        with pytest.raises(QPError) as caught:
            SOLVERS[name]().solve(problem.replaced(**{key: array}))
        assert caught.value.status == "NotFinite"


@pytest.mark.parametrize("fault", ["a bad status with good numbers", "a good status with bad numbers"])
def test_a_solution_needs_a_valid_status_and_small_residuals(fault, monkeypatch):
    """A solver that ran out of time returns plausible numbers, and one with the status Solved may be wrong."""
    problem = random_problem(np.random.default_rng(5))
    solve = _ClarabelProgram.solve

    def faulty(self):
        true, spent = solve(self)
        x, status = np.array(true.x), true.status
        if fault.startswith("a bad status"):
            status = clarabel.SolverStatus.MaxTime
        else:
            x += 1e-3
        return SimpleNamespace(status=status, x=x.tolist(), z=true.z, iterations=true.iterations), spent

    solver = ClarabelSolver()
    assert solver.solve(problem).residuals(problem).largest < 1e-7
    monkeypatch.setattr(_ClarabelProgram, "solve", faulty)
    with pytest.raises(QPError) as caught:
        solver.solve(problem)
    assert ("MaxTime" in caught.value.status) is fault.startswith("a bad status")


def test_a_distant_row_that_becomes_active_is_respected():
    """In a flat valley the solution is many gradient steps away, at a wall; nearer walls are inactive."""
    problem = problem_of(
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


def test_a_walk_rarely_needs_all_rows():
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
    for name in SOLVERS:
        controller = make_controller(config.updated({"qp.solver": name}), model)
        plant = KinematicPlant(model)
        state = State(0.0, np.zeros(model.n))
        for _ in range(2000):
            state = plant.step(controller.step(state, DT), DT)
        ways.append(state.q)
    assert np.abs(np.subtract(ways[1:], ways[0])).max() < 1e-12
    assert np.abs(ways[0]).max() > 1e-3


@pytest.mark.parametrize("name", SOLVERS)
def test_an_indefinite_hessian_is_refused(name):
    problem = random_problem(np.random.default_rng(1))
    problem.H[:] = np.diag([-1.0, *np.ones(7)])
    with pytest.raises(QPError, match="not positive definite") as caught:
        SOLVERS[name]().solve(problem)
    assert caught.value.status == "NotConvex"
