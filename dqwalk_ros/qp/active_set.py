"""DAQP, an active-set solver of the same problem: exact, warm started, several times faster; the one importer of daqp.

It says only that there is no answer, not why. So where it finds none, or one that fails the check, Clarabel has the
last word: it answers, or names the rows in conflict.
"""

from __future__ import annotations

import time

import numpy as np

from dqwalk_ros.errors import QPError
from dqwalk_ros.qp import OPTIMAL, PRIMAL, Problem, Solution
from dqwalk_ros.qp.interior_point import ClarabelSolver
from dqwalk_ros.qp.scaling import pack_active_set, unpack_active_set

try:
    import daqp
except ImportError as error:  # pragma: no cover - where the extra is not installed
    raise QPError(
        "qp.solver is 'daqp', which is not installed: pip install 'dqwalk_ros[daqp]', or set qp.solver to clarabel",
        status="NotInstalled",
    ) from error

__all__ = ["DaqpSolver"]

_EQUALITY = 5
_FAR = 1e30
"""What daqp takes for no bound."""


class DaqpSolver:
    """DAQP, warm started: one instance per shape of problem.

    Attributes
    ----------
    fallbacks : int
        How often Clarabel had to answer.
    """

    name = "daqp"

    def __init__(self) -> None:
        self._kept: dict[tuple[int, int, int, int], _Warm] = {}
        self._second = ClarabelSolver()
        self.fallbacks = 0

    def solve(self, problem: Problem) -> Solution:
        """Solve one problem.

        Raises
        ------
        QPError
            If there is no answer; the rows in conflict are named.
        """
        shape = problem.sizes
        kept = self._kept.get(shape)
        if kept is None:
            kept = self._kept[shape] = _Warm(*shape[:3])
        solution = kept.solve(problem)
        if solution is None:
            self.fallbacks += 1
            del self._kept[shape]  # its working set led nowhere
            return self._second.solve(problem)
        return solution


class _Warm:
    """One DAQP workspace and the arrays it reads; rows are [I; E; G]."""

    def __init__(self, n: int, equalities: int, inequalities: int) -> None:
        rows = equalities + inequalities
        self.n = n
        self.values = np.full(n * (n + 1) + rows * n + 2 * (n + rows), _FAR)
        H, self.c, A, self.high, self.low = np.split(self.values, np.cumsum([n * n, n, rows * n, n + rows]))
        self.H, self.A = H.reshape(n, n), A.reshape(rows, n)
        self.sense = np.zeros(n + rows, dtype=np.int32)
        self.sense[n : n + equalities] = _EQUALITY
        self.model: daqp.Model | None = None

    def solve(self, problem: Problem) -> Solution | None:
        H, c, A, high, low = self.H, self.c, self.A, self.high, self.low
        s, curvature = pack_active_set(problem.values, *problem.sizes, self.values)
        if not s * curvature > 0.0:
            raise QPError("the problem has a number that is not finite", status="NotFinite")
        began = time.perf_counter()
        if self.model is None:
            self.model = daqp.Model()
            self.model.setup(H, c, A, high, low, self.sense)
            self.model.settings = {"primal_tol": 1e-11, "dual_tol": 1e-12}
        elif self.model.update(H, c, A, high, low) < 0:
            return None
        v, _, flag, info = self.model.solve()
        if flag != 1:
            return None
        u, z = np.empty(self.n), np.empty(self.n + high.shape[0])
        violation, _, other = unpack_active_set(problem.values, *problem.sizes, s, curvature, v, info["lam"], u, z)
        if not (violation <= PRIMAL and other <= OPTIMAL):
            return None
        return Solution(u, z, info["iterations"], time.perf_counter() - began)
