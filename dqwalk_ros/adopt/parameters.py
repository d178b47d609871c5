"""Derives the parameters of a walk from the robot, each with its value, the reason for it, and a confidence."""

from __future__ import annotations

import dataclasses
import fnmatch
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dqwalk_ros.adopt.anatomy import Anatomy
from dqwalk_ros.adopt.mjcf import MjcfDrive
from dqwalk_ros.adopt.posture import Standing, leg_axes
from dqwalk_ros.adopt.skeleton import Entry
from dqwalk_ros.config import Config
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.statics import GRAVITY, gravity_torques
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.standing_limits import leg_inertia
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.walks.footsteps import Carried, Footsteps

STIFFEST_FALL = 3.0
"""Servo stiffness as a multiple of m g h below which most robots fall."""
STIFFNESS = 5.0
"""Servo stiffness as a multiple of m g h; below 3 most robots fall."""
RESERVE = 1.3
"""Least effort limit of a joint, as a multiple of the torque that it needs to stand on one foot."""
PRESSURE = 0.25, 0.35
"""How far the ankles must be able to move the pressure from the middle of a sole, in parts of its length and width."""
SHORTEST = 1.5
"""Shortest duration of a weight transfer from foot to foot [s]."""
LONGEST = 0.09
"""Step length of the standing walk as a fraction of the leg."""
LEAST = 0.01
"""Length of a step, as a fraction of the leg, below which a robot does not walk."""
MOST_STEPS = 30
"""Largest number of steps of the standing walk."""
YIELDING = 0.03
"""Torque with which a leg resists a force that is not fed forward in the dynamic walk, as a part of m g h."""
FAR = 3.2
"""Planned length of the dynamic walk [m]: at least three metres with steps that are 6 % too short."""
FROUDE = 0.05
"""Speed of the dynamic walk divided by sqrt(g l), with the leg length l."""
SINGLE, DOUBLE = 0.4, 0.1
"""Durations of single and double support of the dynamic walk with a leg of the length `REFERENCE` [s]."""
SHORTEST_DOUBLE = 0.05
"""Least duration of a double support [s], the bound of ``standing.transfer_duration``."""
ROTOR = 0.03
"""Inertia of a servo's rotor times its no-load speed, divided by its stall torque [s]; 0.01 to 0.09 in the table."""
UNKNOWN = 0.5, 6.0
"""Stall torque, as a part of m g h, and no-load speed [rad/s] of servos without limits in the description."""
ASSUMED = 0.75
"""Assumed damping of the servos, as a part of theirs: with 0.6 stiff legs tremble, with 1 their commands alternate."""
HEAVY_LEGS = 0.65
"""Part of the robot's mass above which legs are too heavy for the dynamic walk, that of a pendulum on light legs."""
CLIMBED, AHEAD, LATER = 0.11, 1.1, 1.25
"""Height of a step that is climbed by touch as a part of the leg, length of the step onto it as one of the sole, and
duration of the swing as one of that on the level."""
HIGHEST = 0.1
"""Largest height of such a step [m]."""
_STAIR = 1.5
"""Height from which a step is a stair, as a multiple of ``gait.footstep_tolerance``."""
PACES = 1.0, 0.85, 0.7
"""Durations of a step of the dynamic walk, as parts of the usual one; quicker steps let a trunk lean less."""
LEAN, MOST_LEAN = 0.2, 0.35
"""Angles by which a trunk leans in usual steps, and at most [rad]."""
_HIP = 0.8
"""Part of the range of the hips' rolls in which it leans."""
START, QUICK_START = 0.6, 0.4
"""Duration of the start of the dynamic walk, and that of a robot whose trunk leans the less for it [s]."""
REFERENCE = 0.46
"""Leg length at which the dynamic walk has the lengths and times of Poppy's [m]; Poppy's own hips are 0.42 m high."""


