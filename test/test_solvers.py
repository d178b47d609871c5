"""Clarabel (dense and lifted) and DAQP: the same answers, optimal, and the same word where there is none."""

from __future__ import annotations

import dataclasses
import pickle
from types import SimpleNamespace

import clarabel
import numpy as np
import pytest
from test_assembly import DT, KINDS, phase_of, setting

from dqwalk_ros.controllers import State, make_controller
from dqwalk_ros.errors import QPError
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.phases import assemble
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.qp import Problem, make_solver
from dqwalk_ros.qp.active_set import DaqpSolver
from dqwalk_ros.qp.in_place import InPlace
from dqwalk_ros.qp.interior_point import ClarabelSolver

SOLVERS = {"dense": lambda: ClarabelSolver(False), "lifted": lambda: ClarabelSolver(True), "daqp": DaqpSolver}


def walked(kind, foot, count=15):
    """Problems along a short way into a phase."""
    model, phase = setting()[1], phase_of(kind, foot)
    q, solver = phase.q_start, ClarabelSolver()
    for _ in range(count):
        problem = assemble(phase, Kinematics(model, q, phase.base), DT)
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
    return Problem(H, c, E, E @ u, G, G @ u - slack, u - margin[0], u + margin[1], names, np.full(n, 0.01), A)


@pytest.mark.parametrize("lifted", [True, False])
def test_a_problem_is_the_same_in_one_buffer_and_in_arrays(lifted):
    made = random_problem(np.random.default_rng(2))
    made = made if lifted else dataclasses.replace(made, J=None, diagonal=None)
    given = [array.copy() for array in made.arrays]
    packed = Problem.of(made.values.copy(), made.sizes, made.names)
    for problem in (made, packed, pickle.loads(pickle.dumps(packed)), dataclasses.replace(packed, names=("a",))):
        assert problem.sizes == (8, 2, 12, 3 if lifted else 0)
        for array, same in zip(problem.arrays, given, strict=True):
            np.testing.assert_array_equal(array, same)
        if lifted:
            np.testing.assert_allclose(np.diag(problem.diagonal) + problem.J.T @ problem.J, problem.H, rtol=1e-12)
        else:
            assert problem.J is problem.diagonal is None
        np.testing.assert_array_equal(problem.values, made.values)
    packed.lower[3] = -0.25  # what is written to an array is in the buffer, and the other way round
    assert np.count_nonzero(packed.values != made.values) == 1
    with pytest.raises(AttributeError, match="no slack"):
        packed.slack  # noqa: B018


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize(("kind", "foot"), KINDS)
def test_answers_are_optimal_on_the_way(kind, foot, name):
    solver = SOLVERS[name]()
    for problem in walked(kind, foot):
        solution = solver.solve(problem)
        assert solution.residuals(problem).largest < 1e-9
        assert np.abs(solution.u - ClarabelSolver(False).solve(problem).u).max() < 1e-9 * np.abs(solution.u).max()


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e3])
def test_answers_are_optimal_whatever_the_scale(name, scale):
    rng, solver = np.random.default_rng(3), SOLVERS[name]()
    for _ in range(40):
        problem = random_problem(rng, scale=scale)
        assert solver.solve(problem).residuals(problem).largest < 1e-7


@pytest.mark.parametrize("name", SOLVERS)
def test_no_answer_names_rows(name):
    solver, rng = SOLVERS[name](), np.random.default_rng(5)
    problem = random_problem(rng, equalities=0)
    solver.solve(problem)
    G, h = problem.G.copy(), problem.h.copy()
    G[1], h[1] = -G[0], 5.0 - h[0]
    with pytest.raises(QPError, match="row0") as caught:
        solver.solve(dataclasses.replace(problem, G=G, h=h))
    assert "row1" in caught.value.rows
    assert solver.solve(problem).residuals(problem).largest < 1e-7  # and it goes on


@pytest.mark.parametrize("name", SOLVERS)
def test_numbers_that_are_none_are_refused(name):
    problem = random_problem(np.random.default_rng(5))
    for key in ("H", "c", "E", "e", "G", "h", "lower", "upper"):
        array = getattr(problem, key).copy()
        array.flat[-1] = np.nan
        with pytest.raises(QPError) as caught:
            SOLVERS[name]().solve(dataclasses.replace(problem, **{key: array}))
        assert caught.value.status == "NotFinite"


@pytest.mark.parametrize("lie", ["a bad status with good numbers", "a good status with bad numbers"])
def test_an_answer_counts_only_with_its_status_and_its_residuals(lie, monkeypatch):
    """A solver that ran out of time has plausible numbers, and one that says Solved may be wrong."""
    problem = random_problem(np.random.default_rng(5))
    run = InPlace.run

    def lying(self, **options):
        true, spent = run(self, **options)
        x, status = np.array(true.x), true.status
        if lie.startswith("a bad status"):
            status = clarabel.SolverStatus.MaxTime
        else:
            x += 1e-3
        return SimpleNamespace(status=status, x=x.tolist(), z=true.z, iterations=true.iterations), spent

    solver = SOLVERS["dense"]()
    assert solver.solve(problem).residuals(problem).largest < 1e-7
    monkeypatch.setattr(InPlace, "run", lying)
    with pytest.raises(QPError) as caught:
        solver.solve(problem)
    assert ("MaxTime" in caught.value.status) is lie.startswith("a bad status")


@pytest.mark.parametrize("lifted", [False, True])
def test_a_row_that_seemed_too_far_away_counts(lifted):
    """A valley takes the answer many gradient steps down, to a wall; the nearer walls say nothing."""
    J, diagonal = np.array([[1.0, 0.0, 0.0]]), np.full(3, 1e-6)
    problem = Problem(
        np.diag(diagonal) + J.T @ J, np.array([-1.0, -1e-2, 0.0]), np.empty((0, 3)), np.empty(0),
        np.array([[0.0, -1.0, 0.0]]), np.array([-500.0]), np.array([-1e3, -1e3, -1.0]), np.array([1e3, 1e3, 1.0]),
        ("wall", *(f"{side} {i}" for side in ("upper", "lower") for i in range(3))), diagonal, J,
    )  # fmt: skip
    solver = ClarabelSolver(lifted)
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
