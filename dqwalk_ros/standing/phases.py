"""The phases of a walk that stands: the CoM is kept over the true soles, edge by edge.

With both feet on the ground the support polygon is the convex hull of both soles, with one foot it is its sole; each
edge is a plane, "as many planes as necessary" (section 3.1 [Urban2020]), moved in by a margin.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.constraints import (
    ComInsideEdges,
    Constraint,
    FrameHeld,
    JointMaximum,
    JointMinimum,
    PointOverPlane,
    PointsOverPlane,
)
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import ConfigError
from dqwalk_ros.geometry import ConvexPolygon, Plane
from dqwalk_ros.kinematics import Kinematics, Point
from dqwalk_ros.model import Foot, RobotModel
from dqwalk_ros.phases.phase import Phase, PhaseKind
from dqwalk_ros.tasks import ComPath, Posture, SwingPath, Task

__all__ = ["double_support", "flat", "posture", "single_support", "stance"]

Array = NDArray[np.float64]

_UP = np.array([0.0, 0.0, 1.0])


def posture(config: Config, model: RobotModel) -> Array:
    """Return the posture that ``standing.posture`` describes, shape (n,) [rad].

    Raises
    ------
    ConfigError
        If an entry is not JOINT=RADIANS or no moving joint has such a name.
    """
    q = np.zeros(model.n)
    for entry in config.standing.posture:
        name, _, text = entry.partition("=")
        hits = [k for k, joint in enumerate(model.joint_names) if fnmatch.fnmatch(joint, name.strip())]
        try:
            angle = float(text)
        except ValueError:
            raise ConfigError(f"standing.posture has '{entry}'; it must be JOINT=RADIANS") from None
        if not hits:
            raise ConfigError(f"standing.posture names '{name}'; the joints are {', '.join(model.joint_names)}")
        q[hits] = angle
    return q


def double_support(config: Config, model: RobotModel, support: Foot, q_start: Array) -> Phase:
    """Return the double support that brings the CoM over the sole of `support`."""
    kin = Kinematics(model, q_start, support.other)
    sole = model.soles[support]
    over = (Point(sole.frame, sole.center),)
    return _on_both(config, model, PhaseKind.DOUBLE_SUPPORT, support, kin, over)


def stance(config: Config, model: RobotModel, support: Foot, q_start: Array) -> Phase:
    """Return the phase that brings the CoM between both soles; the world is the other sole than `support`."""
    kin = Kinematics(model, q_start, support.other)
    over = tuple(Point(sole.frame, sole.center) for sole in model.soles.values())
    return _on_both(config, model, PhaseKind.STANCE, support, kin, over)


def single_support(config: Config, model: RobotModel, support: Foot, q_start: Array, swing_target: Array) -> Phase:
    """Return the single support on the foot `support` that swings the other one to its target."""
    s = config.standing
    kin = Kinematics(model, q_start, support)
    sole, swing = model.soles[support], model.soles[support.other]
    # the swing sole stays on its side of the support sole's inner edge
    side = 1.0 if support is Foot.RIGHT else -1.0
    inner = Plane(side * np.array([0.0, 1.0, 0.0]), side * float(sole.center[1]) + 0.5 * sole.width)
    rows: tuple[Constraint, ...] = (
        _edges(config, ConvexPolygon.hull(sole.corners)),
        PointsOverPlane(
            name="clearance", eta=s.eta_edges, recovery=s.recovery, frame=swing.frame, points=swing.corners,
            plane=Plane(_UP, 0.0),
        ),
        PointsOverPlane(
            name="sole_gap", eta=s.eta_edges, bound=s.sole_gap, recovery=s.recovery, frame=swing.frame,
            points=swing.corners, plane=inner,
        ),
        _pelvis(config, model),
    )  # fmt: skip
    task = SwingPath(
        name="swing",
        weight=s.swing_weight,
        frame=swing.frame,
        start=kin.pose(swing.frame),
        goal=swing_target,
        height=config.gait.step_height,
        duration=s.swing_duration,
        rate=s.swing_rate,
        lever=s.lever,
    )
    com = ComPath(
        name="com",
        weight=s.com_weight,
        start=kin.com_on_ground,
        over=(Point(sole.frame, sole.center),),
        duration=0.5 * s.swing_duration,
        saturation=s.saturation,
    )
    return _phase(config, model, PhaseKind.SINGLE_SUPPORT, support, kin, swing_target, (task, com), (), rows)


def _on_both(
    config: Config, model: RobotModel, kind: PhaseKind, support: Foot, kin: Kinematics, over: tuple[Point, ...]
) -> Phase:
    s = config.standing
    base, end = model.soles[kin.base], model.soles[kin.base.other]
    pose = flat(kin.pose(end.frame))
    hull = ConvexPolygon.hull(np.concatenate([base.corners, DQ(pose).transform_point(end.corners)]))
    rows = (_edges(config, hull), _pelvis(config, model))
    holds = (FrameHeld(name="end_sole", eta=s.eta_feet, recovery=s.recovery, frame=end.frame, pose=pose),)
    task = ComPath(
        name="com",
        start=kin.com_on_ground,
        over=over,
        duration=s.transfer_duration,
        saturation=s.saturation,
    )
    return _phase(config, model, kind, support, kin, None, (task,), holds, rows)


def flat(x: Array) -> Array:
    """Return the pose (8,) on the ground, upright, that is nearest to `x` (8,)."""
    pose = DQ(x)
    ahead = pose.rotation_matrix()[:, 0]
    half = 0.5 * np.arctan2(ahead[1], ahead[0])
    return DQ.from_pose(pose.translation() * [1.0, 1.0, 0.0], [np.cos(half), 0.0, 0.0, np.sin(half)]).vec8()


def _edges(config: Config, polygon: ConvexPolygon) -> ComInsideEdges:
    s = config.standing
    return ComInsideEdges(name="edges", eta=s.eta_edges, bound=s.margin, recovery=s.recovery, polygon=polygon)


def _pelvis(config: Config, model: RobotModel) -> PointOverPlane:
    plane = Plane(_UP, config.pelvis.height)
    return PointOverPlane(name="pelvis", eta=config.pelvis.eta, point=Point(model.pelvis), plane=plane)


def _phase(
    config: Config,
    model: RobotModel,
    kind: PhaseKind,
    support: Foot,
    kin: Kinematics,
    swing_target: Array | None,
    tasks: Sequence[Task],
    holds: tuple[Constraint, ...],
    rows: tuple[Constraint, ...],
) -> Phase:
    joints = config.joints
    back = Posture(name="posture", weight=config.task.posture_weight, q_ref=posture(config, model))
    return Phase(
        kind=kind,
        support=support,
        base=kin.base,
        joint_names=model.joint_names,
        q_start=kin.q,
        swing_target=swing_target,
        eta=config.task.eta,
        damping=config.task.damping,
        tasks=(*tasks, back),
        holds=holds,
        rows=rows,
        limits=(
            JointMaximum(name="joint_max", eta=joints.eta, bound=joints.margin, recovery=0.5, q_max=model.q_max),
            JointMinimum(name="joint_min", eta=joints.eta, bound=joints.margin, recovery=0.5, q_min=model.q_min),
        ),
    )
