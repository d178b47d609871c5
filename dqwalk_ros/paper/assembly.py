"""Assembly of the quadratic program (U6) from the tasks and constraints of a phase.

Each task and each constraint gives a value and its gradient with respect to the coordinates of its features (`tasks`,
`constraints`). They are stacked here, and the chain rule turns the gradients into Jacobians with respect to the joint
angles. Controller, monitor and report all use this code.

All affine tasks and constraints are one matrix product. The other classes of the package are evaluated in one compiled
function; a task or constraint of any other class, such as your own, is evaluated through its method `value`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dqwalk_ros.paper.constraints import (
    Affine,
    Constraint,
    FrameHeld,
    JointMaximum,
    JointMinimum,
    PointInCylinder,
    PointInsideWall,
    inside_cylinder,
    inside_wall,
    pose_error,
    vfi,
)
from dqwalk_ros.paper.kinematics import Kinematics, Observer
from dqwalk_ros.paper.paths import ComPath, SwingPath, follow_com_path, follow_swing_path
from dqwalk_ros.paper.qp.problem import Problem, objective
from dqwalk_ros.paper.targets import Follow, FollowPose, Target, follow, follow_pose
from dqwalk_ros.paper.tasks import ComOverFoot, FramePose, Posture, Task, pose_difference
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit

__all__ = ["Assembly", "Evaluation"]


DEPENDENT = 5e-3
"""Ratio to the largest singular value below which a singular value of equality rows counts as zero."""


@dataclass(slots=True, eq=False)
class Evaluation:
    """Values and gradients of the tasks and constraints of a phase for given joint angles.

    There are r rows of tasks, l of equalities and m of inequalities, in this order.

    Attributes
    ----------
    assembly : Assembly
    values : ndarray, shape (r + l + m,)
        Errors of the tasks, and signed distances of the equalities and inequalities.
    gradients : ndarray, shape (r + l + m, k)
        Gradients of the values with respect to the coordinates of all features.
    J_features : ndarray, shape (k, n)
        Jacobian of these coordinates with respect to the joint angles.
    rates : ndarray, shape (r,)
        Desired time derivatives of the errors.
    limit_distances : ndarray, shape (2n,)
        Distances (U12) and (U13) from the upper and the lower joint limits [rad].
    error : float
        Norm of the error of the first task.
    """

    assembly: Assembly
    values: Array
    gradients: Array
    J_features: Array
    rates: Array
    limit_distances: Array
    error: float

    def problem(self, dt: float, velocity: Array) -> Problem:
        """Return the quadratic program (U6).

        Parameters
        ----------
        dt : float
            Control period [s]; rates are limited to 1/dt.
        velocity : ndarray, shape (n,)
            Largest joint velocities, to which the bounds of u are clipped [rad/s].
        """
        made, n = self.assembly, velocity.shape[0]
        k = made.rows.shape[1] - 2 * n
        H, c, W, w, lower, upper = (
            np.empty((n, n)), np.empty(n), np.empty((k, n)), np.empty(k), np.empty(n), np.empty(n)
        )  # fmt: skip
        _program(
            self.values, self.gradients, self.J_features, self.rates, self.limit_distances, made.sqrt_weights,
            made.damping, made.rows, dt, made.equality_rows, velocity, H, c, W, w, lower, upper,
        )  # fmt: skip
        for group in made.groups:
            _make_independent(W[group], w[group])
        return Problem(H, c, W, w, lower, upper, made.equality_rows, made.names)

    @property
    def margins(self) -> Array:
        """Signed distance minus its bound of each row of the constraints, shape (l + m + 2n,)."""
        out: Array = np.concatenate([self.values[len(self.rates) :], self.limit_distances]) - self.assembly.rows[0]
        return out

    def distances(self) -> dict[str, float]:
        """Return each signed distance minus its bound, by name: >= 0 for a satisfied inequality, 0 for an equality."""
        return {name: float(d) for name, d in self.assembly.by_name(self.margins).items()}


_AFFINE_TASKS = ComOverFoot, Posture
CYLINDER, WALL, HELD, POSE, COM_PATH, SWING_PATH, FOLLOW, FOLLOW_POSE = range(8)
_KINDS: dict[type, int] = {
    PointInCylinder: CYLINDER, PointInsideWall: WALL, FrameHeld: HELD, FramePose: POSE, ComPath: COM_PATH,
    SwingPath: SWING_PATH, Follow: FOLLOW, FollowPose: FOLLOW_POSE,
}  # fmt: skip
_MOST_PARAMETERS = 17


@jit
def _stack(  # type: ignore[no-untyped-def]
    items, parameters, A, b, A_limits, b_limits, eta, q, elapsed, s, values, gradients, rates, limit_distances
):
    """Fill values and gradients of all rows, rates of the tasks' rows, and the distances from the joint limits.

    Affine rows are A s - b. `items` (k, 5) lists the tasks and constraints of the classes in `_KINDS`: kind, first row,
    row after the last one, first column, and column after the last one; `parameters` (k, 17) are their numbers.
    """
    values[:] = A @ s - b
    gradients[:] = A
    rates[:] = -eta * values[: rates.shape[0]]  # of (U6)
    limit_distances[:] = A_limits @ q - b_limits  # (U12), (U13)
    for k in range(items.shape[0]):
        kind, first, last, begin, end = items[k]
        rows, part, a = slice(first, last), s[begin:end], parameters[k]
        if kind == CYLINDER:
            values[first], gradients[first, begin:end] = inside_cylinder(part, a)
        elif kind == WALL:
            values[first], gradients[first, begin:end] = inside_wall(part, a)
        elif kind == HELD:
            values[rows], gradients[rows, begin:end] = pose_error(part, a[:3], a[3:7], 1.0)
        elif kind == POSE:
            values[rows], gradients[rows, begin:end] = pose_difference(part, a[:8])
            rates[rows] = -eta * values[rows]  # of (U6)
        elif kind == COM_PATH:
            values[rows], gradients[rows, begin:end], rates[rows] = follow_com_path(part, a, elapsed, eta)
        elif kind == SWING_PATH:
            values[rows], gradients[rows, begin:end], rates[rows] = follow_swing_path(part, a, elapsed)
        elif kind == FOLLOW:
            values[rows], rates[rows] = follow(values[rows], a)
        else:
            values[rows], gradients[rows, begin:end], rates[rows] = follow_pose(part, a)


@jit
def _program(  # type: ignore[no-untyped-def]
    values, gradients, J_features, rates, limit_distances, sqrt_weights, damping, rows, dt, equality_rows, velocity,
    H, c, W, w, lower, upper,
):  # fmt: skip
    """Fill H (n, n), c (n,), W (l + m, n), w (l + m,) and the bounds lower and upper (n,) of (U6).

    `rows` (3, l + m + 2n) are bound, eta and return speed of the rows of all constraints; the first `equality_rows` of
    them are equalities.
    """
    r, n, k = rates.shape[0], velocity.shape[0], w.shape[0]
    J = gradients @ J_features  # the chain rule: dd/dq = dd/ds ds/dq
    objective(sqrt_weights.reshape((r, 1)) * J[:r], sqrt_weights * rates, damping, H, c)  # (U6)
    right = vfi(np.concatenate((values[r:], limit_distances)), rows[0], rows[1], rows[2], dt)
    W[:], w[:] = J[r:], right[:k]
    w[:equality_rows] = np.maximum(w[:equality_rows], -rows[2, :equality_rows])
    upper[:] = np.minimum(np.maximum(-right[k : k + n], -velocity), velocity)  # -u >= w of (U12)
    lower[:] = np.minimum(np.maximum(right[k + n :], -velocity), velocity)  # u >= w of (U13)


class Assembly:
    """Evaluates the tasks, equalities and inequalities of one phase.

    Parameters
    ----------
    kin : Kinematics
        The robot at the start of the phase, in the base frame of the phase.
    tasks : sequence of Task
    equalities, inequalities : sequence of Constraint
    limits : (JointMaximum, JointMinimum)
    eta, damping : float
        eta [1/s] and lambda of (U6).

    Attributes
    ----------
    names : tuple of str
        Names of the rows of the quadratic program: equalities, inequalities, upper and lower joint limits.
    rows : ndarray, shape (3, l + m + 2n)
        Bound, eta and return speed of each row.
    spans, task_spans : dict of str to slice
        The rows of each constraint, and of each task.
    equality_rows : int
        Number of equality rows, l.
    groups : list of slice
        Rows of the equalities with more than one row, which may be linearly dependent.
    sqrt_weights : ndarray, shape (r,)
        Square roots of the weights of the tasks' rows.
    damping : float
        lambda.
    """

    def __init__(
        self,
        kin: Kinematics,
        tasks: Sequence[Task],
        equalities: Sequence[Constraint],
        inequalities: Sequence[Constraint],
        limits: tuple[JointMaximum, JointMinimum],
        *,
        eta: float,
        damping: float,
    ) -> None:
        joint_names, constraints = kin.model.joint_names, (*equalities, *inequalities)
        every = (*constraints, *limits)
        names = [constraint.row_names(joint_names) for constraint in every]
        self.names = tuple(name for group in names for name in group)
        counts = [len(group) for group in names]
        self.rows = np.repeat([[c.bound, c.eta, c.return_speed] for c in every], counts, axis=0).T.copy()
        self._A_limits = np.concatenate([limit.A for limit in limits])
        self._b_limits = np.concatenate([limit.b for limit in limits])
        self.spans = {c.name: span for c, span in zip(every, _slices(counts), strict=True)}
        self.equality_rows = sum(counts[: len(equalities)])
        self.groups = [span for span in _slices(counts[: len(equalities)]) if span.stop - span.start > 1]
        self._eta, self.damping = eta, damping

        stacked: tuple[Task | Constraint, ...] = (*tasks, *constraints)
        n = len(joint_names)
        columns = _slices([sum(feature.size or n for feature in item.watches) for item in stacked])
        self._observer = Observer([feature for item in stacked for feature in item.watches], kin.tree)
        s, _ = self._observer(kin)
        sizes = [len(task.value(s[at], 0.0)[0]) for task, at in zip(tasks, columns, strict=False)]
        self.sqrt_weights = np.repeat([task.weight**0.5 for task in tasks], sizes)
        self._task_rows, self._first = sum(sizes), sizes[0]
        rows = _slices([*sizes, *counts[: len(constraints)]])
        self.task_spans = {task.name: row for task, row in zip(tasks, rows, strict=False)}

        shape = rows[-1].stop, self._observer.size
        self._A, self._b = np.zeros(shape), np.zeros(shape[0])
        compiled: list[tuple[int, int, int, int, int]] = []
        parameters: list[Array] = []
        targets: list[tuple[int, Target]] = []
        self._tasks: list[tuple[Task, slice, slice]] = []  # those that are not compiled
        self._constraints: list[tuple[Constraint, slice, slice]] = []
        for item, row, column in zip(stacked, rows, columns, strict=True):
            if isinstance(item, Affine) and type(item).value is Affine.value:
                self._A[row, column], self._b[row] = item.A, item.b
            elif isinstance(item, Task) and type(item) in _AFFINE_TASKS:
                at_zero, self._A[row, column] = item.value(np.zeros(column.stop - column.start), 0.0)
                self._b[row] = -at_zero
            elif type(item) in _KINDS:
                if isinstance(item, Follow):
                    self._A[row, column] = item.A
                if isinstance(item, Follow | FollowPose):
                    targets.append((len(compiled), item.target))
                compiled.append((_KINDS[type(item)], row.start, row.stop, column.start, column.stop))
                parameters.append(np.resize(item.parameters, _MOST_PARAMETERS))
            elif isinstance(item, Task):
                self._tasks.append((item, row, column))
            else:
                self._constraints.append((item, row, column))
        self._items = np.array(compiled, dtype=np.int64).reshape(-1, 5)
        self._parameters = np.array(parameters).reshape(-1, _MOST_PARAMETERS)
        self._targets = [(target, self._parameters[k, : len(target.numbers)]) for k, target in targets]

    def __call__(self, kin: Kinematics) -> Evaluation:
        """Return errors, distances and gradients for the joint angles and the elapsed time of `kin`."""
        s, J_features = self._observer(kin)
        values, gradients = np.empty(self._b.shape), np.empty(self._A.shape)
        rates, limit_distances = np.empty(self._task_rows), np.empty(self._b_limits.shape)
        for target, copy in self._targets:  # the walk may have changed it
            copy[:] = target.numbers
        _stack(
            self._items, self._parameters, self._A, self._b, self._A_limits, self._b_limits, self._eta, kin.q,
            kin.elapsed, s, values, gradients, rates, limit_distances,
        )  # fmt: skip
        for task, rows, columns in self._tasks:
            part = s[columns]
            e, gradients[rows, columns] = task.value(part, kin.elapsed)
            values[rows], rates[rows] = e, task.rate(part, e, kin.elapsed, self._eta)
        for constraint, rows, columns in self._constraints:
            values[rows], gradients[rows, columns] = constraint.value(s[columns])
        e = values[: self._first]
        return Evaluation(self, values, gradients, J_features, rates, limit_distances, math.sqrt(e @ e))

    def by_name(self, margins: Array) -> dict[str, Array]:
        """Return the margins (...) of each constraint, by name, from those of all rows (..., l + m + 2n).

        For a constraint of several rows it is the smallest one; for an equality the one with the largest magnitude.
        """
        out = {}
        for name, span in self.spans.items():
            part = margins[..., span]
            if span.stop <= self.equality_rows:
                largest = np.abs(part).argmax(axis=-1, keepdims=True)
                out[name] = np.take_along_axis(part, largest, axis=-1)[..., 0]
            else:
                out[name] = part.min(axis=-1)
        return out


def _slices(sizes: Sequence[int]) -> list[slice]:
    """Return the slices of consecutive blocks of the given sizes."""
    ends = np.cumsum(sizes).tolist()
    return [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]


@jit
def _make_independent(E, e):  # type: ignore[no-untyped-def]
    """Replace the equalities E u = e (k rows) by orthogonal combinations; dependent ones become 0 = 0.

    The rows of a held sole have rank five, not six, if the ankles of both feet have no roll.
    """
    squares, U = np.linalg.eigh(E @ E.T)  # squared singular values of E, and its left singular vectors
    E[:], e[:] = U.T @ E, U.T @ e
    for k in range(e.shape[0]):
        if squares[k] <= DEPENDENT**2 * squares[-1]:
            E[k], e[k] = 0.0, 0.0
