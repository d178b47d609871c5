"""The quadratic program (6) and its solution, by Clarabel (`interior_point`) or DAQP (`active_set`).

Either way the problem is scaled first and the answer checked against the Karush-Kuhn-Tucker conditions after
(`scaling`), so both give the same answer.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.errors import QPError
from dqwalk_ros.qp.packed import size, views

__all__ = ["OPTIMAL", "PRIMAL", "Problem", "Residuals", "Solution", "Solver", "make_solver", "refuse"]

Array = NDArray[np.float64]

PRIMAL = 1e-7
"""Largest scaled violation of a row that is accepted."""
OPTIMAL = 1e-7
"""Largest relative residual of the other Karush-Kuhn-Tucker conditions that is accepted."""


@dataclass(slots=True, eq=False)
class Problem:
    """min 1/2 u'Hu + c'u  subject to  E u = e,  G u >= h,  lower <= u <= upper.

    Made of arrays or, by `of`, of one buffer with all of them; either is worked out from the other when asked for.

    Attributes
    ----------
    H : ndarray, shape (n, n)
        J'J + lambda^2 I of (6); positive definite.
    c : ndarray, shape (n,)
        eta J'x of (6).
    E, e : ndarray, shapes (l, n), (l,)
        W_eq, w_eq.
    G, h : ndarray, shapes (m, n), (m,)
        -W, -w without the joint limits.
    lower, upper : ndarray, shape (n,)
        Joint limits (12)-(13) as velocities.
    names : tuple of str
        Of the rows: equalities, inequalities, upper and lower limits.
    diagonal, J : ndarray, shapes (n,) and (r, n), or None
        The same H as diag(diagonal) + J'J, for large robots.
    values : ndarray
        All of it, as `qp.packed` says; from then on the arrays are views of it.
    """

    H: Array
    c: Array
    E: Array
    e: Array
    G: Array
    h: Array
    lower: Array
    upper: Array
    names: tuple[str, ...] = ()
    diagonal: Array | None = None
    J: Array | None = None
    values: Array = field(init=False, repr=False)
    _sizes: tuple[int, int, int, int] = field(init=False, repr=False)

    @classmethod
    def of(cls, values: Array, sizes: tuple[int, int, int, int], names: tuple[str, ...] = ()) -> Self:
        """Return the problem in a buffer, with n variables, l equalities, m inequalities and r rows of J."""
        problem = cls.__new__(cls)
        problem.values, problem._sizes, problem.names = values, sizes, names
        return problem

    def __getattr__(self, name: str) -> Any:
        # what has no value yet
        if name == "_sizes":
            r = 0 if self.J is None or self.diagonal is None else len(self.J)
            self._sizes = len(self.c), len(self.e), len(self.h), r
        elif name == "values":
            self._pack()
        elif name in _ARRAYS:
            self._unpack()
        else:
            raise AttributeError(f"a Problem has no {name}")
        return getattr(self, name)

    def _unpack(self) -> None:
        _, l, m, r = self._sizes  # noqa: E741
        self.H, self.c, self.lower, self.upper, diagonal, W, w, J = views(self.values, *self._sizes)
        self.E, self.e, self.G, self.h = W[:l], w[:l], W[l : l + m], w[l : l + m]
        self.diagonal, self.J = (diagonal, J) if r else (None, None)

    def _pack(self) -> None:
        arrays, diagonal, J = self.arrays, self.diagonal, self.J
        self.values = np.zeros(size(*self._sizes))
        self._unpack()
        for part, given in zip(self.arrays, arrays, strict=True):
            part[:] = given
        if self.J is not None and self.diagonal is not None:
            self.diagonal[:], self.J[:] = diagonal, J

    @property
    def arrays(self) -> tuple[Array, ...]:
        """H, c, E, e, G, h, lower, upper."""
        return self.H, self.c, self.E, self.e, self.G, self.h, self.lower, self.upper

    @property
    def shape(self) -> tuple[int, int, int]:
        """n, number of equalities, number of inequalities."""
        return self._sizes[:3]

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """The `shape`, and the number of rows of J, 0 without."""
        return self._sizes


_ARRAYS = frozenset(("H", "c", "E", "e", "G", "h", "lower", "upper", "diagonal", "J"))


@dataclass(frozen=True)
class Residuals:
    """How far an answer is from the Karush-Kuhn-Tucker conditions, relative to the size of the terms."""

    stationarity: float
    primal: float
    dual: float
    complementarity: float

    @property
    def largest(self) -> float:
        """The worst of the four."""
        return max(self.stationarity, self.primal, self.dual, self.complementarity)


@dataclass(slots=True, eq=False)
class Solution:
    """An accepted answer.

    Attributes
    ----------
    u : ndarray, shape (n,)
    z : ndarray, shape (l + m + 2n,)
        Multipliers of the equalities, inequalities, upper and lower limits; >= 0 but for the equalities.
    iterations : int
    solve_time : float
        What the solver itself took [s].
    """

    u: Array
    z: Array
    iterations: int
    solve_time: float

    def active(self, problem: Problem) -> tuple[str, ...]:
        """Names of the inequalities that hold the answer back, strongest first."""
        start = problem.e.shape[0]
        z = self.z[start:]
        scale = 1e-6 * max(float(np.abs(problem.c).max()), 1e-300)
        order = np.argsort(-z)
        return tuple(problem.names[start + i] for i in order if z[i] > scale)

    def residuals(self, problem: Problem) -> Residuals:
        """Return the residuals of the Karush-Kuhn-Tucker conditions.

        Stationarity is relative to the largest term of the gradient, the others to the largest velocity and
        multiplier; in complementarity the slack of a row further away than that velocity is relative to itself.
        """
        l, m = problem.e.shape[0], problem.h.shape[0]  # noqa: E741
        n = problem.c.shape[0]
        y, z, up, lo = np.split(self.z, [l, l + m, l + m + n])
        u = self.u
        terms = [problem.H @ u, problem.c, problem.E.T @ y, problem.G.T @ z, up, lo]
        gradient = terms[0] + terms[1] + terms[2] - terms[3] + up - lo
        slack = np.concatenate([problem.G @ u - problem.h, problem.upper - u, u - problem.lower])
        size = max(float(np.abs(u).max(initial=0.0)), 1e-300)
        force = max(max(float(np.abs(t).max(initial=0.0)) for t in terms), 1e-300)
        inequality = self.z[l:]
        return Residuals(
            stationarity=float(np.abs(gradient).max()) / force,
            primal=max(float(np.abs(problem.E @ u - problem.e).max(initial=0.0)), float((-slack).max(initial=0.0)))
            / size,
            dual=float((-inequality).max(initial=0.0)) / force,
            complementarity=float(np.abs(inequality * slack / np.maximum(np.abs(slack), size)).max(initial=0.0))
            / force,
        )


class Solver(Protocol):
    """What solves a `Problem`."""

    name: str

    def solve(self, problem: Problem) -> Solution:
        """Return the answer; raise `QPError` where there is none."""


def make_solver(name: str) -> Solver:
    """Return a new solver, ``"clarabel"`` or ``"daqp"``; it keeps what it learns from one problem for the next.

    Raises
    ------
    QPError
        If it is not installed.
    """
    if name == "daqp":
        from dqwalk_ros.qp.active_set import DaqpSolver

        return DaqpSolver()
    from dqwalk_ros.qp.interior_point import ClarabelSolver

    return ClarabelSolver()


def refuse(problem: Problem, violation: float, row: int, other: float) -> None:
    """Raise if an answer with these residuals (of `scaling.check`) is none, whatever its solver says.

    Raises
    ------
    QPError
        If it violates a row, or another of the Karush-Kuhn-Tucker conditions.
    """
    if not violation <= PRIMAL:
        name = problem.names[row] if problem.names else str(row)
        text = f"the answer violates the row '{name}' by {violation:.3g} (scaled)"
        raise QPError(text, status="Violated", rows=[name])
    if not other <= OPTIMAL:
        raise QPError(f"the answer is not the optimum: a residual of {other:.3g} (relative)", status="NotOptimal")
