"""The quadratic program (6) by Clarabel.

Most inequalities of a walk are far away most of the time, and an interior point pays for each of them in every
iteration. So the problem is solved with those within reach alone; if the answer keeps the others too, it is the
answer. If not, all of them take part.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.exceptions import QPError
from dqwalk_ros.qp import OPTIMAL, PRIMAL, Problem, Solution, refuse
from dqwalk_ros.qp.in_place import SOLVED, InPlace
from dqwalk_ros.qp.scaling import pack_interior_point, pack_nearby, unpack_interior_point, unpack_nearby

__all__ = ["ClarabelSolver"]

Array = NDArray[np.float64]

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
        self._kept: dict[tuple[int, ...], _Shape] = {}
        self.whole = self.refined = 0

    def solve(self, problem: Problem) -> Solution:
        """Solve one problem; where the answer fails the check, once more, more carefully.

        Raises
        ------
        QPError
            If the solver's status is anything but ``Solved``, or its answer violates a row.
        """
        shape = (*problem.shape, 0 if problem.J is None else problem.J.shape[0])
        kept = self._kept.get(shape)
        if kept is None:
            lifted = shape[0] >= _LIFTED * shape[3] if self._lifted is None else self._lifted
            kept = self._kept[shape] = _Shape(*shape[:3], shape[3] if lifted else 0)
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
        return _Whole(*shape[:3], 0, careful=True).solve(problem)


class _Shape:
    """The solvers for one shape of problem: one with all inequalities, and one for each number of them in reach."""

    def __init__(self, n: int, equalities: int, inequalities: int, r: int) -> None:
        self._shape = n, equalities, inequalities, r
        self._multipliers = equalities + inequalities + 2 * n
        self._most = (inequalities + 2 * n) // 2
        self._chosen = np.empty(self._most, dtype=np.int64)
        self._values = np.empty(InPlace(n, r, equalities, self._most, bounds=False).ends[-1])
        self._none = np.empty(n), np.empty((0, n))
        self._few: dict[int, InPlace] = {}

    @cached_property
    def whole(self) -> _Whole:
        """With all of them."""
        return _Whole(*self._shape)

    def nearby(self, problem: Problem) -> Solution | None:
        """Solve with the inequalities in reach; None where that is not the answer, or hardly less work."""
        n, equalities, _, r = self._shape
        arrays, chosen, most = problem.arrays, self._chosen, self._most
        tasks = _tasks(problem) if r else self._none
        s, curvature, count = pack_nearby(*arrays, *tasks, _REACH, most, chosen, self._values)
        if not s * curvature > 0.0:
            raise QPError("the problem has a number that is not finite", status="NotFinite")
        if count > most:
            return None
        few = self._few.get(count)
        if few is None:
            few = self._few[count] = InPlace(n, r, equalities, count, bounds=False, bold=True)
        answer, spent = few.run(self._values[: few.ends[-1]].tolist())
        if answer.status != SOLVED:
            return None
        x, scaled = np.array(answer.x), np.array(answer.z)
        u, z = np.empty(n), np.empty(self._multipliers)
        violation, _, other, room = unpack_nearby(*arrays, s, curvature, chosen, count, x, scaled, r, u, z)
        if not (violation <= PRIMAL and other <= OPTIMAL and room >= 0.0):
            return None
        return Solution(u, z, answer.iterations, spent)


class _Whole:
    """A solver with all inequalities; the far ones are capped at first."""

    def __init__(self, n: int, equalities: int, inequalities: int, r: int, *, careful: bool = False) -> None:
        self._n, self._r = n, r
        self._none = np.empty(n), np.empty((0, n))
        self._program = InPlace(n, r, equalities, inequalities, bounds=True, careful=careful)
        *_, c, d = self._program.ends
        self._sizes = np.array([*self._program.ends, 1 if r else 0])
        self._values = np.empty(d + d - c)
        self._full = self._values[d:]

    def solve(self, problem: Problem) -> Solution:
        """Return the answer; raise `QPError` where there is none."""
        tasks = _tasks(problem) if self._r else self._none
        s, curvature = pack_interior_point(*problem.arrays, *tasks, _CAP, self._sizes, self._values)
        if not s * curvature > 0.0:
            raise QPError("the problem has a number that is not finite", status="NotFinite")
        values = self._values.tolist()
        answer, spent = self._program.run(values)
        scaled = np.array(answer.z)
        if answer.status != SOLVED or scaled[self._full > _CAP].max(initial=0.0) > _ACTIVE:
            answer, more = self._program.run(values, self._program.ends[-1])
            scaled, spent = np.array(answer.z), spent + more
            if answer.status != SOLVED:
                raise _no_answer(problem, str(answer.status), scaled[self._r :])
        u, z = np.empty(self._n), np.empty(scaled.shape[0] - self._r)
        x = np.array(answer.x)
        residuals = unpack_interior_point(*problem.arrays, s, curvature, x, scaled, self._r, u, z)
        refuse(problem, *residuals)
        return Solution(u, z, answer.iterations, spent)


def _tasks(problem: Problem) -> tuple[Array, Array]:
    """Return diagonal and J of the lifted form."""
    assert problem.J is not None  # the shape has it
    assert problem.diagonal is not None
    return problem.diagonal, problem.J


def _no_answer(problem: Problem, status: str, z: Array) -> QPError:
    worst = np.argsort(-np.abs(z))[:6]
    top = float(np.abs(z).max(initial=0.0))
    rows = [problem.names[i] for i in worst if problem.names and abs(z[i]) > 1e-3 * top]
    conflict = f"; rows in conflict: {', '.join(rows)}" if rows else ""
    return QPError(f"the quadratic program has no answer ({status}){conflict}", status=status, rows=rows)
