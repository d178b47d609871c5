"""From tasks and constraints to the quadratic program (U6): everything a phase watches, at one configuration.

Each task and each constraint says a value and a gradient over what it watches (`tasks`, `constraints`). Here they are
stacked and turned into Jacobians by the chain rule, once, for the controller, the monitor and the report alike.

What is affine is one product; the compiled functions of the other kinds that the package has are called from one
compiled pass. Any other task or constraint, such as your own, is asked by its method `value`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.compiled import jit
from dqwalk_ros.constraints import (
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
from dqwalk_ros.kinematics import Kinematics, Observer
from dqwalk_ros.qp import Problem, objective
from dqwalk_ros.tasks import ComOverFoot, FramePose, Task, pose_difference

__all__ = ["Assembly", "Evaluation"]

Array = NDArray[np.float64]

DEPENDENT = 5e-3
"""Equality rows with a singular value below this part of the largest are taken for dependent."""


@dataclass(slots=True, eq=False)
class Evaluation:
    """The tasks and constraints of a phase at one configuration; rows are those of the tasks, then the constraints.

    Attributes
    ----------
    assembly : Assembly
    values : ndarray, shape (r + l + m,)
        Errors of the tasks, and signed distances of the equalities and inequalities.
    gradients : ndarray, shape (r + l + m, k)
        Of the same, over the coordinates of all features watched.
    J_features : ndarray, shape (k, n)
        Jacobian of these coordinates.
    rates : ndarray, shape (r,)
        Velocities of the errors asked for.
    joint_room : ndarray, shape (2n,)
        Distances (U12) and (U13) from the joint limits, upper and lower.
    error : float
        Norm of the error of the first task.
    """

    assembly: Assembly
    values: Array
    gradients: Array
    J_features: Array
    rates: Array
    joint_room: Array
    error: float

    def problem(self, dt: float, velocity: Array) -> Problem:
        """Return the quadratic program (U6).

        Parameters
        ----------
        dt : float
            Control period [s], which caps the rates at 1/dt.
        velocity : ndarray, shape (n,)
            Largest joint velocities, which the bounds are kept within [rad/s].
        """
        of, n = self.assembly, velocity.shape[0]
        k = of.rows.shape[1] - 2 * n
        H, c, W, w, lower, upper = (
            np.empty((n, n)), np.empty(n), np.empty((k, n)), np.empty(k), np.empty(n), np.empty(n)
        )  # fmt: skip
        _program(
            self.values, self.gradients, self.J_features, self.rates, self.joint_room, of.root, of.damping, of.rows,
            dt, of.held, velocity, H, c, W, w, lower, upper,
        )  # fmt: skip
        for group in of.groups:
            _make_independent(W[group], w[group])
        return Problem(H, c, W, w, lower, upper, of.held, of.names)

    def distances(self) -> dict[str, float]:
        """Every signed distance less its bound, by name; what is kept is >= 0, what is held is 0.

        Of several rows it is the least, of an equality the one furthest from 0.
        """
        of = self.assembly
        over = np.concatenate([self.values[len(self.rates) :], self.joint_room]) - of.rows[0]
        out = {}
        for name, span in of.spans.items():
            part = over[span]
            out[name] = float(part[np.argmax(np.abs(part))] if span.stop <= of.held else part.min())
        return out


CYLINDER, WALL, HELD, POSE = range(4)
_KINDS: dict[type, int] = {PointInCylinder: CYLINDER, PointInsideWall: WALL, FrameHeld: HELD, FramePose: POSE}


@jit
def _stack(  # type: ignore[no-untyped-def]
    items, parameters, A, b, A_limits, b_limits, eta, q, s, values, gradients, rates, joint_room
):
    """Fill values and gradients of all rows, rates of the tasks' rows, and the room of the joint limits.

    What is affine is A s - b; `items` (k, 4) are kind, first row, first and last column of what has another kind known
    here, `parameters` (k, 8) are its own.
    """
    values[:] = A @ s - b
    gradients[:] = A
    joint_room[:] = A_limits @ q - b_limits  # (U12), (U13)
    for k in range(items.shape[0]):
        kind, row, begin, end = items[k]
        part, a = s[begin:end], parameters[k]
        if kind == CYLINDER:
            values[row], gradients[row, begin:end] = inside_cylinder(part, a)
        elif kind == WALL:
            values[row], gradients[row, begin:end] = inside_wall(part, a)
        elif kind == HELD:
            values[row : row + 6], gradients[row : row + 6, begin:end] = pose_error(part, a[:3], a[3:7], 1.0)
        else:
            values[row : row + 8], gradients[row : row + 8, begin:end] = pose_difference(part, a)
    rates[:] = -eta * values[: rates.shape[0]]  # of (U6)


@jit
def _program(  # type: ignore[no-untyped-def]
    values, gradients, J_features, rates, joint_room, root, damping, rows, dt, held, velocity,
    H, c, W, w, lower, upper,
):  # fmt: skip
    """Fill H, c, W, w and the bounds of (U6).

    `rows` (3, l + m + 2n) are bound, eta and return speed of all constraints, of which the first `held` are equalities.
    """
    r, n, k = rates.shape[0], velocity.shape[0], w.shape[0]
    J = gradients @ J_features  # the chain rule: dd/dq = dd/ds ds/dq
    objective(root.reshape((r, 1)) * J[:r], root * rates, damping, H, c)  # (U6)
    right = vfi(np.concatenate((values[r:], joint_room)), rows[0], rows[1], rows[2], dt)
    W[:], w[:] = J[r:], right[:k]
    w[:held] = np.maximum(w[:held], -rows[2, :held])
    upper[:] = np.minimum(np.maximum(-right[k : k + n], -velocity), velocity)  # -u >= w of (U12)
    lower[:] = np.minimum(np.maximum(right[k + n :], -velocity), velocity)  # u >= w of (U13)


class Assembly:
    """Tasks, equalities and inequalities of one phase.

    Parameters
    ----------
    kin : Kinematics
        The robot where the phase begins, seen from the base of the phase.
    tasks : sequence of Task
    equalities, inequalities : sequence of Constraint
    limits : (JointMaximum, JointMinimum)
    eta, damping : float
        eta [1/s] and lambda of (U6).

    Attributes
    ----------
    names : tuple of str
        Of the rows of the quadratic program.
    rows : ndarray, shape (3, l + m + 2n)
        Bound, eta and return speed of each of them.
    spans : dict of str to slice
        The rows of each constraint.
    held : int
        Number of equality rows, l.
    groups : list of slice
        Equalities of several rows, which may depend on each other.
    root : ndarray, shape (r,)
        Roots of the weights of the tasks' rows.
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
        heights = [len(group) for group in names]
        self.rows = np.repeat([[c.bound, c.eta, c.return_speed] for c in every], heights, axis=0).T.copy()
        self._A_limits = np.concatenate([limit.A for limit in limits])
        self._b_limits = np.concatenate([limit.b for limit in limits])
        self.spans = {c.name: at for c, at in zip(every, _slices(heights), strict=True)}
        self.held = sum(heights[: len(equalities)])
        self.groups = [self.spans[c.name] for c in equalities if _size(self.spans[c.name]) > 1]
        self._eta, self.damping = eta, damping

        stacked: tuple[Task | Constraint, ...] = (*tasks, *constraints)
        n = len(joint_names)
        columns = _slices([sum(feature.size or n for feature in item.watches) for item in stacked])
        self._observer = Observer([feature for item in stacked for feature in item.watches], kin.tree)
        s, _ = self._observer(kin)
        sizes = [len(task.value(s[at], 0.0)[0]) for task, at in zip(tasks, columns, strict=False)]
        self.root = np.repeat([task.weight**0.5 for task in tasks], sizes)
        self._residuals, self._first = sum(sizes), sizes[0]
        rows = _slices([*sizes, *heights[: len(constraints)]])

        shape = rows[-1].stop, self._observer.size
        self._A, self._b = np.zeros(shape), np.zeros(shape[0])
        known: list[tuple[int, int, int, int]] = []
        parameters: list[Array] = []
        self._asked: list[tuple[Task | Constraint, slice, slice]] = []
        self._paths: list[tuple[Task, slice, slice]] = []
        for item, at, where in zip(stacked, rows, columns, strict=True):
            if isinstance(item, Affine) and type(item).value is Affine.value:
                self._A[at, where], self._b[at] = item.A, item.b
            elif type(item) is ComOverFoot:
                self._A[at, where] = item.value(s[where], 0.0)[1]
            elif type(item) in _KINDS:
                known.append((_KINDS[type(item)], at.start, where.start, where.stop))
                parameters.append(np.resize(item.parameters, 8))
            else:
                self._asked.append((item, at, where))
            if isinstance(item, Task) and type(item).rate is not Task.rate:
                self._paths.append((item, at, where))
        self._items = np.array(known, dtype=np.int64).reshape(-1, 4)
        self._parameters = np.array(parameters).reshape(-1, 8)

    def __call__(self, kin: Kinematics) -> Evaluation:
        """Return errors, distances and gradients at one configuration."""
        s, J_features = self._observer(kin)
        values, gradients = np.empty(self._b.shape), np.empty(self._A.shape)
        rates, room = np.empty(self._residuals), np.empty(self._b_limits.shape)
        _stack(
            self._items, self._parameters, self._A, self._b, self._A_limits, self._b_limits, self._eta, kin.q, s,
            values, gradients, rates, room,
        )  # fmt: skip
        for item, rows, columns in self._asked:
            if isinstance(item, Task):
                values[rows], gradients[rows, columns] = item.value(s[columns], kin.elapsed)
                rates[rows] = -self._eta * values[rows]
            else:
                values[rows], gradients[rows, columns] = item.value(s[columns])
        for task, rows, columns in self._paths:
            rates[rows] = task.rate(s[columns], values[rows], kin.elapsed, self._eta)
        e = values[: self._first]
        return Evaluation(self, values, gradients, J_features, rates, room, math.sqrt(e @ e))


def _slices(sizes: Sequence[int]) -> list[slice]:
    """Return where parts of these sizes lie, one after the other."""
    ends = np.cumsum(sizes).tolist()
    return [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]


def _size(span: slice) -> int:
    return int(span.stop - span.start)


@jit
def _make_independent(E, e):  # type: ignore[no-untyped-def]
    """Replace the equalities E u = e by orthogonal combinations; one that no joint can move becomes 0 = 0.

    Two feet without ankle roll leave the six rows of a held sole with rank five.
    """
    squares, U = np.linalg.eigh(E @ E.T)  # of the singular values of E, and its left singular vectors
    E[:], e[:] = U.T @ E, U.T @ e
    for k in range(e.shape[0]):
        if squares[k] <= DEPENDENT**2 * squares[-1]:
            E[k], e[k] = 0.0, 0.0
