"""The quadratic program (U6) as a search for the point of a polyhedron that is nearest to the origin.

Clarabel solves this form, and so does the active-set method of Lawson & Hanson, *Solving Least Squares Problems*,
chapter 23: with scipy alone, for a machine without Clarabel, such as one that has Ubuntu's packages only.
"""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.paper.qp.problem import Problem, Shape, Solution, check, check_finite, kkt, parts, scale
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.support.errors import QPError

Posed = tuple[Array, Array, Array, Array]
"""M, q, A and b, as `pose` fills them."""
_NEAREST = 1e-12
"""Least squared residual of the dual problem: below it the polyhedron is empty, or its nearest point 1e6 steps away."""


@jit
def pose(numbers: Array, shape: Shape, s: float, curvature: float, chosen: NDArray[np.int64], posed: Posed) -> bool:
    """Fill M (n, n), q (n,), A (n, l + k) and b (l + k,) of the least distance; `chosen` are k inequalities.

    Return whether the Hessian is positive definite. With its Cholesky factor L, M = L^-1 and q = M c, all scaled, the
    variables v = M'(t - q) make the objective 1/2 t't, subject to A't + slack = b. The slack of the equalities, which
    come first, is zero, that of the inequalities is not negative.
    """
    H, c, W, w, lower, upper = parts(numbers, shape)
    (n, l, m), (M, q, A, b) = shape, posed
    k = chosen.shape[0]
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
    if not _invert_factor(H / curvature, M):
        return False
    q[:], A[:] = M @ c / (s * curvature), M @ rows
    b += q @ A
    return True


@jit
def _invert_factor(H: Array, M: Array) -> bool:
    """Fill M (n, n) with L^-1 of the Cholesky factor, H = L L'; return whether H (n, n), which is overwritten, has one.

    The elimination that turns H into L' turns the identity into L^-1. For this few variables it takes a fifth of the
    time that LAPACK takes, and a tenth to compile.
    """
    n = H.shape[0]
    M[:] = 0.0
    for j in range(n):
        M[j, j] = 1.0
    for j in range(n):
        if not H[j, j] > 0.0:
            return False
        root = math.sqrt(H[j, j])
        for k in range(j, n):
            H[j, k] /= root
        for k in range(j + 1):
            M[j, k] /= root
        for i in range(j + 1, n):
            part = H[j, i]
            for k in range(i, n):
                H[i, k] -= part * H[j, k]
            for k in range(j + 1):
                M[i, k] -= part * M[j, k]
    return True


@jit
def answer(
    numbers: Array, shape: Shape, s: float, curvature: float, chosen: NDArray[np.int64], posed: Posed, t: Array,
    y: Array, u: Array, z: Array,
) -> tuple[float, float, float, float, int]:  # fmt: skip
    """Fill u and z with the primal and dual solution t and y, unscaled; return their residuals (see `kkt`)."""
    (M, q, _, _), l = posed, shape[1]
    u[:], z[:] = s * ((t - q) @ M), 0.0
    z[:l] = s * curvature * y[:l]
    for k in range(chosen.shape[0]):
        z[l + chosen[k]] = s * curvature * y[l + k]
    residuals: tuple[float, float, float, float, int] = kkt(numbers, shape, u, z, s, curvature)
    return residuals


def unsolved(problem: Problem, status: str, z: Array) -> QPError:
    """Return the error of a problem without a solution; the rows with the largest multipliers conflict."""
    worst = np.argsort(-np.abs(z))[:6]
    largest = float(np.abs(z).max(initial=0.0))
    rows = [problem.names[i] for i in worst if problem.names and abs(z[i]) > 1e-3 * largest]
    conflict = f"; rows in conflict: {', '.join(rows)}" if rows else ""
    return QPError(f"the quadratic program has no solution ({status}){conflict}", status=status, rows=rows)


class NnlsSolver:
    """Lawson & Hanson's least distance programming: its dual is a problem of non-negative least squares.

    The multipliers y >= 0 of A't <= b minimise |[A; b'] y + f|^2 with f = (0, ..., 0, 1). With its residual r, the
    solution is t = -r[:n] / r[n], and the multipliers are y / r[n]; if r = 0 there is no solution, and the rows with
    y > 0 are in conflict. An equality counts as two inequalities.
    """

    name = "nnls"

    def __init__(self) -> None:
        from scipy.optimize import nnls  # slow to import and rarely needed

        self._nnls = nnls

    def solve(self, problem: Problem) -> Solution:
        """Return the solution of a problem; its number of iterations is that of its active rows.

        Raises
        ------
        QPError
            If there is no solution, or the result does not fulfil the optimality conditions.
        """
        n, l, m = problem.shape
        s, curvature = scale(*problem[:2])
        check_finite(s, curvature)
        rows = np.arange(m + 2 * n)
        posed = np.empty((n, n)), np.empty(n), np.empty((n, l + len(rows))), np.empty(l + len(rows))
        if not pose(*problem[:2], s, curvature, rows, posed):
            raise QPError("the Hessian is not positive definite", status="NotConvex")
        began = time.perf_counter()
        below = np.vstack(posed[2:])
        both = np.hstack([below, -below[:, :l]])
        f = np.append(np.zeros(n), 1.0)
        try:
            found, _ = self._nnls(both, -f)
        except RuntimeError as error:
            raise QPError(f"the quadratic program is not solved: {error}", status="MaxIterations") from error
        r = both @ found + f
        y = found[: l + len(rows)]
        y[:l] -= found[l + len(rows) :]
        if r[n] < _NEAREST:
            raise unsolved(problem, "Infeasible", y)
        spent = time.perf_counter() - began
        u, z = np.empty(n), np.empty(l + len(rows))
        check(problem, *answer(*problem[:2], s, curvature, rows, posed, -r[:n] / r[n], y / r[n], u, z))
        return Solution(u, z, int(np.count_nonzero(y)), spent)
