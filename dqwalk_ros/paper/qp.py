"""The quadratic program (U6) and its solution by Clarabel or by DAQP.

The cost of a slow walk is small (joint velocities down to 1e-6 rad/s) compared with the absolute tolerances of a
solver, so the problem is scaled first: u = s v, where s is the length of a gradient step (or of the longest step that a
row requires), and the objective is divided by its mean curvature. A solution is accepted only if it fulfils the
Karush-Kuhn-Tucker conditions. They determine the solution, which is unique, if the multipliers are of the order of the
gradient. But their residuals are relative to the largest multiplier: if rows are nearly dependent, multipliers are
large, and the two solvers may return different solutions, each of which satisfies all rows.
"""

from __future__ import annotations

import dataclasses
import math
import time
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Protocol

import clarabel
import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.support.errors import ConfigError, QPError, how_to_install

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


PRIMAL = 1e-7
"""Largest scaled violation of a row that is accepted."""
LEAST_SCALE = 1e-9
"""Least scale s [rad/s]: shorter steps are rounding errors."""
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
        Desired task velocity.
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
        E above G, e above h: W_eq and w_eq of (U6), then its -W and -w without the joint limits.
    lower, upper : ndarray, shape (n,)
        Bounds of u by the joint limits (U12) and (U13) and by the largest velocities [rad/s].
    equalities : int
        Number of equality rows, l.
    names : tuple of str
        Names of the rows: equalities, inequalities, upper and lower limits.
    """

    H: Array
    c: Array
    W: Array
    w: Array
    lower: Array
    upper: Array
    equalities: int = 0
    names: tuple[str, ...] = ()

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
        """Rows of the inequalities, shape (m, n)."""
        return self.W[self.equalities :]

    @property
    def h(self) -> Array:
        """Right-hand sides of the inequalities, shape (m,)."""
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
    """Scaled residuals of the Karush-Kuhn-Tucker conditions.

    Attributes
    ----------
    stationarity, dual, complementarity : float
        Relative to the length of the gradient step times the mean curvature, or to the largest multiplier.
    primal : float
        Largest violation of a row, in gradient steps.
    row : int
        Index of the row with the largest violation; -1 if all rows are satisfied.
    """

    stationarity: float
    primal: float
    dual: float
    complementarity: float
    row: int = -1

    @property
    def largest(self) -> float:
        """The largest of the four residuals."""
        return max(self.stationarity, self.primal, self.dual, self.complementarity)


@dataclass(slots=True, eq=False)
class Solution:
    """An accepted solution of a `Problem`.

    Attributes
    ----------
    u : ndarray, shape (n,)
        Joint velocities [rad/s].
    z : ndarray, shape (l + m + 2n,)
        Multipliers of the equalities, inequalities, upper and lower limits; >= 0 except those of the equalities.
    iterations : int
        Number of iterations of the solver.
    solve_time : float
        Time taken by the solver [s].
    """

    u: Array
    z: Array
    iterations: int
    solve_time: float

    def active(self, problem: Problem) -> tuple[str, ...]:
        """Return the names of the active inequalities, in decreasing order of their multipliers."""
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
    """Interface of the solvers."""

    name: str

    def solve(self, problem: Problem) -> Solution:
        """Return the solution; raise `QPError` if there is none."""


def make_solver(name: str) -> Solver:
    """Return a new solver, ``"clarabel"`` or ``"daqp"``; it reuses memory, DAQP also its active set, between problems.

    Raises
    ------
    QPError
        If the solver is not installed.
    """
    return DaqpSolver() if name == "daqp" else ClarabelSolver()


# ---------------------------------------------------------------------- scaling and check of the solution


@jit
def _scale(H, c, W, w, lower, upper, l):  # type: ignore[no-untyped-def] # noqa: E741
    """Return the scale s and the mean curvature of a problem; s is nan if any of its numbers is not finite."""
    curvature, required = np.trace(H) / c.shape[0], 0.0  # the longest step that a row requires
    for k in range(w.shape[0]):
        required = max(required, abs(w[k]) if k < l else w[k])
    for i in range(c.shape[0]):
        required = max(required, lower[i], -upper[i])
    s = max(math.sqrt(c @ c) / curvature, required)
    if not math.isfinite(H.sum() + W.sum() + w.sum() + lower.sum() + upper.sum() + c.sum()):
        return math.nan, curvature
    return max(s, LEAST_SCALE), curvature


@jit
def _slack(u, W, w, lower, upper, l):  # type: ignore[no-untyped-def] # noqa: E741
    """Return the slack of the inequalities at u, shape (m + 2n,): G u - h, upper - u, u - lower."""
    return np.concatenate((W[l:] @ u - w[l:], upper - u, u - lower))


@jit
def _kkt(H, c, W, w, lower, upper, l, u, z, s, curvature):  # type: ignore[no-untyped-def] # noqa: E741
    """Return stationarity, primal, dual, complementarity (see `Residuals`) and the row with the largest violation.

    In the complementarity the slack is scaled like the violations, and limited to one gradient step.
    """
    k, n = w.shape[0], c.shape[0]
    signed = z[:k].copy()
    signed[l:] *= -1.0
    gradient = H @ u + c + signed @ W + z[k : k + n] - z[k + n :]
    force = max(s * curvature, np.abs(z).max())
    primal, row, dual, complementarity = 0.0, -1, 0.0, 0.0
    for i in range(l):
        error = abs(W[i] @ u - w[i]) / s
        if not error <= primal:
            primal, row = error, i
    slack = _slack(u, W, w, lower, upper, l) / s
    for i in range(slack.shape[0]):
        multiplier = z[l + i] / force
        if not -slack[i] <= primal:
            primal, row = -slack[i], l + i
        dual = max(dual, -multiplier)
        complementarity = max(complementarity, abs(multiplier) * min(abs(slack[i]), 1.0))
    return np.abs(gradient).max() / force, primal, dual, complementarity, row


def _check(problem: Problem, stationarity: float, primal: float, dual: float, complementarity: float, row: int) -> None:
    """Check the residuals of a solution.

    Raises
    ------
    QPError
        If it violates a row, or another of the Karush-Kuhn-Tucker conditions.
    """
    if not primal <= PRIMAL:
        name = problem.names[row] if problem.names else str(row)
        text = f"the solution violates the row '{name}' by {primal:.3g} (scaled)"
        raise QPError(text, status="Violated", rows=[name])
    other = max(stationarity, dual, complementarity)
    if not other <= OPTIMAL:
        raise QPError(f"the solution is not optimal: relative residual {other:.3g}", status="NotOptimal")


def _check_finite(s: float, curvature: float) -> None:
    if not s * curvature > 0.0:
        raise QPError("the problem contains a number that is not finite", status="NotFinite")


# ---------------------------------------------------------------------- Clarabel

_NEARBY = 1.0
"""Inequalities whose slack at u = 0 is larger than this many gradient steps are omitted at first."""
_RETRY = ("NotOptimal", "Violated", "AlmostSolved", "InsufficientProgress", "NumericalError", "MaxIterations")
"""Statuses after which the problem is solved again, with equilibration and iterative refinement."""


@jit
def _nearby(H, c, W, w, lower, upper, l):  # type: ignore[no-untyped-def] # noqa: E741
    """Return s, curvature, and the indices of the inequalities near u = 0, at least that of the nearest one."""
    s, curvature = _scale(H, c, W, w, lower, upper, l)
    slack = np.concatenate((-w[l:], upper, -lower)) / s
    return s, curvature, np.flatnonzero(slack <= max(_NEARBY, slack.min()))


@jit
def _clarabel_values(  # type: ignore[no-untyped-def]
    H, c, W, w, lower, upper, l, s, curvature, chosen, M, q, A, b,  # noqa: E741
):  # fmt: skip
    """Fill M (n, n), q (n,), A (n, l + k) and b (l + k,) of Clarabel's form; `chosen` are k inequalities.

    With the Cholesky factor L of the Hessian, M = L^-1 and q = M c, all scaled, the variables v = M'(t - q) make the
    objective 1/2 t't. Clarabel minimises it subject to A't + slack = b. The slack of the equalities, which come first,
    is zero, that of the inequalities is not negative.
    """
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
def _clarabel_solution(H, c, W, w, lower, upper, l, s, curvature, chosen, M, q, t, y, u, z):  # type: ignore[no-untyped-def] # noqa: E741
    """Fill u and z with Clarabel's primal and dual solution t and y, unscaled; return their residuals (see `_kkt`)."""
    u[:], z[:] = s * ((t - q) @ M), 0.0
    z[:l] = s * curvature * y[:l]
    for k in range(chosen.shape[0]):
        z[l + chosen[k]] = s * curvature * y[l + k]
    return _kkt(H, c, W, w, lower, upper, l, u, z, s, curvature)


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
        s, curvature, near = _nearby(*problem.arrays)
        _check_finite(s, curvature)
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
        M, q, A, b = program.values
        try:
            _clarabel_values(*problem.arrays, s, curvature, chosen, M, q, A, b)
        except np.linalg.LinAlgError as error:
            raise QPError("the Hessian is not positive definite", status="NotConvex") from error
        found, spent = program.solve()
        if found.status != _SOLVED:
            z = np.zeros(l + m + 2 * n)
            z[np.concatenate([np.arange(l), l + chosen])] = found.z
            raise _unsolved(problem, str(found.status), z)
        u, z, t, y = np.empty(n), np.empty(l + m + 2 * n), np.array(found.x), np.array(found.z)
        _check(problem, *_clarabel_solution(*problem.arrays, s, curvature, chosen, M, q, t, y, u, z))
        return Solution(u, z, found.iterations, spent)


