"""What to do about a quadratic program (6) without an answer: say which rows fight, and lead the robot back in.

With every distance at or above its bound, standing still satisfies each inequality of (6). So it has no answer only
where the robot is outside already, or an equality asks for more than the inequalities allow. `lead_back` then asks
for the return at the largest common fraction of the wanted rate that the other rows and the velocity limits allow;
rows that are kept stay as they are, and rows that are broken may not get worse. `conflicts` is the elastic program:
the least total by which rows must give way.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.errors import QPError
from dqwalk_ros.qp import Problem

__all__ = ["Conflict", "conflicts", "explained", "lead_back"]

Array = NDArray[np.float64]

_SLOWEST = 1e-3
"""A return slower than this fraction of the wanted rate is none."""
_SHARE = 0.9
"""Part of the fastest return that is asked for: at the fastest one the rows leave a single point."""
_FAST = 1e3
"""Joint velocities are free up to here where they have no limit [rad/s]."""


@dataclass(frozen=True)
class Conflict:
    """Rows that cannot be kept together.

    Attributes
    ----------
    short : dict of str to float
        Rows that must give way, by how much, in the row's own unit per second (m/s, m^2/s for squared distances,
        rad/s); largest first.
    against : tuple of str
        The rows they fight with, strongest first.
    """

    short: dict[str, float]
    against: tuple[str, ...]

    def __str__(self) -> str:
        text = ", ".join(f"{name} is short by {amount:.3g} /s" for name, amount in self.short.items())
        return f"{text}; against {', '.join(self.against[:6])}" if self.against else text


def conflicts(problem: Problem) -> Conflict | None:
    """Return which rows of a problem fight, and by how much; None where they can all be kept.

    Each row is measured by its largest coefficient, so that what is least is a joint velocity whatever the unit of
    the row.
    """
    from scipy.optimize import linprog  # slow to import, and seldom needed

    n, l, m = problem.shape  # noqa: E741
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
    bounds = [(-_FAST, _FAST)] * n + [(0.0, None)] * (2 * l + k)
    found = linprog(cost, below, b[l:], equal if l else None, b[:l] if l else None, bounds)
    if not found.success:
        return None
    slack = found.x[n:]
    give = np.concatenate([slack[:l] + slack[l : 2 * l], slack[2 * l :]])
    forces = np.abs(np.concatenate([found.eqlin.marginals if l else np.empty(0), found.ineqlin.marginals]))
    names = problem.names or tuple(f"row {i}" for i in range(l + k))
    short = [i for i in np.argsort(-give) if give[i] > 1e-9 * max(1.0, float(np.abs(b).max()))]
    if not short:
        return None
    against = [i for i in np.argsort(-forces) if forces[i] > 1e-6 and i not in short]
    return Conflict({names[i]: float(give[i] * size[i]) for i in short}, tuple(names[i] for i in against))


def explained(error: QPError, problem: Problem) -> QPError:
    """Return the error with the rows that fight and by how much, where that can be said."""
    found = conflicts(problem)
    if found is None:
        return error
    return QPError(
        f"the quadratic program has no answer ({error.status}): {found}",
        status=error.status,
        rows=(*found.short, *found.against),
        short=found.short,
    )


def lead_back(problem: Problem) -> tuple[Problem, float]:
    """Return the problem that leads back in as fast as can be, and the fraction of the wanted rate it goes at.

    Every right-hand side that asks for motion, h > 0 or e != 0, is multiplied by one fraction in [0, 1], the largest
    for which all rows can be kept; zero velocity keeps them all at fraction 0.

    Raises
    ------
    QPError
        If there is no way back in.
    """
    from scipy.optimize import linprog  # slow to import, and seldom needed

    n, l, _ = problem.shape  # noqa: E741
    wanted, kept = np.maximum(problem.h, 0.0), np.minimum(problem.h, 0.0)
    rise, low = np.maximum(problem.lower, 0.0), np.minimum(problem.lower, 0.0)
    fall, high = np.minimum(problem.upper, 0.0), np.maximum(problem.upper, 0.0)
    # G u >= kept + t wanted, E u = t e, low + t rise <= u <= high + t fall
    below = np.vstack(
        [
            np.hstack([-problem.G, wanted[:, None]]),
            np.hstack([np.eye(n), -fall[:, None]]),
            np.hstack([-np.eye(n), rise[:, None]]),
        ]
    )
    b = np.concatenate([-kept, high, -low])
    equal = np.hstack([problem.E, -problem.e[:, None]])
    cost = np.zeros(n + 1)
    cost[n] = -1.0
    bounds = [(-_FAST, _FAST)] * n + [(0.0, 1.0)]
    finite = np.isfinite(below).all() and np.isfinite(b).all() and np.isfinite(equal).all()
    found = linprog(cost, below, b, equal if l else None, np.zeros(l) if l else None, bounds) if finite else None
    t = _SHARE * float(found.x[n]) if found is not None and found.success else 0.0
    if t < _SLOWEST:
        raise QPError("there is no way back inside the constraints", status="NoWayBack", rows=())
    relaxed = dataclasses.replace(
        problem, e=t * problem.e, h=kept + t * wanted, lower=low + t * rise, upper=high + t * fall
    )
    return relaxed, t