@dataclass(frozen=True)
class Numbers:
    """Quantities from which the parameters are derived."""

    model: RobotModel
    anatomy: Anatomy
    standing: Standing
    torque: float
    """Largest static torque in single support, as a fraction of the effort limit of the joint."""
    joint: str
    """The joint of `torque`."""
    weak: Mapping[str, float]
    """Joints of the legs whose effort limits are too small to walk, with limits to assume [N m]."""
    reach: float
    """Length of the longest step within the reach of the legs, of those up to `LONGEST` legs [m]."""
    stuck: tuple[str, ...]
    """The joints at a limit in this step."""
    hindrance: str = ""
    """Why no standing walk is possible; empty if one may be."""

    @classmethod
    def of(cls, model: RobotModel, anatomy: Anatomy, standing: Standing) -> Numbers:
        """Return the quantities of a robot that stands in the posture `standing`."""
        config = Config().updated({"gait.step_width": rounded(anatomy.apart, 4)})
        carried = None if anatomy.lean is None else Carried((0.5, 0.5), float(standing.com[2]))
        steps, length = Footsteps(config, model, standing.q, carried), LONGEST * anatomy.leg
        limits = dict(zip(model.joint_names, model.effort_max.tolist(), strict=True))
        needed, turning = dict[str, float](), dict[str, float]()
        for foot in Foot:
            kin = Kinematics(model, standing.q, foot)
            q = steps.nearest(foot, kin.pose(kin.swing)).posture
            torques = np.abs(gravity_torques(Kinematics(model, q, foot), both=False)).tolist()
            known = zip(model.joint_names, torques, strict=True)
            needed |= {name: torque for name, torque in known if name in anatomy.legs[foot]}
            turning |= _turning(Kinematics(model, q, foot), anatomy)
        parts = {name: torque / limits[name] for name, torque in needed.items()}
        joint = max(parts, key=lambda name: parts[name])
        reach, stuck = steps.reach(length)
        while reach < 0.95 * length and length > 1e-3:  # a step that is wanted longer may end shorter
            length = max(reach, 0.5 * length)
            reach, again = steps.reach(length)
            stuck = again or stuck
        weak = _weak(model, anatomy, limits, needed, turning)
        return cls(model, anatomy, standing, parts[joint], joint, weak, reach, stuck)

    @property
    def height(self) -> float:
        """Height of the CoM above the soles, h [m]."""
        return float(self.standing.com[2])

    @property
    def mgh(self) -> float:
        """M g h [N m/rad]."""
        return self.model.mass * GRAVITY * self.height

    @cached_property
    def inertia(self) -> float:
        """Inertia of a leg about its hip [kg m^2]."""
        return leg_inertia(self.model, Kinematics(self.model, self.standing.q, Foot.LEFT))

    @cached_property
    def legs(self) -> float:
        """Mass of both legs, as a part of that of the robot."""
        joints = {self.model.joint_names.index(name) for names in self.anatomy.legs.values() for name in names}
        bodies = [
            body
            for b, body in enumerate(self.model.bodies)
            if joints & {self.model.bodies[k].joint for k in self.model.chain(b)}
        ]
        return sum(body.mass for body in bodies) / self.model.mass

    @property
    def width(self) -> float:
        """Width of a sole [m]."""
        return self.model.soles[Foot.LEFT].width

    @property
    def step(self) -> float:
        """Step length: 0.09 of a leg, or 0.9 of what the legs reach, in whole millimetres, or else `LEAST` legs [m]."""
        length = LONGEST * self.anatomy.leg
        reached = length if self.reach > 0.99 * length else 0.9 * self.reach
        return max(math.floor(reached * 1e3 + 1e-6) / 1e3, LEAST * self.anatomy.leg)

    @property
    def step_reason(self) -> str:
        """What determines the step length."""
        if self.reach > 0.99 * LONGEST * self.anatomy.leg:
            return "0.09 of a leg, within the reach of the legs"
        return f"0.9 of the reach of the legs: {', '.join(self.stuck) or 'they'} cannot move farther"

    @property
    def stiffness(self) -> float:
        """Stiffness of the servos, 5 m g h [N m/rad]."""
        return rounded(STIFFNESS * self.mgh)

    @cached_property
    def armature(self) -> float:
        """Inertia of the rotors, seen from the joints [kg m^2]: that of every robot, or less for weak, fast servos."""
        usual, model = Config().servo.armature, self.model
        legs = [model.joint_names.index(name) for names in self.anatomy.legs.values() for name in names]
        known = [k for k in legs if math.isfinite(model.effort_max[k] + model.velocity_max[k])]
        ratios = [float(model.effort_max[k] / model.velocity_max[k]) for k in known]
        ratio = float(np.median(ratios)) if ratios else UNKNOWN[0] * self.mgh / UNKNOWN[1]
        return rounded(min(usual, ROTOR * ratio), 2)

    def damping(self, stiffness: float, ratio: float, armature: float) -> float:
        """Return the damping of servos divided by their `stiffness` [s] that gives a swinging leg a damping `ratio`.

        The `armature` of the servos [kg m^2] swings with the leg; that of a small robot is the larger part.
        """
        return rounded(2.0 * ratio * math.sqrt((self.inertia + armature) / stiffness), 2)

    @property
    def pace(self) -> float:
        """Duration of a step of the dynamic walk, as a part of the usual one."""
        lean = self.anatomy.lean
        most = min(LEAN, _HIP * lean.most) if lean is not None else LEAN
        return next((pace for pace in PACES if self.leaning(pace) <= most), PACES[-1])

    def leaning(self, pace: float) -> float:
        """Return by how much the trunk leans in a dynamic walk [rad]; 0 if it need not."""
        anatomy = self.anatomy
        if anatomy.lean is None:
            return 0.0
        single = pace * SINGLE * math.sqrt(anatomy.leg / REFERENCE)
        return anatomy.lean.angle(anatomy.apart, self.height, single)

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
        needed = math.sqrt(5.78 * self.anatomy.apart * self.height / (GRAVITY * 0.6 * half))
        return math.ceil(10.0 * max(SHORTEST, needed) - 1e-6) / 10.0


