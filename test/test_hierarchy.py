"""The hierarchy: exact on each level, however it is solved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dqwalk_ros.errors import QPError
from dqwalk_ros.qp import Problem
from dqwalk_ros.whole_body.dual import solve_dual
from dqwalk_ros.whole_body.hierarchy import ActiveSet, Hierarchy, HierarchySolver
from dqwalk_ros.whole_body.reference import solve_reference


def random_hierarchy(seed: int, n: int = 12, rows: int = 8) -> Hierarchy:
    """Return one with a point that satisfies levels 1 and 2."""
    rng = np.random.default_rng(seed)
    M, inside = rng.normal(size=(n, n)), 0.3 * rng.normal(size=n)
    A, E, G = rng.normal(size=(3, n)), rng.normal(size=(2, n)), rng.normal(size=(rows, n))
    lower, upper = np.full(n, -0.5), np.full(n, 0.5)
    inside = np.clip(inside, -0.45, 0.45)
    lower[: n // 3], upper[n // 2 :] = -np.inf, np.inf
    h = G @ inside - rng.random(rows)
    level1 = Problem(M.T @ M + 0.1 * np.eye(n), 5.0 * rng.normal(size=n), A, A @ inside, G, h, lower, upper)
    hard = np.zeros(n, dtype=bool)
    return Hierarchy(level1, E, E @ inside, np.zeros(3, dtype=bool), np.ones(rows, dtype=bool), hard)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1))
def test_the_active_set_is_exact(seed: int) -> None:
    """Every accepted answer satisfies the conditions of Karush, Kuhn and Tucker and is Clarabel's."""
    h = random_hierarchy(seed)
    problem = h.problem()
    answer = HierarchySolver().solve(h)
    assert answer.method in ("active set", "dual method")
    assert answer.residual < 1e-8
    assert answer.x == pytest.approx(solve_reference(problem, 1e-10).u, abs=1e-6)
    settled = ActiveSet().solve(problem)
    if settled is not None:
        finite = replace(problem, lower=np.maximum(problem.lower, -1e3), upper=np.minimum(problem.upper, 1e3))
        assert settled.residuals(finite).largest < 1e-7


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(0, 4))
def test_the_dual_method_is_exact(seed: int, fixed: int) -> None:
    """It satisfies the conditions of Karush, Kuhn and Tucker; with coordinates that are fixed, and rows that repeat."""
    problem = random_hierarchy(seed).problem()
    inside = solve_reference(replace(problem, H=np.eye(12), c=np.zeros(12)), 1e-10).u
    lower, upper = problem.lower.copy(), problem.upper.copy()
    lower[:fixed] = upper[:fixed] = inside[:fixed]
    E, e = np.vstack([problem.E, problem.E[0]]), np.append(problem.e, problem.e[0])
    G, h = np.vstack([problem.G, 2.0 * problem.G]), np.append(problem.h, 2.0 * problem.h)
    problem = replace(problem, E=E, e=e, G=G, h=h, lower=lower, upper=upper)
    solution = solve_dual(problem)
    finite = replace(problem, lower=np.maximum(lower, -1e3), upper=np.minimum(upper, 1e3))
    assert solution.residuals(finite).largest < 1e-7


def test_the_dual_method_says_why_there_is_no_answer() -> None:
    problem = random_hierarchy(3).problem()
    E, e = np.vstack([problem.E, problem.E[:1]]), np.append(problem.e, problem.e[0] + 1.0)
    with pytest.raises(QPError, match="contradict"):
        solve_dual(replace(problem, E=E, e=e))
    with pytest.raises(QPError, match="contradict"):
        solve_dual(replace(problem, G=np.vstack([problem.G, -problem.G]), h=np.append(problem.h, 1.0 - problem.h)))
    with pytest.raises(QPError, match="convex"):
        solve_dual(replace(problem, H=-problem.H))


def test_the_second_time_it_is_known() -> None:
    solver = HierarchySolver()
    counts = [solver.solve(random_hierarchy(1)).iterations for _ in range(2)]
    assert counts[1] == 1


def test_level_two_gives_way_by_the_least() -> None:
    """E x = e out of reach: level 1 is kept, ||E x - e|| is the least there is, and level 3 the best of those."""
    h = random_hierarchy(4)
    n = h.level1.c.shape[0]
    box = replace(h.level1, lower=np.full(n, -0.5), upper=np.full(n, 0.5))
    h = replace(h, level1=box, e=np.array([30.0, -20.0]))
    answer = HierarchySolver().solve(h)
    assert answer.method == "level 2 relaxed"
    assert np.abs(box.E @ answer.x - box.e).max() < 1e-6
    assert (box.G @ answer.x - box.h).min() > -1e-6
    assert np.abs(answer.x).max() < 0.5 + 1e-6
    nearest = solve_reference(replace(box, H=h.E.T @ h.E + 1e-9 * np.eye(n), c=-h.E.T @ h.e), 1e-10).u
    assert answer.residual == pytest.approx(float(np.linalg.norm(h.E @ nearest - h.e)), abs=1e-5)
    rng = np.random.default_rng(0)  # no point of level 1 near by is closer
    for _ in range(200):
        x = np.clip(answer.x + 0.01 * rng.normal(size=n), -0.5, 0.5)
        x = x - np.linalg.pinv(box.E) @ (box.E @ x - box.e)
        if (np.abs(x) <= 0.5).all() and (box.G @ x >= box.h).all():
            assert np.linalg.norm(h.E @ x - h.e) >= answer.residual - 1e-6


def test_level_one_gives_way_only_where_it_may() -> None:
    h = random_hierarchy(7)
    against = np.vstack([h.level1.G, -h.level1.G[:1]])
    least = np.append(h.level1.h, -h.level1.h[0] + 1.0)  # G_0 x >= h_0 and G_0 x <= h_0 - 1
    level1 = replace(h.level1, G=against, h=least)
    soft = np.zeros(9, dtype=bool)
    soft[[0, 8]] = True
    answer = HierarchySolver().solve(replace(h, level1=level1, soft_inequality=soft))
    assert answer.method == "level 1 relaxed"
    gap = against @ answer.x - least
    assert gap[[0, 8]] == pytest.approx([-0.5, -0.5], abs=1e-4)  # the least in the sense of least squares
    assert gap[1:8].min() > -1e-6
    assert answer.violation == pytest.approx(np.sqrt(0.5), abs=1e-3)
    with pytest.raises(QPError):
        HierarchySolver().solve(replace(h, level1=level1, soft_inequality=np.zeros(9, dtype=bool)))


def test_without_level_two() -> None:
    h = random_hierarchy(11)
    h = replace(h, E=h.E[:0], e=h.e[:0])
    answer = HierarchySolver().solve(h)
    assert answer.residual == 0.0
    assert answer.x == pytest.approx(solve_reference(h.level1, 1e-10).u, abs=1e-6)


def test_cold_and_hot_agree() -> None:
    for seed in range(5):
        h = random_hierarchy(seed + 100)
        assert HierarchySolver(hot=False).solve(h).x == pytest.approx(HierarchySolver().solve(h).x, abs=1e-5)
