"""What a walk is made of, as shapes for RViz and Foxglove: soles, centre of mass, planes, cylinder."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from dqwalk_ros.config import Config
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.nodes.messages import pose_fields, time_msg, xyz
from dqwalk_ros.robot import Foot, RobotModel, Sole
from dqwalk_ros.walk import Phase, PhaseKind

__all__ = ["markers"]

Array = NDArray[np.float64]

_SOLE, _COM, _TIP, _BACK, _PELVIS, _CYLINDER, _SWING = (
    (0.30, 0.30, 0.35, 0.9),
    (0.85, 0.10, 0.10, 1.0),
    (0.10, 0.45, 0.85, 0.3),
    (0.90, 0.55, 0.10, 0.3),
    (0.50, 0.50, 0.50, 0.2),
    (0.15, 0.65, 0.25, 0.3),
    (0.15, 0.65, 0.25, 0.6),
)
_HEIGHT = 0.5
"""How far up planes and cylinder are drawn [m]."""
_THIN = 0.002


def markers(stamp: int, config: Config, model: RobotModel, phase: Phase, kin: Kinematics) -> MarkerArray:
    """Return the shapes of one state, in the frame of the base sole; each message replaces the last.

    Parameters
    ----------
    stamp : int [ns]
    config : Config
    model : RobotModel
    phase : Phase
    kin : Kinematics
        Seen from the base of the phase.
    """
    frame = model.soles[phase.base].frame
    clear = Marker(action=Marker.DELETEALL)
    clear.header.frame_id = frame
    shapes = [*_robot(model, phase, kin), *_constraints(config, model, phase, kin)]
    for index, marker in enumerate(shapes):
        marker.header.stamp, marker.header.frame_id = time_msg(stamp), frame
        marker.id = index
    return MarkerArray(markers=[clear, *shapes])


def _shape(kind: int, name: str, x: Array, scale: tuple[float, float, float], color: tuple[float, ...]) -> Marker:
    marker = Marker(ns=name, type=kind, action=Marker.ADD, pose=pose_fields(x))
    marker.scale.x, marker.scale.y, marker.scale.z = scale
    marker.color = ColorRGBA(r=color[0], g=color[1], b=color[2], a=color[3])
    return marker


def _at(p: Array, yaw: float = 0.0) -> Array:
    return DQ.from_pose(p, [np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)]).vec8()


def _sole(sole: Sole, pose: Array, color: tuple[float, ...], name: str) -> Marker:
    center = (DQ(pose) * DQ.from_pose(sole.center - [0.0, 0.0, 0.5 * _THIN])).vec8()
    return _shape(Marker.CUBE, name, center, (sole.length, sole.width, _THIN), color)


def _robot(model: RobotModel, phase: Phase, kin: Kinematics) -> Iterator[Marker]:
    for foot in Foot:
        sole = model.soles[foot]
        yield _sole(sole, kin.pose(sole.frame), _SOLE, f"sole/{foot.value}")
    yield _shape(Marker.SPHERE, "com", _at(kin.com), (0.02, 0.02, 0.02), _COM)
    shadow = _shape(Marker.LINE_LIST, "com/projection", _at(np.zeros(3)), (_THIN, 0.0, 0.0), _COM)
    shadow.points = [xyz(kin.com), xyz(kin.com * [1.0, 1.0, 0.0])]
    yield shadow
    if phase.swing_target is not None:
        yield _sole(model.soles[phase.base.other], phase.swing_target, _SWING, "swing_target")


def _constraints(config: Config, model: RobotModel, phase: Phase, kin: Kinematics) -> Iterator[Marker]:
    base, end = model.soles[phase.base], model.soles[phase.base.other]
    up = np.array([0.0, 0.0, 0.5 * _HEIGHT])
    height = np.array([0.0, 0.0, config.pelvis.height])
    yield _shape(Marker.CUBE, "pelvis_plane", _at(base.center + height), (0.4, 0.4, _THIN), _PELVIS)
    if phase.kind is PhaseKind.SINGLE_SUPPORT:
        wide = 2.0 * config.ssp.com_radius
        yield _shape(Marker.CYLINDER, "com_cylinder", _at(base.center + up), (wide, wide, _HEIGHT), _CYLINDER)
        return
    for name, mine, its, color in (
        ("tip_plane", base.tip, kin.point(end.frame, end.tip), _TIP),
        ("back_plane", base.heel, kin.point(end.frame, end.heel), _BACK),
    ):
        along = (its - mine)[:2]
        center = np.append(0.5 * (its + mine)[:2], 0.0) + up
        size = (float(np.hypot(*along)) + 0.1, _THIN, _HEIGHT)
        yield _shape(Marker.CUBE, name, _at(center, float(np.arctan2(along[1], along[0]))), size, color)
    start = Kinematics(model, phase.q_start, phase.base).point(end.frame, end.tip)
    wide = 2.0 * config.dsp.sliding_radius
    yield _shape(Marker.CYLINDER, "sliding_area", _at(start * [1.0, 1.0, 0.0]), (wide, wide, _THIN), _CYLINDER)
