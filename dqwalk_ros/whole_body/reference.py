"""The slow and sure way to solve a `Problem` of any scaling: Clarabel, once, with its own equilibration."""

from __future__ import annotations

import clarabel
import numpy as np
from scipy import sparse

from dqwalk_ros.errors import QPError
from dqwalk_ros.qp import Problem, Solution

__all__ = ["solve_reference"]

_ALMOST = 1e-6
"""Largest violation of a row in an answer that is ``AlmostSolved``."""


def solve_reference(problem: Problem, tolerance: float = 1e-9) -> Solution:
    """Solve a problem; its bounds and h may be infinite.

    What a fast solver is compared with, and what it falls back on.

    Raises
    ------
    QPError
        If the solver's status is anything but ``Solved``, or ``AlmostSolved`` with every row kept to 1e-6.
    """
    equalities = problem.e.shape[0]
    b = np.concatenate([problem.e, -problem.h, problem.upper, -problem.lower])
    rows = np.flatnonzero(np.isfinite(b))
    eye = sparse.identity(problem.c.shape[0], format="csr")
    A = sparse.vstack([sparse.csr_matrix(problem.E), sparse.csr_matrix(-problem.G), eye, -eye], format="csr")[rows]
    settings = clarabel.DefaultSettings()
    settings.verbose = settings.presolve_enable = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    cones = [clarabel.ZeroConeT(equalities), clarabel.NonnegativeConeT(len(rows) - equalities)]
    P = sparse.triu(sparse.csc_matrix(problem.H), format="csc")
    answer = clarabel.DefaultSolver(P, problem.c, sparse.csc_matrix(A), b[rows], cones, settings).solve()
    u, status = np.array(answer.x), str(answer.status)
    off = A @ u - b[rows]
    off[:equalities] = np.abs(off[:equalities])
    kept = status == "Solved" or (status == "AlmostSolved" and float(off.max(initial=0.0)) < _ALMOST)
    if not kept:
        raise QPError(f"the quadratic program has no answer ({status})", status=status)
    z = np.zeros(b.shape[0])
    z[rows] = answer.z
    return Solution(u=u, z=z, iterations=answer.iterations, solve_time=answer.solve_time)
