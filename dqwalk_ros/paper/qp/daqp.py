"""The solution of the quadratic program (U6) by the active-set solver DAQP, started from the last active set."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from dqwalk_ros.paper.qp.problem import Problem, Shape, Solution, Solver, check, check_finite, kkt, parts, scale
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.support.errors import ConfigError, QPError
from dqwalk_ros.support.imports import how_to_install

EQUALITY = 5
"""DAQP's code of an equality."""
NO_BOUND = 1e30
"""DAQP ignores bounds of this size and larger."""
_FAILED: Any = None, None, 0, None
"""Result of a problem that DAQP does not accept."""


@jit
def _pose(numbers: Array, shape: Shape, H: Array, c: Array, A: Array, high: Array, low: Array) -> tuple[float, float]:
    """Fill DAQP's H, c, A, high and low of low <= [v; A v] <= high, with A = W; return s and the mean curvature."""
    unscaled_H, unscaled_c, A[:], w, lower, upper = parts(numbers, shape)
    s, curvature = scale(numbers, shape)
    n, l, _ = shape
    np.divide(unscaled_H, curvature, H)
    np.divide(unscaled_c, s * curvature, c)
    np.divide(lower, s, low[:n])
    np.divide(w, s, low[n:])
    np.divide(upper, s, high[:n])
    high[n : n + l], high[n + l :] = low[n : n + l], NO_BOUND
    return s, curvature


@jit
def _answer(
    numbers: Array, shape: Shape, s: float, curvature: float, u: Array, lam: Array, z: Array
) -> tuple[float, float, float, float, int]:
    """Scale DAQP's u back, and fill z with its lam; return their residuals (see `kkt`).

    DAQP's multiplier of a row at its lower bound is negative.
    """
    n, l, m = shape
    k, force = l + m, s * curvature
    u *= s
    z[:l], z[l:k] = force * lam[n : n + l], -force * lam[n + l :]
    z[k : k + n], z[k + n :] = np.maximum(force * lam[:n], 0.0), np.maximum(-force * lam[:n], 0.0)
    residuals: tuple[float, float, float, float, int] = kkt(numbers, shape, u, z, s, curvature)
    return residuals


class DaqpSolver:
    """The active-set solver DAQP, warm started, several times faster than Clarabel; one instance per shape of problem.

    DAQP reports that there is no solution, but not which rows conflict. So if it fails, or its result does not fulfil
    the optimality conditions, another solver solves the problem, or names the rows in conflict.

    Parameters
    ----------
    fallback : Solver
        The other solver.

    Attributes
    ----------
    fallbacks : int
        Number of problems that were passed on to the other solver.

    Raises
    ------
    ConfigError
        If daqp is not installed.
    """

    name = "daqp"

    def __init__(self, fallback: Solver) -> None:
        try:
            import daqp
        except ImportError as error:
            how = how_to_install("daqp")
            why = f"qp.solver is daqp, which is not installed: {how}, or --set qp.solver=clarabel"
            raise ConfigError(why) from error
        self._make_model = daqp.Model
        self._models: dict[Shape, tuple[Any, tuple[Array, ...]]] = {}
        self._fallback = fallback
        self.fallbacks = 0

    def solve(self, problem: Problem) -> Solution:
        """Return the solution of a problem.

        Raises
        ------
        QPError
            If there is no solution; the rows in conflict are named.
        """
        shape = n, l, m = problem.shape
        k, kept = l + m, self._models.get(shape)
        posed = kept[1] if kept else (np.empty((n, n)), np.empty(n), np.empty((k, n)), np.empty(n + k), np.empty(n + k))
        s, curvature = _pose(problem.numbers, shape, *posed)
        check_finite(s, curvature)
        began = time.perf_counter()
        try:
            if kept and k:  # it cannot update a problem that has bounds only
                model = kept[0]
                updated = model.update(*posed[:2]) >= 0  # and all that depends on H and c: it reads the other arrays
            else:
                model, updated = self._make_model(), True
                sense = np.zeros(n + k, dtype=np.int32)
                sense[n : n + l] = EQUALITY
                model.setup(*posed, sense)
                model.settings = {"primal_tol": 1e-11, "dual_tol": 1e-12}
                self._models[shape] = model, posed
            u, _, flag, info = model.solve() if updated else _FAILED
            spent = time.perf_counter() - began
            if flag == 1:
                z = np.empty(k + 2 * n)
                check(problem, *_answer(problem.numbers, shape, s, curvature, u, info["lam"], z))
                return Solution(u, z, info["iterations"], spent)
        except (QPError, RuntimeError):  # DAQP's own error is that a Hessian is not positive definite
            pass
        self.fallbacks += 1
        self._models.pop(shape, None)  # the next warm start must not use this active set
        return self._fallback.solve(problem)
