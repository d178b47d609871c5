"""The quadratic program (U6), its scale, and the check of its solution.

The cost of a slow walk is small (joint velocities down to 1e-6 rad/s) compared with the absolute tolerances of a
solver, so the problem is scaled first: u = s v, where s is the length of a gradient step (or of the longest step that a
row requires), and the objective is divided by its mean curvature. A solution is accepted only if it fulfils the
Karush-Kuhn-Tucker conditions. They determine the solution, which is unique, if the multipliers are of the order of the
gradient. But their residuals are relative to the largest multiplier: if rows are nearly dependent, multipliers are
large, and the two solvers may return different solutions, each of which satisfies all rows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol, Self

import numpy as np

from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.support.errors import QPError

_PRIMAL = 1e-7
"""Largest scaled violation of a row that is accepted."""
_LEAST_SCALE = 1e-9
"""Least scale s [rad/s]: shorter steps are rounding errors."""
_OPTIMAL = 1e-7
"""Largest relative residual of the other Karush-Kuhn-Tucker conditions that is accepted."""


@jit
def objective(J: Array, rate: Array, damping: float, H: Array, c: Array) -> None:
    """Fill H (n, n) and c (n,) of (U6): ||J u - rate||^2 + lambda^2 ||u||^2, with rate = -eta x.

    Parameters
    ----------
    J : ndarray, shape (r, n)
        Jacobian of the tasks.
    rate : ndarray, shape (r,)
        Desired task velocity.
    damping : float
        lambda.
    H, c : ndarray, shapes (n, n) and (n,)
    """
    np.dot(J.T, J, H)  # (U6)
    for i in range(H.shape[0]):
        H[i, i] += damping**2
    c[:] = -(rate @ J)


Shape = tuple[int, int, int]
"""n, number of equalities l, and number of inequalities m of a `Problem`."""
Parts = tuple[Array, Array, Array, Array, Array, Array]
"""H, c, W, w, lower and upper of a `Problem`."""


def _parts(numbers: Array, shape: Shape) -> Parts:
    """Return the parts of the numbers of a `Problem`, in the same memory."""
    n, k = shape[0], shape[1] + shape[2]
    bounds = k * (n + 1)
    square = bounds + 2 * n
    end = square + n * n
    H, c = numbers[square:end].reshape((n, n)), numbers[end:]
    W, w = numbers[: k * n].reshape((k, n)), numbers[k * n : bounds]
    return H, c, W, w, numbers[bounds : bounds + n], numbers[bounds + n : square]


parts = jit(_parts)


class Problem(NamedTuple):
    """min 1/2 u'Hu + c'u  subject to  E u = e,  G u >= h,  lower <= u <= upper."""

    numbers: Array
    """W, w, lower, upper, H and c one after another, because compiled functions read one array faster than six."""
    shape: Shape
    """n, number of equalities l, and number of inequalities m."""
    names: tuple[str, ...] = ()
    """Names of the rows: equalities, inequalities, upper and lower limits."""

    @classmethod
    def of(
        cls, H: Array, c: Array, W: Array, w: Array, lower: Array, upper: Array, equalities: int = 0,
        names: tuple[str, ...] = (),
    ) -> Self:  # fmt: skip
        """Return the problem of these parts, which are copied."""
        numbers = np.concatenate([*map(np.ravel, (W, w, lower, upper, H, c))])
        return cls(numbers, (len(c), equalities, len(w) - equalities), names)

    @classmethod
    def empty(cls, shape: Shape, names: tuple[str, ...]) -> Self:
        """Return a problem whose numbers are not filled in yet."""
        n, l, m = shape
        return cls(np.empty((l + m) * (n + 1) + n * (n + 3)), shape, names)

    def replaced(self, *, names: tuple[str, ...] | None = None, **changes: Array) -> Self:
        """Return the problem with other parts, by their names."""
        kept = dict(zip(("H", "c", "W", "w", "lower", "upper"), self.parts, strict=True))
        return self.of(**kept | changes, equalities=self.shape[1], names=self.names if names is None else names)

    @property
    def parts(self) -> Parts:
        """H, c, W, w, lower and upper, in the same memory."""
        return _parts(self.numbers, self.shape)

    @property
    def H(self) -> Array:
        """J'J + lambda^2 I of (U6), shape (n, n); positive definite."""
        return self.parts[0]

    @property
    def c(self) -> Array:
        """Linear part of the objective: eta J'x of (U6), shape (n,)."""
        return self.parts[1]

    @property
    def W(self) -> Array:
        """E above G: W_eq of (U6), then its -W without the joint limits, shape (l + m, n)."""
        return self.parts[2]

    @property
    def w(self) -> Array:
        """The right-hand sides e above h: w_eq of (U6), then its -w, shape (l + m,)."""
        return self.parts[3]

    @property
    def lower(self) -> Array:
        """Bound of u by the joint limits (U13) and the largest velocities, shape (n,) [rad/s]."""
        return self.parts[4]

    @property
    def upper(self) -> Array:
        """Bound of u by the joint limits (U12) and the largest velocities, shape (n,) [rad/s]."""
        return self.parts[5]

    @property
    def E(self) -> Array:
        """W_eq, shape (l, n)."""
        return self.W[: self.shape[1]]

    @property
    def e(self) -> Array:
        """w_eq, shape (l,)."""
        return self.w[: self.shape[1]]

    @property
    def G(self) -> Array:
        """Rows of the inequalities, shape (m, n)."""
        return self.W[self.shape[1] :]

    @property
    def h(self) -> Array:
        """Right-hand sides of the inequalities, shape (m,)."""
        return self.w[self.shape[1] :]


