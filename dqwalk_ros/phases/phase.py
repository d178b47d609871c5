"""A phase as data, and the quadratic program (6) it asks for at one configuration."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.assembly import Table
from dqwalk_ros.constraints import Constraint, JointMaximum, JointMinimum
from dqwalk_ros.kinematics import Kinematics, Rooted
from dqwalk_ros.model import Foot, RobotModel
from dqwalk_ros.qp import Problem
from dqwalk_ros.tasks import Task

__all__ = ["Phase", "PhaseKind", "assemble", "com_target"]

Array = NDArray[np.float64]


class PhaseKind(enum.Enum):
    """Both feet on the ground, or one; in a stance the weight is on both."""

    DOUBLE_SUPPORT = "double_support"
    SINGLE_SUPPORT = "single_support"
    STANCE = "stance"


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

    def table(self, rooted: Rooted) -> Table:
        """Return the compiled form of the phase for a robot; made once."""
        table: Table | None = self.__dict__.get("_table")
        if table is None or table.rooted is not rooted:
            table = self.__dict__["_table"] = Table(
                rooted,
                self.joint_names,
                self.tasks,
                self.holds,
                self.rows,
                self.limits,
                eta=self.eta,
                damping=self.damping,
                names=self.row_names,
            )
        return table

    def __getstate__(self) -> dict[str, object]:
        # the compiled form is made anew where the phase is sent
        return {key: value for key, value in self.__dict__.items() if key != "_table"}

    def error(self, kin: Kinematics) -> float:
        """Norm of the error of the phase's own task."""
        return self.table(kin.rooted).error(kin, self.tasks[0])

    def distances(self, kin: Kinematics) -> dict[str, float]:
        """Every signed distance less its bound, by name; what is kept is >= 0, what is held is 0.

        Of several rows it is the least, of an equality the one furthest from 0.
        """
        held = {row.name: _largest(row.distance(kin) - row.bound) for row in self.holds}
        kept = {row.name: float(row.distance(kin).min() - row.bound) for row in self.constraints}
        return held | kept


def _largest(d: Array) -> float:
    return float(d[np.argmax(np.abs(d))])


def com_target(model: RobotModel, kind: PhaseKind, base: Foot, q_start: Array) -> Array:
    """Return where on the ground the CoM goes with both feet down, shape (3,) [m], as seen where the phase begins.

    To the other sole's centre, in a stance halfway to it.
    """
    end = model.soles[base.other]
    there = Kinematics(model, q_start, base).point(end.frame, end.center)
    if kind is PhaseKind.STANCE:
        there = 0.5 * (there + model.soles[base].center)
    return np.array([there[0], there[1], 0.0])


def assemble(phase: Phase, kin: Kinematics, dt: float, velocity: Array | None = None) -> Problem:
    """Return the quadratic program (6) of a phase at one configuration.

    Parameters
    ----------
    phase : Phase
    kin : Kinematics
        Seen from ``phase.base``.
    dt : float
        Control period [s], which caps the rates at 1/dt.
    velocity : ndarray, shape (n,), optional
        Limits of the joint velocities, which the bounds are kept within [rad/s].
    """
    return phase.table(kin.rooted).problem(kin, dt, velocity)
