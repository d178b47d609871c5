"""The solution of the quadratic program (U6) by the interior-point solver Clarabel."""

from __future__ import annotations

import time
from types import SimpleNamespace

import clarabel
import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.paper.qp.least_distance import Posed, answer, pose, unsolved
from dqwalk_ros.paper.qp.problem import Problem, Shape, Solution, check, check_finite, parts, scale
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.support.errors import QPError

_OMIT_BEYOND = 1.0
"""Rows further than this many gradient steps at u = 0 enter only if the first solution violates them."""
_RETRY = ("NotOptimal", "Violated", "AlmostSolved", "InsufficientProgress", "NumericalError", "MaxIterations")
"""Statuses after which the problem is solved again, with equilibration and iterative refinement."""


@jit
def _nearby(numbers: Array, shape: Shape) -> tuple[float, float, NDArray[np.int64]]:
    """Return s, curvature, and the indices of the inequalities near u = 0, at least that of the nearest one."""
    _, _, _, w, lower, upper = parts(numbers, shape)
    s, curvature = scale(numbers, shape)
    slack = np.concatenate((-w[shape[1] :], upper, -lower)) / s
    return s, curvature, np.flatnonzero(slack <= max(_OMIT_BEYOND, slack.min()))


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
        s, curvature, near = _nearby(problem.numbers, problem.shape)
        check_finite(s, curvature)
        n, _, m = problem.shape
        if 2 * len(near) <= m + 2 * n:
            try:
                return self._solved(problem, s, curvature, near)
            except QPError:  # a row that was omitted is violated, or Clarabel failed
                pass
        self.whole += 1
        everything = np.arange(m + 2 * n)
        for chosen, careful in ((everything, False), (everything, True)):
            try:
                return self._solved(problem, s, curvature, chosen, careful=careful)
            except QPError as error:
                if error.status not in _RETRY:
                    raise
                failed = error
        try:  # bounds thousands of steps away, such as those of unequal speed limits, may be what Clarabel fails at
            return self._solved(problem, s, curvature, near)
        except QPError:
            raise failed from None

    def _solved(
        self, problem: Problem, s: float, curvature: float, chosen: NDArray[np.int64], *, careful: bool = False
    ) -> Solution:
        """Return the checked solution of a problem with the inequalities `chosen` only."""
        n, l, m = problem.shape
        key = (n, l, len(chosen), careful)  # the compiled functions trust the sizes of the program's arrays
        program = self._programs.get(key)
        if program is None:
            program = self._programs[key] = _ClarabelProgram(n, l, len(chosen), careful=careful)
        if not pose(*problem[:2], s, curvature, chosen, program.posed):
            raise QPError("the Hessian is not positive definite", status="NotConvex")
        found, spent = program.solve()
        status, t, y = str(found.status), np.array(found.x), np.array(found.z)
        u, z = np.empty(n), np.zeros(l + m + 2 * n)
        if status == "Solved" or (careful and status in _RETRY):  # what passes the check is a solution
            residuals = answer(*problem[:2], s, curvature, chosen, program.posed, t, y, u, z)
            try:
                check(problem, *residuals)
                return Solution(u, z, found.iterations, spent)
            except QPError:
                if status == "Solved":
                    raise
        z[np.concatenate([np.arange(l), l + chosen])] = y
        raise unsolved(problem, status, z)


class _ClarabelProgram:
    """One Clarabel solver for all problems with n variables, l equalities and k inequalities.

    Attributes
    ----------
    posed : tuple of ndarray
        M, q, A and b, as `pose` fills them.
    """

    def __init__(self, n: int, l: int, k: int, *, careful: bool) -> None:
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.presolve_enable = False  # presolving would change the sparsity pattern
        # the problem is scaled already; linearly dependent rows, such as those of two held feet, may need both
        settings.equilibrate_enable = settings.iterative_refinement_enable = careful
        # steps almost up to the boundary need fewer iterations, but may end there without progress
        settings.max_step_fraction = 0.9 if careful else 0.9999
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
