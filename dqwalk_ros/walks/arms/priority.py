"""The priority of a walk over the arms, where they press on the body."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.paper.assembly import Evaluation
from dqwalk_ros.paper.qp.problem import Problem, Solution

_FIRST = 10.0
"""Weight of the walk's joint velocities when those of the arms are chosen, much larger than those of the arms."""
_FREE = 0.5
"""Time for which an arm must not have pressed on the body until it is free again [s]: its rows come and go."""


@dataclass(eq=False)
class Priority:
    """Solves the programs of a walk with arms, so that the walk has priority.

    A task of the arms has no gradient in other joints, but a row that keeps an arm from the body has: while one is
    active, the program would turn the trunk away from an arm that presses on it. Then the walk is solved without arms;
    next the arms, to which the other joints yield only if the rows have no other solution; and at last the whole robot,
    with these velocities as the only task of the arms.
    """

    joints: NDArray[np.intp]
    """The joints of the arms, shape (k,)."""
    tasks: Collection[str]
    """Names of their tasks."""
    apart: Collection[str]
    """Names of the rows that keep an arm from the body."""
    weight: float
    """Of the velocities of the arms."""
    pressed: float = math.nan
    """Time at which an arm was last kept from the body [s]."""
    by: str = ""
    """The rows that kept it."""

    def solved(self, now: Evaluation, problem: Problem, solve: Callable[[Problem], Solution], time: float) -> Solution:
        """Return the solution of a program at a time [s], which `solve` solves; its tasks are those of `now`."""
        of_arms = np.array([name in self.apart for name in problem.names[: len(problem.w)]], dtype=bool)
        if not of_arms.any():
            return solve(problem)
        if not time - self.pressed < _FREE:
            solution = solve(problem)
            self._note(of_arms, problem, solution, time)
            if self.pressed != time:
                return solution
        arms, weight = self.joints, self.weight
        others = np.delete(np.arange(problem.shape[0]), arms)
        H, c = now.share(self.tasks)
        walk_H, walk_c = problem.H - H, problem.c - c
        walk_H[arms, arms] += weight
        keeps = ~of_arms
        names = (*itertools.compress(problem.names, keeps), *problem.names[len(keeps) :])
        u = solve(problem.replaced(H=walk_H, c=walk_c, W=problem.W[keeps], w=problem.w[keeps], names=names)).u
        H[arms, arms] += now.assembly.damping**2
        H[others, others] += _FIRST
        c[others] -= _FIRST * u[others]
        chosen = problem.replaced(H=H, c=c)
        solution = solve(chosen)
        self._note(of_arms, chosen, solution, time)
        c = walk_c.copy()
        c[arms] -= weight * solution.u[arms]
        return solve(problem.replaced(H=walk_H, c=c))

    def _note(self, of_arms: NDArray[np.bool_], problem: Problem, solution: Solution, time: float) -> None:
        """Note the time if one of the rows `of_arms` (l + m,) is active."""
        least = 1e-6 * max(float(np.abs(problem.c).max()), 1e-300)
        if (active := of_arms & (solution.z[: len(of_arms)] > least)).any():
            self.pressed = time
            self.by = ", ".join(itertools.compress(problem.names, active))
