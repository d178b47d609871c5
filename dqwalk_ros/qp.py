"""The quadratic program (U6) and its solution, by Clarabel or by DAQP; the one importer of both.

The costs of a slow walk are tiny (joint velocities down to 1e-6 rad/s), so a solver's absolute tolerances never count
unless the problem is scaled first: u = s v with s the length of a gradient step (or the longest step a row asks for),
and the objective divided by its mean curvature. Whatever solved it, an answer is accepted only if it fulfils the
Karush-Kuhn-Tucker conditions, so both solvers give the same one.
"""

from __future__ import annotations

import dataclasses
import math
import time
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Protocol, Self

import clarabel
import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.compiled import jit
from dqwalk_ros.errors import QPError

__all__ = [
    "ClarabelSolver",
    "Conflict",
    "DaqpSolver",
    "Problem",
    "Residuals",
    "Solution",
    "Solver",
    "conflicts",
    "explained",
    "lead_back",
    "make_solver",
    "objective",
]

Array = NDArray[np.float64]

PRIMAL = 1e-7
"""Largest scaled violation of a row that is accepted."""
STILL = 1e-9
"""Steps shorter than this [rad/s] are rounding: what asks for no more is solved to this scale."""
OPTIMAL = 1e-7
"""Largest relative residual of the other Karush-Kuhn-Tucker conditions that is accepted."""


@jit
def objective(J, rate, damping, H, c):  # type: ignore[no-untyped-def]
    """Fill H (n, n) and c (n,) of (U6): ||J u - rate||^2 + lambda^2 ||u||^2, with rate = -eta x.

    Parameters
    ----------
    J : ndarray, shape (r, n)
        Jacobian of the tasks.
    rate : ndarray, shape (r,)
        Task velocity asked for.
    damping : float
        lambda.
    H, c : ndarray, shapes (n, n) and (n,)
    """
    H[:] = J.T @ J
    for i in range(H.shape[0]):
        H[i, i] += damping**2
    c[:] = -(rate @ J)


@dataclass(slots=True, eq=False)
class Problem:
    """min 1/2 u'Hu + c'u  subject to  E u = e,  G u >= h,  lower <= u <= upper.

    Attributes
    ----------
    H : ndarray, shape (n, n)
        J'J + lambda^2 I of (U6); positive definite.
    c : ndarray, shape (n,)
        eta J'x of (U6).
    W, w : ndarray, shapes (l + m, n), (l + m,)
        E over G, e over h: W_eq and w_eq of (U6), then its -W and -w without the joint limits.
    lower, upper : ndarray, shape (n,)
        Joint limits (U12) and (U13), and the largest velocities.
    equalities : int
        How many of the rows are equalities, l.
    names : tuple of str
        Of the rows: equalities, inequalities, upper and lower limits.
    """

    H: Array
    c: Array
    W: Array
    w: Array
    lower: Array
    upper: Array
    equalities: int = 0
    names: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, H: Array, c: Array, E: Array, e: Array, G: Array, h: Array, lower: Array, upper: Array,
        names: tuple[str, ...] = (),
    ) -> Self:  # fmt: skip
        """Return the problem with these equalities and inequalities."""
        return cls(H, c, np.concatenate([E, G]), np.concatenate([e, h]), lower, upper, len(e), names)

    @property
    def E(self) -> Array:
        """W_eq, shape (l, n)."""
        return self.W[: self.equalities]

    @property
    def e(self) -> Array:
        """w_eq, shape (l,)."""
        return self.w[: self.equalities]

    @property
    def G(self) -> Array:
        """Inequalities, shape (m, n)."""
        return self.W[self.equalities :]

    @property
    def h(self) -> Array:
        """Least values of the inequalities, shape (m,)."""
        return self.w[self.equalities :]

    @property
    def shape(self) -> tuple[int, int, int]:
        """n, number of equalities, number of inequalities."""
        return self.c.shape[0], self.equalities, self.w.shape[0] - self.equalities

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array, Array, Array, int]:
        """H, c, W, w, lower, upper, l."""
        return self.H, self.c, self.W, self.w, self.lower, self.upper, self.equalities


