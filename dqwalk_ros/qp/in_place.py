"""Clarabel, updated in place: one solver for all problems of one pattern; the one importer of clarabel."""

from __future__ import annotations

import time
from collections.abc import Sequence
from types import SimpleNamespace

import clarabel
import numpy as np
from numpy.typing import NDArray

__all__ = ["SOLVED", "InPlace"]

SOLVED = clarabel.SolverStatus.Solved


class InPlace:
    """min 1/2 v'Pv + q'v, A v + slack = b, with the slack of the first rows zero and of the others not negative.

    The columns of v have `r` rows of the lifted form, the equalities and the dense inequalities, and with `bounds` an
    upper and a lower one each. Lifted, r columns y with the rows y - J v = 0 follow, and P is diagonal; else it is
    the upper triangle of a dense matrix.

    Parameters
    ----------
    values : ndarray
        Where P, q, A and b are to be found, one after the other, column by column; after them, where there is room,
        another b.
    n, r, equalities, dense : int
    bounds : bool
    bold : bool
        Whether steps go almost up to the boundary, and end closer to the optimum: fewer iterations, and still the
        joint velocities to 1e-10, where few inequalities matter.
    careful : bool
        Whether linear systems are equilibrated and refined, which dependent rows may need.

    Attributes
    ----------
    other : ndarray
        The other b.
    """

    def __init__(
        self,
        values: NDArray[np.float64],
        n: int,
        r: int,
        equalities: int,
        dense: int,
        *,
        bounds: bool,
        bold: bool = False,
        careful: bool = False,
    ) -> None:
        self._settings = _settings(bold=bold, careful=careful)
        first = r + equalities
        full = first + dense
        rows, columns, height = full + 2 * n * bounds, n + r, full + 2 * bounds
        index = np.empty((n, height), dtype=np.int64)
        index[:, :full] = np.arange(full)
        if bounds:
            index[:, full] = full + np.arange(n)
            index[:, full + 1] = full + n + np.arange(n)
        starts = np.concatenate([np.arange(n) * height, n * height + np.arange(r + 1)])
        self._A = np.concatenate([index.ravel(), np.arange(r)]), starts, (rows, columns)
        if r:
            self._P = np.arange(columns), np.arange(columns + 1), (columns, columns)
        else:
            upper = np.concatenate([np.arange(j + 1) for j in range(n)])
            self._P = upper, np.concatenate([[0], np.cumsum(np.arange(1, n + 1))]), (n, n)
        self._cones = [clarabel.NonnegativeConeT(rows - first)]
        if first:
            self._cones.insert(0, clarabel.ZeroConeT(first))
        ends = np.cumsum([len(self._P[0]), columns, len(self._A[0]), rows, rows])
        self._left, self._cost, self._rows, self._right, self.other, _ = np.split(values, ends)
        self._solver: clarabel.DefaultSolver | None = None

    def run(self, *, other: bool = False) -> tuple[clarabel.DefaultSolution, float]:
        """Solve for the values as they are now, with the `other` b where that is wanted.

        Returns
        -------
        clarabel.DefaultSolution
        float
            What the solution took [s]; Clarabel's own figure has the setup in it.
        """
        # lists are taken over faster than arrays
        P, q, A = self._left.tolist(), self._cost.tolist(), self._rows.tolist()
        b = (self.other if other else self._right).tolist()
        if self._solver is None:
            matrices = _csc(P, *self._P), q, _csc(A, *self._A), b
            self._solver = clarabel.DefaultSolver(*matrices, self._cones, self._settings)
        else:
            self._solver.update(P=P, q=q, A=A, b=b)
        began = time.perf_counter()
        answer = self._solver.solve()
        return answer, time.perf_counter() - began


def _csc(
    values: Sequence[float], rows: NDArray[np.int64], starts: NDArray[np.int64], shape: tuple[int, int]
) -> SimpleNamespace:
    """Return what clarabel reads of a scipy.sparse.csc_matrix, without the half second that scipy takes to import."""
    data = np.array(values)
    return SimpleNamespace(data=data, indices=rows, indptr=starts, shape=shape, has_canonical_format=True)


def _settings(*, bold: bool, careful: bool) -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.presolve_enable = False  # it would change the pattern
    if bold:
        settings.max_step_fraction = 0.9999
    settings.equilibrate_enable = careful  # the problem is scaled already
    settings.iterative_refinement_enable = careful  # dependent rows, such as those of two held feet, may need it
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-14 if bold else 1e-12
    return settings
