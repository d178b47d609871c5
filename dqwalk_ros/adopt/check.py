"""Checks whether a configuration fits its robot before the first step."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import Z, angle_of
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.statics import gravity_torques
from dqwalk_ros.plants.base import stands_still
from dqwalk_ros.plants.table import entry, make_plant
from dqwalk_ros.robot.model import RobotModel, find_urdf
from dqwalk_ros.robot.servos import Servos
from dqwalk_ros.robot.shapes import Shapes
from dqwalk_ros.robot.standing_limits import Finding, servo_findings
from dqwalk_ros.robot.urdf import Urdf
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.walks.dynamic.upright import leans
from dqwalk_ros.walks.footsteps import Carried, Footsteps
from dqwalk_ros.walks.stepping import SteppingWalk
from dqwalk_ros.walks.table import make_controller, make_walk

_BELOW = 0.012
"""Largest distance of a foot below its sole [m]."""
_LEVEL = math.radians(2.0)
"""Largest angle between two parallel soles [rad]."""
_SMALLEST = 0.01
"""Least side of a sole [m]."""
_BESIDE = 0.15
"""Largest distance of the CoM from the middle of the soles to a side, as a fraction of their distance. With a load in
one hand Poppy's dynamic walk stands 20 of 20 times with 0.12, 19 with 0.148, and none with 0.20."""
_UPRIGHT = math.radians(20.0)
"""Largest angle of the pelvis' z axis to the vertical in the posture [rad]."""
_REACHED = 0.9
"""Least length of a step within the reach of the legs, as a fraction of the wanted length."""
_TORQUE = 1.3
"""Least torque limit, as a multiple of the static torque on one foot."""


def check(config: Config, model: RobotModel) -> list[Finding]:
    """Return the parameters that do not fit the robot; an empty list if all fit.

    Posture, soles and capsules of free arms are checked; without such problems, for the standing and the dynamic walk
    also torques, steps and whether the CoM is between the soles, and for the standing walk the CoM and servos.
    """
    q = model.posture(config.standing.posture)
    found = [Finding(why, "")] if (why := stands_still(config)) else []
    found += [*_posture(config, model, q), *_soles(config, model, q)]
    if config.arms.joints and not config.collision.pairs:
        text = "nothing keeps the free arms from the body; `dqwalk config FILE --capsules` prints pairs and capsules"
        found.append(Finding(text, "collision.pairs, collision.capsules"))
    if found or config.gait.style == "paper":
        return found
    if config.gait.style == "standing":
        found += [*_com(config, model, q), *servo_findings(config, model)]
    found += [*_com_beside(model, q), *_torque(config, model, q)]
    return [*found, *_step(config, model, q)]


def require_usable(config: Config, model: RobotModel) -> None:
    """Check that a walk has a first command, and that there is its plant, so that what can be checked can be used.

    Raises
    ------
    DqwalkError
        As `walks.table.make_controller`, `VelocityController.step` and `plants.table.entry`.
    """
    controller = make_controller(config, model)
    controller.step(make_plant("integrator", config, model).state, config.dt)
    if config.plant.name:
        entry(config.plant.name)


def _posture(config: Config, model: RobotModel, q: Array) -> Iterator[Finding]:
    outside = [k for k in range(model.n) if not model.q_min[k] - 1e-6 <= q[k] <= model.q_max[k] + 1e-6]
    for k in outside:
        yield Finding(
            f"the walk begins with '{model.joint_names[k]}' at {q[k]:.3f} rad, outside its limits of "
            f"{model.q_min[k]:.3f} and {model.q_max[k]:.3f} rad",
            "standing.posture",
        )


def _soles(config: Config, model: RobotModel, q: Array) -> Iterator[Finding]:
    """Check that left and right are not exchanged, and that the soles point forward, are level and below the feet."""
    kin = Kinematics(model, q, Foot.LEFT)
    left, right = (model.soles[foot] for foot in Foot)
    other = DQ(kin.pose(right.frame))
    p = kin.point(right.frame, right.center) - left.center
    if p[1] >= 0.0:
        yield Finding(
            f"the right sole is {1e3 * p[1]:.0f} mm to the left of the left sole: left and right are exchanged, or "
            "the soles point backward",
            "robot.left_sole, robot.right_sole",
        )
    R = other.rotation_matrix()
    tilt = angle_of(R[2, 2])
    if tilt > _LEVEL:
        text = f"the soles are not parallel in the posture: the angle between them is {math.degrees(tilt):.1f} degrees"
        yield Finding(text, "robot.left_sole_rpy, robot.right_sole_rpy")
    elif abs(p[2]) > 0.005:
        yield Finding(
            f"one sole is {1e3 * abs(p[2]):.1f} mm higher than the other in the posture",
            "standing.posture, robot.left_sole_xyz, robot.right_sole_xyz",
        )
    turn = math.atan2(R[1, 0], R[0, 0])
    if abs(turn) > math.radians(15.0):
        text = f"the forward directions of the soles differ by {math.degrees(abs(turn)):.0f} degrees"
        yield Finding(text, "robot.left_sole_rpy, robot.right_sole_rpy")
    if (least := min(left.length, left.width, right.length, right.width)) < _SMALLEST:
        text = f"a sole has a side of {1e3 * least:.0f} mm; a walk needs flat feet"
        yield Finding(text, "robot.sole_length, robot.sole_width")
    lean = angle_of(kin.direction(model.pelvis, Z)[2])
    if lean > _UPRIGHT:
        yield Finding(
            f"z of the pelvis '{model.pelvis}' is {math.degrees(lean):.0f} degrees off the vertical in the posture: "
            "the dynamic walk keeps it vertical",
            "robot.pelvis",
        )
    if kin.point(model.pelvis)[2] < 0.0:
        yield Finding("the pelvis is below the soles: they are upside down", "robot.left_sole_rpy")
    yield from _within_feet(config, model)


