"""The quadratic program (6) by Clarabel.

Most inequalities of a walk are far away most of the time, and an interior point pays for each of them in every
iteration. So the problem is solved with those within reach alone; if the answer keeps the others too, it is the
answer. If not, all of them take part.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.errors import QPError
from dqwalk_ros.qp import OPTIMAL, PRIMAL, Problem, Solution, refuse
from dqwalk_ros.qp.in_place import SOLVED, InPlace
from dqwalk_ros.qp.scaling import pack_interior_point, pack_nearby, unpack_interior_point, unpack_nearby

__all__ = ["ClarabelSolver"]

Array = NDArray[np.float64]
_Sizes = tuple[int, int, int, int]

_REACH = 1.0
"""Rows further away than this many gradient steps are left out at first."""
_CAP = 100.0
"""Where all take part, rows this many gradient steps away start out capped."""
_ACTIVE = 1e-4
"""A capped row with a scaled multiplier above this mattered after all."""
_DOUBTFUL = ("NotOptimal", "Violated", "AlmostSolved", "InsufficientProgress", "NumericalError", "MaxIterations")
"""What may be answered after all, with its linear systems solved more carefully."""
_LIFTED = 3
"""From so many joints per row of the tasks on the sparse form y = J u is faster than the dense Hessian."""


class ClarabelSolver:
    """Clarabel, kept and updated in place for each shape of problem.

    Parameters
    ----------
    lifted : bool, optional
        Whether the task velocity y = J u becomes a variable, so that the Hessian is diagonal and the work grows
        linearly with the number of joints; by default where there are many joints for the rows of the tasks.

    Attributes
    ----------
    whole, refined : int
        How often all inequalities had to take part, and how often even that answer had to be refined.
    """

    name = "clarabel"

    def __init__(self, lifted: bool | None = None) -> None:
        self._lifted = lifted
        self._kept: dict[_Sizes, _Shape] = {}
        self.whole = self.refined = 0

    def solve(self, problem: Problem) -> Solution:
        """Solve one problem; where the answer fails the check, once more, more carefully.

        Raises
        ------
        QPError
            If the solver's status is anything but ``Solved``, or its answer violates a row.
        """
        sizes = problem.sizes
        kept = self._kept.get(sizes)
        if kept is None:
            lifted = sizes[0] >= _LIFTED * sizes[3] if self._lifted is None else self._lifted
            kept = self._kept[sizes] = _Shape(sizes, lifted=lifted and sizes[3] > 0)
        solution = kept.nearby(problem)
        if solution is not None:
            return solution
        self.whole += 1
        try:
            return kept.whole.solve(problem)
        except QPError as error:
            if error.status not in _DOUBTFUL:
                raise
        self.refined += 1
        return _Whole(sizes, lifted=False, careful=True).solve(problem)


class _Shape:
    """The solvers for one shape of problem: one with all inequalities, and one for each number of them in reach."""

    def __init__(self, sizes: _Sizes, *, lifted: bool) -> None:
        n, equalities, inequalities, r = sizes
        self._sizes, self._lifted, self._r = sizes, lifted, r if lifted else 0
        self._multipliers = equalities + inequalities + 2 * n
        self._most = (inequalities + 2 * n) // 2
        self._chosen = np.empty(self._most, dtype=np.int64)
        self._values = np.empty(_capacity(sizes, self._r, equalities + self._most))
        self._few: dict[int, InPlace] = {}

    @cached_property
    def whole(self) -> _Whole:
        """With all of them."""
        return _Whole(self._sizes, lifted=self._lifted)

    def nearby(self, problem: Problem) -> Solution | None:
        """Solve with the inequalities in reach; None where that is not the answer, or hardly less work."""
        sizes, chosen, most = self._sizes, self._chosen, self._most
        values = problem.values
        s, curvature, count = pack_nearby(values, *sizes, self._lifted, _REACH, most, chosen, self._values)
        if not s * curvature > 0.0:
            raise QPError("the problem has a number that is not finite", status="NotFinite")
        if count > most:
            return None
        n, r = sizes[0], self._r
        few = self._few.get(count)
        if few is None:
            few = self._few[count] = InPlace(self._values, n, r, sizes[1], count, bounds=False, bold=True)
        answer, spent = few.run()
        if answer.status != SOLVED:
            return None
        found = np.array(answer.x + answer.z)
        u, z = np.empty(n), np.empty(self._multipliers)
        violation, _, other, room = unpack_nearby(values, *sizes, s, curvature, chosen, count, found, n + r, r, u, z)
        if not (violation <= PRIMAL and other <= OPTIMAL and room >= 0.0):
            return None
        return Solution(u, z, answer.iterations, spent)


class _Whole:
    """A solver with all inequalities; the far ones are capped at first."""

    def __init__(self, sizes: _Sizes, *, lifted: bool, careful: bool = False) -> None:
        n, equalities, inequalities, r = sizes
        self._sizes, self._lifted, self._r = sizes, lifted, r if lifted else 0
        rows = equalities + inequalities + 2 * n
        self._multipliers = rows
        self._values = np.empty(_capacity(sizes, self._r, rows) + self._r + rows)
        self._program = InPlace(self._values, n, self._r, equalities, inequalities, bounds=True, careful=careful)

    def solve(self, problem: Problem) -> Solution:
        """Return the answer; raise `QPError` where there is none."""
        values, sizes, r = problem.values, self._sizes, self._r
        s, curvature = pack_interior_point(values, *sizes, self._lifted, _CAP, self._values)
        if not s * curvature > 0.0:
            raise QPError("the problem has a number that is not finite", status="NotFinite")
        answer, spent = self._program.run()
        scaled = np.array(answer.z)
        if answer.status != SOLVED or scaled[self._program.other > _CAP].max(initial=0.0) > _ACTIVE:
            answer, more = self._program.run(other=True)
            scaled, spent = np.array(answer.z), spent + more
            if answer.status != SOLVED:
                raise _no_answer(problem, str(answer.status), scaled[r:])
        u, z = np.empty(sizes[0]), np.empty(self._multipliers)
        residuals = unpack_interior_point(values, *sizes, s, curvature, np.array(answer.x), scaled, r, u, z)
        refuse(problem, *residuals)
        return Solution(u, z, answer.iterations, spent)


def _capacity(sizes: _Sizes, r: int, rows: int) -> int:
    """Return how many numbers P, q, A and b have at most, with so many rows below those of the lifted form."""
    n = sizes[0]
    return max(n * (n + 1) // 2, n + r) + (n + r) + n * (r + rows) + r + (r + rows)


def _no_answer(problem: Problem, status: str, z: Array) -> QPError:
    worst = np.argsort(-np.abs(z))[:6]
    top = float(np.abs(z).max(initial=0.0))
    rows = [problem.names[i] for i in worst if problem.names and abs(z[i]) > 1e-3 * top]
    conflict = f"; rows in conflict: {', '.join(rows)}" if rows else ""
    return QPError(f"the quadratic program has no answer ({status}){conflict}", status=status, rows=rows)
