"""Hierarchical least squares: constraints first, then balance, then the objectives, section VI [Sherikov2014].

Rows lower <= (x, A x) <= upper have a level, and the cost comes last. Nearly always all rows can hold, and the
hierarchy is one quadratic program. Where they cannot, the levels are solved in order: the rows of each are moved
by the least, in the sense of least squares, that lets them hold together with the levels before it.

DAQP solves every program: an active-set method, exact to rounding, started from the active set of the tick before.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import daqp
import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.errors import QPError

__all__ = ["BALANCE", "LAW", "LIMIT", "Answer", "Hierarchy", "HierarchySolver"]

Array = NDArray[np.float64]

LAW, LIMIT, BALANCE = 0, 1, 2
"""Levels of rows: laws of motion and contact, which never give way, and the rest of level 1; level 2."""
_EQUALITY = 5
"""What DAQP calls an equality."""
_INFINITE = 1e30
"""What DAQP takes for no bound."""
_OPTIONS = {"primal_tol": 1e-9, "sing_tol": 1e-13, "iter_limit": 1000}
"""Of DAQP: largest violation of a row, and how nearly dependent the active rows may be."""
_HELD = 1e-7
"""A row with a multiplier beyond this holds others back."""


@dataclass(frozen=True)
class Hierarchy:
    """Least squares of three levels over x, shape (n,).

    Attributes
    ----------
    H, c : ndarray, shapes (n, n), (n,)
        Cost 1/2 x'Hx + c'x of level 3; H is positive definite.
    A : ndarray, shape (m, n)
    lower, upper : ndarray, shape (n + m,)
        Bounds of x, then of A x; equal for an equality, infinite for none.
    level : ndarray of int, shape (n + m,)
        `LAW`, `LIMIT` or `BALANCE`, of each bound and row.
    """

    H: Array
    c: Array
    A: Array
    lower: Array
    upper: Array
    level: NDArray[np.int_]

    def violation(self, x: Array) -> Array:
        """Return by how much x violates each bound and row, shape (n + m,)."""
        rows = np.concatenate([x, self.A @ x])
        violation: Array = np.maximum(np.maximum(self.lower - rows, rows - self.upper), 0.0)
        return violation


@dataclass(frozen=True)
class Answer:
    """The lexicographic optimum.

    Attributes
    ----------
    x : ndarray, shape (n,)
    method : str
        ``"all rows hold"``, ``"level 2 relaxed"`` or ``"level 1 relaxed"``.
    residual : float
        By how much the rows of level 2 are missed, in the norm of least squares.
    violation : float
        By how much those of level 1 had to give way.
    iterations : int
        Changes of the active set.
    solve_time : float
        [s], by the clock that the solver was given.
    """

    x: Array
    method: str
    residual: float
    violation: float
    iterations: int
    solve_time: float


class HierarchySolver:
    """Solves one hierarchy after the other.

    Parameters
    ----------
    clock : callable
        Measures `solve_time` [s].
    """

    def __init__(self, *, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self._multipliers: dict[tuple[int, ...], Array] = {}

    def solve(self, h: Hierarchy) -> Answer:
        """Return the answer.

        Raises
        ------
        QPError
            If a number is not finite, or the rows that never give way contradict each other.
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
                    raise QPError("no motion obeys the laws of motion and of contact", status="Infeasible")
                violation = float(np.linalg.norm(h.violation(moved[1])[h.level == LIMIT]))
                moved = _relaxed(moved[0], BALANCE) or moved
            x, iterations = self._program(moved[0])
            if x is None:  # there is no room left for level 3
                x = moved[1]
        residual = float(np.linalg.norm(h.violation(x)[h.level == BALANCE]))
        return Answer(x, method, residual, violation, iterations, self._clock() - began)

    def _program(self, h: Hierarchy) -> tuple[Array | None, int]:
        """Return the optimum under all rows, None if the rows contradict each other, and the number of iterations."""
        start = self._multipliers.get(h.A.shape)
        x, multipliers, iterations = _solve(h.H, h.c, h.A, h.lower, h.upper, dual_start=start)
        if x is not None:
            self._multipliers[h.A.shape] = multipliers
        return x, iterations


def _solve(H: Array, c: Array, A: Array, lower: Array, upper: Array, **options: Any) -> tuple[Array | None, Array, int]:
    """Minimise 1/2 x'Hx + c'x with lower <= (x, A x) <= upper; x is None where DAQP finds no answer.

    Returns
    -------
    x : ndarray, shape (n,), or None
    multipliers : ndarray, shape (n + m,)
        From which a similar problem may start.
    iterations : int
    """
    low, high = np.maximum(lower, -_INFINITE), np.minimum(upper, _INFINITE)
    sense = np.where(low < high, 0, _EQUALITY).astype(np.int32)
    x, _, flag, info = daqp.solve(H, c, A, high, low, sense, **_OPTIONS, **options)
    return np.array(x) if flag == 1 and np.isfinite(x).all() else None, np.array(info["lam"]), info["iterations"]


def _relaxed(h: Hierarchy, level: int) -> tuple[Hierarchy, Array] | None:
    """Let the rows of a level hold as well as those of the levels before it allow, in the sense of least squares.

    Every row that holds them back, or that gives way, has a multiplier that is not zero; these rows become equalities,
    so that a later level cannot undo it.

    Returns
    -------
    moved : Hierarchy
        With those equalities.
    nearest : ndarray, shape (n,)
        The x that was found.
    None
        Instead of both, where the levels before it cannot hold.
    """
    n = len(h.c)
    rows = np.vstack([np.eye(n), h.A])
    before, soft = np.flatnonzero(h.level < level), np.flatnonzero(h.level == level)
    # x, and a slack s per row that gives way: min 1/2 |s|^2 with lower <= A x + s <= upper; as it is singular in x,
    # level 2 takes proximal steps, which are exact; level 1, when the robot falls, some of |x|^2, which never cycles
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
