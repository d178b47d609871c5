"""A phase as data, and the quadratic program (6) it asks for at one configuration."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.constraints import Constraint, JointMaximum, JointMinimum, gain, vfi_rows
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.model import Foot
from dqwalk_ros.qp import Problem
from dqwalk_ros.tasks import Task

__all__ = ["Phase", "PhaseKind", "assemble"]

Array = NDArray[np.float64]


class PhaseKind(enum.Enum):
    """Both feet on the ground, or one."""

    DOUBLE_SUPPORT = "double_support"
    SINGLE_SUPPORT = "single_support"


@dataclass(frozen=True, kw_only=True)
class Phase:
    """One phase of Fig. 1.

    Attributes
    ----------
    kind : PhaseKind
    support : Foot
        The foot that carries the weight at the end of the phase, by which the phase is named.
    base : Foot
        The foot whose sole is the world: the support foot in single support, the other one in double support.
    joint_names : tuple of str
    q_start : ndarray, shape (n,)
        Where the phase began [rad].
    swing_target : ndarray, shape (8,), or None
        x_d of the swinging sole in the base frame.
    eta, damping : float
        eta [1/s] and lambda of (6).
    tasks : tuple of Task
        The first is the phase's own: its error ends the phase.
    holds : tuple of Constraint
        Equalities, d' = -eta (d - bound).
    rows : tuple of Constraint
        Inequalities, d' >= -eta (d - bound).
    limits : tuple of JointMaximum and JointMinimum
        Joint limits (12) and (13), which the quadratic program takes as bounds on u.
    """

    kind: PhaseKind
    support: Foot
    base: Foot
    joint_names: tuple[str, ...]
    q_start: Array
    swing_target: Array | None
    eta: float
    damping: float
    tasks: tuple[Task, ...]
    holds: tuple[Constraint, ...]
    rows: tuple[Constraint, ...]
    limits: tuple[JointMaximum, JointMinimum]

    @property
    def name(self) -> str:
        """Such as ``double_support/left``."""
        return f"{self.kind.value}/{self.support.value}"

    @cached_property
    def constraints(self) -> tuple[Constraint, ...]:
        """All inequalities."""
        return (*self.rows, *self.limits)

    @cached_property
    def row_names(self) -> tuple[str, ...]:
        """Names of the rows of the quadratic program, in its order."""
        return tuple(
            name for row in (*self.holds, *self.rows, *self.limits) for name in row.row_names(self.joint_names)
        )

    def error(self, kin: Kinematics) -> float:
        """Norm of the error of the phase's own task."""
        e = self.tasks[0].error(kin)
        return float(np.sqrt(e @ e))

    def distances(self, kin: Kinematics) -> dict[str, float]:
        """Every signed distance less its bound, by name; what is kept is >= 0, what is held is 0.

        Of the joint limits it is the least.
        """
        held = {row.name: float(row.distance(kin)[0] - row.bound) for row in self.holds}
        kept = {row.name: float(row.distance(kin).min() - row.bound) for row in self.constraints}
        return held | kept


def assemble(phase: Phase, kin: Kinematics, dt: float) -> Problem:
    """Return the quadratic program (6) of a phase at one configuration.

    Parameters
    ----------
    phase : Phase
    kin : Kinematics
        Seen from ``phase.base``.
    dt : float
        Control period [s], which caps the rates at 1/dt.
    """
    n = kin.q.shape[0]
    H = np.zeros((n, n))
    H.flat[:: n + 1] = phase.damping**2
    c = np.zeros(n)
    for task in phase.tasks:
        J = task.jacobian(kin)
        H += task.weight * (J.T @ J)
        c += (task.weight * phase.eta) * (task.error(kin) @ J)
    E, e = _stacked(phase.holds, kin, dt)
    G, h = _stacked(phase.rows, kin, dt)
    above, below = phase.limits
    return Problem(
        H=H,
        c=c,
        E=E,
        e=e,
        G=G,
        h=h,
        lower=-gain(below.eta, dt) * (below.distance(kin) - below.bound),
        upper=gain(above.eta, dt) * (above.distance(kin) - above.bound),
        names=phase.row_names,
    )


def _stacked(rows: tuple[Constraint, ...], kin: Kinematics, dt: float) -> tuple[Array, Array]:
    if not rows:
        return np.empty((0, kin.q.shape[0])), np.empty(0)
    parts = [vfi_rows(row, kin, dt) for row in rows]
    return np.concatenate([G for G, _ in parts]), np.concatenate([h for _, h in parts])
