"""Hierarchical least squares: constraints first, then balance, then what is wanted, section VI [Sherikov2014].

Level 1 holds, level 2 is met as well as level 1 allows, level 3 as well as both allow. Each is exact:

1. Nearly always levels 1 and 2 can both hold, and the hierarchy is one quadratic program with [A; E] x = [b; e].
2. Where they cannot, the least ||E x - e|| under level 1 is found first, and its E x takes the place of e.
3. Where level 1 itself cannot hold (a robot about to fall), the rows marked `soft` give way by the least that is
   needed, in the sense of least squares. That is the last resort, not a mode of operation.

The quadratic program of a tick is hardly different from that of the tick before, so its active set is guessed from
there and corrected until it repeats: then the answer is a point of Karush, Kuhn and Tucker, exact to rounding.
Where the guess does not settle at once (the support changes, a push), the dual method answers, exactly as well;
Clarabel has the last word on what seems to have no answer.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack

from dqwalk_ros.errors import QPError
from dqwalk_ros.qp import Problem, Solution
from dqwalk_ros.whole_body.dual import solve_dual
from dqwalk_ros.whole_body.reference import solve_reference

__all__ = ["ActiveSet", "Answer", "Hierarchy", "HierarchySolver"]

Array = NDArray[np.float64]

_PRIMAL = 1e-7
"""An inequality is violated beyond this."""
_EQUALITY = 1e-7
"""Largest residual of an equality in an answer that is accepted."""
_DUAL = 1e-9
"""A multiplier below minus this lets its row go."""


@dataclass(frozen=True)
class Hierarchy:
    """Three levels over x.

    Attributes
    ----------
    level1 : Problem
        Its rows and bounds are level 1; its H and c are the cost 1/2 x'Hx + c'x of level 3.
    E, e : ndarray, shapes (r, n), (r,)
        Level 2: E x = e; r may be 0.
    soft_equality, soft_inequality : ndarray of bool, shapes (l,), (m,)
        Rows of level 1 that may give way as the last resort; bounds on `soft_bound`, shape (n,), too.
    """

    level1: Problem
    E: Array
    e: Array
    soft_equality: NDArray[np.bool_]
    soft_inequality: NDArray[np.bool_]
    soft_bound: NDArray[np.bool_]

    def problem(self, e: Array | None = None) -> Problem:
        """Return the quadratic program with both levels as equalities; `e` in place of its own."""
        p = self.level1
        E, held = np.vstack([p.E, self.E]), np.concatenate([p.e, self.e if e is None else e])
        return Problem.of(p.H, p.c, E, held, p.G, p.h, p.lower, p.upper, p.names)


@dataclass(frozen=True)
class Answer:
    """The lexicographic optimum.

    Attributes
    ----------
    x : ndarray, shape (n,)
    method : str
        ``"active set"``, ``"dual method"``, ``"clarabel"``, ``"level 2 relaxed"`` or ``"level 1 relaxed"``.
    residual : float
        ||E x - e||: what level 2 misses.
    violation : float
        By how much the soft rows of level 1 had to give way, in the norm of least squares.
    iterations : int
        Guesses of the active set, steps of the dual method, or iterations of Clarabel.
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
    hot : bool
        Guess the active set, or take the dual method; without it every tick goes to Clarabel.
    """

    def __init__(self, *, clock: Callable[[], float] = time.perf_counter, hot: bool = True) -> None:
        self._clock, self._hot = clock, hot
        self._active = ActiveSet()
        if hot:  # have it compiled before the first state waits for its answer
            one, none = np.eye(1), np.zeros((0, 1))
            solve_dual(Problem.of(one, one[0], none, none[:, 0], none, none[:, 0], -one[0], one[0]))

    def solve(self, hierarchy: Hierarchy) -> Answer:
        """Return the answer.

        Raises
        ------
        QPError
            If level 1 has no answer even with its soft rows giving way.
        """
        began = self._clock()
        solution, method, violation = self._solve(hierarchy)
        residual = float(np.linalg.norm(hierarchy.E @ solution.u - hierarchy.e))
        return Answer(solution.u, method, residual, violation, solution.iterations, self._clock() - began)

    def _solve(self, hierarchy: Hierarchy) -> tuple[Solution, str, float]:
        problem = hierarchy.problem()
        solution = self._active.solve(problem) if self._hot else None
        if solution is not None:
            return solution, "active set", 0.0
        try:
            return *self._sure(problem), 0.0
        except QPError:
            pass
        try:
            return self._least_residual(hierarchy), "level 2 relaxed", 0.0
        except QPError:
            relaxed, nearest, violation = _relax(hierarchy)
        try:
            return self._sure(relaxed.problem())[0], "level 1 relaxed", violation
        except QPError:
            pass
        try:
            return self._least_residual(relaxed), "level 1 relaxed", violation
        except QPError:
            return nearest, "level 1 relaxed", violation  # levels 2 and 3 have no room left

    def _sure(self, problem: Problem) -> tuple[Solution, str]:
        """Ask the dual method and check its answer; where there is none Clarabel has the last word."""
        if self._hot:
            try:
                solution = solve_dual(problem)
            except QPError:
                solution = None
            if solution is not None and _holds(problem, solution.u):
                self._active.remember(problem, solution)
                return solution, "dual method"
        return solve_reference(problem, 1e-8), "clarabel"

    def _least_residual(self, hierarchy: Hierarchy) -> Solution:
        p, E = hierarchy.level1, hierarchy.E
        nearest = solve_reference(replace(p, H=E.T @ E + 1e-9 * np.eye(p.c.shape[0]), c=-E.T @ hierarchy.e), 1e-9)
        try:
            return solve_reference(hierarchy.problem(E @ nearest.u), 1e-8)
        except QPError:
            return nearest  # the third level has no room left


def _holds(problem: Problem, u: Array) -> bool:
    """Tell whether every row is kept."""
    slack = np.concatenate([problem.G @ u - problem.h, problem.upper - u, u - problem.lower])
    return bool(np.abs(problem.E @ u - problem.e).max(initial=0.0) <= _EQUALITY and slack.min() >= -_PRIMAL)


def _relax(hierarchy: Hierarchy) -> tuple[Hierarchy, Solution, float]:
    """Relax level 1.

    Returns
    -------
    relaxed : Hierarchy
        Its soft rows were moved by the least that makes level 1 hold.
    nearest : Solution
        The shortest x that holds them.
    violation : float
        By how much they were moved.
    """
    p = hierarchy.level1
    n = p.c.shape[0]
    soft = (hierarchy.soft_equality, hierarchy.soft_inequality, hierarchy.soft_bound)
    eq, ineq, box = (np.flatnonzero(mask) for mask in soft)
    k = [len(eq), len(ineq), len(box), len(box)]
    at = n + np.cumsum([0, *k])
    size = int(at[-1])
    # x, and one slack per soft row; the slack of a bound makes it a row of its own
    E = np.zeros((p.e.shape[0], size))
    E[:, :n] = p.E
    E[eq, np.arange(at[0], at[1])] = 1.0
    G = np.zeros((p.h.shape[0] + 2 * len(box), size))
    G[: len(p.h), :n] = p.G
    G[ineq, np.arange(at[1], at[2])] = 1.0
    low, high = len(p.h) + np.arange(len(box)), len(p.h) + len(box) + np.arange(len(box))
    G[low, box], G[low, np.arange(at[2], at[3])] = 1.0, 1.0
    G[high, box], G[high, np.arange(at[3], at[4])] = -1.0, 1.0
    lower, upper = np.full(size, -np.inf), np.full(size, np.inf)
    lower[:n], upper[:n] = p.lower, p.upper
    lower[box], upper[box] = -np.inf, np.inf
    lower[at[1] :] = 0.0
    H = np.diag(np.concatenate([np.full(n, 1e-9), np.ones(size - n)]))
    h = np.concatenate([p.h, p.lower[box], -p.upper[box]])
    found = solve_reference(Problem.of(H, np.zeros(size), E, p.e, G, h, lower, upper), 1e-9)
    slack = found.u[n:]
    room = 1e-7 * (1.0 + np.abs(slack))
    s_eq, s_in, s_low, s_high = np.split(slack, np.cumsum(k)[:-1])
    _, r_in, r_low, r_high = np.split(room, np.cumsum(k)[:-1])
    e, h, lower, upper = p.e.copy(), p.h.copy(), p.lower.copy(), p.upper.copy()
    e[eq] -= s_eq
    h[ineq] -= s_in + r_in
    lower[box] -= s_low + r_low
    upper[box] += s_high + r_high
    relaxed = replace(hierarchy, level1=replace(p, w=np.concatenate([e, h]), lower=lower, upper=upper))
    return relaxed, replace(found, u=found.u[:n]), float(np.linalg.norm(slack))


class ActiveSet:
    """A primal-dual active set method that begins where the last problem of the same shape ended.

    The guess W is taken as equalities; then what is violated enters and what has a multiplier of the wrong sign
    leaves, all at once, until W repeats. It is given up when it cycles.
    """

    def __init__(self, most: int = 2) -> None:
        self._most = most  # a third guess costs more than the dual method
        self._last: dict[tuple[int, int, int], NDArray[np.bool_]] = {}

    def solve(self, problem: Problem) -> Solution | None:
        """Return the exact solution, or None where the guess did not settle."""
        n, _, m = problem.shape
        guess = self._last.get(problem.shape)
        return self._run(problem, np.zeros(m + 2 * n, dtype=np.bool_) if guess is None else guess)

    def remember(self, problem: Problem, solution: Solution) -> None:
        """Begin from here the next time."""
        self._last[problem.shape] = solution.z[len(problem.e) :] > 0.0

    def _run(self, problem: Problem, active: NDArray[np.bool_]) -> Solution | None:
        n, l, m = problem.shape  # noqa: E741
        L, info = lapack.dpotrf(problem.H, lower=1, clean=0)
        if info:
            return None
        fixed = problem.upper - problem.lower < 1e-10
        always = np.concatenate([np.zeros(m, dtype=np.bool_), fixed, np.zeros(n, dtype=np.bool_)])
        never = np.concatenate([np.zeros(m + n, dtype=np.bool_), fixed])
        active = (active | always) & ~never
        whitened = blas.dtrsm(1.0, L, problem.E.T, lower=1)  # L^-1 E'
        y0 = lapack.dtrtrs(L, -problem.c, lower=1)[0]
        bound = np.concatenate([problem.h, -problem.upper, problem.lower])
        seen: set[bytes] = set()
        for count in range(1, self._most + 1):
            rows, k = np.flatnonzero(active), int(active.sum())
            # every active row as C x = d in the sense of C x >= d: G, then -I at the upper, I at the lower bounds
            C = np.zeros((n, k), order="F")
            inner = rows < m
            C[:, inner] = problem.G[rows[inner]].T
            outer = np.flatnonzero(~inner)
            index = rows[outer] - m
            C[index % n, outer] = np.where(index < n, -1.0, 1.0)
            Y = np.hstack([whitened, blas.dtrsm(1.0, L, C, lower=1, overwrite_b=1)]) if k else whitened
            S = Y.T @ Y
            S[np.diag_indices_from(S)] += 1e-12
            factor, info = lapack.dpotrf(S, lower=1, clean=0)
            if info:
                return None
            z = lapack.dpotrs(factor, np.concatenate([problem.e, bound[rows]]) - Y.T @ y0, lower=1)[0]
            x = lapack.dtrtrs(L, y0 + Y @ z, lower=1, trans=1)[0]
            slack = np.concatenate([problem.G @ x, -x, x]) - bound
            wanted = slack < -_PRIMAL
            wanted[rows] = (z[l:] >= -_DUAL) | always[rows]
            wanted &= ~never
            if np.array_equal(wanted, active):
                if not float(np.abs(problem.E @ x - problem.e).max(initial=0.0)) <= _EQUALITY:
                    return None
                self._last[problem.shape] = active
                full = np.zeros(l + m + 2 * n)
                full[:l] = -z[:l]
                full[l + rows] = z[l:]
                return Solution(x, full, count, 0.0)
            key = wanted.tobytes()
            if key in seen:
                return None
            seen.add(key)
            active = wanted
        return None
