"""The dual method of Goldfarb and Idnani, compiled: exact, from nowhere, in a time that is nearly the same every time.

It starts at the minimum without constraints and takes them in one by one, the most violated first; whoever has a
multiplier that would turn negative leaves. The rows that are active stay independent throughout, however many there
are to choose from, which is where guesses of many rows at once fail.

D. Goldfarb, A. Idnani, "A numerically stable dual method for solving strictly convex quadratic programs",
Mathematical Programming 27 (1983).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from dqwalk_ros.compiled import jit
from dqwalk_ros.errors import QPError
from dqwalk_ros.qp import Problem, Solution

__all__ = ["solve_dual"]

_VIOLATED = 1e-10
"""A row counts as violated beyond this, divided by its norm."""
_DEPENDENT = 1e-20
"""Of a row the share, squared, that the active ones must leave over for it to be independent of them."""
_MOST = 1000
_INFEASIBLE, _GAVE_UP = -1, -2


def solve_dual(problem: Problem) -> Solution:
    """Return the exact solution.

    Raises
    ------
    QPError
        If H is not positive definite, no point satisfies all rows, or it does not come to an end.
    """
    n, l, m = problem.shape  # noqa: E741
    L, info = lapack.dpotrf(problem.H, lower=1, clean=1)
    if info:
        raise QPError("the cost is not strictly convex", status="NotConvex")
    J = np.ascontiguousarray(lapack.dtrtri(L, lower=1)[0])
    x, z = np.empty(n), np.zeros(l + m + 2 * n)
    arrays = problem.c, problem.E, problem.e, problem.G, problem.h, problem.lower, problem.upper
    count = _run(J, *(np.ascontiguousarray(part) for part in arrays), x, z)
    if count == _INFEASIBLE:
        raise QPError("the quadratic program has no answer: its rows contradict each other", status="Infeasible")
    if count == _GAVE_UP or not np.isfinite(x).all():
        raise QPError("the dual method came to no end", status="MaxIterations")
    return Solution(x, z, count, 0.0)


@jit
def _normal(i, E, G, out):  # type: ignore[no-untyped-def]
    """Write the row i of [E; G; -I; I] to `out`."""
    l, m, n = E.shape[0], G.shape[0], out.shape[0]  # noqa: E741
    if i < l:
        out[:] = E[i]
    elif i < l + m:
        out[:] = G[i - l]
    else:
        out[:] = 0.0
        if i < l + m + n:
            out[i - l - m] = -1.0
        else:
            out[i - l - m - n] = 1.0


@jit
def _turn(J, j, cos, sin):  # type: ignore[no-untyped-def]
    """Rotate rows j and j + 1."""
    for k in range(J.shape[1]):
        a, b = J[j, k], J[j + 1, k]
        J[j, k] = cos * a + sin * b
        J[j + 1, k] = cos * b - sin * a


@jit
def _add(J, R, d, q):  # type: ignore[no-untyped-def]
    """Take in the row whose image is d as the q-th: turn J until d ends with its q-th number."""
    for j in range(d.shape[0] - 2, q - 1, -1):
        if d[j + 1] == 0.0:
            continue
        size = np.hypot(d[j], d[j + 1])
        _turn(J, j, d[j] / size, d[j + 1] / size)
        d[j], d[j + 1] = size, 0.0
    R[: q + 1, q] = d[: q + 1]


@jit
def _drop(J, R, k, q):  # type: ignore[no-untyped-def]
    """Let the k-th of q active rows go."""
    for j in range(k, q - 1):
        R[: j + 2, j] = R[: j + 2, j + 1]
    for j in range(k, q - 1):
        if R[j + 1, j] == 0.0:
            continue
        size = np.hypot(R[j, j], R[j + 1, j])
        cos, sin = R[j, j] / size, R[j + 1, j] / size
        for i in range(j, q - 1):
            a, b = R[j, i], R[j + 1, i]
            R[j, i] = cos * a + sin * b
            R[j + 1, i] = cos * b - sin * a
        _turn(J, j, cos, sin)


@jit
def _worst(x, G, h, lower, upper, norm, active, first):  # type: ignore[no-untyped-def]
    """Return the row that is violated most, -1 where none is; the inequalities begin at `first`."""
    m, n = G.shape[0], x.shape[0]
    found, most = -1, -_VIOLATED
    slack = np.dot(G, x) - h
    for i in range(m):
        value = slack[i] / norm[i]
        if value < most and not active[first + i]:
            found, most = first + i, value
    for i in range(n):
        if upper[i] - x[i] < most and not active[first + m + i]:
            found, most = first + m + i, upper[i] - x[i]
        if x[i] - lower[i] < most and not active[first + m + n + i]:
            found, most = first + m + n + i, x[i] - lower[i]
    return found


@jit
def _run(J, c, E, e, G, h, lower, upper, x, z):  # type: ignore[no-untyped-def]
    """Write solution and multipliers to x and z; return the number of steps, or why there is none. J is L^-1."""
    n, l, m = x.shape[0], e.shape[0], h.shape[0]  # noqa: E741
    x[:] = -np.dot(J.T, np.dot(J, c))
    R, a, r, u = np.zeros((n, n)), np.empty(n), np.empty(n), np.zeros(n + 1)
    rows, active = np.empty(n, np.int64), np.zeros(l + m + 2 * n, np.bool_)
    equal = np.zeros(l + m + 2 * n, np.bool_)
    equal[:l] = True
    norm = np.empty(m)
    for i in range(m):
        norm[i] = max(np.sqrt(np.dot(G[i], G[i])), 1e-12)
    first = np.empty(l + n, np.int64)  # equalities, and coordinates whose bounds are one
    given = l
    for i in range(l):
        first[i] = i
    for i in range(n):
        if upper[i] - lower[i] < _VIOLATED:
            first[given] = l + m + i
            equal[l + m + i] = active[l + m + n + i] = True
            given += 1
    q, taken = 0, 0
    for count in range(1, _MOST):
        if taken < given:
            p = first[taken]
            taken += 1
        else:
            p = _worst(x, G, h, lower, upper, norm, active, l)
            if p < 0:
                for k in range(q):
                    if rows[k] < l:
                        z[rows[k]] = -u[k]
                    elif u[k] >= 0.0:
                        z[rows[k]] = u[k]
                    else:  # it is the lower of two bounds that are one
                        z[rows[k] + n] = -u[k]
                return count
        _normal(p, E, G, a)
        if p < l + m:
            goal = e[p] if p < l else h[p - l]
        else:
            goal = -upper[p - l - m] if p < l + m + n else lower[p - l - m - n]
        own = 0.0
        while True:
            d = np.dot(J, a)
            left, whole = np.dot(d[q:], d[q:]), np.dot(d, d)
            for i in range(q - 1, -1, -1):
                value = d[i]
                for k in range(i + 1, q):
                    value -= R[i, k] * r[k]
                r[i] = value / R[i, i]
            short = goal - np.dot(a, x)
            independent = left > _DEPENDENT * whole and q < n
            full = short / left if independent else np.inf
            if equal[p]:
                if not independent:
                    if abs(short) > 1e-8 * max(1.0, abs(goal)):
                        return _INFEASIBLE
                    break  # it says what others say already
                step, out = full, -1
            else:
                step, out = full, -1
                for k in range(q):
                    if not equal[rows[k]] and r[k] > 0.0 and u[k] / r[k] < step:
                        step, out = u[k] / r[k], k
                if step == np.inf:
                    return _INFEASIBLE
            if independent:
                x += step * np.dot(J[q:].T, d[q:])
            for k in range(q):
                u[k] -= step * r[k]
            own += step
            if out < 0:
                _add(J, R, d, q)
                rows[q], u[q], active[p] = p, own, True
                q += 1
                break
            active[rows[out]] = False
            _drop(J, R, out, q)
            for k in range(out, q - 1):
                rows[k], u[k] = rows[k + 1], u[k + 1]
            q -= 1
    return _GAVE_UP
