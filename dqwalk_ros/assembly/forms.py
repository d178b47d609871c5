"""How each kind of task and constraint is written into the table that the compiled pass reads.

A form returns for each row (of a constraint) or for the whole (of a task) the kind, the body, a second body, and the
numbers that come after the common columns: for a row the point on the body (3), the point on the second body (3) and
what the kind asks for (7). Only exact classes have a form: a subclass may have changed its methods.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros import kernels
from dqwalk_ros.assembly.compiled import (
    AXIS,
    COM_OVER_FOOT,
    COM_PATH,
    CYLINDER,
    EDGE,
    FRAME_HELD,
    FRAME_POSE,
    PLANE,
    POSTURE,
    SWING_PATH,
    WALL,
)
from dqwalk_ros.constraints import (
    AxisLevel,
    ComInsideEdges,
    Constraint,
    FrameHeld,
    PointInCylinder,
    PointInsideWall,
    PointOverPlane,
    PointsOverPlane,
)
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.kinematics import Point, Rooted
from dqwalk_ros.tasks import ComOverFoot, ComPath, FramePose, Posture, SwingPath, Task

__all__ = ["HEIGHT", "ROWS", "TASKS"]

Array = NDArray[np.float64]
_Entry = tuple[int, int, int, list[float]]

_UP = np.array([0.0, 0.0, 1.0])


def _at(point: Point, rooted: Rooted) -> tuple[int, Array]:
    """Return the body of a point and its place on it, -1 for the centre of mass."""
    if not point.frame:
        return -1, np.zeros(3)
    body, pose = rooted.frames[point.frame]
    return body, kernels.point(pose, point.offset)


def _plane(row: PointOverPlane, rooted: Rooted) -> list[_Entry]:
    body, p = _at(row.point, rooted)
    return [(PLANE, body, 0, [*p, 0, 0, 0, *row.plane.n, row.plane.d])]


def _planes(row: PointsOverPlane, rooted: Rooted) -> list[_Entry]:
    places = (_at(Point(row.frame, p), rooted) for p in row.points)
    return [(PLANE, body, 0, [*p, 0, 0, 0, *row.plane.n, row.plane.d]) for body, p in places]


def _cylinder(row: PointInCylinder, rooted: Rooted) -> list[_Entry]:
    body, p = _at(row.point, rooted)
    axis = row.cylinder.axis
    return [(CYLINDER, body, 0, [*p, 0, 0, 0, *axis.l, *axis.m, row.cylinder.radius**2])]


def _wall(row: PointInsideWall, rooted: Rooted) -> list[_Entry]:
    body, p = _at(row.point, rooted)
    other, b = _at(row.moving, rooted)
    return [(WALL, body, other, [*p, *b, *row.fixed, row.side])]


def _axis(row: AxisLevel, rooted: Rooted) -> list[_Entry]:
    body, pose = rooted.frames[row.frame]
    up = kernels.point(pose, _UP) - kernels.point(pose, np.zeros(3))
    return [(AXIS, body, 0, [*up, 0, 0, 0, *row.direction])]


def _edges(row: ComInsideEdges, rooted: Rooted) -> list[_Entry]:
    return [(EDGE, -1, 0, [0, 0, 0, 0, 0, 0, *n, d]) for n, d in zip(*row.polygon.edges(), strict=True)]


def _held(row: FrameHeld, rooted: Rooted) -> list[_Entry]:
    body, pose = rooted.frames[row.frame]
    at = DQ(row.pose)
    return [(FRAME_HELD, body, 0, [*pose, *at.translation(), *at.P().conj().vec4()])]


def _com_over_foot(task: ComOverFoot, rooted: Rooted) -> _Entry:
    body, p = _at(task.foot, rooted)
    return COM_OVER_FOOT, body, 0, [*p]


def _frame_pose(task: FramePose, rooted: Rooted) -> _Entry:
    body, pose = rooted.frames[task.frame]
    return FRAME_POSE, body, 0, [*pose, *task.target]


def _posture(task: Posture, rooted: Rooted) -> _Entry:
    return POSTURE, -1, 0, [*task.q_ref]


def _com_path(task: ComPath, rooted: Rooted) -> _Entry | None:
    if not 1 <= len(task.over) <= 2:
        return None
    (body, p), (other, b) = _at(task.over[0], rooted), _at(task.over[-1], rooted)
    return COM_PATH, body, other, [*p, *b, *task.start, task.duration, task.saturation]


def _swing_path(task: SwingPath, rooted: Rooted) -> _Entry:
    body, pose = rooted.frames[task.frame]
    start, way, half = task.legs
    path = [*start.translation(), *way, *start.P().vec4(), *half.vec3(), task.height, task.duration]
    return SWING_PATH, body, 0, [*pose, *path, task.rate, task.lever]


_Rows = Callable[[Any, Rooted], list[_Entry]]
_Whole = Callable[[Any, Rooted], _Entry | None]

ROWS: dict[type[Constraint], _Rows] = {
    PointOverPlane: _plane,
    PointsOverPlane: _planes,
    PointInCylinder: _cylinder,
    PointInsideWall: _wall,
    AxisLevel: _axis,
    ComInsideEdges: _edges,
    FrameHeld: _held,
}
"""Of constraints; several rows of one are several entries, one after the other, but for a frame held by six."""

TASKS: dict[type[Task], _Whole] = {
    ComOverFoot: _com_over_foot,
    FramePose: _frame_pose,
    Posture: _posture,
    ComPath: _com_path,
    SwingPath: _swing_path,
}
"""Of tasks; None where the table cannot hold one."""

HEIGHT = {COM_OVER_FOOT: 2, FRAME_POSE: 8, POSTURE: 0, COM_PATH: 2, SWING_PATH: 6}
"""Rows of J for each kind of task."""
