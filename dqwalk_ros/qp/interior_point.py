"""Clarabel, scaled and updated in place; the one importer of clarabel."""

from __future__ import annotations

import time
from types import SimpleNamespace

import clarabel
import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.exceptions import QPError
from dqwalk_ros.qp import Problem, Solution, refuse
from dqwalk_ros.qp.scaling import pack_interior_point, unpack_interior_point

__all__ = ["ClarabelSolver"]

Array = NDArray[np.float64]
_Pattern = tuple[NDArray[np.int64], NDArray[np.int64], tuple[int, int]]

_CAP = 100.0
"""Rows this many gradient steps away start out capped."""
_ACTIVE = 1e-4
"""A capped row with a scaled multiplier above this mattered after all."""
_SOLVED = clarabel.SolverStatus.Solved
_DOUBTFUL = ("NotOptimal", "Violated", "AlmostSolved", "InsufficientProgress", "NumericalError", "MaxIterations")
"""What may be answered after all, with its linear systems solved more carefully."""
_LIFTED = 3
"""From so many joints per row of the tasks on the sparse form y = J u is faster than the dense Hessian."""


class ClarabelSolver:
    """Clarabel, kept and updated in place: one instance per shape of problem.

    Parameters
    ----------
    lifted : bool, optional
        Whether the task velocity y = J u becomes a variable, so that the Hessian is diagonal and the work grows
        linearly with the number of joints; by default where there are many joints for the rows of the tasks.

    Attributes
    ----------
    refined : int
        How often an answer had to be refined.
    """

    name = "clarabel"

    def __init__(self, lifted: bool | None = None) -> None:
        self._lifted = lifted
        self._kept: dict[tuple[int, ...], _InPlace] = {}
        self.refined = 0

    def solve(self, problem: Problem) -> Solution:
        """Solve one problem; where the answer fails the check, once more, more carefully.

        Raises
        ------
        QPError
            If the solver's status is anything but ``Solved``, or its answer violates a row.
        """
        shape = (*problem.shape, 0 if problem.J is None else problem.J.shape[0])
        kept = self._kept.get(shape)
        if kept is None:
            lifted = shape[0] >= _LIFTED * shape[3] if self._lifted is None else self._lifted
            kept = self._kept[shape] = _InPlace(*shape[:3], shape[3] if lifted else 0)
        try:
            return kept.solve(problem)
        except QPError as error:
            if error.status not in _DOUBTFUL:
                raise
        self.refined += 1
        return _InPlace(*shape[:3], 0, careful=True).solve(problem)


class _InPlace:
    """One Clarabel solver and the patterns of its matrices, as `pack_interior_point` fills them."""

    def __init__(self, n: int, equalities: int, inequalities: int, r: int, *, careful: bool = False) -> None:
        self._careful = careful
        self.n, self.r, self.first = n, r, r + equalities
        dense = r + equalities + inequalities
        rows, columns = dense + 2 * n, n + r
        index = np.empty((n, dense + 2), dtype=np.int64)
        index[:, :dense] = np.arange(dense)
        index[:, dense] = dense + np.arange(n)
        index[:, dense + 1] = dense + n + np.arange(n)
        starts = [*(np.arange(n) * (dense + 2)), *(n * (dense + 2) + np.arange(r + 1))]
        self._A = np.concatenate([index.ravel(), np.arange(r)]), np.array(starts), (rows, columns)
        self._P: _Pattern
        if r:
            self._P = np.arange(columns), np.arange(columns + 1), (columns, columns)
        else:
            upper = np.concatenate([np.arange(j + 1) for j in range(n)])
            self._P = upper, np.concatenate([[0], np.cumsum(np.arange(1, n + 1))]), (n, n)
        self._cones = [clarabel.NonnegativeConeT(inequalities + 2 * n)]
        if self.first:
            self._cones.insert(0, clarabel.ZeroConeT(self.first))
        ends = np.cumsum([len(self._P[0]), columns, len(self._A[0]), rows])
        self._sizes = np.array([*ends, 1 if r else 0])
        self._ends = [int(end) for end in ends]
        self._out = np.empty(self._ends[-1] + rows)
        self._full = self._out[self._ends[-1] :]
        self._none = np.empty((0, n)), np.empty(n)
        self._solver: clarabel.DefaultSolver | None = None
        self._spent = 0.0

    def solve(self, problem: Problem) -> Solution:
        J, diagonal = self._none
        if self.r:
            assert problem.J is not None  # the shape has it
            assert problem.diagonal is not None
            J, diagonal = problem.J, problem.diagonal
        s, curvature = pack_interior_point(*problem.arrays, diagonal, J, _CAP, self._sizes, self._out)
        if not s * curvature > 0.0:
            raise QPError("the problem has a number that is not finite", status="NotFinite")
        self._spent = 0.0
        answer = self._run()
        scaled = np.array(answer.z)
        if answer.status != _SOLVED or scaled[self._full > _CAP].max(initial=0.0) > _ACTIVE:
            answer = self._run(self._full)
            scaled = np.array(answer.z)
            if answer.status != _SOLVED:
                raise _no_answer(problem, str(answer.status), scaled[self.r :])
        u, z = np.empty(self.n), np.empty(scaled.shape[0] - self.r)
        x = np.array(answer.x)
        residuals = unpack_interior_point(*problem.arrays, s, curvature, x, scaled, self.r, u, z)
        refuse(problem, *residuals)
        return Solution(u, z, answer.iterations, self._spent)

    def _run(self, full: Array | None = None) -> clarabel.DefaultSolution:
        a, b, c, d = self._ends
        if self._solver is None:
            P, q, A, right = np.split(self._out[:d], [a, b, c])
            matrices = _csc(P, self._P), q, _csc(A, self._A)
            self._solver = clarabel.DefaultSolver(*matrices, right, self._cones, _settings(careful=self._careful))
            if full is None:
                return self._answer()
        values = self._out.tolist()  # lists are taken over faster than arrays
        at = c if full is None else d
        self._solver.update(P=values[:a], q=values[a:b], A=values[b:c], b=values[at : at + d - c])
        return self._answer()

    def _answer(self) -> clarabel.DefaultSolution:
        assert self._solver is not None
        began = time.perf_counter()  # Clarabel's own figure has the setup in it
        answer = self._solver.solve()
        self._spent += time.perf_counter() - began
        return answer


def _csc(values: Array, pattern: _Pattern) -> SimpleNamespace:
    """Return what clarabel reads of a scipy.sparse.csc_matrix, without the half second that scipy takes to import."""
    rows, starts, shape = pattern
    return SimpleNamespace(data=values, indices=rows, indptr=starts, shape=shape, has_canonical_format=True)


def _no_answer(problem: Problem, status: str, z: Array) -> QPError:
    worst = np.argsort(-np.abs(z))[:6]
    top = float(np.abs(z).max(initial=0.0))
    rows = [problem.names[i] for i in worst if problem.names and abs(z[i]) > 1e-3 * top]
    conflict = f"; rows in conflict: {', '.join(rows)}" if rows else ""
    return QPError(f"the quadratic program has no answer ({status}){conflict}", status=status, rows=rows)


def _settings(*, careful: bool) -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.presolve_enable = False  # it would change the pattern
    settings.equilibrate_enable = careful  # the problem is scaled already
    settings.iterative_refinement_enable = careful  # dependent rows, such as those of two held feet, may need it
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    return settings