def _turning(kin: Kinematics, anatomy: Anatomy) -> dict[str, float]:
    """Return the torques of the joints of the stance leg that keep a body from turning while the other swings [N m].

    The bodies of the swinging leg, as point masses, are accelerated ahead in proportion to their depth below the hip,
    the sole as on a minimum-jerk path over two steps of the dynamic walk, 5.78 d/T^2 at most: their moment about the
    vertical at the stance hip is carried by the vertical parts of the axes.
    """
    model, size = kin.model, anatomy.leg / REFERENCE
    ahead = 2.0 * FROUDE * math.sqrt(GRAVITY * anatomy.leg) * (SINGLE + DOUBLE) * math.sqrt(size)
    acceleration = 5.78 * ahead / (SINGLE**2 * size)
    of = {model.joint_names[body.joint]: b for b, body in enumerate(model.bodies) if body.joint >= 0}
    stance, swing = anatomy.legs[kin.base], anatomy.legs[kin.base.other]
    hip, other = (kin.point(model.links[of[leg[0]]]) for leg in (stance, swing))
    moment = 0.0
    for b in (of[name] for name in swing):
        _, y, z = kin.point(model.links[b], model.bodies[b].com)
        moment += model.bodies[b].mass * acceleration * (other[2] - z) / anatomy.leg * abs(y - hip[1])
    axes = {name: kin.direction(model.links[of[name]], model.bodies[of[name]].axis) for name in stance}
    return {name: moment * abs(float(axis[2])) for name, axis in axes.items()}


