"""The phases of the paper: double support (section 4.1) and single support (section 4.2) [Urban2020]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.constraints import (
    AxisLevel,
    Constraint,
    JointMaximum,
    JointMinimum,
    PointInCylinder,
    PointInsideWall,
    PointOverPlane,
)
from dqwalk_ros.geometry import Cylinder, Line, Plane, wall_normal
from dqwalk_ros.kinematics import Kinematics, Point
from dqwalk_ros.model import Foot, RobotModel
from dqwalk_ros.phases.phase import Phase, PhaseKind
from dqwalk_ros.tasks import ComOverFoot, FramePose, Posture, Task

__all__ = ["double_support", "single_support"]

Array = NDArray[np.float64]

_UP = np.array([0.0, 0.0, 1.0])
_X = np.array([1.0, 0.0, 0.0])
_Y = np.array([0.0, 1.0, 0.0])


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