_SOLVED = clarabel.SolverStatus.Solved


class _ClarabelProgram:
    """One Clarabel solver for all problems with n variables, l equalities and k inequalities.

    Attributes
    ----------
    values : tuple of ndarray
        M, q, A and b, as `_clarabel_values` fills them.
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
        self.values = np.empty((n, n)), np.empty(n), np.empty((n, l + k)), np.empty(l + k)

    def solve(self) -> tuple[clarabel.DefaultSolution, float]:
        """Solve for `values`; return Clarabel's result and the time taken [s], without that of the setup."""
        _, q, A, b = self.values
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


# ---------------------------------------------------------------------- DAQP

_EQUALITY = 5
"""DAQP's code of an equality."""
_NO_BOUND = 1e30
"""DAQP ignores bounds of this size and larger."""


@jit
def _daqp_values(H, c, W, w, lower, upper, l, H_out, c_out, A, high, low):  # type: ignore[no-untyped-def] # noqa: E741
    """Fill DAQP's H, c, A, high and low of low <= [v; A v] <= high, with A = W; return s and the mean curvature."""
    s, curvature = _scale(H, c, W, w, lower, upper, l)
    n = c.shape[0]
    H_out[:], c_out[:], A[:] = H / curvature, c / (s * curvature), W
    high[:n], high[n : n + l], high[n + l :] = upper / s, w[:l] / s, _NO_BOUND
    low[:n], low[n:] = lower / s, w / s
    return s, curvature