def _weak(
    model: RobotModel,
    anatomy: Anatomy,
    limits: Mapping[str, float],
    needed: Mapping[str, float],
    turning: Mapping[str, float],
) -> dict[str, float]:
    """Return the joints of both legs that are too weak, with effort limits to assume [N m]; see `Numbers`.

    A joint needs `RESERVE` times the larger of the torques `needed` to stand on one foot and `turning` to keep the body
    from turning [N m], and each joint below the knee what moves the pressure by the parts `PRESSURE` of the sole from
    its middle. Other joints of the legs with the same limit as one that is too weak are taken to be too weak, too.
    """
    sole, load, out = model.soles[Foot.LEFT], model.mass * GRAVITY, dict[str, float]()
    arms = np.array([PRESSURE[1] * sole.width, PRESSURE[0] * sole.length, 0.0])
    moving = {
        model.joint_names[k]: load * float(np.abs(axis) @ arms)
        for joints, axes, leg in leg_axes(model, anatomy)
        for k, axis in zip(joints[leg.knee + 1 :], axes[leg.knee + 1 :], strict=True)
    }
    for pair in zip(*anatomy.legs.values(), strict=True):
        standing, pressing = max(needed[name] for name in pair), max(moving.get(name, 0.0) for name in pair)
        standing = max(standing, *(turning[name] for name in pair))
        if min(limits[name] for name in pair) < max(RESERVE * standing, pressing):
            out |= {name: max(limits[name], rounded(max(1.5 * standing, pressing))) for name in pair}
    assumed = {limit: max(out[name] for name in out if limits[name] == limit) for limit in map(limits.get, out)}
    alike = {name: assumed[limits[name]] for leg in anatomy.legs.values() for name in leg if limits[name] in assumed}
    return out | alike


def com_threshold(leg: float) -> float:
    """Return the distance of the CoM from its goal at which a phase of the standing walk ends [m], for a leg length."""
    return rounded(0.005 * min(1.0, leg / 0.4))


def rounded(value: float, digits: int = 3) -> float:
    """Return a number rounded to `digits` significant digits."""
    return float(f"{value:.{digits}g}")


# ---------------------------------------------------------------------- the files


def robot_entries(model: RobotModel, anatomy: Anatomy, lock: Sequence[str], free: str) -> list[Entry]:
    """Return the parameters of the section ``robot``; `free` describes the joints that are not in `lock`."""
    sole, found = model.soles[Foot.LEFT], anatomy.soles
    sensor = "inertial sensor" if anatomy.imu else "no link is named like an inertial sensor"
    return [
        Entry("robot.urdf", "robot.urdf", "repaired, with frames of the soles, in the folder of this file"),
        Entry("robot.pelvis", anatomy.pelvis, "link that carries both legs"),
        *(Entry(f"robot.{k.value}_sole", model.soles[k].frame, found[k].source, found[k].confidence) for k in Foot),
        Entry("robot.imu", anatomy.imu or anatomy.pelvis, sensor),
        Entry("robot.lock", list(lock) or [""], f"all joints but {free}; with an angle if zero is outside the limits"),
        Entry("robot.sole_length", rounded(sole.length, 4), "largest rectangle in the foot"),
        Entry("robot.sole_width", rounded(sole.width, 4), "largest rectangle in the foot"),
    ]


def _posture(model: RobotModel, standing: Standing) -> list[str]:
    """Return the posture as name and angle of each joint that is not at zero."""
    angles = zip(model.joint_names, standing.q, strict=True)
    return [f"{name}={angle:.4f}" for name, angle in angles if abs(angle) > 5e-5]


def paper_parameters(numbers: Numbers) -> list[Entry]:
    """Return the parameters of the walk of Urban & Adorno."""
    anatomy = numbers.anatomy
    return [
        Entry("gait.style", "paper", "Urban & Adorno"),
        Entry("gait.step_length", numbers.step, numbers.step_reason),
        Entry("gait.step_width", rounded(anatomy.apart, 4), "distance of the soles"),
        Entry("dsp.sliding_radius", rounded(0.1 * anatomy.leg), "0.1 of a leg"),
        Entry(
            "ssp.com_radius", rounded(max(0.5 * numbers.width, 0.6 * anatomy.apart)), "reached before the feet slide"
        ),
        Entry("pelvis.height", rounded(0.7 * numbers.standing.pelvis), "0.7 of the standing height"),
    ]


