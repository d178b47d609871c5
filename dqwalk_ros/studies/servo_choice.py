"""Which servo a biped needs: speed, height of steps, slope and push that the torque-speed curve of a servo allows.

One step of the dynamic walk is computed without a simulation. The CoM moves as a linear inverted pendulum over the
middle of the support sole, at a constant height; the pelvis is upright; the swing foot moves with minimum
jerk. The angles follow by inverse kinematics, the torques by virtual work from the forces that accelerate the bodies,
which are taken as point masses, against gravity:

    tau_j = sum_b J_bj . m_b (a_b - g)

A servo allows the step if |tau + armature q'' + friction sign q' + back_emf q'| stays below its stall torque. A speed
is possible if the servos allow one of the steps that have it: of several durations, with the CoM at several heights,
because a knee that stretches has to be quick, and one that is bent bears more. Nothing is left for balance: a walk near
the limit has no reserve.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from dqwalk_ros.config import Config
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.servos import Servos, ServoType
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.walks.dynamic.swing import Swing, advanced
from dqwalk_ros.walks.footsteps import Footsteps
from dqwalk_ros.walks.table import style_of

_SAMPLES = 41
"""Number of times in a step."""
_ITERATIONS, _POSTURE, _TRUNK = 12, 1e-2, 0.1
"""Gauss-Newton method: largest number of iterations, and weights of the previous angles of legs and of other joints."""
_WEIGHTS = np.array([1.0] * 6 + [1.0, 0.1, 0.1] + [0.05, 0.05, 0.05])
"""Weights of position and orientation of the swing sole, of the CoM, and of the orientation of the pelvis."""
_NEEDED = [0, 1, 2, 6]
"""The errors that have to vanish: those of the swing sole's position, and of the CoM ahead."""
_BLUR = 0.2
"""Time over which velocities and accelerations are averaged, as a part of the swing: servos do not follow a jump."""
_OFF = 0.01
"""Largest error of a posture that is reached, as a fraction of the height of the CoM."""
_SPEEDS = np.geomspace(0.02, 0.6, 14)
"""Speeds that are tried, in units of sqrt(g h) with the height h of the CoM."""
_DURATIONS = (0.7, 1.0, 1.4, 2.0)
"""Durations of a step that are tried, as fractions of that of the walk."""
_DOUBLE = 0.08
"""Part of such a step in double support: the shorter it is, the slower is the swing."""
_LOWER = (0.0, 0.02, 0.04, 0.06)
"""Distances by which the CoM is lower than in the posture of the walk, as fractions of its height."""
_HEIGHTS = np.geomspace(0.02, 0.5, 10)
"""Heights of steps that are tried, as fractions of the height of the CoM."""
_SLOPES = np.radians([0.0, 3.0, 6.0, 9.0, 12.0, 16.0, 20.0])
"""Slopes that are tried [rad]."""


@dataclass(frozen=True)
class Gait:
    """A step of a walk."""

    single: float
    double: float
    """Durations of single and double support [s]."""
    length: float
    height: float
    """[m]"""
    slope: float = 0.0
    """Inclination of the floor, positive: it rises ahead [rad]."""
    lower: float = 0.0
    """Distance by which the CoM is lower than in the posture of the walk [m]."""

    @classmethod
    def of(cls, config: Config) -> Gait:
        """Return the step of a dynamic walk.

        Raises
        ------
        ConfigError
            If the walk is another one, whose steps do not have fixed durations.
        """
        if (style := style_of(config)) != "dynamic":
            raise ConfigError(f"servos are chosen for a dynamic walk; gait.style is {style or 'that of no other'}")
        s, gait = config.standing, config.gait
        return cls(s.swing_duration, s.transfer_duration, gait.step_length, gait.step_height)

    @property
    def duration(self) -> float:
        """Time from one step to the next [s]."""
        return self.single + self.double

    @property
    def speed(self) -> float:
        """Speed of the body [m/s]."""
        return self.length / self.duration


