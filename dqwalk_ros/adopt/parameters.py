"""Derives the parameters of a walk from the robot, each with its value, the reason for it, and a confidence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.adopt.anatomy import Anatomy
from dqwalk_ros.adopt.posture import Standing
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.robot import Foot, RobotModel
from dqwalk_ros.stability import leg_inertia
from dqwalk_ros.statics import GRAVITY, gravity_torques

__all__ = [
    "Entry",
    "Numbers",
    "dynamic_parameters",
    "measure",
    "paper_parameters",
    "parameters",
    "robot_entries",
    "whole_body_parameters",
]

Array = NDArray[np.float64]

STIFFNESS = 5.0
"""Servo stiffness as a multiple of m g h; below 3 most robots fall."""
SHORTEST = 1.5
"""Shortest duration of a weight transfer from foot to foot [s]."""
FROUDE = 0.05
"""Speed of the dynamic walk divided by sqrt(g l), with the leg length l."""
REFERENCE = 0.46
"""Leg length at which the dynamic walk has the lengths and times of Poppy's [m]; Poppy's own hips are 0.42 m high."""


@dataclass(frozen=True)
class Entry:
    """One parameter with the reason for its value.

    Attributes
    ----------
    key : str
        Name, such as ``gait.step_length``.
    value : value
    reason : str
        Written as a comment beside the value.
    confidence : str
        ``sure``, ``likely`` or ``guess``.
    """

    key: str
    value: Any
    reason: str
    confidence: str = "sure"


@dataclass(frozen=True)
class Numbers:
    """Quantities from which the parameters are derived.

    Attributes
    ----------
    mass : float
        Mass of the robot, m [kg].
    height : float
        Height of the CoM above the soles, h [m].
    mgh : float
        m g h [N m/rad].
    inertia : float
        Inertia of a leg about its hip [kg m^2].
    torque : float
        Largest static torque in single support, as a fraction of the effort limit of the joint.
    joint : str
        The joint of `torque`.
    leg : float
        Height of the hips above the soles [m].
    width, length : float
        Size of a sole [m].
    apart : float
        Lateral distance of the soles' centres [m].
    step : float
        Step length [m].
    """

    mass: float
    height: float
    mgh: float
    inertia: float
    torque: float
    joint: str
    leg: float
    width: float
    length: float
    apart: float
    step: float

    @property
    def stiffness(self) -> float:
        """Stiffness of the servos, 5 m g h [N m/rad]."""
        return rounded(STIFFNESS * self.mgh)

    def damping(self, stiffness: float, ratio: float = 0.5) -> float:
        """Return the damping of servos divided by their `stiffness` [s] that gives a swinging leg a damping `ratio`."""
        return rounded(2.0 * ratio * math.sqrt(self.inertia / stiffness), 2)

    @property
    def margin(self) -> float:
        """Least distance of the CoM from the edges of a sole [m]."""
        return rounded(min(0.008, 0.15 * self.width))

    @property
    def transfer(self) -> float:
        """Duration of a weight transfer from foot to foot [s].

        On a minimum-jerk path of the duration T over the distance d, the largest acceleration of the CoM is
        5.78 d/T^2, and the distance of the CoP from the CoM is h/g times the acceleration. T is chosen such that this
        distance is 0.6 of the half width that the margin leaves.
        """
        half = max(0.5 * self.width - self.margin, 1e-3)
        needed = math.sqrt(5.78 * self.apart * self.height / (GRAVITY * 0.6 * half))
        return math.ceil(10.0 * max(SHORTEST, needed) - 1e-6) / 10.0


def rounded(value: float, digits: int = 3) -> float:
    """Return a number rounded to `digits` significant digits."""
    return float(f"{value:.{digits}g}")


def measure(model: RobotModel, anatomy: Anatomy, standing: Standing, single: Sequence[Array], step: float) -> Numbers:
    """Return the quantities from which the parameters are derived.

    Parameters
    ----------
    model : RobotModel
    anatomy : Anatomy
    standing : Standing
    single : sequence of ndarray, shape (n,)
        Postures with the CoM over the left and over the right sole [rad].
    step : float
        Step length [m].

    Returns
    -------
    Numbers
    """
    sole = model.soles[Foot.LEFT]
    height = float(standing.com[2])
    torque, joint = static_torque(model, anatomy, single)
    return Numbers(
        mass=model.mass,
        height=height,
        mgh=model.mass * GRAVITY * height,
        inertia=leg_inertia(model, Kinematics(model, standing.q, Foot.LEFT)),
        torque=torque,
        joint=joint,
        leg=anatomy.leg,
        width=sole.width,
        length=sole.length,
        apart=standing.width,
        step=step,
    )


def static_torque(model: RobotModel, anatomy: Anatomy, single: Sequence[Array]) -> tuple[float, str]:
    """Return the largest static torque on one foot as a fraction of the effort limit, and the name of its joint."""
    parts = {
        name: float(part)
        for foot, q in zip(Foot, single, strict=True)
        for name, part in zip(
            model.joint_names,
            np.abs(gravity_torques(Kinematics(model, q, foot), both=False)) / model.effort_max,
            strict=True,
        )
        if name in anatomy.legs[foot]
    }
    joint = max(parts, key=lambda name: parts[name])
    return parts[joint], joint


# ---------------------------------------------------------------------- the files


def robot_entries(
    model: RobotModel, anatomy: Anatomy, locked: dict[str, float], soles: dict[Foot, str], free: str
) -> list[Entry]:
    """Return the parameters of the section ``robot``; `free` describes the joints that move."""
    sole = model.soles[Foot.LEFT]
    return [
        Entry("robot.urdf", "robot.urdf", "repaired, with frames of the soles, in the folder of this file"),
        Entry("robot.pelvis", anatomy.pelvis, "link that carries both legs"),
        Entry(
            "robot.left_sole", soles[Foot.LEFT], anatomy.soles[Foot.LEFT].source, anatomy.soles[Foot.LEFT].confidence
        ),
        Entry(
            "robot.right_sole",
            soles[Foot.RIGHT],
            anatomy.soles[Foot.RIGHT].source,
            anatomy.soles[Foot.RIGHT].confidence,
        ),
        Entry(
            "robot.imu",
            anatomy.imu or anatomy.pelvis,
            "inertial sensor" if anatomy.imu else "no link is named like an inertial sensor",
        ),
        Entry(
            "robot.lock",
            [name if not angle else f"{name}={angle:.6g}" for name, angle in locked.items()] or [""],
            f"all joints except {free}; with an angle if zero is outside the limits",
        ),
        Entry("robot.sole_length", rounded(sole.length, 4), "largest rectangle in the foot"),
        Entry("robot.sole_width", rounded(sole.width, 4), "largest rectangle in the foot"),
    ]


def paper_parameters(numbers: Numbers, standing: Standing, anatomy: Anatomy) -> list[Entry]:
    """Return the parameters of the walk of Urban & Adorno."""
    return [
        Entry("gait.style", "paper", "Urban & Adorno"),
        Entry("gait.step_length", numbers.step, "0.09 of a leg"),
        Entry("gait.step_width", rounded(numbers.apart, 4), "distance of the soles"),
        Entry("dsp.sliding_radius", rounded(0.1 * numbers.leg), "0.1 of a leg"),
        Entry(
            "ssp.com_radius", rounded(max(0.5 * numbers.width, 0.6 * numbers.apart)), "reached before the feet slide"
        ),
        Entry("pelvis.height", rounded(0.7 * standing.pelvis), "0.7 of the standing height"),
    ]


def whole_body_parameters(
    model: RobotModel, anatomy: Anatomy, numbers: Numbers, standing: Standing, arms: dict[Foot, tuple[str, ...]]
) -> list[Entry]:
    """Return the parameters of the whole-body controller [Sherikov et al.].

    Lengths are those of the paper's robot, whose CoM is 0.73 m high, scaled with the height of the CoM, and times with
    the square root of that height.
    """
    size = float(standing.com[2]) / 0.73
    slow = math.sqrt(size)
    interval = rounded(0.005 * max(4, round(20.0 * slow)))  # a multiple of the control period
    posture = [
        f"{name}: {angle:.4f}" for name, angle in zip(model.joint_names, standing.q, strict=True) if abs(angle) > 5e-5
    ]
    most = model.effort_max[np.isfinite(model.effort_max)]
    scaled = "as the paper's robot, scaled by the height of the CoM"
    return [
        Entry("dt", 0.005, "200 Hz"),
        Entry("gait.first_support", "right", "as the paper's robot"),
        Entry("whole_body.torso", anatomy.torso, "link that carries the arms"),
        Entry("whole_body.hand", anatomy.hands[Foot.RIGHT], "end of the right arm"),
        Entry("whole_body.posture", posture, "soles level, knees bent by 9 % of the leg"),
        Entry(
            "whole_body.free",
            [*anatomy.legs[Foot.LEFT], *anatomy.legs[Foot.RIGHT], *arms[Foot.RIGHT]],
            "legs and right arm, which have separate tasks",
        ),
        Entry("whole_body.interval", interval, "as the paper's robot, scaled by the square root of the CoM's height"),
        Entry("whole_body.single_support", rounded(7.0 * interval), "seven intervals"),
        Entry("whole_body.double_support", interval, "one interval"),
        Entry("whole_body.first_double_support", rounded(3.0 * interval), "three intervals"),
        Entry("whole_body.feet_distance", rounded(numbers.apart, 4), "distance of the soles in the posture"),
        Entry("whole_body.cop_length", rounded(0.6 * numbers.length), "0.6 of the sole"),
        Entry("whole_body.cop_width", rounded(0.5 * numbers.width), "half of the sole"),
        Entry("whole_body.step_length", rounded(0.2 * size), scaled),
        Entry("whole_body.step_width_min", rounded(numbers.apart, 4), "distance of the soles in the posture"),
        Entry("whole_body.step_width_max", rounded(numbers.apart + 0.11 * size, 4), scaled),
        Entry("whole_body.step_height", rounded(0.07 * size), scaled),
        Entry("whole_body.hand_weight", 2.0, "twice that of the paper's robot: other arms are heavier", "guess"),
        Entry("whole_body.effort", rounded(float(most.max()) if most.size else 150.0), "largest limit of the URDF"),
    ]


def parameters(model: RobotModel, anatomy: Anatomy, numbers: Numbers, standing: Standing) -> list[Entry]:
    """Return the parameters of the standing walk, whose stiffness, damping and duration follow from `numbers`."""
    n = numbers
    small = min(1.0, n.leg / 0.4)
    posture = [
        f"{name}={angle:.4f}" for name, angle in zip(model.joint_names, standing.q, strict=True) if abs(angle) > 5e-5
    ]
    steps = max(10, math.ceil(0.6 / n.step))
    swing = 1.5
    speed = float(np.min([3.0, *model.velocity_max[np.isfinite(model.velocity_max)]]))
    roll, yaw = "R" in anatomy.kinds[-2:], "Y" in anatomy.kinds
    scale = 1.0 if n.torque * 1.3 <= 1.0 else rounded(1.5 * n.torque)
    return [
        Entry("dt", 0.005, "200 Hz"),
        Entry("gait.style", "standing", "the CoM stays over the true soles"),
        Entry("gait.steps", steps, "more than half a metre"),
        Entry("gait.step_length", n.step, "0.09 of a leg, within the reach of the legs"),
        Entry("gait.step_width", rounded(n.apart, 4), "distance of the soles in the posture"),
        Entry("gait.step_height", rounded(min(max(0.04 * n.leg, 0.008), 0.03)), "0.04 of a leg"),
        Entry("gait.most_length", rounded(1.2 * n.step), "longest step commanded by cmd_vel"),
        Entry(
            "gait.most_side", rounded(0.04 * n.leg) if roll else 0.0, "the ankles roll" if roll else "no ankle rolls"
        ),
        Entry("gait.most_turn", 0.1 if yaw else 0.0, "the hips yaw" if yaw else "no hip yaws"),
        Entry("gait.phase_timeout", rounded(4.0 * max(n.transfer, swing) + 4.0), "four times a phase"),
        Entry("task.eta", 2.0, "as for every robot"),
        Entry("task.damping", 0.03, "as for every robot"),
        Entry("task.posture_weight", 0.0002, "as for every robot"),
        Entry("pelvis.height", rounded(0.7 * standing.pelvis), "0.7 of the standing height"),
        Entry("standing.posture", posture, "soles level, knees bent by 4 % of the leg, CoM over the soles' middle"),
        Entry("standing.margin", n.margin, "8 mm, or 0.15 of the sole's width"),
        Entry("standing.pressure_margin", rounded(min(0.004, 0.07 * n.width)), "half of the margin"),
        Entry("standing.transfer_duration", n.transfer, "the CoP stays within the soles during the transfer"),
        Entry("standing.swing_duration", swing, "as for every robot"),
        Entry("standing.com_threshold", rounded(0.005 * small), "5 mm, less for a short leg"),
        Entry("standing.swing_threshold", rounded(0.003 * small), "3 mm, less for a short leg"),
        Entry("standing.saturation", rounded(0.03 * small), "3 cm, less for a short leg"),
        Entry("standing.lever", rounded(0.5 * n.leg), "half a leg"),
        Entry("standing.balance", 1.0, "as for every robot"),
        Entry("joints.eta", 5.0, "as for every robot"),
        Entry("joints.velocity", rounded(speed), "3 rad/s, or the slowest joint"),
        Entry("servo.stiffness", n.stiffness, f"5 m g h, m g h = {n.mgh:.4g} N m/rad", "guess"),
        Entry("servo.assumed_stiffness", n.stiffness, "equal to servo.stiffness, for gravity feedforward", "guess"),
        Entry(
            "servo.damping",
            n.damping(n.stiffness),
            f"a damping ratio of 0.5 for a leg of {n.inertia:.3g} kg m^2",
            "guess",
        ),
        Entry(
            "servo.torque_scale",
            scale,
            "the effort limits of the URDF"
            if scale == 1.0
            else f"{n.joint} needs {n.torque:.2g} times its effort limit of the URDF to stand on one foot",
            "likely" if scale == 1.0 else "guess",
        ),
        Entry("monitor.tolerance", 0.0001, "error of the Euler method at touchdown"),
    ]


def dynamic_parameters(anatomy: Anatomy, numbers: Numbers, damping: float) -> list[Entry]:
    """Return the parameters of the dynamic walk that differ from the standing walk.

    They are those of ``config/poppy_dynamic.yaml``, with lengths scaled by the leg and times by its square root.

    Parameters
    ----------
    anatomy : Anatomy
    numbers : Numbers
    damping : float
        ``servo.damping`` [s].
    """
    size = numbers.leg / REFERENCE
    slow = math.sqrt(size)
    single, double = rounded(0.4 * slow, 2), rounded(0.1 * slow, 2)
    speed = FROUDE * math.sqrt(GRAVITY * numbers.leg)
    step = rounded(speed * (single + double), 2)
    roll = "R" in anatomy.kinds[-2:]
    time, length = "as Poppy, scaled by the square root of the leg", "as Poppy, scaled by the leg"
    return [
        Entry("gait.style", "dynamic", "steps of a fixed duration, adjusted to the divergent component of motion"),
        Entry("gait.steps", 20, "about a metre for a small robot, three for a tall one"),
        Entry("gait.step_length", step, f"{speed:.2f} m/s, a Froude number of {FROUDE}"),
        Entry("gait.step_height", rounded(0.02 * size, 2), length),
        Entry("gait.most_length", rounded(1.2 * step, 2), "longest step commanded by cmd_vel"),
        Entry("gait.most_side", 0.0, "sideways steps are left to the standing walk"),
        Entry("task.eta", rounded(4.0 / slow, 2), time),
        Entry("standing.transfer_duration", double, time),
        Entry("standing.swing_duration", single, time),
        Entry("standing.balance", 0.7, "as Poppy"),
        Entry("standing.eta_feet", 10.0, "as Poppy"),
        Entry("standing.eta_edges", 20.0, "as Poppy"),
        Entry("standing.recovery", 0.1, "as Poppy"),
        Entry("standing.swing_weight", 30.0, "as Poppy"),
        Entry("standing.swing_rate", rounded(12.0 / slow, 2), time),
        Entry("dynamic.start_duration", rounded(0.6 * slow, 2), time),
        Entry("dynamic.stop_duration", rounded(slow, 2), time),
        Entry("dynamic.com_rate", rounded(2.0 / slow, 2), time),
        Entry("dynamic.height_rate", rounded(4.0 / slow, 2), time),
        Entry("dynamic.upright_rate", rounded(5.0 / slow, 2), time),
        Entry("dynamic.catch_margin", rounded(min(0.012 * size, 0.17 * numbers.width), 2), "0.17 of the sole's width"),
        Entry("dynamic.catch_beyond", rounded(0.01 * size, 2), length),
        Entry("dynamic.catch_length", rounded(0.1 * size, 2), length),
        Entry("dynamic.catch_side", rounded(0.05 * size, 2) if roll else 0.0, length if roll else "no ankle rolls"),
        Entry("dynamic.shortest_step", rounded(0.26 * slow, 2), time),
        Entry("dynamic.untouched", rounded(0.04 * slow, 2), time),
        Entry("dynamic.settled", rounded(0.12 * slow, 2), time),
        Entry("joints.eta", 10.0, "as Poppy"),
        Entry("joints.velocity", 6.0, "as Poppy"),
        Entry(
            "servo.assumed_lead", rounded(0.7 * damping, 2), "0.7 of servo.damping: more, and steps get long", "guess"
        ),
        Entry("qp.solver", "daqp", "the fastest"),
    ]