def whole_body_parameters(model: RobotModel, standing: Standing, numbers: Numbers) -> list[Entry]:
    """Return the parameters of the whole-body controller [Sherikov et al.].

    Lengths are those of the paper's robot, whose CoM is 0.73 m high, scaled with the height of the CoM, and times with
    the square root of that height.
    """
    size, anatomy = float(standing.com[2]) / 0.73, numbers.anatomy
    slow = math.sqrt(size)
    interval = rounded(0.005 * max(4, round(20.0 * slow)))  # a multiple of the control period
    most = model.effort_max[np.isfinite(model.effort_max)]
    scaled = "as the paper's robot, scaled by the height of the CoM"
    return [
        Entry("dt", 0.005, "200 Hz", "default"),
        Entry("gait.first_support", "right", "as the paper's robot"),
        Entry("whole_body.torso", anatomy.torso, "link that carries the arms"),
        Entry("whole_body.hand", anatomy.hands[Foot.RIGHT], "end of the right arm"),
        Entry("whole_body.posture", _posture(model, standing), "soles level, knees bent by 9 % of the leg"),
        Entry(
            "whole_body.free",
            [*anatomy.legs[Foot.LEFT], *anatomy.legs[Foot.RIGHT], *anatomy.arms[Foot.RIGHT]],
            "legs and right arm, which have separate tasks",
        ),
        Entry("whole_body.interval", interval, "as the paper's robot, scaled by the square root of the CoM's height"),
        Entry("whole_body.single_support", rounded(7.0 * interval), "seven intervals"),
        Entry("whole_body.double_support", interval, "one interval"),
        Entry("whole_body.first_double_support", rounded(3.0 * interval), "three intervals"),
        Entry("whole_body.feet_distance", rounded(anatomy.apart, 4), "distance of the soles in the posture"),
        Entry("whole_body.cop_length", rounded(0.6 * numbers.model.soles[Foot.LEFT].length), "0.6 of the sole"),
        Entry("whole_body.cop_width", rounded(0.5 * numbers.width), "half of the sole"),
        Entry("whole_body.step_length", rounded(0.2 * size), scaled),
        Entry("whole_body.step_width_min", rounded(anatomy.apart, 4), "distance of the soles in the posture"),
        Entry("whole_body.step_width_max", rounded(anatomy.apart + 0.11 * size, 4), scaled),
        Entry("whole_body.step_height", rounded(0.07 * size), scaled),
        Entry("whole_body.hand_weight", 2.0, "twice that of the paper's robot: other arms are heavier", "guess"),
        Entry("whole_body.effort", rounded(float(most.max()) if most.size else 150.0), "largest limit of the URDF"),
    ]