@dataclass(frozen=True)
class Residuals:
    """How far an answer is from the Karush-Kuhn-Tucker conditions, scaled.

    Attributes
    ----------
    stationarity, dual, complementarity : float
        Relative to the largest term of the gradient, or multiplier.
    primal : float
        Largest violation of a row, in gradient steps.
    row : int
        The row with the largest violation; -1 where all are kept.
    """

    stationarity: float
    primal: float
    dual: float
    complementarity: float
    row: int = -1

    @property
    def largest(self) -> float:
        """The worst of the four."""
        return max(self.stationarity, self.primal, self.dual, self.complementarity)


@dataclass(slots=True, eq=False)
class Solution:
    """An accepted answer.

    Attributes
    ----------
    u : ndarray, shape (n,)
    z : ndarray, shape (l + m + 2n,)
        Multipliers of the equalities, inequalities, upper and lower limits; >= 0 but for the equalities.
    iterations : int
    solve_time : float
        Time the solver itself took [s].
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
        """Return the residuals of the Karush-Kuhn-Tucker conditions."""
        s, curvature = _scale(*problem.arrays)
        return Residuals(*_kkt(*problem.arrays, self.u, self.z, s, curvature))


class Solver(Protocol):
    """What solves a `Problem`."""

    name: str

    def solve(self, problem: Problem) -> Solution:
        """Return the answer; raise `QPError` where there is none."""


def make_solver(name: str) -> Solver:
    """Return a new solver, ``"clarabel"`` or ``"daqp"``; it keeps what it learns from one problem for the next.

    Raises
    ------
    QPError
        If it is not installed.
    """
    return DaqpSolver() if name == "daqp" else ClarabelSolver()


# ---------------------------------------------------------------------- scaling and check, compiled as they are read


@jit
def _scale(H, c, W, w, lower, upper, l):  # type: ignore[no-untyped-def] # noqa: E741
    """Return s and the mean curvature; s is nan where any number of the problem is not finite."""
    curvature, asked = np.trace(H) / c.shape[0], 0.0  # the longest step that a row asks for
    for k in range(w.shape[0]):
        asked = max(asked, abs(w[k]) if k < l else w[k])
    for i in range(c.shape[0]):
        asked = max(asked, lower[i], -upper[i])
    s = max(math.sqrt(c @ c) / curvature, asked)
    if not math.isfinite(H.sum() + W.sum() + w.sum() + lower.sum() + upper.sum() + c.sum()):
        return math.nan, curvature
    return max(s, STILL), curvature


@jit
def _room(u, W, w, lower, upper, l):  # type: ignore[no-untyped-def] # noqa: E741
    """Return the room that u leaves in the inequalities, (m + 2n,): G u - h, upper - u, u - lower."""
    return np.concatenate((W[l:] @ u - w[l:], upper - u, u - lower))


@jit
def _kkt(H, c, W, w, lower, upper, l, u, z, s, curvature):  # type: ignore[no-untyped-def] # noqa: E741
    """Return stationarity, primal, dual, complementarity (see `Residuals`) and the row with the largest violation.

    The slack in complementarity is scaled as the violations are; beyond one gradient step it counts as one.
    """
    k, n = w.shape[0], c.shape[0]
    signed = z[:k].copy()
    signed[l:] *= -1.0
    gradient = H @ u + c + signed @ W + z[k : k + n] - z[k + n :]
    force = max(s * curvature, np.abs(z).max())
    primal, row, dual, complementarity = 0.0, -1, 0.0, 0.0
    for i in range(l):
        off = abs(W[i] @ u - w[i]) / s
        if not off <= primal:
            primal, row = off, i
    room = _room(u, W, w, lower, upper, l) / s
    for i in range(room.shape[0]):
        multiplier = z[l + i] / force
        if not -room[i] <= primal:
            primal, row = -room[i], l + i
        dual = max(dual, -multiplier)
        complementarity = max(complementarity, abs(multiplier) * min(abs(room[i]), 1.0))
    return np.abs(gradient).max() / force, primal, dual, complementarity, row


def _check(problem: Problem, stationarity: float, primal: float, dual: float, complementarity: float, row: int) -> None:
    """Refuse an answer with these residuals.

    Raises
    ------
    QPError
        If it violates a row, or another of the Karush-Kuhn-Tucker conditions.
    """
    if not primal <= PRIMAL:
        name = problem.names[row] if problem.names else str(row)
        text = f"the answer violates the row '{name}' by {primal:.3g} (scaled)"
        raise QPError(text, status="Violated", rows=[name])
    other = max(stationarity, dual, complementarity)
    if not other <= OPTIMAL:
        raise QPError(f"the answer is not the optimum: a residual of {other:.3g} (relative)", status="NotOptimal")


def _check_finite(s: float, curvature: float) -> None:
    if not s * curvature > 0.0:
        raise QPError("the problem has a number that is not finite", status="NotFinite")


# ---------------------------------------------------------------------- Clarabel

_REACH = 1.0
"""Inequalities further away than this many gradient steps are left out at first."""
_DOUBTFUL = ("NotOptimal", "Violated", "AlmostSolved", "InsufficientProgress", "NumericalError", "MaxIterations")
"""What may be answered after all, with linear systems that are equilibrated and refined."""


@jit
def _nearby(H, c, W, w, lower, upper, l):  # type: ignore[no-untyped-def] # noqa: E741
    """Return s, curvature, and the numbers of the inequalities within reach of u = 0, the nearest one at least."""
    s, curvature = _scale(H, c, W, w, lower, upper, l)
    room = np.concatenate((-w[l:], upper, -lower)) / s
    return s, curvature, np.flatnonzero(room <= max(_REACH, room.min()))


@jit
def _clarabel_values(  # type: ignore[no-untyped-def]
    H, c, W, w, lower, upper, l, s, curvature, chosen, P, q, A, b,  # noqa: E741
):  # fmt: skip
    """Fill P (upper triangle), q, A (n, l + k) and b of Clarabel's form with the k inequalities `chosen`.

    It minimises 1/2 v'Pv + q'v subject to A v + slack = b; the slack of the equalities, which come first, is zero,
    that of the others not negative.
    """
    n, k, m = c.shape[0], chosen.shape[0], w.shape[0] - l
    q[:], A[:], at = c / (s * curvature), 0.0, 0
    for j in range(n):
        P[at : at + j + 1] = H[j, : j + 1] / curvature
        at += j + 1
    A[:, :l], b[:l] = W[:l].T, w[:l] / s
    for j in range(k):
        i = chosen[j]
        if i < m:
            A[:, l + j], b[l + j] = -W[l + i], -w[l + i] / s
        elif i < m + n:
            A[i - m, l + j], b[l + j] = 1.0, upper[i - m] / s
        else:
            A[i - m - n, l + j], b[l + j] = -1.0, -lower[i - m - n] / s


@jit
def _clarabel_answer(H, c, W, w, lower, upper, l, s, curvature, chosen, v, y, u, z):  # type: ignore[no-untyped-def] # noqa: E741
    """Fill u and z with Clarabel's answer; return their residuals (see `_kkt`)."""
    u[:], z[:] = s * v, 0.0
    z[:l] = s * curvature * y[:l]
    for k in range(chosen.shape[0]):
        z[l + chosen[k]] = s * curvature * y[l + k]
    return _kkt(H, c, W, w, lower, upper, l, u, z, s, curvature)