@dataclass(frozen=True)
class Residuals:
    """Scaled residuals of the Karush-Kuhn-Tucker conditions.

    Those but the primal one are relative to the length of the gradient step times the mean curvature, or to the largest
    multiplier.
    """

    stationarity: float
    primal: float
    """Largest violation of a row, in gradient steps."""
    dual: float
    complementarity: float
    row: int = -1
    """Index of the row with the largest violation; -1 if all rows are satisfied."""

    @property
    def largest(self) -> float:
        """The largest of the four residuals."""
        return max(self.stationarity, self.primal, self.dual, self.complementarity)


@dataclass(slots=True, eq=False)
class Solution:
    """An accepted solution of a `Problem`."""

    u: Array
    """Joint velocities, shape (n,) [rad/s]."""
    z: Array
    """Multipliers of the equalities, inequalities, upper and lower limits, shape (l + m + 2n,); >= 0 except those of
    the equalities."""
    iterations: int
    """Number of iterations of the solver."""
    solve_time: float
    """Time taken by the solver [s]."""

    def active(self, problem: Problem) -> tuple[str, ...]:
        """Return the names of the active inequalities, in decreasing order of their multipliers."""
        start = problem.e.shape[0]
        z = self.z[start:]
        least = 1e-6 * max(float(np.abs(problem.c).max()), 1e-300)
        order = np.argsort(-z)
        return tuple(problem.names[start + i] for i in order if z[i] > least)

    def residuals(self, problem: Problem) -> Residuals:
        """Return the residuals of the Karush-Kuhn-Tucker conditions."""
        given = problem[:2]
        return Residuals(*kkt(*given, self.u, self.z, *scale(*given)))


class Solver(Protocol):
    """Interface of the solvers."""

    name: str

    def solve(self, problem: Problem) -> Solution:
        """Return the solution; raise `QPError` if there is none."""


# ---------------------------------------------------------------------- scaling and check of the solution


@jit
def scale(numbers: Array, shape: Shape) -> tuple[float, float]:
    """Return the scale s and the mean curvature of a problem; s is nan if any of its numbers is not finite."""
    H, c, _, w, lower, upper = parts(numbers, shape)
    curvature, required = np.trace(H) / c.shape[0], 0.0  # the longest step that a row requires
    for k in range(w.shape[0]):
        required = max(required, abs(w[k]) if k < shape[1] else w[k])
    for i in range(c.shape[0]):
        required = max(required, lower[i], -upper[i])
    s = max(math.sqrt(c @ c) / curvature, required)
    if not math.isfinite(numbers.sum()):
        return math.nan, curvature
    return max(s, _LEAST_SCALE), curvature


@jit
def _times(A: Array, x: Array) -> Array:
    """Return A x; of so few numbers in a third of the time that BLAS takes, which `@` calls."""
    y = np.zeros(A.shape[0])
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            y[i] += A[i, j] * x[j]
    return y


@jit
def kkt(
    numbers: Array, shape: Shape, u: Array, z: Array, s: float, curvature: float
) -> tuple[float, float, float, float, int]:
    """Return stationarity, primal, dual, complementarity (see `Residuals`) and the row with the largest violation.

    `u` (n,) is the solution, and `z` (k + 2 n,) are the multipliers of the rows, the upper and the lower bounds. In the
    complementarity the slack is scaled like the violations, and limited to one gradient step.
    """
    H, c, W, w, lower, upper = parts(numbers, shape)
    n, l, m = shape
    k = l + m
    signed = z[:k].copy()
    signed[l:] *= -1.0
    gradient = _times(H, u) + c + _times(W.T, signed) + z[k : k + n] - z[k + n :]
    slack = np.concatenate((_times(W, u) - w, upper - u, u - lower))
    force = max(s * curvature, np.abs(z).max())
    primal, row, dual, complementarity = 0.0, -1, 0.0, 0.0
    for i in range(k + 2 * n):
        violation, multiplier = -slack[i] / s, z[i] / force
        if i < l:
            violation = abs(violation)
        else:
            dual = max(dual, -multiplier)
            complementarity = max(complementarity, abs(multiplier) * min(abs(violation), 1.0))
        if not violation <= primal:
            primal, row = violation, i
    return np.abs(gradient).max() / force, primal, dual, complementarity, row


def check(problem: Problem, stationarity: float, primal: float, dual: float, complementarity: float, row: int) -> None:
    """Check the residuals of a solution.

    Raises
    ------
    QPError
        If it violates a row, or another of the Karush-Kuhn-Tucker conditions.
    """
    if not primal <= _PRIMAL:
        name = problem.names[row] if problem.names else str(row)
        text = f"the solution violates the row '{name}' by {primal:.3g} (scaled)"
        raise QPError(text, status="Violated", rows=[name])
    other = max(stationarity, dual, complementarity)
    if not other <= _OPTIMAL:
        raise QPError(f"the solution is not optimal: relative residual {other:.3g}", status="NotOptimal")


def check_finite(s: float, curvature: float) -> None:
    """Check the scale of a problem.

    Raises
    ------
    QPError
        If a number of the problem is not finite.
    """
    if not s * curvature > 0.0:
        raise QPError("the problem contains a number that is not finite", status="NotFinite")
