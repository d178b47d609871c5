"""Whether a configuration fits its robot: what can be known of a standing walk before the first step."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.robot import Foot, RobotModel, find_urdf
from dqwalk_ros.servos import Servos
from dqwalk_ros.shapes import Shapes
from dqwalk_ros.stability import Finding, servo_findings
from dqwalk_ros.statics import gravity_torques
from dqwalk_ros.urdf import Urdf

__all__ = ["Finding", "check"]

Array = NDArray[np.float64]

_BELOW = 0.012
"""No part of a foot is further below its sole [m]."""
_LEVEL = math.radians(2.0)
"""Soles that lean more against each other are not parallel [rad]."""
_TORQUE = 1.3
"""Least torque limit, in units of the torque that stands on one foot."""


def check(config: Config, model: RobotModel) -> list[Finding]:
    """Return what does not fit.

    Parameters
    ----------
    config : Config
    model : RobotModel
    """
    q = model.posture(config.standing.posture)
    found = [*_posture(config, model, q), *_soles(config, model, q)]
    if config.gait.style == "standing" and not found:
        found += [*_com(config, model, q), *servo_findings(config, model), *_torque(config, model, q)]
    return found


def _posture(config: Config, model: RobotModel, q: Array) -> list[Finding]:
    outside = [k for k in range(model.n) if not model.q_min[k] - 1e-6 <= q[k] <= model.q_max[k] + 1e-6]
    return [
        Finding(
            f"the walk begins with '{model.joint_names[k]}' at {q[k]:.3f} rad, and its limits are "
            f"{model.q_min[k]:.3f} and {model.q_max[k]:.3f}",
            "standing.posture",
        )
        for k in outside
    ]


def _soles(config: Config, model: RobotModel, q: Array) -> list[Finding]:
    """Return what is wrong with the soles: left is left, both look ahead, level, and are where the feet end."""
    kin = Kinematics(model, q, Foot.LEFT)
    left, right = (model.soles[foot] for foot in Foot)
    other = DQ(kin.pose(right.frame))
    out = []
    p = kin.point(right.frame, right.center) - left.center
    if p[1] >= 0.0:
        out.append(
            Finding(
                f"the right sole is {1e3 * p[1]:.0f} mm to the left of the left one: left and right are exchanged, or "
                "the soles look back",
                "robot.left_sole, robot.right_sole",
            )
        )
    R = other.rotation_matrix()
    tilt = math.acos(min(1.0, float(R[2, 2])))
    if tilt > _LEVEL:
        text = f"the soles are not parallel in the posture: {math.degrees(tilt):.1f} degrees apart"
        out.append(Finding(text, "robot.left_sole_rpy, robot.right_sole_rpy"))
    elif abs(p[2]) > 0.005:
        out.append(
            Finding(
                f"one sole is {1e3 * abs(p[2]):.1f} mm higher than the other in the posture",
                "standing.posture, robot.left_sole_xyz, robot.right_sole_xyz",
            )
        )
    turn = math.atan2(R[1, 0], R[0, 0])
    if abs(turn) > math.radians(15.0):
        text = f"the soles look {math.degrees(abs(turn)):.0f} degrees apart"
        out.append(Finding(text, "robot.left_sole_rpy, robot.right_sole_rpy"))
    if kin.point(model.pelvis)[2] < 0.0:
        out.append(Finding("the pelvis is below the soles: they look down", "robot.left_sole_rpy"))
    return out + _lowest(config, model)


def _lowest(config: Config, model: RobotModel) -> list[Finding]:
    """Return how far a foot reaches below its sole."""
    shapes = Shapes(Urdf(model.urdf, model.name), find_urdf(config.robot.urdf))
    out = []
    for foot, sole in model.soles.items():
        frame = model.frames[sole.frame]
        to_sole = DQ(frame.pose).conj()
        links = [name for name, other in model.frames.items() if other.body == frame.body]
        for which in ("collisions", "visuals"):
            found = [
                (to_sole * DQ(model.frames[name].pose)).transform_point(surface.vertices)[:, 2].min()
                for name in links
                for surface in shapes.of(name, which)
            ]
            if found:
                break
        unread = next((f"'{mesh}' {why}" for mesh, why in shapes.missing.items()), "")
        if not found and unread:
            text = f"no shape of the {foot.value} foot can be read, so its sole is not checked: {unread}"
            out.append(Finding(text, "robot.urdf"))
        if found and min(found) < -_BELOW:
            out.append(
                Finding(
                    f"the {foot.value} foot reaches {-1e3 * float(min(found)):.0f} mm below its sole",
                    f"robot.{foot.value}_sole, robot.{foot.value}_sole_xyz",
                )
            )
    return out


def _com(config: Config, model: RobotModel, q: Array) -> list[Finding]:
    """Return how far the CoM of the posture is from the middle of the soles."""
    kin = Kinematics(model, q, Foot.LEFT)
    left, right = (model.soles[foot] for foot in Foot)
    middle = 0.5 * (left.center + kin.point(right.frame, right.center))
    off = float(kin.com[0] - middle[0])
    room = 0.5 * left.length - config.standing.margin
    if abs(off) > room:
        where = "ahead of" if off > 0.0 else "behind"
        return [
            Finding(
                f"the CoM of the posture is {1e3 * abs(off):.0f} mm {where} the soles' middle, and they reach "
                f"{1e3 * room:.0f} mm: knees that bend the wrong way, soles that look back, or another posture",
                "standing.posture",
            )
        ]
    return []


def _torque(config: Config, model: RobotModel, q: Array) -> list[Finding]:
    """Return whether a joint is too weak to stand on one foot."""
    over = Kinematics(model, _over_left(model, q), Foot.LEFT)
    tau = np.abs(gravity_torques(over, both=False))
    limit = Servos.of(config, model).torque
    worst = int(np.argmax(tau / limit))
    if tau[worst] * _TORQUE <= limit[worst]:
        return []
    text = (
        f"'{model.joint_names[worst]}' needs about {tau[worst]:.3g} N m to stand on one foot and has "
        f"{limit[worst]:.3g}; {_TORQUE} times as much is the least"
    )
    return [Finding(text, "servo.torque_scale, the effort limits of the URDF", "torque")]


def _over_left(model: RobotModel, q: Array) -> Array:
    """Return a posture near `q` whose CoM is over the left sole, the right one where it is (Gauss and Newton)."""
    right, center = model.soles[Foot.RIGHT].frame, model.soles[Foot.LEFT].center[:2]
    there = DQ(Kinematics(model, q, Foot.LEFT).pose(right))
    for _ in range(30):
        kin = Kinematics(model, q, Foot.LEFT)
        off = DQ(kin.pose(right)) * there.conj()
        turned = 2.0 * off.vec8()[1:4] * np.copysign(1.0, off.vec8()[0])
        e = np.concatenate([kin.point(right) - there.translation(), turned, kin.com[:2] - center])
        J = np.concatenate([kin.point_jacobian(right), kin.angular_jacobian(right), kin.com_jacobian[:2]])
        q = np.clip(q - J.T @ np.linalg.solve(J @ J.T + 1e-6 * np.eye(8), e), model.q_min, model.q_max)
    return q
