"""Infeasible quadratic programs: the rows that conflict, and a slower return to violated constraints.

If every distance is at or above its bound, u = 0 satisfies each inequality of (U6). So the problem is infeasible only
if a constraint is violated already, or an equality requires more than the inequalities allow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dqwalk_ros.paper.qp.problem import Problem
from dqwalk_ros.support.errors import QPError

_LEAST_FRACTION = 1e-3
"""Least fraction of the desired return speed that `lead_back` accepts."""
_RETURN_FRACTION = 0.9
"""Fraction of the fastest feasible return that is used; at the fastest one the feasible set is a single point."""
_LARGEST_VELOCITY = 1e3
"""Bound of the joint velocities in the linear programs below [rad/s]."""


@dataclass(frozen=True)
class Conflict:
    """Rows that cannot be satisfied together."""

    short: dict[str, float]
    """Amount by which each row must be relaxed, in its own unit per second (m/s, m^2/s for squared distances, rad/s);
    largest first."""
    against: tuple[str, ...]
    """The active rows that conflict with them, in decreasing order of their multipliers."""

    def __str__(self) -> str:
        text = ", ".join(f"{name} is short by {amount:.3g} /s" for name, amount in self.short.items())
        return f"{text}; against {', '.join(self.against[:6])}" if self.against else text


def conflicts(problem: Problem) -> Conflict | None:
    """Return the rows of a problem that conflict, and by how much; None if the problem is feasible.

    It is the solution of the elastic program, which minimises the sum of the relaxations of all rows. Each row is
    divided by its largest coefficient, so that the sum has the unit of a joint velocity.
    """
    from scipy.optimize import linprog  # slow to import and rarely needed

    n, l, m = problem.shape
    rows = np.vstack([problem.E, -problem.G, np.eye(n), -np.eye(n)])  # E u = e, and A u <= b for the rest
    b = np.concatenate([problem.e, -problem.h, problem.upper, -problem.lower])
    if not (np.isfinite(rows).all() and np.isfinite(b).all()):
        return None
    size = np.maximum(np.abs(rows).max(axis=1, initial=0.0), 1e-12)
    A, b = rows / size[:, None], b / size
    k = m + 2 * n
    cost = np.concatenate([np.zeros(n), np.ones(2 * l + k)])
    equal = np.hstack([A[:l], np.eye(l), -np.eye(l), np.zeros((l, k))])
    below = np.hstack([A[l:], np.zeros((k, 2 * l)), -np.eye(k)])
    bounds = [(-_LARGEST_VELOCITY, _LARGEST_VELOCITY)] * n + [(0.0, None)] * (2 * l + k)
    found = linprog(cost, below, b[l:], equal if l else None, b[:l] if l else None, bounds)
    if not found.success:
        return None
    slack = found.x[n:]
    relaxation = np.concatenate([slack[:l] + slack[l : 2 * l], slack[2 * l :]])
    multipliers = np.abs(np.concatenate([found.eqlin.marginals if l else np.empty(0), found.ineqlin.marginals]))
    names = problem.names or tuple(f"row {i}" for i in range(l + k))
    short = [i for i in np.argsort(-relaxation) if relaxation[i] > 1e-9 * max(1.0, float(np.abs(b).max()))]
    if not short:
        return None
    against = [i for i in np.argsort(-multipliers) if multipliers[i] > 1e-6 and i not in short]
    return Conflict({names[i]: float(relaxation[i] * size[i]) for i in short}, tuple(names[i] for i in against))


def explained(error: QPError, problem: Problem) -> QPError:
    """Return a copy of the error that names the conflicting rows, or the error itself if none are found."""
    found = conflicts(problem)
    if found is None:
        return error
    return QPError(
        f"the quadratic program has no solution ({error.status}): {found}",
        status=error.status,
        rows=(*found.short, *found.against),
        short=found.short,
    )


def lead_back(problem: Problem) -> tuple[Problem, float]:
    """Return a relaxed problem that leads back to the constraints more slowly, and the fraction of the desired speed.

    Rows that u = 0 satisfies stay as they are. All right-hand sides that require motion, h > 0 or e != 0, are
    multiplied by the same fraction t in [0, 1]: 0.9 of the largest one for which the problem is feasible. Violated
    distances do not decrease; with t = 0 the problem is always feasible, by u = 0.

    Raises
    ------
    QPError
        If the fraction is smaller than 1e-3.
    """
    from scipy.optimize import linprog  # slow to import and rarely needed

    n, l, _ = problem.shape
    wanted, satisfied = np.maximum(problem.h, 0.0), np.minimum(problem.h, 0.0)
    rise, low = np.maximum(problem.lower, 0.0), np.minimum(problem.lower, 0.0)
    fall, high = np.minimum(problem.upper, 0.0), np.maximum(problem.upper, 0.0)
    # G u >= satisfied + t wanted, E u = t e, low + t rise <= u <= high + t fall
    below = np.vstack(
        [
            np.hstack([-problem.G, wanted[:, None]]),
            np.hstack([np.eye(n), -fall[:, None]]),
            np.hstack([-np.eye(n), rise[:, None]]),
        ]
    )
    b = np.concatenate([-satisfied, high, -low])
    equal = np.hstack([problem.E, -problem.e[:, None]])
    cost = np.zeros(n + 1)
    cost[n] = -1.0
    bounds = [(-_LARGEST_VELOCITY, _LARGEST_VELOCITY)] * n + [(0.0, 1.0)]
    finite = np.isfinite(below).all() and np.isfinite(b).all() and np.isfinite(equal).all()
    found = linprog(cost, below, b, equal if l else None, np.zeros(l) if l else None, bounds) if finite else None
    t = _RETURN_FRACTION * float(found.x[n]) if found is not None and found.success else 0.0
    if t < _LEAST_FRACTION:
        raise QPError("there is no way back inside the constraints", status="NoWayBack", rows=())
    w = np.concatenate([t * problem.e, satisfied + t * wanted])
    relaxed = problem.replaced(w=w, lower=low + t * rise, upper=high + t * fall)
    return relaxed, t