class ClarabelSolver:
    """Clarabel, kept and updated in place for each shape of problem.

    Most inequalities of a walk are far away most of the time, and an interior point pays for each of them in every
    iteration. So the problem is solved with those within reach alone; if the answer keeps the others too, it is the
    answer. If not, all of them take part.

    Attributes
    ----------
    whole : int
        How often all inequalities had to take part.
    """

    name = "clarabel"

    def __init__(self) -> None:
        self._kept: dict[tuple[int, int, int], _InPlace] = {}
        self.whole = 0

    def solve(self, problem: Problem) -> Solution:
        """Solve one problem.

        Raises
        ------
        QPError
            If there is no answer, or one that does not pass the check.
        """
        s, curvature, near = _nearby(*problem.arrays)
        _check_finite(s, curvature)
        n, _, m = problem.shape
        if 2 * len(near) <= m + 2 * n:
            try:
                return self._solved(problem, s, curvature, near)
            except QPError:  # a row that was left out is not kept, or the few rows alone have no answer
                pass
        self.whole += 1
        everything = np.arange(m + 2 * n)
        try:
            return self._solved(problem, s, curvature, everything)
        except QPError as error:
            if error.status not in _DOUBTFUL:
                raise
        return self._solved(problem, s, curvature, everything, careful=True)

    def _solved(
        self, problem: Problem, s: float, curvature: float, chosen: NDArray[np.int64], *, careful: bool = False
    ) -> Solution:
        n, l, m = problem.shape  # noqa: E741
        key = (n, l, -1 if careful else len(chosen))
        program = self._kept.get(key)
        if program is None:
            program = self._kept[key] = _InPlace(n, l, len(chosen), careful=careful)
        _clarabel_values(*problem.arrays, s, curvature, chosen, *program.values)
        answer, spent = program.solve()
        if answer.status != _SOLVED:
            z = np.zeros(l + m + 2 * n)
            z[np.concatenate([np.arange(l), l + chosen])] = answer.z
            raise _no_answer(problem, str(answer.status), z)
        u, z, v, y = np.empty(n), np.empty(l + m + 2 * n), np.array(answer.x), np.array(answer.z)
        _check(problem, *_clarabel_answer(*problem.arrays, s, curvature, chosen, v, y, u, z))
        return Solution(u, z, answer.iterations, spent)


