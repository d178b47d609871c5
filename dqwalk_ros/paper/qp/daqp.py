"""The solution of the quadratic program (U6) by the active-set solver DAQP, started from the last active set."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from dqwalk_ros.paper.qp.problem import Problem, Solution, Solver, check, check_finite, kkt, scale
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.support.errors import ConfigError, QPError, how_to_install

__all__ = ["EQUALITY", "NO_BOUND", "DaqpSolver"]


EQUALITY = 5
"""DAQP's code of an equality."""
NO_BOUND = 1e30
"""DAQP ignores bounds of this size and larger."""


@jit
def _posed(
    H: Array, c: Array, W: Array, w: Array, lower: Array, upper: Array, l: int,  # noqa: E741
    H_out: Array, c_out: Array, A: Array, high: Array, low: Array,
) -> tuple[float, float]:  # fmt: skip
    """Fill DAQP's H, c, A, high and low of low <= [v; A v] <= high, with A = W; return s and the mean curvature.

    The first arguments are the `Numbers` of the problem.
    """
    s, curvature = scale((H, c, W, w, lower, upper, l))
    n = c.shape[0]
    H_out[:], c_out[:], A[:] = H / curvature, c / (s * curvature), W
    high[:n], high[n : n + l], high[n + l :] = upper / s, w[:l] / s, NO_BOUND
    low[:n], low[n:] = lower / s, w / s
    return s, curvature


@jit
def _answer(
    H: Array, c: Array, W: Array, w: Array, lower: Array, upper: Array, l: int,  # noqa: E741
    s: float, curvature: float, v: Array, lam: Array, u: Array, z: Array,
) -> tuple[float, float, float, float, int]:  # fmt: skip
    """Fill u and z with DAQP's v and lam, unscaled; return their residuals (see `kkt`).

    DAQP's multiplier of a row at its lower bound is negative.
    """
    n, k, force = c.shape[0], w.shape[0], s * curvature
    u[:] = s * v
    z[:l], z[l:k] = force * lam[n : n + l], -force * lam[n + l :]
    z[k : k + n], z[k + n :] = np.maximum(force * lam[:n], 0.0), np.maximum(-force * lam[:n], 0.0)
    residuals: tuple[float, float, float, float, int] = kkt((H, c, W, w, lower, upper, l), u, z, s, curvature)
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
        self._models: dict[tuple[int, int, int], tuple[Any, tuple[Array, ...]]] = {}
        self._fallback = fallback
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
        posed = kept[1] if kept else (np.empty((n, n)), np.empty(n), np.empty((k, n)), np.empty(n + k), np.empty(n + k))
        s, curvature = _posed(*problem.numbers, *posed)
        check_finite(s, curvature)
        began = time.perf_counter()
        try:
            if kept and k:  # it cannot update a problem that has bounds only
                model = kept[0]
                updated = model.update(*posed) >= 0
            else:
                model, updated = self._make_model(), True
                sense = np.zeros(n + l + m, dtype=np.int32)
                sense[n : n + l] = EQUALITY
                model.setup(*posed, sense)
                model.settings = {"primal_tol": 1e-11, "dual_tol": 1e-12}
                self._models[shape] = model, posed  # the model reads these arrays
            v, _, flag, info = model.solve() if updated else (None, None, 0, None)
            spent = time.perf_counter() - began
            if flag == 1 and info is not None:
                u, z = np.empty(n), np.empty(k + 2 * n)
                check(problem, *_answer(*problem.numbers, s, curvature, v, info["lam"], u, z))
                return Solution(u, z, info["iterations"], spent)
        except (QPError, RuntimeError):  # DAQP's own error is that a Hessian is not positive definite
            pass
        self.fallbacks += 1
        self._models.pop(shape, None)  # the next warm start must not use this active set
        return self._fallback.solve(problem)
