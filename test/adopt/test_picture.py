"""The picture of a robot that is adopted."""

from __future__ import annotations

import numpy as np
from small_humanoid import SMALL, small_model

from dqwalk_ros.adopt.picture import _bones
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.robot.urdf import Urdf


def test_the_picture_has_the_bones_of_a_robot_without_meshes() -> None:
    model = small_model(Urdf.load(SMALL))
    kin = Kinematics(model, np.zeros(model.n), Foot.LEFT)
    bones = _bones(model, kin)
    assert len(bones) == model.n + 2  # to each joint, and to both soles
    thigh = next(bone for bone in bones if np.allclose(bone[1], kin.point("l_shank")))
    assert np.linalg.norm(thigh[0] - thigh[1]) > 0.1
