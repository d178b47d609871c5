"""The solution of the quadratic program (U6) by the interior-point solver Clarabel."""

from __future__ import annotations

import time
from types import SimpleNamespace

import clarabel
import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.paper.qp.problem import Numbers, Problem, Solution, check, check_finite, kkt, scale
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.support.errors import QPError

__all__ = ["ClarabelSolver"]


Posed = tuple[Array, Array, Array, Array]
_OMIT_BEYOND = 1.0
"""Rows further than this many gradient steps at u = 0 enter only if the first solution violates them."""
_RETRY = ("NotOptimal", "Violated", "AlmostSolved", "InsufficientProgress", "NumericalError", "MaxIterations")
"""Statuses after which the problem is solved again, with equilibration and iterative refinement."""


@jit
def _nearby(numbers: Numbers) -> tuple[float, float, NDArray[np.int64]]:
    """Return s, curvature, and the indices of the inequalities near u = 0, at least that of the nearest one."""
    _, _, _, w, lower, upper, l = numbers  # noqa: E741
    s, curvature = scale(numbers)
    slack = np.concatenate((-w[l:], upper, -lower)) / s
    return s, curvature, np.flatnonzero(slack <= max(_OMIT_BEYOND, slack.min()))


@jit
def _posed(numbers: Numbers, s: float, curvature: float, chosen: NDArray[np.int64], posed: Posed) -> None:
    """Fill M (n, n), q (n,), A (n, l + k) and b (l + k,) of Clarabel's form; `chosen` are k inequalities.

    With the Cholesky factor L of the Hessian, M = L^-1 and q = M c, all scaled, the variables v = M'(t - q) make the
    objective 1/2 t't. Clarabel minimises it subject to A't + slack = b. The slack of the equalities, which come first,
    is zero, that of the inequalities is not negative.
    """
    H, c, W, w, lower, upper, l = numbers  # noqa: E741
    M, q, A, b = posed
    n, k, m = c.shape[0], chosen.shape[0], w.shape[0] - l
    rows = np.zeros((n, l + k))
    rows[:, :l], b[:l] = W[:l].T, w[:l] / s
    for j in range(k):
        i = chosen[j]
        if i < m:
            rows[:, l + j], b[l + j] = -W[l + i], -w[l + i] / s
        elif i < m + n:
            rows[i - m, l + j], b[l + j] = 1.0, upper[i - m] / s
        else:
            rows[i - m - n, l + j], b[l + j] = -1.0, -lower[i - m - n] / s
    M[:] = np.linalg.inv(np.linalg.cholesky(H / curvature))
    q[:], A[:] = M @ c / (s * curvature), M @ rows
    b += q @ A


@jit
def _answer(
    numbers: Numbers, s: float, curvature: float, chosen: NDArray[np.int64], posed: Posed, t: Array, y: Array,
    u: Array, z: Array,
) -> tuple[float, float, float, float, int]:  # fmt: skip
    """Fill u and z with Clarabel's primal and dual solution t and y, unscaled; return their residuals (see `kkt`)."""
    (M, q, _, _), l = posed, numbers[6]  # noqa: E741
    u[:], z[:] = s * ((t - q) @ M), 0.0
    z[:l] = s * curvature * y[:l]
    for k in range(chosen.shape[0]):
        z[l + chosen[k]] = s * curvature * y[l + k]
    residuals: tuple[float, float, float, float, int] = kkt(numbers, u, z, s, curvature)
    return residuals


