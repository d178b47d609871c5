"""Assembly of the quadratic program (U6) from the tasks and constraints of a phase.

One compiled call, `_assemble`, leads from the joint angles to the program: the poses and lines (`kinematics`), the
coordinates of the features (`features`), the value, gradient and rate of each task and constraint by the function that
its class names (`tasks`, `constraints`, or a file of your own), and the rows of (U6). Controller, monitor and report
all use this code.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.paper.constraints import Constraint, JointMaximum, JointMinimum, vfi
from dqwalk_ros.paper.features import BODIES, QUANTITY, WATCHED, Quantity, Watched, observe
from dqwalk_ros.paper.kinematics import Bodies, Kinematics, forward
from dqwalk_ros.paper.qp.problem import Problem, Shape, objective, parts
from dqwalk_ros.paper.rows import Rows, slices
from dqwalk_ros.paper.tasks import Task, converge
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.by_address import INTEGERS, MATRIX, TABLE, VECTOR, Record
from dqwalk_ros.support.compiled import jit

DEPENDENT = 5e-3
"""Ratio to the largest singular value below which a singular value of equality rows counts as zero."""
_ANY = 1e-9
"""Control period that limits no rate [s]."""


@dataclass(slots=True, eq=False)
class Evaluation:
    """Values of the tasks and constraints of a phase, and its quadratic program, for given joint angles.

    There are r rows of tasks, l of equalities and m of inequalities, in this order.
    """

    assembly: Assembly
    values: Array
    """Errors of the tasks, signed distances of the equalities and inequalities, and distances (U12) and (U13) from the
    upper and the lower joint limits, shape (r + l + m + 2n,) [rad]."""
    J: Array
    """Jacobians of all but the limits, shape (r + l + m, n)."""
    wanted: Array
    """J u that makes the errors of the tasks converge, shape (r,)."""
    problem: Problem
    """The quadratic program (U6)."""
    error: float
    """Norm of the error of the first task."""

    @property
    def margins(self) -> Array:
        """Signed distance minus its bound of each row of the constraints, shape (l + m + 2n,)."""
        margins: Array = self.values[self.assembly.task_rows :] - self.assembly.rows.numbers[0]
        return margins

    def share(self, names: Collection[str]) -> tuple[Array, Array]:
        """Return H (n, n) and c (n,) of some tasks in the objective, without damping."""
        spans = self.assembly.task_spans.items()
        rows = [row for name, span in spans if name in names for row in range(span.start, span.stop)]
        J, weights = self.J[rows], self.assembly.sqrt_weights[rows] ** 2
        return (weights[:, None] * J).T @ J, -(weights * self.wanted[rows]) @ J

    def distances(self) -> dict[str, float]:
        """Return each signed distance minus its bound, by name: >= 0 for a satisfied inequality, 0 for an equality."""
        return {name: float(d) for name, d in self.assembly.rows.by_name(self.margins).items()}


class _Stack(NamedTuple):
    """Tasks, equalities, inequalities and both joint limits in the form that compiled code evaluates."""

    functions: NDArray[np.int64]
    """Their compiled functions, shape (k,)."""
    spans: NDArray[np.int64]
    """First row and row after the last one, the same of the columns in s, and of `parameters`, shape (k, 6)."""
    parameters: Array
    """Shape (p,)."""
    gradients: Array
    """With respect to the coordinates s of all features, shape (r + l + m, features)."""
    rates: Array
    """Derivatives by time alone, shape (r + l + m,)."""


class _Form(NamedTuple):
    """Constants of the quadratic program of a phase."""

    tasks: Array
    """eta and saturation of each task, shape (tasks, 2)."""
    sqrt_weights: Array
    """Shape (r,)."""
    rows: Array
    """Bound, eta and return speed of the rows of all constraints, shape (3, l + m + 2n)."""
    groups: NDArray[np.int64]
    """First row and row after the last one of the equalities with more than one row, which may be linearly dependent,
    shape (g, 2)."""


class _Memory(NamedTuple):
    """What a phase is evaluated with: the tree of the robot, and the records of what is computed."""

    tree: NDArray[np.int64]
    links: Array
    bodies: Bodies
    watched: Watched
    stack: _Stack
    form: _Form


_MEMORY = Record(
    _Memory,
    TABLE,
    MATRIX,
    BODIES,
    WATCHED,
    Record(_Stack, INTEGERS, TABLE, VECTOR, MATRIX, VECTOR),
    Record(_Form, MATRIX, VECTOR, MATRIX, TABLE),
)
_call, _opened = QUANTITY.call, _MEMORY.opened


@jit
def _assemble(
    elapsed: float, dt: float, velocity: Array, damping: float, table: NDArray[np.int64], values: Array, J: Array,
    wanted: Array, numbers: Array, shape: Shape,
) -> float:  # fmt: skip
    """Fill values, Jacobians J, `wanted` and the numbers of the `Problem`; return the norm of the first task's error.

    The `table` is that of the `_Memory`, which has the joint angles and the vertical.
    """
    tree, links, bodies, watched, stack, form = _opened(table)
    forward(bodies.q, tree, links, bodies.poses, bodies.lines, bodies.com, bodies.com_jacobian)
    observe(bodies, watched)
    _evaluate(bodies.q, watched.s, stack, elapsed, values)
    np.dot(stack.gradients, watched.J, J)  # the chain rule: dd/dq = dd/ds ds/dq
    error: float = _fill(values, J, wanted, stack, form, damping, dt, velocity, numbers, shape)
    return error


@jit
def _first_error(
    bodies: tuple[Any, ...], watched: tuple[Any, ...], function: int, parameters: Array, elapsed: float
) -> float:
    """Return the norm of the error of the task with a function and parameters, which watches these features."""
    seen = Watched(*watched)
    observe(Bodies(*bodies), seen)
    e, _, _ = _call(function, seen.s, parameters, elapsed)
    return math.sqrt(e @ e)


@jit
def _evaluate(q: Array, s: Array, stack: _Stack, elapsed: float, values: Array) -> None:
    """Fill values, gradients and rates of all tasks and constraints, and the distances from the joint limits."""
    limits = stack.spans.shape[0] - 2
    for k in range(limits):
        first, last, begin, end, start, stop = stack.spans[k]
        values[first:last], stack.gradients[first:last, begin:end], stack.rates[first:last] = _call(
            stack.functions[k], s[begin:end], stack.parameters[start:stop], elapsed
        )
    for k in range(limits, limits + 2):  # bounds of u, whose gradients are known
        first, last, _, _, start, stop = stack.spans[k]
        values[first:last], _, _ = _call(stack.functions[k], q, stack.parameters[start:stop], elapsed)


@jit
def _fill(
    values: Array, J: Array, wanted: Array, stack: _Stack, form: _Form, damping: float, dt: float, velocity: Array,
    numbers: Array, shape: Shape,
) -> float:  # fmt: skip
    """Fill `wanted` and the numbers of the `Problem`; return the norm of the first task's error."""
    H, c, W, w, lower, upper = parts(numbers, shape)
    n, r, m, equalities = velocity.shape[0], wanted.shape[0], w.shape[0], shape[1]
    for k in range(form.tasks.shape[0]):
        rows = slice(stack.spans[k, 0], stack.spans[k, 1])
        wanted[rows] = converge(values[rows], form.tasks[k, 0], form.tasks[k, 1]) - stack.rates[rows]
    objective(form.sqrt_weights.reshape((r, 1)) * J[:r], form.sqrt_weights * wanted, damping, H, c)
    right = vfi(values[r:], form.rows[0], form.rows[1], form.rows[2], dt)
    W[:], w[:] = J[r:], right[:m]
    w[:equalities] = np.maximum(w[:equalities], -form.rows[2, :equalities])
    w -= stack.rates[r:]
    upper[:] = np.minimum(np.maximum(-right[m : m + n], -velocity), velocity)  # -u >= w of (U12)
    lower[:] = np.minimum(np.maximum(right[m + n :], -velocity), velocity)  # u >= w of (U13)
    for k in range(form.groups.shape[0]):
        rows = slice(form.groups[k, 0], form.groups[k, 1])
        _make_independent(W[rows], w[rows])
    e = values[: stack.spans[0, 1]]
    return math.sqrt(e @ e)