@jit
def _daqp_solution(H, c, W, w, lower, upper, l, s, curvature, v, lam, u, z):  # type: ignore[no-untyped-def] # noqa: E741
    """Fill u and z with DAQP's v and lam, unscaled; return their residuals (see `_kkt`).

    DAQP's multiplier of a row at its lower bound is negative.
    """
    n, k, force = c.shape[0], w.shape[0], s * curvature
    u[:] = s * v
    z[:l], z[l:k] = force * lam[n : n + l], -force * lam[n + l :]
    z[k : k + n], z[k + n :] = np.maximum(force * lam[:n], 0.0), np.maximum(-force * lam[:n], 0.0)
    return _kkt(H, c, W, w, lower, upper, l, u, z, s, curvature)


class DaqpSolver:
    """The active-set solver DAQP, warm started, several times faster than Clarabel; one instance per shape of problem.

    DAQP reports that there is no solution, but not which rows conflict. So if it fails, or its result does not fulfil
    the optimality conditions, Clarabel solves the problem, or names the rows in conflict.

    Attributes
    ----------
    fallbacks : int
        Number of problems that were passed on to Clarabel.

    Raises
    ------
    ConfigError
        If daqp is not installed.
    """

    name = "daqp"

    def __init__(self) -> None:
        try:
            import daqp
        except ImportError as error:
            how = how_to_install("daqp")
            why = f"qp.solver is daqp, which is not installed: {how}, or --set qp.solver=clarabel"
            raise ConfigError(why) from error
        self._make_model = daqp.Model
        self._models: dict[tuple[int, int, int], tuple[Any, tuple[Array, ...]]] = {}
        self._fallback = ClarabelSolver()
        self.fallbacks = 0

    def solve(self, problem: Problem) -> Solution:
        """Return the solution of a problem.

        Raises
        ------
        QPError
            If there is no solution; the rows in conflict are named.
        """
        n, l, m = shape = problem.shape  # noqa: E741
        k = l + m
        kept = self._models.get(shape)
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
                model, updated = self._make_model(), True
                sense = np.zeros(n + l + m, dtype=np.int32)
                sense[n : n + l] = _EQUALITY
                model.setup(*values, sense)
                model.settings = {"primal_tol": 1e-11, "dual_tol": 1e-12}
                self._models[shape] = model, values  # the model reads these arrays
            v, _, flag, info = model.solve() if updated else (None, None, 0, None)
            spent = time.perf_counter() - began
            if flag == 1 and info is not None:
                u, z = np.empty(n), np.empty(k + 2 * n)
                _check(problem, *_daqp_solution(*problem.arrays, s, curvature, v, info["lam"], u, z))
                return Solution(u, z, info["iterations"], spent)
        except (QPError, RuntimeError):  # DAQP's own error is that a Hessian is not positive definite
            pass
        self.fallbacks += 1
        self._models.pop(shape, None)  # the next warm start must not use this active set
        return self._fallback.solve(problem)


