"""From tasks and constraints to the quadratic program (6), compiled.

Tasks and constraints say readably what they are (`distance`, `jacobian`, `error`); those are their definition, and
the oracle of what happens here. The kinds below are written into one table when a phase begins, and each tick one
compiled pass over the table fills the matrices. A kind that is not below, such as one of your own, is asked by its
methods; a phase may mix both. Only exact classes are taken for the table: a subclass may have changed its methods.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros import kernels
from dqwalk_ros.assembly.compiled import AXIS, COM_OVER_FOOT, CYLINDER, FRAME_POSE, PLANE, POSTURE, WALL, evaluate
from dqwalk_ros.constraints import (
    AxisLevel,
    Constraint,
    JointMaximum,
    JointMinimum,
    PointInCylinder,
    PointInsideWall,
    PointOverPlane,
    gain,
    hold_rows,
    vfi_rows,
)
from dqwalk_ros.kinematics import Kinematics, Point, Rooted
from dqwalk_ros.qp import Problem
from dqwalk_ros.tasks import ComOverFoot, FramePose, Posture, Task

__all__ = ["Table"]

Array = NDArray[np.float64]

_UP = np.array([0.0, 0.0, 1.0])


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
            form = _ROWS.get(type(constraint))
            if form is None or constraint.recovery < np.inf:
                asked = hold_rows if k < len(holds) else vfi_rows
                self._others.append((slice(at, at + count), constraint, asked))
            else:
                kind, body, other, numbers = form(constraint, rooted)
                index.append([kind, body, other, at])
                data.append([constraint.eta, constraint.bound, *numbers])
            at += count
        self._equalities = sum(len(hold.row_names(joint_names)) for hold in holds)
        self._height = at
        self._row_index, self._row_data = _table(index, 4, np.int64), _table(data, 15, np.float64)

        index, data = [], []
        self._other_tasks: list[Task] = []
        self._residuals = 0
        for task in tasks:
            made = _TASKS.get(type(task))
            if made is None:
                self._other_tasks.append(task)
                continue
            kind, body, height, numbers = made(task, rooted)
            index.append([kind, body])
            data.append([task.weight, *numbers])
            self._residuals += height
        self._task_index, self._task_data = _table(index, 2, np.int64), _table(data, max(17, n + 1), np.float64)

        above, below = limits
        self._limits = np.zeros((2, n + 2))
        self._limits[0, :n], self._limits[1, :n] = np.inf, -np.inf
        self._other_limits: tuple[Constraint, Constraint] | None = None
        if type(above) is JointMaximum and type(below) is JointMinimum:
            self._limits[0] = *above.q_max, above.eta, above.bound
            self._limits[1] = *below.q_min, below.eta, below.bound
        else:
            self._other_limits = above, below

    def problem(self, kin: Kinematics, dt: float) -> Problem:
        """Return the quadratic program at one configuration.

        Parameters
        ----------
        kin : Kinematics
        dt : float
            Control period [s], which caps the rates at 1/dt.
        """
        n, l = self._n, self._equalities  # noqa: E741
        H, c, diagonal = np.empty((n, n)), np.empty(n), np.empty(n)
        J, W, w = np.empty((self._residuals, n)), np.empty((self._height, n)), np.empty(self._height)
        lower, upper = np.empty(n), np.empty(n)
        evaluate(
            *kin.arrays, self._moves, self._row_index, self._row_data, self._task_index, self._task_data, self._limits,
            self._eta, self._damping, 1.0 / dt, H, c, diagonal, J, W, w, lower, upper,
        )  # fmt: skip
        for at, constraint, asked in self._others:
            W[at], w[at] = asked(constraint, kin, dt)
        for task in self._other_tasks:
            root = task.weight**0.5
            part = root * task.jacobian(kin)
            H += part.T @ part
            c -= root * (task.wanted(kin, self._eta) @ part)
            J = np.concatenate([J, part])
        if self._other_limits is not None:
            above, below = self._other_limits
            upper = gain(above.eta, dt) * (above.distance(kin) - above.bound)
            lower = -gain(below.eta, dt) * (below.distance(kin) - below.bound)
        return Problem(H, c, W[:l], w[:l], W[l:], w[l:], lower, upper, self._names, diagonal, J)


def _table(rows: list[list[Any]], width: int, dtype: type) -> NDArray[Any]:
    out: NDArray[Any] = np.zeros((len(rows), width), dtype=dtype)
    for k, row in enumerate(rows):
        out[k, : len(row)] = row
    return out


def _at(point: Point, rooted: Rooted) -> tuple[int, Array]:
    """Return the body of a point and its place on it, -1 for the centre of mass."""
    if not point.frame:
        return -1, np.zeros(3)
    body, pose = rooted.frames[point.frame]
    return body, kernels.point(pose, point.offset)


# Each form returns the kind, the body, a second body, and the numbers from column 2 of the table on:
# the point on the body (3), the point on the second body (3), and what the kind asks for (7).


def _plane(row: PointOverPlane, rooted: Rooted) -> tuple[int, int, int, list[float]]:
    body, p = _at(row.point, rooted)
    return PLANE, body, 0, [*p, 0, 0, 0, *row.plane.n, row.plane.d]


def _cylinder(row: PointInCylinder, rooted: Rooted) -> tuple[int, int, int, list[float]]:
    body, p = _at(row.point, rooted)
    axis = row.cylinder.axis
    return CYLINDER, body, 0, [*p, 0, 0, 0, *axis.l, *axis.m, row.cylinder.radius**2]


def _wall(row: PointInsideWall, rooted: Rooted) -> tuple[int, int, int, list[float]]:
    body, p = _at(row.point, rooted)
    other, b = _at(row.moving, rooted)
    return WALL, body, other, [*p, *b, *row.fixed, row.side]


def _axis(row: AxisLevel, rooted: Rooted) -> tuple[int, int, int, list[float]]:
    body, pose = rooted.frames[row.frame]
    up = kernels.point(pose, _UP) - kernels.point(pose, np.zeros(3))
    return AXIS, body, 0, [*up, 0, 0, 0, *row.direction]


def _com_over_foot(task: ComOverFoot, rooted: Rooted) -> tuple[int, int, int, list[float]]:
    body, p = _at(task.foot, rooted)
    return COM_OVER_FOOT, body, 2, [*p]


def _frame_pose(task: FramePose, rooted: Rooted) -> tuple[int, int, int, list[float]]:
    body, pose = rooted.frames[task.frame]
    return FRAME_POSE, body, 8, [*pose, *task.target]


def _posture(task: Posture, rooted: Rooted) -> tuple[int, int, int, list[float]]:
    return POSTURE, -1, 0, [*task.q_ref]


_Asked = Callable[[Constraint, Kinematics, float], tuple[Array, Array]]
_Form = Callable[[Any, Rooted], tuple[int, int, int, list[float]]]
_ROWS: dict[type, _Form] = {
    PointOverPlane: _plane,
    PointInCylinder: _cylinder,
    PointInsideWall: _wall,
    AxisLevel: _axis,
}
_TASKS: dict[type, _Form] = {ComOverFoot: _com_over_foot, FramePose: _frame_pose, Posture: _posture}