def parameters(numbers: Numbers) -> list[Entry]:
    """Return the parameters of the standing walk, whose stiffness, damping and duration follow from `numbers`."""
    n, model, anatomy, standing = numbers, numbers.model, numbers.anatomy, numbers.standing
    small = min(1.0, anatomy.leg / 0.4)
    steps = min(max(10, math.ceil(0.6 / n.step)), MOST_STEPS)
    swing = 1.5
    speed = float(np.min([3.0, *model.velocity_max[np.isfinite(model.velocity_max)]]))
    roll, yaw = anatomy.sideways, anatomy.turns
    return [
        Entry("dt", 0.005, "200 Hz", "default"),
        Entry("gait.style", "standing", "the CoM stays over the real soles"),
        Entry("gait.steps", steps, "more than half a metre, if steps are long enough"),
        Entry("gait.step_length", n.step, n.step_reason),
        Entry("gait.step_width", rounded(anatomy.apart, 4), "distance of the soles in the posture"),
        Entry("gait.step_height", rounded(min(max(0.04 * anatomy.leg, 0.008), 0.03)), "0.04 of a leg"),
        Entry("gait.most_length", rounded(1.2 * n.step), "longest step commanded by cmd_vel"),
        Entry(
            "gait.most_side",
            rounded(0.04 * anatomy.leg) if roll else 0.0,
            "the pelvis moves sideways over flat soles" if roll else "the pelvis cannot move sideways over flat soles",
        ),
        Entry("gait.most_turn", 0.1 if yaw else 0.0, "the feet can turn" if yaw else "the feet cannot turn"),
        Entry("gait.phase_timeout", rounded(4.0 * max(n.transfer, swing) + 4.0), "four times a phase"),
        Entry("gait.recover", "dynamic.yaml", "whose steps catch pushes that one sole cannot balance"),
        Entry("task.eta", 2.0, "as for every robot", "default"),
        Entry("task.damping", 0.03, "as for every robot", "default"),
        Entry(
            "task.posture_weight",
            rounded(0.0002 * small**2),
            "weighs angles against lengths: less for the square of a short leg, or the CoM is held off its goal",
            "default",
        ),
        Entry("pelvis.height", rounded(0.7 * standing.pelvis), "0.7 of the standing height"),
        Entry(
            "standing.posture",
            _posture(model, standing),
            "soles level, knees bent by 4 % of the leg, CoM over the soles' middle",
        ),
        Entry("standing.margin", n.margin, "8 mm, or 0.15 of the sole's width"),
        Entry("standing.pressure_margin", rounded(min(0.004, 0.07 * n.width)), "half of the margin"),
        Entry("standing.transfer_duration", n.transfer, "the CoP stays within the soles during the transfer"),
        Entry("standing.swing_duration", swing, "as for every robot", "default"),
        Entry("standing.com_threshold", com_threshold(anatomy.leg), "5 mm, less for a short leg"),
        Entry("standing.swing_threshold", rounded(0.003 * small), "3 mm, less for a short leg"),
        Entry("standing.saturation", rounded(0.03 * small), "3 cm, less for a short leg"),
        Entry("standing.lever", rounded(0.5 * anatomy.leg), "half a leg"),
        Entry("standing.balance", 1.0, "as for every robot", "default"),
        Entry("joints.eta", 5.0, "as for every robot", "default"),
        Entry("joints.velocity", rounded(speed), "3 rad/s, or the slowest joint"),
        *_servo_parameters(n),
        Entry("monitor.tolerance", 0.0001, "error of the Euler method at touchdown", "default"),
    ]


def _servo_parameters(n: Numbers) -> list[Entry]:
    """Return the parameters of servos whose types are not known."""
    return [
        Entry("servo.stiffness", n.stiffness, f"5 m g h, m g h = {n.mgh:.4g} N m/rad", "guess"),
        Entry("servo.assumed_stiffness", n.stiffness, "equal to servo.stiffness, for gravity feedforward", "guess"),
        Entry(
            "servo.damping",
            n.damping(n.stiffness, 0.5, n.armature),
            f"a damping ratio of 0.5 for a leg of {n.inertia:.3g} kg m^2 and the rotors",
            "guess",
        ),
        *(
            Entry(f"servo.{key}", n.armature, "0.03 s times effort limit / velocity limit, or 0.0025 m g h", "guess")
            for key in ("armature", "assumed_armature")
            if n.armature < Config().servo.armature
        ),
        Entry("servo.torque_scale", 1.0, "the effort limits of robot.urdf", "likely"),
    ]


def assumed(damping: float, part: float = ASSUMED) -> tuple[str, ...]:
    """Return ``servo.assumed`` of servos with a `damping` [s], of which a `part` is assumed.

    It has precedence over ``servo.assumed_damping``, which the files of plants give for all robots.
    """
    return (f"*=damping {rounded(part * damping):g}",)