_SOLVED = clarabel.SolverStatus.Solved


class _InPlace:
    """One Clarabel solver for all problems with n variables, l equalities and k inequalities.

    Attributes
    ----------
    values : tuple of ndarray
        P, q, A and b, as `_clarabel_values` fills them.
    """

    def __init__(self, n: int, l: int, k: int, *, careful: bool) -> None:  # noqa: E741
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.presolve_enable = False  # it would change the pattern
        # the problem is scaled already; dependent rows, such as those of two held feet, may need more
        settings.equilibrate_enable = settings.iterative_refinement_enable = careful
        if not careful:
            settings.max_step_fraction = 0.9999  # almost up to the boundary: fewer iterations
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12 if careful else 1e-14
        self._settings = settings
        rows = np.concatenate([np.arange(j + 1) for j in range(n)])
        self._P = rows, np.concatenate([[0], np.cumsum(np.arange(1, n + 1))]), (n, n)
        self._A = np.tile(np.arange(l + k), n), np.arange(n + 1) * (l + k), (l + k, n)
        self._cones = ([clarabel.ZeroConeT(l)] if l else []) + [clarabel.NonnegativeConeT(k)]
        self._solver: clarabel.DefaultSolver | None = None
        self.values = np.empty(n * (n + 1) // 2), np.empty(n), np.empty((n, l + k)), np.empty(l + k)

    def solve(self) -> tuple[clarabel.DefaultSolution, float]:
        """Solve for `values`; return the answer, and the time it took [s]: Clarabel's own figure contains the setup."""
        P, q, A, b = (part.ravel() for part in self.values)
        if self._solver is None:
            matrices = _csc(P, *self._P), q, _csc(A, *self._A), b
            self._solver = clarabel.DefaultSolver(*matrices, self._cones, self._settings)
        else:  # lists are taken over faster than arrays
            self._solver.update(P=P.tolist(), q=q.tolist(), A=A.tolist(), b=b.tolist())
        began = time.perf_counter()
        answer = self._solver.solve()
        return answer, time.perf_counter() - began


def _csc(values: Array, rows: NDArray[np.int64], starts: NDArray[np.int64], shape: tuple[int, int]) -> SimpleNamespace:
    """Return what clarabel reads of a scipy.sparse.csc_matrix, without the half second that scipy takes to import."""
    return SimpleNamespace(data=values, indices=rows, indptr=starts, shape=shape, has_canonical_format=True)


def _no_answer(problem: Problem, status: str, z: Array) -> QPError:
    worst = np.argsort(-np.abs(z))[:6]
    top = float(np.abs(z).max(initial=0.0))
    rows = [problem.names[i] for i in worst if problem.names and abs(z[i]) > 1e-3 * top]
    conflict = f"; rows in conflict: {', '.join(rows)}" if rows else ""
    return QPError(f"the quadratic program has no answer ({status}){conflict}", status=status, rows=rows)


# ---------------------------------------------------------------------- DAQP

_EQUALITY = 5
_NO_BOUND = 1e30
"""From here on daqp takes a bound for absent."""


@jit
def _daqp_values(H, c, W, w, lower, upper, l, H_out, c_out, A, high, low):  # type: ignore[no-untyped-def] # noqa: E741
    """Fill H, c, A, high and low of low <= [v; A v] <= high, with A = W; return s and the mean curvature."""
    s, curvature = _scale(H, c, W, w, lower, upper, l)
    n = c.shape[0]
    H_out[:], c_out[:], A[:] = H / curvature, c / (s * curvature), W
    high[:n], high[n : n + l], high[n + l :] = upper / s, w[:l] / s, _NO_BOUND
    low[:n], low[n:] = lower / s, w / s
    return s, curvature


@jit
def _daqp_answer(H, c, W, w, lower, upper, l, s, curvature, v, lam, u, z):  # type: ignore[no-untyped-def] # noqa: E741
    """Fill u and z; return their residuals (see `_kkt`). In daqp a row at its lower bound has a negative multiplier."""
    n, k, force = c.shape[0], w.shape[0], s * curvature
    u[:] = s * v
    z[:l], z[l:k] = force * lam[n : n + l], -force * lam[n + l :]
    z[k : k + n], z[k + n :] = np.maximum(force * lam[:n], 0.0), np.maximum(-force * lam[:n], 0.0)
    return _kkt(H, c, W, w, lower, upper, l, u, z, s, curvature)


class DaqpSolver:
    """DAQP, an active-set solver: exact, warm started, several times faster; one instance per shape of problem.

    It says only that there is no answer, not why. So where it finds no answer, or one that does not pass the check,
    Clarabel answers instead, or names the rows in conflict.

    Attributes
    ----------
    fallbacks : int
        How often Clarabel had to answer.

    Raises
    ------
    QPError
        If daqp is not installed.
    """

    name = "daqp"

    def __init__(self) -> None:
        try:
            import daqp
        except ImportError as error:
            raise QPError(
                "qp.solver is 'daqp', which is not installed: pip install 'dqwalk_ros[daqp]', "
                "or set qp.solver to clarabel",
                status="NotInstalled",
            ) from error
        self._model = daqp.Model
        self._kept: dict[tuple[int, int, int], tuple[Any, tuple[Array, ...]]] = {}
        self._second = ClarabelSolver()
        self.fallbacks = 0

    def solve(self, problem: Problem) -> Solution:
        """Solve one problem.

        Raises
        ------
        QPError
            If there is no answer; the rows in conflict are named.
        """
        n, l, m = shape = problem.shape  # noqa: E741
        k = l + m
        kept = self._kept.get(shape)
        values = (
            kept[1] if kept else (np.empty((n, n)), np.empty(n), np.empty((k, n)), np.empty(n + k), np.empty(n + k))
        )
        s, curvature = _daqp_values(*problem.arrays, *values)
        _check_finite(s, curvature)
        began = time.perf_counter()
        try:
            if kept and k:  # it cannot update a problem that has bounds only
                model = kept[0]
                updated = model.update(*values) >= 0
            else:
                model, updated = self._model(), True
                sense = np.zeros(n + l + m, dtype=np.int32)
                sense[n : n + l] = _EQUALITY
                model.setup(*values, sense)
                model.settings = {"primal_tol": 1e-11, "dual_tol": 1e-12}
                self._kept[shape] = model, values  # the model reads these arrays
            v, _, flag, info = model.solve() if updated else (None, None, 0, None)
            spent = time.perf_counter() - began
            if flag == 1 and info is not None:
                u, z = np.empty(n), np.empty(k + 2 * n)
                _check(problem, *_daqp_answer(*problem.arrays, s, curvature, v, info["lam"], u, z))
                return Solution(u, z, info["iterations"], spent)
        except QPError:
            pass
        self.fallbacks += 1
        self._kept.pop(shape, None)  # its working set led nowhere
        return self._second.solve(problem)


# ---------------------------------------------------------------------- a problem without an answer

# With every distance at or above its bound, standing still satisfies each inequality of (U6). So it has no answer only
# where the robot is outside already, or an equality asks for more than the inequalities allow.

_SLOWEST = 1e-3
"""The least fraction of the wanted rate that counts as a return."""
_SHARE = 0.9
"""Part of the fastest return that is asked for: at the fastest one the rows leave a single point."""
_FAST = 1e3
"""Joint velocities are free up to here where they have no limit [rad/s]."""


@dataclass(frozen=True)
class Conflict:
    """Rows that cannot be kept together.

    Attributes
    ----------
    short : dict of str to float
        Rows that must give way, by how much, in the row's own unit per second (m/s, m^2/s for squared distances,
        rad/s); largest first.
    against : tuple of str
        The rows they fight with, strongest first.
    """

    short: dict[str, float]
    against: tuple[str, ...]

    def __str__(self) -> str:
        text = ", ".join(f"{name} is short by {amount:.3g} /s" for name, amount in self.short.items())
        return f"{text}; against {', '.join(self.against[:6])}" if self.against else text


def conflicts(problem: Problem) -> Conflict | None:
    """Return which rows of a problem fight, and by how much; None where they can all be kept.

    The elastic program: the least total by which rows must give way. Each row is measured by its largest coefficient,
    so that the total is a joint velocity whatever the units of the rows.
    """
    from scipy.optimize import linprog  # slow to import, and seldom needed

    n, l, m = problem.shape  # noqa: E741
    rows = np.vstack([problem.E, -problem.G, np.eye(n), -np.eye(n)])  # E u = e, and A u <= b for the rest
    b = np.concatenate([problem.e, -problem.h, problem.upper, -problem.lower])
    if not (np.isfinite(rows).all() and np.isfinite(b).all()):
        return None
    size = np.maximum(np.abs(rows).max(axis=1, initial=0.0), 1e-12)
    A, b = rows / size[:, None], b / size
    k = m + 2 * n
    cost = np.concatenate([np.zeros(n), np.ones(2 * l + k)])
    equal = np.hstack([A[:l], np.eye(l), -np.eye(l), np.zeros((l, k))])
    below = np.hstack([A[l:], np.zeros((k, 2 * l)), -np.eye(k)])
    bounds = [(-_FAST, _FAST)] * n + [(0.0, None)] * (2 * l + k)
    found = linprog(cost, below, b[l:], equal if l else None, b[:l] if l else None, bounds)
    if not found.success:
        return None
    slack = found.x[n:]
    give = np.concatenate([slack[:l] + slack[l : 2 * l], slack[2 * l :]])
    forces = np.abs(np.concatenate([found.eqlin.marginals if l else np.empty(0), found.ineqlin.marginals]))
    names = problem.names or tuple(f"row {i}" for i in range(l + k))
    short = [i for i in np.argsort(-give) if give[i] > 1e-9 * max(1.0, float(np.abs(b).max()))]
    if not short:
        return None
    against = [i for i in np.argsort(-forces) if forces[i] > 1e-6 and i not in short]
    return Conflict({names[i]: float(give[i] * size[i]) for i in short}, tuple(names[i] for i in against))


def explained(error: QPError, problem: Problem) -> QPError:
    """Return the error with the rows that fight and by how much, where that can be said."""
    found = conflicts(problem)
    if found is None:
        return error
    return QPError(
        f"the quadratic program has no answer ({error.status}): {found}",
        status=error.status,
        rows=(*found.short, *found.against),
        short=found.short,
    )


def lead_back(problem: Problem) -> tuple[Problem, float]:
    """Return the problem that leads back in as fast as can be, and the fraction of the wanted rate it goes at.

    Rows that are kept stay as they are, and rows that are broken may not get worse. Every right-hand side that
    asks for motion, h > 0 or e != 0, is multiplied by one fraction in [0, 1], the largest for which all rows can be
    kept; zero velocity keeps them all at fraction 0.

    Raises
    ------
    QPError
        If there is no way back in.
    """
    from scipy.optimize import linprog  # slow to import, and seldom needed

    n, l, _ = problem.shape  # noqa: E741
    wanted, kept = np.maximum(problem.h, 0.0), np.minimum(problem.h, 0.0)
    rise, low = np.maximum(problem.lower, 0.0), np.minimum(problem.lower, 0.0)
    fall, high = np.minimum(problem.upper, 0.0), np.maximum(problem.upper, 0.0)
    # G u >= kept + t wanted, E u = t e, low + t rise <= u <= high + t fall
    below = np.vstack(
        [
            np.hstack([-problem.G, wanted[:, None]]),
            np.hstack([np.eye(n), -fall[:, None]]),
            np.hstack([-np.eye(n), rise[:, None]]),
        ]
    )
    b = np.concatenate([-kept, high, -low])
    equal = np.hstack([problem.E, -problem.e[:, None]])
    cost = np.zeros(n + 1)
    cost[n] = -1.0
    bounds = [(-_FAST, _FAST)] * n + [(0.0, 1.0)]
    finite = np.isfinite(below).all() and np.isfinite(b).all() and np.isfinite(equal).all()
    found = linprog(cost, below, b, equal if l else None, np.zeros(l) if l else None, bounds) if finite else None
    t = _SHARE * float(found.x[n]) if found is not None and found.success else 0.0
    if t < _SLOWEST:
        raise QPError("there is no way back inside the constraints", status="NoWayBack", rows=())
    w = np.concatenate([t * problem.e, kept + t * wanted])
    relaxed = dataclasses.replace(problem, w=w, lower=low + t * rise, upper=high + t * fall)
    return relaxed, t
