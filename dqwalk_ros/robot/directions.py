"""Which way a joint moves what hangs on it, in words, for whoever turns it by hand and compares."""

from __future__ import annotations

import numpy as np

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array

_AXES = (("ahead", "back"), ("left", "right"), ("up", "down"))
_TURNS = (
    ("rolled to its right", "rolled to its left"),
    ("pitched down", "pitched up"),
    ("turned left", "turned right"),
)
"""Words of positive and negative components along x, y, z, and of rotations about them."""
_PART = 0.5
"""Part of a direction from which on a component of it is named."""
_LEVER = 0.3
"""Part of the distance from a joint to the CoM behind it that must be a lever; else the joint turns, as a yaw does."""


def motion(model: RobotModel, q: Array, joint: int, angle: float) -> str:
    """Return what a motion of a joint from the angles `q` (n,) [rad] does, seen from the pelvis.

    Parameters
    ----------
    joint : int
        Its index.
    angle : float
        By how much it was turned [rad]; only its sign matters.

    Returns
    -------
    str
        Such as ``l_shin moved back and up``: the CoM of all bodies that the joint carries, or ``spine turned left``
        where that is near the axis of the joint.
    """
    kin = Kinematics(model, q, Foot.LEFT)
    (moved,) = (k for k, body in enumerate(model.bodies) if body.joint == joint)
    carried = [k for k in range(len(model.bodies)) if moved in model.chain(k)]
    masses = np.array([max(model.bodies[k].mass, 1e-9) for k in carried])
    places = np.array([kin.point(model.links[k], model.bodies[k].com) for k in carried])
    to_pelvis = DQ(kin.pose(model.pelvis)).rotation_matrix().T
    link = model.links[moved]
    axis = to_pelvis @ kin.direction(link, model.bodies[moved].axis) * np.sign(angle)
    arm = to_pelvis @ (masses @ places / masses.sum() - kin.point(link))
    way = np.cross(axis, arm)
    part = next(name for name, frame in model.frames.items() if frame.body == moved)
    if (speed := float(np.linalg.norm(way))) < max(_LEVER * float(np.linalg.norm(arm)), 1e-4):
        k = int(np.abs(axis).argmax())
        return f"{part} {_TURNS[k][int(axis[k] < 0.0)]}"
    way = way / speed
    named = [_AXES[k][int(way[k] < 0.0)] for k in np.argsort(-np.abs(way)) if abs(way[k]) > _PART]
    return f"{part} moved {' and '.join(named)}"
