"""The quadratic program (6) and its solution; the one importer of clarabel.

The costs of a slow walk are tiny (joint velocities down to 1e-6 rad/s), so that a solver's tolerances never count
unless the problem is scaled first: u = s v with s the length of a gradient step, and the objective divided by its
curvature. A right-hand side far away is capped; if its row turns out to matter the problem is solved again without
the cap, so the answer is always that of (6).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from dqwalk_ros.exceptions import QPError

__all__ = ["ClarabelSolver", "Problem", "Residuals", "Solution", "make_solver"]

Array = NDArray[np.float64]

_CAP = 100.0
"""Rows this many gradient steps away start out capped."""
_ACTIVE = 1e-4
"""A capped row with a scaled multiplier above this mattered after all."""
_PRIMAL = 1e-7
"""Largest scaled violation of an answer that is accepted."""


@dataclass(frozen=True)
class Problem:
    """min 1/2 u'Hu + c'u  subject to  E u = e,  G u >= h,  lower <= u <= upper.

    Attributes
    ----------
    H : ndarray, shape (n, n)
        J'J + lambda^2 I of (6); positive definite.
    c : ndarray, shape (n,)
        eta J'x of (6).
    E, e : ndarray, shapes (l, n), (l,)
        W_eq, w_eq.
    G, h : ndarray, shapes (m, n), (m,)
        -W, -w without the joint limits.
    lower, upper : ndarray, shape (n,)
        Joint limits (12)-(13) as velocities.
    names : tuple of str
        Of the rows: equalities, inequalities, upper and lower limits.
    """

    H: Array
    c: Array
    E: Array
    e: Array
    G: Array
    h: Array
    lower: Array
    upper: Array
    names: tuple[str, ...] = ()

    @property
    def shape(self) -> tuple[int, int, int]:
        """n, number of equalities, number of inequalities."""
        return self.c.shape[0], self.e.shape[0], self.h.shape[0]


@dataclass(frozen=True)
class Residuals:
    """How far an answer is from the Karush-Kuhn-Tucker conditions, relative to the size of the terms."""

    stationarity: float
    primal: float
    dual: float
    complementarity: float

    @property
    def largest(self) -> float:
        """The worst of the four."""
        return max(self.stationarity, self.primal, self.dual, self.complementarity)


@dataclass(frozen=True)
class Solution:
    """An accepted answer.

    Attributes
    ----------
    u : ndarray, shape (n,)
    z : ndarray, shape (l + m + 2n,)
        Multipliers of the equalities, inequalities, upper and lower limits; >= 0 but for the equalities.
    iterations : int
    solve_time : float
        What the solver itself took [s].
    """

    u: Array
    z: Array
    iterations: int
    solve_time: float

    def active(self, problem: Problem) -> tuple[str, ...]:
        """Names of the inequalities that hold the answer back, strongest first."""
        start = problem.e.shape[0]
        z = self.z[start:]
        scale = 1e-6 * max(float(np.abs(problem.c).max()), 1e-300)
        order = np.argsort(-z)
        return tuple(problem.names[start + i] for i in order if z[i] > scale)

    def residuals(self, problem: Problem) -> Residuals:
        """Return the residuals of the Karush-Kuhn-Tucker conditions.

        Stationarity is relative to the largest term of the gradient, the others to the largest velocity and
        multiplier.
        """
        l, m = problem.e.shape[0], problem.h.shape[0]  # noqa: E741
        n = problem.c.shape[0]
        y, z, up, lo = np.split(self.z, [l, l + m, l + m + n])
        u = self.u
        terms = [problem.H @ u, problem.c, problem.E.T @ y, problem.G.T @ z, up, lo]
        gradient = terms[0] + terms[1] + terms[2] - terms[3] + up - lo
        slack = np.concatenate([problem.G @ u - problem.h, problem.upper - u, u - problem.lower])
        size = max(float(np.abs(u).max(initial=0.0)), 1e-300)
        force = max(max(float(np.abs(t).max(initial=0.0)) for t in terms), 1e-300)
        inequality = self.z[l:]
        return Residuals(
            stationarity=float(np.abs(gradient).max()) / force,
            primal=max(float(np.abs(problem.E @ u - problem.e).max(initial=0.0)), float((-slack).max(initial=0.0)))
            / size,
            dual=float((-inequality).max(initial=0.0)) / force,
            complementarity=float(np.abs(inequality * slack).max(initial=0.0)) / (force * size),
        )


class ClarabelSolver:
    """Clarabel, kept and updated in place: one instance per shape of problem."""

    name = "clarabel"

    def __init__(self) -> None:
        self._kept: dict[tuple[int, int, int], _InPlace] = {}

    def solve(self, problem: Problem) -> Solution:
        """Solve one problem.

        Raises
        ------
        QPError
            If the solver's status is anything but ``Solved``, or its answer violates a row.
        """
        kept = self._kept.get(problem.shape)
        if kept is None:
            kept = self._kept[problem.shape] = _InPlace(*problem.shape)
        return kept.solve(problem)


SOLVERS: dict[str, Callable[[], ClarabelSolver]] = {"clarabel": ClarabelSolver}


def make_solver(name: str) -> ClarabelSolver:
    """Return a new solver: ``"clarabel"``."""
    return SOLVERS[name]()


class _InPlace:
    """One Clarabel solver and the pattern of its matrices: rows [E; -G; I; -I], upper triangle of H."""

    def __init__(self, n: int, equalities: int, inequalities: int) -> None:
        rows = equalities + inequalities
        self.n, self.dense = n, rows
        self._tril = np.tril_indices(n)  # row-major lower is column-major upper of a symmetric matrix
        self._values = np.empty((n, rows + 2))
        self._values[:, rows] = 1.0
        self._values[:, rows + 1] = -1.0
        index = np.empty((n, rows + 2), dtype=np.int64)
        index[:, :rows] = np.arange(rows)
        index[:, rows] = rows + np.arange(n)
        index[:, rows + 1] = rows + n + np.arange(n)
        self._a_pattern = (index.ravel(), np.arange(n + 1) * (rows + 2))
        self._p_pattern = (
            np.concatenate([np.arange(j + 1) for j in range(n)]),
            np.concatenate([[0], np.cumsum(np.arange(1, n + 1))]),
        )
        self._cones = [clarabel.NonnegativeConeT(inequalities + 2 * n)]
        if equalities:
            self._cones.insert(0, clarabel.ZeroConeT(equalities))
        self._equalities = equalities
        self._solver: clarabel.DefaultSolver | None = None
        self._spent = 0.0  # Clarabel adds up the time of all calls

    def solve(self, problem: Problem) -> Solution:
        l = self._equalities  # noqa: E741
        curvature = float(np.trace(problem.H)) / self.n
        full = np.concatenate([problem.e, -problem.h, problem.upper, -problem.lower])
        # u = s v: a gradient step, or the step that a row asks for where that is longer
        asked = max(float(np.abs(full[:l]).max(initial=0.0)), -float(full[l:].min(initial=0.0)))
        s = max(math.sqrt(float(problem.c @ problem.c)) / curvature, asked) or 1.0
        if not (math.isfinite(s) and math.isfinite(curvature) and np.isfinite(full).all()):
            raise QPError("the problem has a number that is not finite", status="NotFinite")
        self._values[:, :l] = problem.E.T
        np.negative(problem.G.T, out=self._values[:, l : self.dense])
        P = (problem.H / curvature)[self._tril]
        c = problem.c / (s * curvature)
        full /= s
        b = full.copy()
        np.minimum(b[l:], _CAP, out=b[l:])
        before = self._spent
        answer = self._run(P, c, b)
        z = np.array(answer.z)
        if (z[l:][full[l:] > _CAP] > _ACTIVE).any() or str(answer.status) != "Solved":
            answer = self._run(P, c, full)
            z = np.array(answer.z)
        status = str(answer.status)
        if status != "Solved":
            worst = np.argsort(-np.abs(z))[:6]
            top = float(np.abs(z).max(initial=0.0))
            rows = [problem.names[i] for i in worst if problem.names and abs(z[i]) > 1e-3 * top]
            raise QPError(
                f"the quadratic program has no answer ({status})"
                + (f"; rows in conflict: {', '.join(rows)}" if rows else ""),
                status=status,
                rows=rows,
            )
        v = np.array(answer.x)
        self._check(problem, v, full)
        return Solution(u=s * v, z=z * (s * curvature), iterations=answer.iterations, solve_time=self._spent - before)

    def _check(self, problem: Problem, v: Array, b: Array) -> None:
        """Refuse an answer that violates a row, whatever its status."""
        l, n = self._equalities, self.n  # noqa: E741
        off = np.concatenate(
            [np.abs(problem.E @ v - b[:l]), -(problem.G @ v) - b[l : self.dense], v - b[self.dense : -n], -v - b[-n:]]
        )
        worst = int(np.argmax(off))
        if not off[worst] <= _PRIMAL:
            name = problem.names[worst] if problem.names else str(worst)
            raise QPError(
                f"the answer violates the row '{name}' by {off[worst]:.3g} (scaled)", status="Violated", rows=[name]
            )

    def _run(self, P: Array, c: Array, b: Array) -> clarabel.DefaultSolution:
        values = self._values.ravel()
        if self._solver is None:
            shape = (self.dense + 2 * self.n, self.n)
            self._solver = clarabel.DefaultSolver(
                sparse.csc_matrix((P, *self._p_pattern), shape=(self.n, self.n)),
                c,
                sparse.csc_matrix((values, *self._a_pattern), shape=shape),
                b,
                self._cones,
                _settings(),
            )
        else:
            # lists are taken over faster than arrays
            self._solver.update(P=P.tolist(), q=c.tolist(), A=values.tolist(), b=b.tolist())
        answer = self._solver.solve()
        self._spent = answer.solve_time
        return answer


def _settings() -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.presolve_enable = False  # it would change the pattern
    settings.equilibrate_enable = False  # the problem is scaled already
    settings.iterative_refinement_enable = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    return settings