def servo_types(given: Sequence[str], joints: Sequence[str], table: Collection[str]) -> list[str]:
    """Return ``servo.types`` of entries NAME=TYPE, where NAME is a joint, a pattern, or a part of names of joints.

    Raises
    ------
    ConfigError
        If an entry has another form, no joint has its name, or `table` has no such type.
    """
    out = []
    for entry in given:
        name, equals, kind = (word.strip() for word in entry.partition("="))
        if not (name and equals and kind):
            raise ConfigError(f"--servo {entry}: expected NAME=TYPE, such as knee={next(iter(table))}")
        if kind not in table:
            raise ConfigError(f"--servo {entry}: there is no type '{kind}' in the table of servos: {', '.join(table)}")
        pattern = next((text for text in (name, f"*{name}*") if fnmatch.filter(joints, text)), None)
        if pattern is None:
            raise ConfigError(f"--servo {entry}: no joint is named like '{name}'; the joints are {', '.join(joints)}")
        out.append(f"{pattern}={kind}")
    return out


def drive_parameters(drives: Mapping[str, MjcfDrive], numbers: Numbers) -> tuple[dict[str, float], list[Entry]]:
    """Return the parameters of the servos that follow from the `drives` of the legs' joints, and what they are.

    Gains of actuators that are too soft to stand are those of a policy rather than of servos; they are not used.
    """
    legs = [drives[name] for names in numbers.anatomy.legs.values() for name in names if name in drives]
    if not legs:
        return {}, []
    stiffness, damping, armature, friction = np.median([dataclasses.astuple(drive) for drive in legs], axis=0).tolist()
    values = {f"servo.{key}": rounded(armature) for key in ("armature", "assumed_armature")}
    values["servo.friction"] = rounded(friction)
    values = {key: value for key, value in values.items() if value > 0.0}
    rotor = values.get("servo.armature", numbers.armature)
    values["servo.damping"] = numbers.damping(numbers.stiffness, 0.5, rotor)
    if not stiffness > 0.0:
        return values, []
    part, source = stiffness / numbers.mgh, "median of the legs' position actuators"
    entry = Entry("position gain", f"{stiffness:.4g} N m/rad, {part:.2g} m g h", source)
    if part < STIFFEST_FALL:
        source += f": below {STIFFEST_FALL:g} m g h robots fall, so {STIFFNESS:g} m g h are assumed"
        return values, [Entry(entry.what, entry.value, source, "guess")]
    values |= {"servo.stiffness": rounded(stiffness), "servo.assumed_stiffness": rounded(stiffness)}
    ratio = 0.5 * damping / math.sqrt(stiffness * (numbers.inertia + rotor))
    values["servo.damping"] = rounded(damping / stiffness) if ratio > 0.3 else numbers.damping(stiffness, 0.5, rotor)
    return values, [entry]


def climb_parameters(numbers: Numbers, dynamic: Config) -> list[Entry]:
    """Return the parameters with which the `dynamic` walk climbs a step by touch; see config/overlays/climb.yaml."""
    leg, sole, gait = numbers.anatomy.leg, numbers.model.soles[Foot.LEFT].length, dynamic.gait
    stair = _STAIR * gait.footstep_tolerance
    swing = rounded(LATER * dynamic.standing.swing_duration, 2)
    return [
        Entry("gait.climb", min(rounded(CLIMBED * leg, 2), HIGHEST), f"{CLIMBED:g} of a leg"),
        Entry("gait.step_height", max(gait.step_height, stair), "a step that is lower does not stop the foot"),
        Entry("gait.most_length", rounded(AHEAD * sole, 3), "so far ahead the foot lands on the step"),
        Entry("standing.swing_duration", swing, f"{LATER:g} times that on the level"),
    ]


