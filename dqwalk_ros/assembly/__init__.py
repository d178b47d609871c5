"""From tasks and constraints to the quadratic program (6), compiled.

Tasks and constraints say readably what they are (`distance`, `jacobian`, `error`); those are their definition, and
the oracle of what happens here. The kinds in `forms` are written into one table when a phase begins, and each tick
one compiled pass over the table fills the matrices. A kind that is not there, such as one of your own, is asked by its
methods; a phase may mix both. Only exact classes are taken for the table: a subclass may have changed its methods.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.assembly import forms
from dqwalk_ros.assembly.compiled import POSTURE, evaluate, first_error
from dqwalk_ros.constraints import (
    Constraint,
    FrameHeld,
    JointMaximum,
    JointMinimum,
    gain,
    hold_rows,
    vfi_rows,
)
from dqwalk_ros.kinematics import Kinematics, Rooted
from dqwalk_ros.qp import Problem
from dqwalk_ros.qp.packed import size
from dqwalk_ros.tasks import Task

__all__ = ["Table"]

Array = NDArray[np.float64]

_Asked = Callable[[Constraint, Kinematics, float], tuple[Array, Array]]


class Table:
    """Tasks, equalities and inequalities of one phase, in the form the compiled pass reads.

    Parameters
    ----------
    rooted : Rooted
        The robot, seen from the base of the phase.
    joint_names : tuple of str
    tasks : sequence of Task
    holds, rows : sequence of Constraint
        Equalities and inequalities.
    limits : (Constraint, Constraint)
        Upper and lower joint limits, which become bounds on u.
    eta, damping : float
        eta [1/s] and lambda of (6).
    names : tuple of str
        Of the rows of the quadratic program.
    """

    def __init__(
        self,
        rooted: Rooted,
        joint_names: tuple[str, ...],
        tasks: Sequence[Task],
        holds: Sequence[Constraint],
        rows: Sequence[Constraint],
        limits: tuple[Constraint, Constraint],
        *,
        eta: float,
        damping: float,
        names: tuple[str, ...],
    ) -> None:
        self.rooted = rooted
        self._n = n = len(joint_names)
        self._moves = rooted.moves
        self._eta, self._damping, self._names = eta, damping, names
        index: list[list[int]] = []
        data: list[list[float]] = []
        self._others: list[tuple[slice, Constraint, _Asked]] = []
        at = 0
        for k, constraint in enumerate((*holds, *rows)):
            count = len(constraint.row_names(joint_names))
            held = k < len(holds)
            form = forms.ROWS.get(type(constraint))
            if form is None or (held and count > 1 and type(constraint) is not FrameHeld):
                self._others.append((slice(at, at + count), constraint, hold_rows if held else vfi_rows))
            else:
                least = -constraint.recovery if held else -np.inf
                side = [constraint.eta, constraint.bound, constraint.recovery, least]
                for j, (kind, body, other, numbers) in enumerate(form(constraint, rooted)):
                    index.append([kind, body, other, at + j, int(held)])
                    data.append([*side, *numbers])
            at += count
        equalities = sum(len(hold.row_names(joint_names)) for hold in holds)
        height = at
        self._row_index, self._row_data = _table(index, 5, np.int64), _table(data, 19, np.float64)

        index, data = [], []
        self._other_tasks: list[Task] = []
        residuals = 0
        self._first = False  # whether the first task is in the table
        for task in tasks:
            whole = forms.TASKS.get(type(task))
            made = whole(task, rooted) if whole is not None else None
            if made is None:
                self._other_tasks.append(task)
                continue
            kind, body, other, numbers = made
            index.append([kind, body, other])
            data.append([task.weight, *numbers])
            residuals += forms.HEIGHT[kind]
            if task is tasks[0]:
                self._first = kind != POSTURE
        self._task_index, self._task_data = _table(index, 3, np.int64), _table(data, max(26, n + 1), np.float64)

        above, below = limits
        self._limits = np.zeros((2, n + 3))
        self._limits[0, :n], self._limits[1, :n] = np.inf, -np.inf
        self._other_limits: tuple[Constraint, Constraint] | None = None
        if type(above) is JointMaximum and type(below) is JointMinimum:
            self._limits[0] = *above.q_max, above.eta, above.bound, above.recovery
            self._limits[1] = *below.q_min, below.eta, below.bound, below.recovery
        else:
            self._other_limits = above, below
        self._sizes = n, equalities, height - equalities, residuals
        self._size = size(*self._sizes)
        self._free = np.full(n, np.inf)
        self._mixed = bool(self._others or self._other_tasks or self._other_limits is not None)

    def problem(self, kin: Kinematics, dt: float, velocity: Array | None = None) -> Problem:
        """Return the quadratic program at one configuration.

        Parameters
        ----------
        kin : Kinematics
        dt : float
            Control period [s], which caps the rates at 1/dt.
        velocity : ndarray, shape (n,), optional
            Limits of the joint velocities, which the bounds are kept within [rad/s].
        """
        sizes = self._sizes
        values = np.empty(self._size)
        limit = self._free if velocity is None else velocity
        evaluate(
            kin.q, kin.values, kin.up, kin.elapsed, self._moves, self._row_index, self._row_data, self._task_index,
            self._task_data, self._limits, limit, self._eta, self._damping, 1.0 / dt, *sizes, values,
        )  # fmt: skip
        problem = Problem.of(values, sizes, self._names)
        return self._asked(problem, kin, dt, limit) if self._mixed else problem

    def _asked(self, problem: Problem, kin: Kinematics, dt: float, limit: Array) -> Problem:
        """Return the problem with what is not in the table."""
        W, w = np.concatenate([problem.E, problem.G]), np.concatenate([problem.e, problem.h])
        for at, constraint, asked in self._others:
            W[at], w[at] = asked(constraint, kin, dt)
        H, c, J, diagonal = problem.H, problem.c, problem.J, problem.diagonal
        parts = [] if J is None else [J]
        for task in self._other_tasks:
            root = task.weight**0.5
            part = root * task.jacobian(kin)
            H += part.T @ part
            c -= root * (task.wanted(kin, self._eta) @ part)
            parts.append(part)
        lower, upper = problem.lower, problem.upper
        if self._other_limits is not None:
            above, below = self._other_limits
            upper = np.maximum(gain(above.eta, dt) * (above.distance(kin) - above.bound), -above.recovery)
            lower = np.minimum(-gain(below.eta, dt) * (below.distance(kin) - below.bound), below.recovery)
            lower, upper = np.clip(lower, -limit, limit), np.clip(upper, -limit, limit)
        if parts and diagonal is None:
            diagonal = H.diagonal() - sum(np.einsum("ij,ij->j", part, part) for part in parts)
        l = self._sizes[1]  # noqa: E741
        return Problem(
            H, c, W[:l], w[:l], W[l:], w[l:], lower, upper, self._names, diagonal,
            np.concatenate(parts) if parts else None,
        )  # fmt: skip

    def error(self, kin: Kinematics, task: Task) -> float:
        """Return the norm of the error of the first task, which is `task`, at one configuration."""
        if self._first:
            bodies = self._moves.shape[0]
            found: float = first_error(
                bodies, self._n, kin.values, kin.up, kin.elapsed, self._task_index, self._task_data
            )
            return found
        e = task.error(kin)
        return float(np.sqrt(e @ e))


def _table(rows: list[list[Any]], width: int, dtype: type) -> NDArray[Any]:
    out: NDArray[Any] = np.zeros((len(rows), width), dtype=dtype)
    for k, row in enumerate(rows):
        out[k, : len(row)] = row
    return out