@dataclass(frozen=True)
class Step:
    """Angles and torques of all joints in a step on the left foot."""

    q: Array
    velocity: Array
    acceleration: Array
    """Shape (N, n) [rad, rad/s, rad/s^2]."""
    torque: Array
    """Shape (N, n) [N m]."""
    stuck: tuple[str, ...]
    """Joints at their limits where the legs do not reach the step."""
    off: float
    """Largest error of the postures [m]; zero for a step within the reach of the legs."""


def step(config: Config, model: RobotModel, gait: Gait) -> Step:
    """Return the motion of a step on the left foot, from the middle of one double support to that of the next."""
    posture = model.posture(config.standing.posture)
    still = Kinematics(model, posture, Foot.LEFT)
    beside = DQ(Footsteps(config, model, posture).beside(Foot.LEFT))
    t = np.linspace(-0.5, 0.5, _SAMPLES) * gait.duration
    q, stuck, off = _reached(still, beside, *_paths(still, beside, gait, t))
    states = [Kinematics(model, angles, Foot.LEFT) for angles in q]
    places = [
        [DQ(x).transform_point(c) for x, c in zip(kin.poses, kin.tree.links[:, 12:15], strict=True)] for kin in states
    ]
    motion, place = CubicSpline(t, q), CubicSpline(t, np.array(places))
    early, late = (np.clip(t + side * _BLUR * gait.single, t[0], t[-1]) for side in (-0.5, 0.5))

    def rate_of(of: CubicSpline, order: int) -> Array:
        """Return the mean of the derivative of a trajectory of `order` over the time around each sample."""
        mean: Array = (of(late, order - 1) - of(early, order - 1)) / (late - early).reshape(-1, *[1] * (of.c.ndim - 2))
        return mean

    up = np.array([math.sin(gait.slope), 0.0, math.cos(gait.slope)])
    force = model.mass * still.tree.links[:, 11, None] * (rate_of(place, 2) + GRAVITY * up)
    line = np.array([kin.lines for kin in states])
    columns = np.cross(line[:, None, :, :3], place(t)[:, :, None, :]) + line[:, None, :, 3:]
    torque = np.einsum("kbjx,kbx,bj->kj", columns, force, still.tree.moves)
    return Step(q, rate_of(motion, 1), rate_of(motion, 2), torque, stuck, off)


def _paths(still: Kinematics, beside: DQ, gait: Gait, t: Array) -> tuple[Array, Array]:
    """Return the CoM and the position of the swing sole at the times `t` (N,) of a step, shape (N, 3) each [m].

    `still` is the robot in its posture, and `beside` the pose of the right sole beside the left one.
    """
    soles, height = still.model.soles, float(still.com[2]) - gait.lower
    center, other = soles[Foot.LEFT].center, beside.transform_point(soles[Foot.RIGHT].center)
    rate = math.sqrt(GRAVITY / height)
    half = 0.5 * rate * gait.duration
    com = np.zeros((len(t), 3))
    com[:, 0] = center[0] + height * math.tan(gait.slope) + 0.5 * gait.length * np.sinh(rate * t) / math.sinh(half)
    com[:, 1] = center[1] + 0.5 * (other - center)[1] * np.cosh(rate * t) / math.cosh(half)
    com[:, 2] = height
    start, goal = (DQ.from_pose([sign * gait.length, 0.0, 0.0]) * beside for sign in (-1.0, 1.0))
    path, single = Swing(start.vec8(), goal.vec8(), gait.height, 0.0), gait.single
    elapsed = np.clip(t + 0.5 * single, 0.0, single).tolist()
    return com, np.array([advanced(*path.compiled, time, single)[0][:3] for time in elapsed])