def dynamic_parameters(numbers: Numbers, damping: float, stiffness: float) -> list[Entry]:
    """Return the parameters of the dynamic walk that differ from the standing walk.

    They are those of ``config/poppy_dynamic.yaml``, with lengths scaled by the leg and times by its square root;
    `damping` and `stiffness` are those of the section ``servo`` [s, N m/rad].
    """
    anatomy = numbers.anatomy
    size = anatomy.leg / REFERENCE
    slow = math.sqrt(size) * numbers.pace
    single, double = rounded(SINGLE * slow, 2), max(rounded(DOUBLE * slow, 2), SHORTEST_DOUBLE)
    speed = FROUDE * math.sqrt(GRAVITY * anatomy.leg)
    step = rounded(speed * (single + double), 2)
    roll = anatomy.sideways
    start = START if anatomy.lean is None else QUICK_START
    time, length = "as Poppy, scaled by the square root of the leg", "as Poppy, scaled by the leg"
    return [
        Entry("gait.style", "dynamic", "steps of a fixed duration, adjusted to the divergent component of motion"),
        Entry("gait.steps", math.ceil(FAR / step) + Config().dynamic.ramp, f"{FAR:g} m"),
        Entry("gait.step_length", step, f"{speed:.2f} m/s, a Froude number of {FROUDE}"),
        Entry("gait.step_height", rounded(0.02 * size, 2), length),
        Entry("gait.most_length", rounded(1.2 * step, 2), "longest step commanded by cmd_vel"),
        Entry("gait.most_side", 0.0, "sideways steps are left to the standing walk"),
        Entry("task.eta", rounded(4.0 / slow, 2), time),
        Entry("standing.transfer_duration", double, time),
        Entry("standing.swing_duration", single, time),
        Entry("standing.balance", 0.7, "as Poppy", "default"),
        Entry("standing.eta_feet", 10.0, "as Poppy", "default"),
        Entry("standing.eta_edges", 20.0, "as Poppy", "default"),
        Entry("standing.recovery", 0.1, "as Poppy", "default"),
        Entry("standing.swing_weight", 30.0, "as Poppy", "default"),
        Entry("standing.swing_rate", rounded(12.0 / slow, 2), time),
        Entry("dynamic.start_duration", rounded(start * slow, 2), time),
        Entry("dynamic.stop_duration", rounded(slow, 2), time),
        Entry("dynamic.land_late", rounded(0.03 * slow, 2), "a tilted foot touches the ground early"),
        Entry("dynamic.com_rate", rounded(2.0 / slow, 2), time),
        Entry("dynamic.height_rate", rounded(4.0 / slow, 2), time),
        Entry("dynamic.upright_rate", rounded(5.0 / slow, 2), time),
        Entry("dynamic.catch_margin", rounded(min(0.012 * size, 0.17 * numbers.width), 2), "0.17 of the sole's width"),
        Entry("dynamic.catch_beyond", rounded(0.01 * size, 2), length),
        Entry("dynamic.catch_length", rounded(0.1 * size, 2), length),
        Entry(
            "dynamic.catch_side",
            rounded(0.05 * size, 2) if roll else 0.0,
            length if roll else "the pelvis cannot move sideways over flat soles",
        ),
        Entry("dynamic.shortest_step", rounded(0.26 * slow, 2), time),
        Entry("dynamic.untouched", rounded(0.04 * slow, 2), time),
        Entry("dynamic.settled", rounded(0.12 * slow, 2), time),
        Entry("joints.eta", 10.0, "as Poppy", "default"),
        Entry("joints.velocity", 6.0, "as Poppy", "default"),
        Entry(
            "servo.window",
            rounded(min(max(YIELDING * numbers.mgh / stiffness, 0.003), 0.15), 2),
            f"legs yield with {YIELDING:g} m g h, as those of Poppy",
            "default",
        ),
        Entry(
            "servo.assumed_lead", rounded(0.7 * damping, 2), "0.7 of servo.damping: more, and steps get long", "guess"
        ),
    ]
