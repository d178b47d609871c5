"""The links that a walk needs beside those of a description: root, pelvis and soles with x forward and z up."""

from __future__ import annotations

import numpy as np

from dqwalk_ros.adopt.anatomy import Anatomy
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.robot.urdf import Urdf, zero_pose

_ALIGNED = 1e-6
"""Largest angle between the axes of the pelvis or the root and those of the robot that counts as none [rad]."""
_HIGH = 0.4, 1.6
"""Least and largest height of the origin of pelvis and root above the soles, as fractions of that of the hips."""


def add_body_frames(urdf: Urdf, anatomy: Anatomy) -> str:
    """Add a root link, and a pelvis between the hips with x forward and z up, to a description that lacks them.

    The name of the pelvis is returned. Where a description has the origins and the axes of these links is arbitrary;
    heights and directions are not.
    """
    hips = anatomy.hips

    def serves(x: DQ) -> bool:
        """Return whether a pose in the root link has the axes of the robot and is not far from the hips."""
        off = hips.conj() * x
        high = anatomy.leg + float(off.translation()[2])
        upright = float(np.linalg.norm(off.rotation_vector())) < _ALIGNED
        return upright and _HIGH[0] * anatomy.leg < high < _HIGH[1] * anatomy.leg

    pelvis, old, others = anatomy.pelvis, urdf.root, dict(urdf.joints)
    if not serves(zero_pose(urdf, pelvis)):
        pelvis = "dqwalk_pelvis"
        urdf.add_frame(pelvis, anatomy.pelvis, zero_pose(urdf, anatomy.pelvis).conj() * hips)
        others = dict(urdf.joints)
    if not serves(DQ(1.0)):
        urdf.joints.clear()
        urdf.add_frame("dqwalk_root", old, hips.conj())
        (joint,) = urdf.joints.values()
        joint.parent, joint.child = "dqwalk_root", old
        urdf.joints.update(others)
    return pelvis


def add_soles(urdf: Urdf, anatomy: Anatomy) -> dict[Foot, str]:
    """Add the frames of the soles; their names are returned."""
    names = {foot: f"dqwalk_{foot.value}_sole" for foot in Foot}
    for foot, sole in anatomy.soles.items():
        urdf.add_frame(names[foot], sole.link, sole.pose)
    return names