@jit
def _make_independent(E: Array, e: Array) -> None:
    """Replace the equalities E u = e (k rows) by orthogonal combinations; dependent ones become 0 = 0.

    The rows of a held sole have rank five, not six, if the ankles of both feet have no roll.
    """
    squares, U = np.linalg.eigh(E @ E.T)  # squared singular values of E, and its left singular vectors
    E[:], e[:] = U.T @ E, U.T @ e
    for k in range(e.shape[0]):
        if squares[k] <= DEPENDENT**2 * squares[-1]:
            E[k], e[k] = 0.0, 0.0


class Assembly:
    """Evaluates the tasks, equalities and inequalities of one phase.

    Parameters
    ----------
    kin : Kinematics
        The robot at the start of the phase, in the base frame of the phase.
    eta, damping : float
        eta [1/s] and lambda of (U6).

    Attributes
    ----------
    rows : Rows
        Of the constraints.
    task_spans : dict of str to slice
        The rows of each task.
    task_rows : int
        Number of rows of the tasks, r.
    sqrt_weights : ndarray, shape (r,)
        Square roots of the weights of the tasks' rows.
    damping : float
        lambda of (U6).
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
        self._given = kin, tasks, equalities, inequalities, limits, eta, damping
        self.rows = Rows.of(kin, equalities, inequalities, limits)
        self._always = not np.isfinite(self.rows.near).any()
        n, l = len(kin.q), self.rows.equalities
        self._shape = n, l, len(self.rows.near) - l
        self._unlimited = np.full(n, np.inf)
        self.damping = damping

        constraints = (*equalities, *inequalities, *limits)
        stacked: tuple[Quantity, ...] = (*tasks, *constraints)
        functions = QUANTITY.table([type(item).function for item in stacked])
        given = [np.array(item.parameters, dtype=np.float64) for item in stacked]
        watched, columns = Watched.of((item.watches for item in stacked[:-2]), kin.tree)
        observe(kin.bodies, watched)
        seen = [*(watched.s[at] for at in columns), kin.q, kin.q]  # a limit is one of q
        sizes = [_checked(*one) for one in zip(stacked, functions, seen, given, strict=True)]
        for constraint, size in zip(constraints, sizes[len(tasks) :], strict=True):
            if size != (count := len(constraint.row_names(kin.model.joint_names))):
                raise ValueError(f"{constraint.name} has {size} distances, but names {count} rows")

        rows, parts, parameters = slices(sizes), slices([len(part) for part in given]), np.concatenate(given)
        self.task_spans = {task.name: span for task, span in zip(tasks, rows, strict=False)}
        self.task_rows = r = sum(sizes[: len(tasks)])
        self.sqrt_weights = np.repeat([task.weight**0.5 for task in tasks], sizes[: len(tasks)])
        live = [(item.live, parameters[part]) for item, part in zip(stacked, parts, strict=True)]
        self._live = [(numbers, copy[: len(numbers)]) for numbers, copy in live if numbers is not None]
        three = zip(rows, [*columns, *[slice(0, 0)] * 2], parts, strict=True)
        count = rows[-3].stop  # but for the limits
        stack = _Stack(
            functions,
            np.array([(at.start, at.stop) for each in three for at in each], dtype=np.int64).reshape(-1, 6),
            parameters,
            np.zeros((count, len(watched.s))),
            np.empty(count),
        )
        of_equalities = rows[len(tasks) : len(tasks) + len(equalities)]
        groups = [(at.start - r, at.stop - r) for at in of_equalities if at.stop - at.start > 1]
        form = _Form(
            np.array([(eta if task.eta is None else task.eta, task.saturation) for task in tasks]),
            self.sqrt_weights,
            self.rows.numbers,
            np.array(groups, dtype=np.int64).reshape(-1, 2),
        )
        bodies = Bodies._make(map(np.empty_like, kin.bodies))._replace(moves=kin.tree.moves)
        self._memory = _Memory(kin.tree.tree, kin.tree.links, bodies, watched, stack, form)
        self._table = _MEMORY.table(self._memory)
        self._q, self._up = bodies.q, bodies.up
        self._first = tuple(watched.first(len(tasks[0].watches))), functions[0], parameters[parts[0]], tasks[0].live

    def __call__(
        self, q: Array, up: Array, elapsed: float = math.inf, dt: float | None = None, velocity: Array | None = None
    ) -> Evaluation:
        """Return values and quadratic program; see `phase.Phase.evaluate`."""
        for live, copy in self._live:
            copy[:] = live
        (n, l, m), r = self._shape, self.task_rows
        values, J, wanted = np.empty(r + l + m + 2 * n), np.empty((r + l + m, n)), np.empty(r)
        problem = Problem.empty(self._shape, self.rows.names)
        self._q[:], self._up[:] = q, up  # copied here, as another kind of array would be compiled for
        error = _assemble(
            elapsed, _ANY if dt is None else dt, self._unlimited if velocity is None else velocity, self.damping,
            self._table, values, J, wanted, problem.numbers, problem.shape,
        )  # fmt: skip
        if not self._always:
            enters = self.rows.near
            if dt is not None and velocity is not None:  # nothing beyond reaches its bound within a period
                enters = np.maximum(enters, dt * np.abs(J[r:]) @ velocity)
            kept = ~(values[r : -2 * n] - self.rows.numbers[0, : l + m] >= enters)  # also what is not a number
            names = itertools.compress(self.rows.names, [*kept, *[True] * (2 * n)])
            problem = problem.replaced(W=problem.W[kept], w=problem.w[kept], names=tuple(names))
        return Evaluation(self, values, J, wanted, problem, error)

    def error(self, kin: Kinematics, elapsed: float) -> float:
        """Return the norm of the first task's error, `elapsed` [s] after the phase began, without the program."""
        watched, function, parameters, live = self._first
        if live is not None:
            parameters[: len(live)] = live
        error: float = _first_error(tuple(kin.bodies), watched, function, parameters, elapsed)
        return error

    def __reduce__(self) -> tuple[Any, ...]:
        return _made, self._given  # the addresses of functions are those of this process


@jit
def _shapes(function: int, s: Array, parameters: Array) -> tuple[int, tuple[int, int], int]:
    """Return the number of values, the shape of the gradient, and the number of rates that a function returns."""
    value, gradient, rate = _call(function, s, parameters, 0.0)
    return value.shape[0], gradient.shape, rate.shape[0]


def _checked(item: Quantity, function: int, s: Array, parameters: Array) -> int:
    """Return the number of values of a task or constraint; what else its function returns must have fitting shapes."""
    count, gradient, rates = _shapes(function, s, parameters)
    if gradient != (count, len(s)) or rates != count:
        raise ValueError(
            f"{item.name}: gradient and rate of {count} values of {len(s)} coordinates have the shapes {gradient} and "
            f"{(rates,)}, not {(count, len(s))} and {(count,)}"
        )
    return int(count)


def _made(*given: Any) -> Assembly:
    """Return the assembly of the given arguments, for `pickle`."""
    return Assembly(*given[:5], eta=given[5], damping=given[6])
