"""Markers for RViz and Foxglove, made from the shapes of `dqwalk_ros.report.scene`."""

from __future__ import annotations

import numpy as np
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from dqwalk_ros.config import Config
from dqwalk_ros.nodes.messages import header, pose_fields, xyz
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import Phase
from dqwalk_ros.report.colors import COM, FOOT, Rgb
from dqwalk_ros.report.scene import Moment, NamedRegion, Scene
from dqwalk_ros.robot.model import RobotModel, Sole
from dqwalk_ros.support.arrays import Array

_THIN = 0.002


def markers(stamp: int, config: Config, model: RobotModel, phase: Phase, kin: Kinematics) -> MarkerArray:
    """Return the markers of one state, in the frame of the base sole; each message replaces the one before.

    Parameters
    ----------
    stamp : int [ns]
    kin : Kinematics
        Of that state, relative to the base sole of the phase.
    """
    view = Scene(config, model).look(Moment(0.0, kin.q, phase, 0, 0.0, DQ(1.0).vec8()))
    shapes = [_sole(f"sole/{foot.value}", model.soles[foot], x, FOOT[foot], 0.9) for foot, x in view.soles.items()]
    if view.target is not None:
        swing = phase.base.other
        shapes.append(_sole("swing_target", model.soles[swing], view.target, FOOT[swing], 0.5))
    shapes.append(_shape(Marker.SPHERE, "com", _pose_at(view.com), (0.02, 0.02, 0.02), COM))
    plumb = _shape(Marker.LINE_LIST, "com/projection", _pose_at(np.zeros(3)), (_THIN, 0.0, 0.0), COM)
    plumb.points = [xyz(view.com), xyz(view.com * [1.0, 1.0, 0.0])]
    shapes += [plumb, *map(_region, view.regions)]
    clear = Marker(action=Marker.DELETEALL)
    clear.header.frame_id = frame = model.soles[phase.base].frame
    for index, marker in enumerate(shapes):
        marker.header, marker.id = header(stamp, frame), index
    return MarkerArray(markers=[clear, *shapes])


def _region(drawn: NamedRegion) -> Marker:
    """Return the marker of a constraint's region."""
    kind = Marker.CYLINDER if drawn.region.kind == "cylinder" else Marker.CUBE
    x, y, z = np.maximum(drawn.extent, _THIN).tolist()
    return _shape(kind, drawn.name, drawn.region.pose, (x, y, z), drawn.color, 0.3)


def _sole(name: str, sole: Sole, x: Array, color: Rgb, opacity: float) -> Marker:
    center = (DQ(x) * DQ.from_pose(sole.center - [0.0, 0.0, 0.5 * _THIN])).vec8()
    return _shape(Marker.CUBE, name, center, (sole.length, sole.width, _THIN), color, opacity)


def _pose_at(p: Array) -> Array:
    return DQ.from_pose(p).vec8()


def _shape(
    kind: int, name: str, x: Array, scale: tuple[float, float, float], color: Rgb, opacity: float = 1.0
) -> Marker:
    marker = Marker(ns=name, type=kind, action=Marker.ADD, pose=pose_fields(x))
    marker.scale.x, marker.scale.y, marker.scale.z = scale
    r, g, b = (channel / 255.0 for channel in color)
    marker.color = ColorRGBA(r=r, g=g, b=b, a=opacity)
    return marker
