"""The phases of the walk as data: double support (section 4.1) and single support (section 4.2).

A phase says what is wanted (tasks), what is held (equalities), what is kept (inequalities) and where the feet are
meant to go; `assemble` turns it into the quadratic program (6) at one configuration. The world of a phase is the
sole of its base foot.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.constraints import (
    AxisLevel,
    Constraint,
    JointMaximum,
    JointMinimum,
    PointInCylinder,
    PointInsideWall,
    PointOverPlane,
    gain,
    vfi_rows,
)
from dqwalk_ros.geometry import Cylinder, Line, Plane, wall_normal
from dqwalk_ros.kinematics import Kinematics, Point
from dqwalk_ros.model import Foot, RobotModel
from dqwalk_ros.qp import Problem
from dqwalk_ros.tasks import ComOverFoot, FramePose, Posture, Task

__all__ = ["Phase", "PhaseKind", "assemble", "double_support", "make_phase", "single_support"]

Array = NDArray[np.float64]

_UP = np.array([0.0, 0.0, 1.0])
_X = np.array([1.0, 0.0, 0.0])
_Y = np.array([0.0, 1.0, 0.0])


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


def make_phase(
    config: Config,
    model: RobotModel,
    kind: PhaseKind,
    support: Foot,
    q_start: ArrayLike,
    swing_target: ArrayLike | None = None,
) -> Phase:
    """Return the phase that begins at `q_start`; the same arguments give the same phase.

    Parameters
    ----------
    config : Config
    model : RobotModel
    kind : PhaseKind
    support : Foot
    q_start : array_like, shape (n,)
        [rad]
    swing_target : array_like, shape (8,)
        For single support.

    Raises
    ------
    ValueError
        If a single support comes without its target.
    """
    q = np.array(q_start, dtype=np.float64)
    if kind is PhaseKind.DOUBLE_SUPPORT:
        return double_support(config, model, support, q)
    if swing_target is None:
        raise ValueError("a single support needs the target of its swing foot")
    return single_support(config, model, support, q, np.array(swing_target, dtype=np.float64))


def double_support(config: Config, model: RobotModel, support: Foot, q_start: Array) -> Phase:
    """Return the double support that brings the CoM over the foot `support`, section 4.1."""
    dsp = config.dsp
    base = support.other
    kin = Kinematics(model, q_start, base)
    base_sole, end_sole = model.soles[base], model.soles[support]
    end = end_sole.frame
    tip, heel, center = (Point(end, offset) for offset in (end_sole.tip, end_sole.heel, end_sole.center))

    def wall(name: str, eta: float, fixed: Array, moving: Point, inside: Array) -> PointInsideWall:
        b = moving.position(kin)
        n = wall_normal(fixed, b, inside)
        t = b - fixed
        side = 1.0 if t[0] * n[1] >= t[1] * n[0] else -1.0
        return PointInsideWall(name=name, eta=eta, point=Point(), fixed=fixed, moving=moving, side=side)

    holds: list[Constraint] = [
        PointOverPlane(name="ground", eta=dsp.eta_ground, point=tip, plane=Plane(_UP, 0.0)),  # (8)
    ]
    if dsp.flat_feet:
        holds += [
            AxisLevel(name="flat_pitch", eta=dsp.eta_ground, frame=end, direction=_X),
            AxisLevel(name="flat_roll", eta=dsp.eta_ground, frame=end, direction=_Y),
        ]
    sliding = Cylinder(Line.through(tip.position(kin), _UP), dsp.sliding_radius)
    rows = (
        PointInCylinder(name="sliding", eta=dsp.eta_sliding, point=tip, cylinder=sliding),  # (7)
        wall("tip_plane", dsp.eta_tip, base_sole.tip, tip, base_sole.heel),  # (9)
        wall("back_plane", dsp.eta_back, base_sole.heel, heel, base_sole.tip),  # (10)
        _pelvis(config, model),  # (11)
    )
    task = ComOverFoot(name="com", foot=center)
    return _phase(config, model, PhaseKind.DOUBLE_SUPPORT, support, base, q_start, None, task, tuple(holds), rows)


def single_support(config: Config, model: RobotModel, support: Foot, q_start: Array, swing_target: Array) -> Phase:
    """Return the single support on the foot `support` that swings the other one to its target, section 4.2."""
    cylinder = Cylinder(Line.through(model.soles[support].center, _UP), config.ssp.com_radius)
    rows = (
        PointInCylinder(name="com_cylinder", eta=config.ssp.eta_com, point=Point(), cylinder=cylinder),  # (14)
        _pelvis(config, model),  # (11)
    )
    task = FramePose(name="swing", frame=model.soles[support.other].frame, target=swing_target)
    return _phase(config, model, PhaseKind.SINGLE_SUPPORT, support, support, q_start, swing_target, task, (), rows)


def _pelvis(config: Config, model: RobotModel) -> PointOverPlane:
    plane = Plane(_UP, config.pelvis.height)
    return PointOverPlane(name="pelvis", eta=config.pelvis.eta, point=Point(model.pelvis), plane=plane)


def _phase(
    config: Config,
    model: RobotModel,
    kind: PhaseKind,
    support: Foot,
    base: Foot,
    q_start: Array,
    swing_target: Array | None,
    task: Task,
    holds: tuple[Constraint, ...],
    rows: tuple[Constraint, ...],
) -> Phase:
    tasks: tuple[Task, ...] = (task,)
    if config.task.posture_weight > 0.0:
        tasks += (Posture(name="posture", weight=config.task.posture_weight, q_ref=np.zeros(model.n)),)
    joints = config.joints
    return Phase(
        kind=kind,
        support=support,
        base=base,
        joint_names=model.joint_names,
        q_start=q_start,
        swing_target=swing_target,
        eta=config.task.eta,
        damping=config.task.damping,
        tasks=tasks,
        holds=holds,
        rows=rows,
        limits=(
            JointMaximum(name="joint_max", eta=joints.eta, bound=joints.margin, q_max=model.q_max),  # (12)
            JointMinimum(name="joint_min", eta=joints.eta, bound=joints.margin, q_min=model.q_min),  # (13)
        ),
    )


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