def _within_feet(config: Config, model: RobotModel) -> Iterator[Finding]:
    """Check that no foot extends below its sole, and that the centre of each sole is not beside its foot."""
    shapes = Shapes(Urdf(model.urdf, model.name), find_urdf(config.robot.urdf))
    for foot, sole in model.soles.items():
        frame = model.frames[sole.frame]
        to_sole = DQ(frame.pose).conj()
        links = [name for name, other in model.frames.items() if other.body == frame.body]
        hulls, _ = shapes.hulls(links)
        found = [(to_sole * DQ(model.frames[name].pose)).transform_point(corners) for name, corners in hulls.items()]
        unread = next((f"'{mesh}' {why}" for mesh, why in shapes.missing.items()), "")
        if not found and unread:
            text = f"no shape of the {foot.value} foot can be read, so its sole is not checked: {unread}"
            yield Finding(text, "robot.urdf")
        if not found:
            continue
        corners, where = np.concatenate(found), f"robot.{foot.value}_sole, robot.{foot.value}_sole_xyz"
        (*low, lowest), (*high, _) = corners.min(axis=0), corners.max(axis=0)
        beside = np.maximum(np.maximum(low - sole.center[:2], sole.center[:2] - high), 0.0).max()
        if lowest < -_BELOW:
            yield Finding(f"the {foot.value} foot reaches {-1e3 * float(lowest):.0f} mm below its sole", where)
        if beside > 0.0:
            text = f"the centre of the {foot.value} sole is {1e3 * float(beside):.0f} mm beside the shapes of its foot"
            yield Finding(text, where)


def _com(config: Config, model: RobotModel, q: Array) -> Iterator[Finding]:
    """Check that the CoM of the posture is over the soles."""
    kin = Kinematics(model, q, Foot.LEFT)
    left, right = (model.soles[foot] for foot in Foot)
    middle = 0.5 * (left.center + kin.point(right.frame, right.center))
    deviation = float(kin.com[0] - middle[0])
    room = 0.5 * left.length - config.standing.margin
    if abs(deviation) > room:
        where = "ahead of" if deviation > 0.0 else "behind"
        yield Finding(
            f"the CoM of the posture is {1e3 * abs(deviation):.0f} mm {where} the middle of the soles, more than "
            f"{1e3 * room:.0f} mm: the knees bend the wrong way, the soles point backward, or the posture is wrong",
            "standing.posture",
        )


def _com_beside(model: RobotModel, q: Array) -> Iterator[Finding]:
    """Check that the CoM of the posture is between the soles, such as with a load in one hand."""
    kin = Kinematics(model, q, Foot.LEFT)
    left, right = (model.soles[foot] for foot in Foot)
    other = kin.point(right.frame, right.center)
    deviation, apart = float(kin.com[1] - 0.5 * (left.center + other)[1]), abs(float(left.center[1] - other[1]))
    if abs(deviation) > _BESIDE * apart:
        side = "left" if deviation > 0.0 else "right"
        text = (
            f"the CoM of the posture is {1e3 * abs(deviation):.0f} mm to the {side} of the middle of the soles; a walk "
            f"stands up to {1e3 * _BESIDE * apart:.0f} mm: lean the trunk away from what is heavy, or carry it in front"
        )
        yield Finding(text, "standing.posture, robot.payload")


def _step(config: Config, model: RobotModel, q: Array) -> Iterator[Finding]:
    """Check that the legs reach a step: the walk moves each footprint to the nearest one that they reach."""
    length = config.gait.step_length
    walk = make_walk(config, model) if config.gait.style == "dynamic" else None  # it carries the CoM less far
    steps = walk.footsteps if isinstance(walk, SteppingWalk) else Footsteps(config, model, q)
    if why := steps.not_beside():
        yield Finding(why, "gait.step_width", "step")
        return
    reached, stuck = steps.reach(length)
    if abs(reached) < _REACHED * abs(length):
        why = f": {', '.join(stuck)} at the limit" if stuck else ""
        yield Finding(
            f"the legs reach steps of {1e3 * reached:.0f} mm instead of {1e3 * length:.0f} mm{why}",
            "gait.step_length",
            "step",
        )


def _torque(config: Config, model: RobotModel, q: Array) -> Iterator[Finding]:
    """Check that all joints are strong enough to stand on one foot."""
    kin = Kinematics(model, q, Foot.LEFT)
    carried = Carried((0.5, 0.5), float(kin.com[2])) if leans(kin) else None
    over = Footsteps(config, model, q, carried).nearest(Foot.LEFT, kin.pose(kin.swing)).posture
    tau = np.abs(gravity_torques(Kinematics(model, over, Foot.LEFT), both=False))
    limit = Servos.of(config, model).torque
    worst = int(np.argmax(tau / limit))
    if tau[worst] * _TORQUE <= limit[worst]:
        return
    text = (
        f"'{model.joint_names[worst]}' needs about {tau[worst]:.3g} N m to stand on one foot; its limit is "
        f"{limit[worst]:.3g} N m and should be at least {_TORQUE} times the needed torque"
    )
    yield Finding(text, "servo.torque_scale, the effort limits of the URDF", "torque")