# ---------------------------------------------------------------------- infeasible problems

# If every distance is at or above its bound, u = 0 satisfies each inequality of (U6). So the problem is infeasible only
# if a constraint is violated already, or an equality requires more than the inequalities allow.

_LEAST_FRACTION = 1e-3
"""Least fraction of the desired return speed that `lead_back` accepts."""
_RETURN_FRACTION = 0.9
"""Fraction of the fastest feasible return that is used; at the fastest one the feasible set is a single point."""
_LARGEST_VELOCITY = 1e3
"""Bound of the joint velocities in the linear programs below [rad/s]."""


@dataclass(frozen=True)
class Conflict:
    """Rows that cannot be satisfied together.

    Attributes
    ----------
    short : dict of str to float
        Amount by which each row must be relaxed, in its own unit per second (m/s, m^2/s for squared distances,
        rad/s); largest first.
    against : tuple of str
        The active rows that conflict with them, in decreasing order of their multipliers.
    """

    short: dict[str, float]
    against: tuple[str, ...]

    def __str__(self) -> str:
        text = ", ".join(f"{name} is short by {amount:.3g} /s" for name, amount in self.short.items())
        return f"{text}; against {', '.join(self.against[:6])}" if self.against else text


def conflicts(problem: Problem) -> Conflict | None:
    """Return the rows of a problem that conflict, and by how much; None if the problem is feasible.

    It is the solution of the elastic program, which minimises the sum of the relaxations of all rows. Each row is
    divided by its largest coefficient, so that the sum has the unit of a joint velocity.
    """
    from scipy.optimize import linprog  # slow to import and rarely needed

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
    bounds = [(-_LARGEST_VELOCITY, _LARGEST_VELOCITY)] * n + [(0.0, None)] * (2 * l + k)
    found = linprog(cost, below, b[l:], equal if l else None, b[:l] if l else None, bounds)
    if not found.success:
        return None
    slack = found.x[n:]
    relaxation = np.concatenate([slack[:l] + slack[l : 2 * l], slack[2 * l :]])
    multipliers = np.abs(np.concatenate([found.eqlin.marginals if l else np.empty(0), found.ineqlin.marginals]))
    names = problem.names or tuple(f"row {i}" for i in range(l + k))
    short = [i for i in np.argsort(-relaxation) if relaxation[i] > 1e-9 * max(1.0, float(np.abs(b).max()))]
    if not short:
        return None
    against = [i for i in np.argsort(-multipliers) if multipliers[i] > 1e-6 and i not in short]
    return Conflict({names[i]: float(relaxation[i] * size[i]) for i in short}, tuple(names[i] for i in against))


