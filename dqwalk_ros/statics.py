"""The joint torques that hold a standing robot against gravity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.kinematics import Kinematics

__all__ = ["GRAVITY", "gravity_torques"]

Array = NDArray[np.float64]

GRAVITY = 9.80665
"""[m/s^2]"""


def gravity_torques(kin: Kinematics, *, both: bool) -> Array:
    """Return the joint torques of statics, shape (n,) [N m].

    Seen from the base sole the ground pushes the other sole with a part w of the weight, so that virtual work gives
    tau = M g up.(J_CoM - w J_p). With both feet on the ground w is where the CoM is on the way from sole to sole, and p
    lies as far from the other sole's centre as the CoM from the line between both.

    Parameters
    ----------
    kin : Kinematics
    both : bool
        Whether both feet are on the ground.
    """
    model, up = kin.model, kin.up
    tau: Array = up @ kin.com_jacobian
    if both:
        sole = model.soles[kin.base.other]
        a, b = model.soles[kin.base].center[:2], kin.point(sole.frame, sole.center)[:2]
        way, com = b - a, kin.com_on_ground
        share = float(np.clip((com - a) @ way / (way @ way), 0.0, 1.0))
        aside = com - (a + share * way)
        ahead = kin.direction(sole.frame, np.array([1.0, 0.0, 0.0]))[:2]
        half = 0.5 * sole.length
        point = sole.center + np.array([np.clip(aside @ ahead, -half, half), 0.0, 0.0])
        tau = tau - share * (up @ kin.point_jacobian(sole.frame, point))
    return model.mass * GRAVITY * tau
