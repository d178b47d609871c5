"""Which way a joint moves what hangs on it, in words, for whoever turns it by hand and compares."""

from __future__ import annotations

import numpy as np

from dqwalk_ros.paper.dual_quaternions import DQ
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
    poses: list[DQ] = []
    for body in model.bodies:
        turn = [1.0, 0.0, 0.0, 0.0]
        if body.joint >= 0:
            half = 0.5 * q[body.joint]
            turn = [np.cos(half), *(np.sin(half) * body.axis)]
        here = DQ(body.origin) * DQ(np.array([*turn, 0.0, 0.0, 0.0, 0.0]))
        poses.append(poses[body.parent] * here if body.parent >= 0 else here)
    (moved,) = (k for k, body in enumerate(model.bodies) if body.joint == joint)
    carried = [k for k in range(len(poses)) if moved in model.chain(k)]
    masses = np.array([max(model.bodies[k].mass, 1e-9) for k in carried])
    places = np.array([poses[k].translation() + poses[k].rotation_matrix() @ model.bodies[k].com for k in carried])
    pelvis = model.frames[model.pelvis]
    to_pelvis = (poses[pelvis.body] * DQ(pelvis.pose)).rotation_matrix().T
    axis = to_pelvis @ poses[moved].rotation_matrix() @ model.bodies[moved].axis * np.sign(angle)
    arm = to_pelvis @ (masses @ places / masses.sum() - poses[moved].translation())
    way = np.cross(axis, arm)
    part = next(name for name, frame in model.frames.items() if frame.body == moved)
    if (speed := float(np.linalg.norm(way))) < max(_LEVER * float(np.linalg.norm(arm)), 1e-4):
        k = int(np.abs(axis).argmax())
        return f"{part} {_TURNS[k][int(axis[k] < 0.0)]}"
    way = way / speed
    named = [_AXES[k][int(way[k] < 0.0)] for k in np.argsort(-np.abs(way)) if abs(way[k]) > _PART]
    return f"{part} moved {' and '.join(named)}"