class ClarabelSolver:
    """The interior-point solver Clarabel; one instance per shape of problem is kept and updated in place.

    Most inequalities of a walk are inactive and far from their bound, but each of them costs time in every iteration.
    So the problem is first solved with the inequalities near u = 0 only. If the result satisfies all others, it is the
    solution of the problem; if not, the problem is solved with all of them.

    Attributes
    ----------
    whole : int
        Number of problems that were solved with all inequalities.
    """

    name = "clarabel"

    def __init__(self) -> None:
        self._programs: dict[tuple[int, int, int, bool], _ClarabelProgram] = {}
        self.whole = 0

    def solve(self, problem: Problem) -> Solution:
        """Return the solution of a problem.

        Raises
        ------
        QPError
            If there is no solution, or Clarabel's result does not fulfil the optimality conditions.
        """
        s, curvature, near = _nearby(problem.numbers)
        check_finite(s, curvature)
        n, _, m = problem.shape
        if 2 * len(near) <= m + 2 * n:
            try:
                return self._solved(problem, s, curvature, near)
            except QPError:  # a row that was omitted is violated, or Clarabel failed
                pass
        self.whole += 1
        everything = np.arange(m + 2 * n)
        try:
            return self._solved(problem, s, curvature, everything)
        except QPError as error:
            if error.status not in _RETRY:
                raise
        return self._solved(problem, s, curvature, everything, careful=True)

    def _solved(
        self, problem: Problem, s: float, curvature: float, chosen: NDArray[np.int64], *, careful: bool = False
    ) -> Solution:
        """Return the checked solution of a problem with the inequalities `chosen` only."""
        n, l, m = problem.shape  # noqa: E741
        key = (n, l, len(chosen), careful)  # the compiled functions trust the sizes of the program's arrays
        program = self._programs.get(key)
        if program is None:
            program = self._programs[key] = _ClarabelProgram(n, l, len(chosen), careful=careful)
        try:
            _posed(problem.numbers, s, curvature, chosen, program.posed)
        except np.linalg.LinAlgError as error:
            raise QPError("the Hessian is not positive definite", status="NotConvex") from error
        found, spent = program.solve()
        if found.status != _SOLVED:
            z = np.zeros(l + m + 2 * n)
            z[np.concatenate([np.arange(l), l + chosen])] = found.z
            raise _unsolved(problem, str(found.status), z)
        u, z, t, y = np.empty(n), np.empty(l + m + 2 * n), np.array(found.x), np.array(found.z)
        check(problem, *_answer(problem.numbers, s, curvature, chosen, program.posed, t, y, u, z))
        return Solution(u, z, found.iterations, spent)


_SOLVED = clarabel.SolverStatus.Solved


class _ClarabelProgram:
    """One Clarabel solver for all problems with n variables, l equalities and k inequalities.

    Attributes
    ----------
    posed : tuple of ndarray
        M, q, A and b, as `_posed` fills them.
    """

    def __init__(self, n: int, l: int, k: int, *, careful: bool) -> None:  # noqa: E741
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.presolve_enable = False  # presolving would change the sparsity pattern
        # the problem is scaled already; linearly dependent rows, such as those of two held feet, may need both
        settings.equilibrate_enable = settings.iterative_refinement_enable = careful
        if not careful:
            settings.max_step_fraction = 0.9999  # steps almost up to the boundary: fewer iterations
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12 if careful else 1e-14
        self._settings = settings
        self._P = np.arange(n), np.arange(n + 1), (n, n)
        self._A = np.tile(np.arange(l + k), n), np.arange(n + 1) * (l + k), (l + k, n)
        self._cones = ([clarabel.ZeroConeT(l)] if l else []) + [clarabel.NonnegativeConeT(k)]
        self._solver: clarabel.DefaultSolver | None = None
        self.posed: Posed = np.empty((n, n)), np.empty(n), np.empty((n, l + k)), np.empty(l + k)

    def solve(self) -> tuple[clarabel.DefaultSolution, float]:
        """Solve for `posed`; return Clarabel's result and the time taken [s], without that of the setup."""
        _, q, A, b = self.posed
        if self._solver is None:
            n = q.shape[0]
            matrices = _csc(np.ones(n), *self._P), np.zeros(n), _csc(A.ravel(), *self._A), b
            self._solver = clarabel.DefaultSolver(*matrices, self._cones, self._settings)
        else:  # Clarabel converts lists faster than arrays
            self._solver.update(A=A.ravel().tolist(), b=b.tolist())
        began = time.perf_counter()
        found = self._solver.solve()
        return found, time.perf_counter() - began


def _csc(values: Array, rows: NDArray[np.int64], starts: NDArray[np.int64], shape: tuple[int, int]) -> SimpleNamespace:
    """Return an object with the attributes of a scipy.sparse.csc_matrix; importing scipy would take half a second."""
    return SimpleNamespace(data=values, indices=rows, indptr=starts, shape=shape, has_canonical_format=True)


def _unsolved(problem: Problem, status: str, z: Array) -> QPError:
    """Return the error of a problem that Clarabel did not solve; the rows with the largest multipliers conflict."""
    worst = np.argsort(-np.abs(z))[:6]
    largest = float(np.abs(z).max(initial=0.0))
    rows = [problem.names[i] for i in worst if problem.names and abs(z[i]) > 1e-3 * largest]
    conflict = f"; rows in conflict: {', '.join(rows)}" if rows else ""
    return QPError(f"the quadratic program has no solution ({status}){conflict}", status=status, rows=rows)
