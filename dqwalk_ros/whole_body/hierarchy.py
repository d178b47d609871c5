"""Hierarchical least squares: constraints first, then balance, then the objectives, section VI [Sherikov2014].

Rows lower <= (x, A x) <= upper have a level; the cost is the last level. If all rows are feasible, which is the usual
case, the hierarchy is one quadratic program. Otherwise the levels are solved in their order: the rows of each level are
relaxed by the least amount, in the sense of least squares, for which they are feasible together with the previous ones.

All programs are solved by the active-set solver DAQP, started from the active set of the previous control period.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import daqp
import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.paper.qp.daqp import EQUALITY, NO_BOUND
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import QPError

LAW, LIMIT, BALANCE = 0, 1, 2
"""Levels of rows: equations of motion and contact, which are never relaxed; the rest of level 1; level 2."""
_OPTIONS = {"primal_tol": 1e-9, "sing_tol": 1e-13, "iter_limit": 1000}
"""Options of DAQP: tolerance of the rows, tolerance for dependent active rows, and largest number of iterations."""
_HELD = 1e-7
"""Least multiplier of an active row."""


@dataclass(frozen=True)
class Hierarchy:
    """A hierarchical least-squares problem of three levels over x, shape (n,)."""

    H: Array
    c: Array
    """Cost 1/2 x'Hx + c'x of level 3, shapes (n, n), (n,); H is positive definite."""
    A: Array
    """Shape (m, n)."""
    lower: Array
    upper: Array
    """Bounds of x, then of A x, shape (n + m,); equal for an equality, infinite for an unbounded side."""
    level: NDArray[np.int_]
    """`LAW`, `LIMIT` or `BALANCE` for each bound and row, shape (n + m,)."""

    def violation(self, x: Array) -> Array:
        """Return the violation of each bound and row by x, shape (n + m,)."""
        rows = np.concatenate([x, self.A @ x])
        violation: Array = np.maximum(np.maximum(self.lower - rows, rows - self.upper), 0.0)
        return violation


@dataclass(frozen=True)
class Answer:
    """The solution of a hierarchy, its lexicographic optimum."""

    x: Array
    """Shape (n,)."""
    method: str
    """``"all rows hold"``, ``"level 2 relaxed"`` or ``"level 1 relaxed"``."""
    residual: float
    """Norm of the violation of the rows of level 2."""
    violation: float
    """Norm of the relaxation of the rows of level 1."""
    iterations: int
    """Number of changes of the active set."""
    solve_time: float
    """Time taken by the solver, measured by its clock [s]."""


class HierarchySolver:
    """Solves a sequence of hierarchies, each started from the active set of the previous one.

    Parameters
    ----------
    clock : callable
        Clock for `solve_time` [s].
    """

    def __init__(self, *, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self._multipliers: dict[tuple[int, ...], Array] = {}

    def solve(self, h: Hierarchy) -> Answer:
        """Return the solution of a hierarchy.

        Raises
        ------
        QPError
            If a number is not finite, or the rows of the level `LAW` contradict each other.
        """
        began = self._clock()
        if not np.isfinite(h.H.sum() + h.c.sum() + h.A.sum()) or np.isnan([h.lower, h.upper]).any():
            raise QPError("the hierarchy has a number that is not finite", status="NotFinite")
        method, violation = "all rows hold", 0.0
        x, iterations = self._program(h)
        if x is None:
            method, moved = "level 2 relaxed", _relaxed(h, BALANCE)
            if moved is None:  # level 1 alone cannot hold
                method, moved = "level 1 relaxed", _relaxed(h, LIMIT)
                if moved is None:
                    raise QPError("the equations of motion and contact have no solution", status="Infeasible")
                violation = float(np.linalg.norm(h.violation(moved[1])[h.level == LIMIT]))
                moved = _relaxed(moved[0], BALANCE) or moved
            x, iterations = self._program(moved[0])
            if x is None:  # the levels before it leave no freedom for level 3
                x = moved[1]
        residual = float(np.linalg.norm(h.violation(x)[h.level == BALANCE]))
        return Answer(x, method, residual, violation, iterations, self._clock() - began)

    def _program(self, h: Hierarchy) -> tuple[Array | None, int]:
        """Return the optimum subject to all rows (None if they are infeasible), and the number of iterations."""
        start = self._multipliers.get(h.A.shape)
        x, multipliers, iterations = _solve(h.H, h.c, h.A, h.lower, h.upper, dual_start=start)
        if x is not None:
            self._multipliers[h.A.shape] = multipliers
        return x, iterations


def _solve(H: Array, c: Array, A: Array, lower: Array, upper: Array, **options: Any) -> tuple[Array | None, Array, int]:
    """Minimise 1/2 x'Hx + c'x subject to lower <= (x, A x) <= upper by DAQP.

    Returns
    -------
    x : ndarray, shape (n,), or None
        None if DAQP finds no solution.
    multipliers : ndarray, shape (n + m,)
        Multipliers for the warm start of a similar problem.
    iterations : int
    """
    low, high = np.maximum(lower, -NO_BOUND), np.minimum(upper, NO_BOUND)
    sense = np.where(low < high, 0, EQUALITY).astype(np.int32)
    x, _, flag, info = daqp.solve(H, c, A, high, low, sense, **_OPTIONS, **options)
    return np.array(x) if flag == 1 and np.isfinite(x).all() else None, np.array(info["lam"]), info["iterations"]


def _relaxed(h: Hierarchy, level: int) -> tuple[Hierarchy, Array] | None:
    """Relax the rows of a level by the least squares for which they are feasible with the previous levels.

    All active and all relaxed rows have non-zero multipliers; they become equalities at the solution, so that a later
    level cannot change it.

    Returns
    -------
    moved : Hierarchy
        The hierarchy with these equalities.
    nearest : ndarray, shape (n,)
        The solution x.
    None
        Instead of both, if the previous levels are infeasible.
    """
    n = len(h.c)
    rows = np.vstack([np.eye(n), h.A])
    before, soft = np.flatnonzero(h.level < level), np.flatnonzero(h.level == level)
    # x, and a slack s per relaxed row: min 1/2 |s|^2 with lower <= A x + s <= upper; singular in x, so level 2 has
    # exact proximal steps; level 1, relaxed only when the robot falls, a small cost |x|^2, which avoids cycling
    weight, proximal = (1e-4, 0.0) if level == LIMIT else (0.0, 1e-6)
    k = len(soft)
    kept = np.concatenate([before, soft])
    A = np.zeros((len(kept), n + k))
    A[:, :n], A[len(before) :, n:] = rows[kept], np.eye(k)
    free = np.full(n + k, np.inf)
    lower, upper = np.concatenate([-free, h.lower[kept]]), np.concatenate([free, h.upper[kept]])
    H = np.diag(np.repeat([weight, 1.0], [n, k]))
    x, multipliers, _ = _solve(H, np.zeros(n + k), A, lower, upper, eps_prox=proximal)
    if x is None:
        return None
    nearest = x[:n]
    held = kept[np.abs(multipliers[n + k :]) > _HELD]
    lower, upper = h.lower.copy(), h.upper.copy()
    lower[held] = upper[held] = rows[held] @ nearest
    return replace(h, lower=lower, upper=upper), nearest