def _reached(still: Kinematics, beside: DQ, com: Array, foot: Array) -> tuple[Array, tuple[str, ...], float]:
    """Return the angles (N, n) [rad] that follow the paths of `_paths`, and `Step.stuck` and `Step.off` of them."""
    model, swing, height = still.model, still.swing, float(com[0, 2])
    pelvis, n, q, stuck, off = DQ(still.pose(model.pelvis)), model.n, still.q, set[str](), 0.0
    keep = np.full(n, (_TRUNK * height) ** 2)
    keep[[joint for pair in leg_pairs(model) for joint in pair]] = (_POSTURE * height) ** 2
    found = np.empty((len(com), n))
    for k, (middle, sole) in enumerate(zip(com, foot, strict=True)):
        last = q
        for _ in range(_ITERATIONS):
            kin = Kinematics(model, q, Foot.LEFT)
            x = DQ(kin.pose(swing))
            e = np.concatenate([
                x.translation() - sole,
                height * (x * beside.conj()).rotation_vector(),
                kin.com - middle,
                height * (DQ(kin.pose(model.pelvis)) * pelvis.conj()).rotation_vector(),
            ])  # fmt: skip
            J = np.concatenate([
                kin.point_jacobian(swing), height * kin.angular_jacobian(swing),
                kin.com_jacobian, height * kin.angular_jacobian(model.pelvis),
            ])  # fmt: skip
            H = (J.T * _WEIGHTS) @ J + np.diag(keep)
            change = np.clip(np.linalg.solve(H, -(J.T * _WEIGHTS) @ e - keep * (q - last)), -0.3, 0.3)
            moved = np.clip(q + change, model.q_min, model.q_max)
            change, q = moved - q, moved
            if np.abs(change).max() < 1e-5:
                break
        if np.abs(e[_NEEDED]).max() > _OFF * height:
            off = max(off, float(np.abs(e[_NEEDED]).max()))
            at = (q <= model.q_min + 1e-6) | (q >= model.q_max - 1e-6)
            stuck |= {name for name, there in zip(model.joint_names, at, strict=True) if there}
        found[k] = q
    return found, tuple(sorted(stuck)), off


def largest_loads(servos: Servos, motion: Step) -> Array:
    """Return the largest part of its torque-speed curve that each joint needs in a step, shape (n,)."""
    inner = servos.armature * motion.acceleration + servos.friction * np.sign(motion.velocity)
    out: Array = servos.load(motion.torque + inner, motion.velocity).max(axis=0)
    return out


def own_servos(config: Config, model: RobotModel) -> Servos:
    """Return the servos of a configuration; those without a type lose their torque up to the velocity limit."""
    servos = Servos.of(config, model)
    servos.back_emf[:] = np.where(servos.back_emf > 0.0, servos.back_emf, servos.torque / model.velocity_max)
    return servos


@dataclass(frozen=True)
class Most:
    """The largest value that servos allow."""

    value: float
    joint: str
    """The joint that binds, of both legs the left one; empty if none does."""
    sign: str = ""
    """``>``: no servo binds within the reach of the legs, whose end is the value; ``<``: the least value that was tried
    is too much; else empty."""


@dataclass(frozen=True)
class Choice:
    """What one type of servo in all joints of the legs allows."""

    name: str
    voltage: float
    """[V]; 0 for the servos of the configuration."""
    speed: Most
    """[m/s], by the best of the steps that are tried."""
    joints: dict[str, Most]
    """Largest speed of each joint of a leg alone, the others being strong enough [m/s]."""
    height: Most
    slope: Most
    """Largest height of a step [m] and slope [rad], at the step length of the configuration."""
    push: float
    """Largest push ahead that is caught by steps as long as the servos allow, with the pressure at the toes [N s]."""
    warm: float
    """Largest RMS torque of a joint at the speed of the configuration, as a fraction of its stall torque."""


def leg_pairs(model: RobotModel) -> list[tuple[int, int]]:
    """Return the indices of the joints of the left and the right leg, from the hip to the ankle."""
    chains = [[model.bodies[b].joint for b in model.chain(model.frames[model.soles[f].frame].body)[1:]] for f in Foot]
    common = set(chains[0]) & set(chains[1])
    left, right = ([joint for joint in chain if joint not in common] for chain in chains)
    return list(zip(left, right, strict=True))


