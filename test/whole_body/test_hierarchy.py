"""The hierarchical solver: exact on each level, for feasible and infeasible rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exactness import clarabel_solution
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from dqwalk_ros.support.errors import QPError
from dqwalk_ros.whole_body.hierarchy import BALANCE, LAW, LIMIT, Hierarchy, HierarchySolver

N, EQUALITIES, INEQUALITIES = 12, 3, 8
E = slice(N + EQUALITIES + INEQUALITIES, None)  # the two rows of level 2, which come last


def random_hierarchy(seed: int, fixed: int = 0) -> Hierarchy:
    """Return a feasible hierarchy of bounds, equalities, inequalities and level 2.

    The last `fixed` coordinates have equal upper and lower bounds.
    """
    rng = np.random.default_rng(seed)
    M, feasible = rng.normal(size=(N, N)), np.clip(0.3 * rng.normal(size=N), -0.45, 0.45)
    A = rng.normal(size=(EQUALITIES + INEQUALITIES + 2, N))
    lower = np.concatenate([np.full(N, -0.5), A @ feasible])
    upper = np.concatenate([np.full(N, 0.5), A @ feasible])
    lower[: N // 3], upper[N // 2 : N] = -np.inf, np.inf
    lower[N - fixed : N] = upper[N - fixed : N] = feasible[N - fixed :]
    soft = slice(N + EQUALITIES, N + EQUALITIES + INEQUALITIES)
    lower[soft] -= rng.random(INEQUALITIES)
    upper[soft] = np.inf
    level = np.full(len(lower), LAW)
    level[soft], level[E] = LIMIT, BALANCE
    return Hierarchy(M.T @ M + 0.1 * np.eye(N), 5.0 * rng.normal(size=N), A, lower, upper, level)


def with_bounds(h: Hierarchy, rows: slice | list[int], lower: object, upper: object) -> Hierarchy:
    """Return the hierarchy with changed bounds of some rows."""
    h = replace(h, lower=h.lower.copy(), upper=h.upper.copy())
    h.lower[rows], h.upper[rows] = lower, upper
    return h


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(0, 4))
def test_solutions_satisfy_the_karush_kuhn_tucker_conditions(seed: int, fixed: int) -> None:
    """All rows hold, and the gradient of the cost is a combination of the active rows with multipliers >= 0.

    Some coordinates are fixed, and every row is duplicated.
    """
    h = random_hierarchy(seed, fixed)
    twice = [np.concatenate([column, column[N:]]) for column in (h.lower, h.upper, h.level)]
    h = Hierarchy(h.H, h.c, np.vstack([h.A, h.A]), *twice)
    answer = HierarchySolver().solve(h)
    x = answer.x
    assert answer.method == "all rows hold"
    assert h.violation(x).max() < 1e-8
    rows, values = np.vstack([np.eye(N), h.A]), np.concatenate([x, h.A @ x])
    signs = [(rows, np.abs(values - h.lower) < 1e-7), (-rows, np.abs(values - h.upper) < 1e-7)]
    active = np.vstack([part[at] for part, at in signs])
    gradient = h.H @ x + h.c
    _, residual = nnls(active.T, gradient, maxiter=1000)
    assert residual < 1e-6 * max(1.0, float(np.linalg.norm(gradient)))


def test_the_active_set_is_warm_started() -> None:
    solver = HierarchySolver()
    first, second = (solver.solve(random_hierarchy(1)) for _ in range(2))
    assert second.iterations == 1 < first.iterations
    assert second.x == pytest.approx(first.x, abs=1e-12)


def test_level_two_is_relaxed_by_the_least_residual() -> None:
    """E x = e infeasible: level 1 is kept, ||E x - e|| is minimal, and level 3 is optimal among these solutions."""
    h = with_bounds(with_bounds(random_hierarchy(4), slice(0, N), -0.5, 0.5), E, [30.0, -20.0], [30.0, -20.0])
    answer = HierarchySolver().solve(h)
    assert answer.method == "level 2 relaxed"
    assert answer.violation == pytest.approx(0.0, abs=1e-9)
    assert h.violation(answer.x)[h.level < BALANCE].max() < 1e-7
    rows, e = h.A[-2:], h.lower[E]
    kept = np.concatenate([np.full(N, True), h.level[N:] < BALANCE])
    without = Hierarchy(
        rows.T @ rows + 1e-9 * np.eye(N), -rows.T @ e, h.A[:-2], h.lower[kept], h.upper[kept], h.level[kept]
    )
    nearest = clarabel_solution(without, 1e-10)
    assert answer.residual == pytest.approx(float(np.linalg.norm(rows @ nearest - e)), abs=1e-6)
    best = with_bounds(h, E, rows @ nearest - 1e-7, rows @ nearest + 1e-7)  # level 3 at this residual of level 2
    assert answer.x == pytest.approx(clarabel_solution(best), abs=1e-4)


def test_only_limits_of_level_one_are_relaxed() -> None:
    """Two contradicting limits of level 1 are violated equally; contradicting laws are an error."""
    h = random_hierarchy(7)
    first = N + EQUALITIES
    rows = np.vstack([h.A, h.A[EQUALITIES]])  # the first inequality, and an upper bound 1 below its lower bound
    h = Hierarchy(
        h.H,
        h.c,
        rows,
        np.append(h.lower, -np.inf),
        np.append(h.upper, h.lower[first] - 1.0),
        np.append(h.level, LIMIT),
    )
    answer = HierarchySolver().solve(h)
    assert answer.method == "level 1 relaxed"
    violation = h.violation(answer.x)
    assert violation[[first, -1]] == pytest.approx([0.5, 0.5], abs=1e-4)  # the least-squares solution
    assert violation[h.level == LAW].max() < 1e-8
    violation[[first, -1]] = 0.0
    assert violation.max() < 1e-4  # the other rows are hardly violated
    assert answer.violation == pytest.approx(np.sqrt(0.5), abs=1e-4)
    with pytest.raises(QPError, match="equations of motion"):
        HierarchySolver().solve(replace(h, level=np.where(h.level == LIMIT, LAW, h.level)))


def test_without_level_two() -> None:
    h = random_hierarchy(11)
    h = Hierarchy(h.H, h.c, h.A[:-2], h.lower[: E.start], h.upper[: E.start], h.level[: E.start])
    answer = HierarchySolver().solve(h)
    assert answer.residual == 0.0
    assert answer.x == pytest.approx(clarabel_solution(h, 1e-10), abs=1e-6)


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_nonfinite_hierarchies_are_rejected(number: float) -> None:
    h = random_hierarchy(2)
    with pytest.raises(QPError, match="finite"):
        HierarchySolver().solve(replace(h, c=np.full(N, number)))
    with pytest.raises(QPError, match="finite"):
        HierarchySolver().solve(with_bounds(h, slice(0, 1), np.nan, 1.0))