def explained(error: QPError, problem: Problem) -> QPError:
    """Return a copy of the error that names the conflicting rows, or the error itself if none are found."""
    found = conflicts(problem)
    if found is None:
        return error
    return QPError(
        f"the quadratic program has no solution ({error.status}): {found}",
        status=error.status,
        rows=(*found.short, *found.against),
        short=found.short,
    )


def lead_back(problem: Problem) -> tuple[Problem, float]:
    """Return a relaxed problem that leads back to the constraints more slowly, and the fraction of the desired speed.

    Rows that u = 0 satisfies stay as they are. All right-hand sides that require motion, h > 0 or e != 0, are
    multiplied by the same fraction t in [0, 1]: 0.9 of the largest one for which the problem is feasible. Violated
    distances do not decrease; with t = 0 the problem is always feasible, by u = 0.

    Raises
    ------
    QPError
        If the fraction is smaller than 1e-3.
    """
    from scipy.optimize import linprog  # slow to import and rarely needed

    n, l, _ = problem.shape  # noqa: E741
    wanted, satisfied = np.maximum(problem.h, 0.0), np.minimum(problem.h, 0.0)
    rise, low = np.maximum(problem.lower, 0.0), np.minimum(problem.lower, 0.0)
    fall, high = np.minimum(problem.upper, 0.0), np.maximum(problem.upper, 0.0)
    # G u >= satisfied + t wanted, E u = t e, low + t rise <= u <= high + t fall
    below = np.vstack(
        [
            np.hstack([-problem.G, wanted[:, None]]),
            np.hstack([np.eye(n), -fall[:, None]]),
            np.hstack([-np.eye(n), rise[:, None]]),
        ]
    )
    b = np.concatenate([-satisfied, high, -low])
    equal = np.hstack([problem.E, -problem.e[:, None]])
    cost = np.zeros(n + 1)
    cost[n] = -1.0
    bounds = [(-_LARGEST_VELOCITY, _LARGEST_VELOCITY)] * n + [(0.0, 1.0)]
    finite = np.isfinite(below).all() and np.isfinite(b).all() and np.isfinite(equal).all()
    found = linprog(cost, below, b, equal if l else None, np.zeros(l) if l else None, bounds) if finite else None
    t = _RETURN_FRACTION * float(found.x[n]) if found is not None and found.success else 0.0
    if t < _LEAST_FRACTION:
        raise QPError("there is no way back inside the constraints", status="NoWayBack", rows=())
    w = np.concatenate([t * problem.e, satisfied + t * wanted])
    relaxed = dataclasses.replace(problem, w=w, lower=low + t * rise, upper=high + t * fall)
    return relaxed, t