def choose(
    config: Config,
    model: RobotModel,
    types: dict[str, ServoType],
    progress: Callable[[float, str], None] = lambda *_: None,
) -> list[Choice]:
    """Return what the servos of a configuration allow, and those of each type.

    Raises
    ------
    ConfigError
        If the walk is not a dynamic one.
    """
    gait, still = Gait.of(config), Kinematics(model, model.posture(config.standing.posture), Foot.LEFT)
    height = float(still.com[2])
    ladders = {
        "speed": [(v, _with_speed(gait, v, height)) for v in (_SPEEDS * math.sqrt(GRAVITY * height)).tolist()],
        "height": [(x, [replace(gait, height=x)]) for x in (_HEIGHTS * height).tolist()],
        "slope": [(x, [replace(gait, slope=x)]) for x in _SLOPES.tolist()],
    }
    reached: list[_Ladder] = []
    for name, ladder in ladders.items():
        reached.append([])
        for value, gaits in ladder:
            progress((len(reached) - 1 + len(reached[-1]) / len(ladder)) / len(ladders), f"steps of another {name}")
            if not (found := [(one, motion) for one in gaits if not (motion := step(config, model, one)).off]):
                break
            reached[-1].append((value, found))
    rows = [("own", 0.0, own_servos(config, model))]
    for name, kind in types.items():
        rows.append((name, kind.voltage, Servos.of(config, model)))
        rows[-1][2].equip(slice(None), kind, kind.voltage, config.servo.p_gain)
    present = step(config, model, gait)
    return [_choice(model, gait, present, height, reached, *row) for row in rows]


def _with_speed(gait: Gait, speed: float, height: float) -> list[Gait]:
    """Return the steps that are tried for a speed [m/s]."""
    durations = [part * gait.duration for part in _DURATIONS]
    return [
        Gait((1.0 - _DOUBLE) * duration, _DOUBLE * duration, speed * duration, gait.height, lower=lower * height)
        for duration in durations
        for lower in _LOWER
    ]


_Ladder = list[tuple[float, list[tuple[Gait, Step]]]]
"""Increasing values, each with the steps that have it and that the legs reach."""


def _choice(
    model: RobotModel,
    gait: Gait,
    present: Step,
    height: float,
    ladders: Sequence[_Ladder],
    name: str,
    voltage: float,
    servos: Servos,
) -> Choice:
    pairs = leg_pairs(model)
    names = [model.joint_names[left] for left, _ in pairs]

    def most(ladder: _Ladder) -> tuple[Most, dict[str, Most]]:
        """Return the largest value of all joints, and that of each."""
        values, needed, least = [], [], []
        for value, steps in ladder:
            loads = np.array([largest_loads(servos, motion)[pairs].max(axis=1) for _, motion in steps])
            values.append(value)
            needed.append(loads[int(np.argmin(loads.max(axis=1)))])
            least.append(loads.min(axis=0))
        every = [float(loads.max()) for loads in needed]
        binds = next((names[int(np.argmax(loads))] for loads in needed if loads.max() > 1.0), "")
        single = {joint: _crossing(values, [float(x[k]) for x in least], joint) for k, joint in enumerate(names)}
        return _crossing(values, every, binds), single

    speed, joints = most(ladders[0])
    # any number of steps ahead catches xi if it is at most the toes plus L / (exp(w T) - 1) ahead of the support
    rate, toes, caught = math.sqrt(GRAVITY / height), model.soles[Foot.LEFT].length / 2.0, 0.0
    for part in _DURATIONS:
        duration = part * gait.duration
        same = [(v, [one for one in steps if math.isclose(one[0].duration, duration)]) for v, steps in ladders[0]]
        longest = duration * most([one for one in same if one[1]])[0].value
        caught = max(caught, max(longest - gait.length, 0.0) / math.expm1(rate * duration))
    legs = [joint for pair in pairs for joint in pair]
    warm = float((np.sqrt(np.mean(present.torque**2, axis=0)) / servos.torque)[legs].max())
    push = model.mass * rate * (toes + caught)
    return Choice(name, voltage, speed, joints, most(ladders[1])[0], most(ladders[2])[0], push, warm)


def _crossing(values: list[float], loads: list[float], joint: str) -> Most:
    """Return the value at which the load of a joint reaches 1, by linear interpolation."""
    if not values:
        return Most(0.0, "", ">")
    over = next((k for k, load in enumerate(loads) if load > 1.0), len(loads))
    if over == len(loads):
        return Most(values[-1], "", ">")
    if over == 0:
        return Most(values[0], joint, "<")
    return Most(float(np.interp(1.0, loads[over - 1 : over + 1], values[over - 1 : over + 1])), joint)
