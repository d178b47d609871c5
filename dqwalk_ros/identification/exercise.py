"""Exercise for the identification of servos without ground contact: slow sweeps, reversals, small steps and a chirp.

The root of the robot is fixed and level. The joints of a limb move one after the other, and the limbs at the same time.
While a joint moves, the other joints of its limb keep a posture in which gravity loads it in both directions, if there
is one, because backlash is observable where the load changes its sign, and stiffness where the load varies.

The exercise is a `Walk`, so it runs in one process, through ROS 2 and on a robot, and is recorded to the same bag.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.paper.features import JointAngles
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import Z
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import Next, Phase, PhaseKind, Timed
from dqwalk_ros.paper.state import State
from dqwalk_ros.paper.tasks import Task
from dqwalk_ros.paper.walk import Walk, joint_limits
from dqwalk_ros.robot.clearance import Clearance, limbs
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.walks.following import minimum_jerk

NAME = f"{__name__}:Exercise"
"""Value of ``gait.walk`` for an exercise."""

_SLOT = 20.0
"""Duration of the exercise of one joint, including the motion to its posture [s]."""
_WAY, _REST = 2.5, 0.5
"""Duration of the motion to a posture, and of the rest there [s]."""
_GRID = 0.005
"""Sampling time of the path [s]."""
_SWEEP, _REVERSAL, _STEPS = 0.25, 0.04, (0.03, 0.015, 0.04, 0.02)
"""Largest amplitudes of the slow and of the short sweep, and heights of the steps [rad]."""
_STEP_TIME = 0.02
"""Rise time of a step [s], so that the commanded velocity is below the limit of the joint."""
_CHIRP = (0.5, 7.0)
"""First and last frequency of the chirp [Hz]."""
_CHIRP_SPEED = 1.3
"""Largest velocity of the chirp [rad/s]; with a delay of 0.1 s a goal is within ``servo.window`` of its joint."""
_MARGIN = 0.1
"""Least distance from the limits of a joint [rad]."""
_REACH = 0.9
"""Largest angle of the other joints in a posture [rad]."""
_TRIES = 80
"""Number of candidate postures for each joint."""
_MORE = 1000
"""The same, where none of these is clear of other links."""
_LEAN = 1.2
"""Largest angle between a sole and the floor [rad]; a controller interprets a larger one as a fall."""


def exercise_config(config: Config, cycles: int = 1) -> Config:
    """Return the configuration of an exercise of all joints of the robot of `config`.

    Parameters
    ----------
    cycles : int
        Number of exercises of each joint.
    """
    return config.updated(
        {
            "gait.walk": NAME,
            "gait.cycles": cycles,
            "robot.lock": (),
            "standing.posture": (),
            "physics.held": True,
            "servo.assumed": ("*=damping 0",),  # no feedforward, which the fit would attribute to the servo
            "servo.assumed_lead": 0.0,
            "safety.sole_tilt": 1.5,  # the soles are not on the ground
            "safety.contradiction": 3.0,
        }
    )


@dataclass(frozen=True)
class Slot:
    """The exercise of one joint."""

    joint: int
    """Index of the joint."""
    posture: Array
    """Angles in the middle of the motion, of which only those of the limb are used, shape (n,) [rad]."""
    sweep: float
    """Amplitude of the slow sweep [rad]."""


@functools.lru_cache(maxsize=4)
def slots(model: RobotModel, cycles: int) -> tuple[tuple[Slot, ...], ...]:
    """Return the slots of each limb in order, in the postures with the largest variation of the gravity torque.

    Limbs with fewer joints than the longest limb are exercised more than `cycles` times, each time in other postures.
    In each slot, on the way to it and back to zero the links keep clear of each other, those of other limbs included.

    Parameters
    ----------
    cycles : int
        Number of exercises of each joint of the longest limb.

    Returns
    -------
    tuple of tuple of Slot
        For each limb, its slots.

    Raises
    ------
    ConfigError
        If the range of a joint is too small, or it cannot move clear of other links.
    """
    random, clearance, found = np.random.default_rng(0), _Clearance(model), limbs(model)
    most = max(map(len, found)) * cycles
    counts = [most // len(limb) * len(limb) for limb in found]
    out: list[list[Slot]] = [[] for _ in found]
    here = np.zeros(model.n)
    for k in range(most):
        busy = [k < count for count in counts]
        ending = [joint for limb, count in zip(found, counts, strict=True) if k == count - 1 for joint in limb]
        moves = _Moves(here, tuple(ending))
        for i in sorted(range(len(found)), key=lambda i: busy[i]):  # first those that go back to zero
            limb, own = found[i], out[i]
            if busy[i]:
                own.append(_slot(model, limb[k % len(limb)], limb, random, clearance, moves))
                moves = moves.with_limb(limb, own[-1].posture, own[-1].joint, own[-1].sweep)
            else:
                moves = moves.with_limb(limb, np.zeros(model.n))
        here = moves.posture
    return tuple(map(tuple, out))


@dataclass(frozen=True)
class _Moves:
    """What the limbs do in a slot: they move from `begin` to `posture`, both (n,), then joints oscillate by `sweep`."""

    begin: Array
    ending: tuple[int, ...] = ()
    """Joints that move to zero after this slot."""
    limbs: tuple[int, ...] = ()
    """First joints of the limbs whose motion is known."""
    target: Array | None = None
    sweep: Array | None = None

    @property
    def posture(self) -> Array:
        """Angles about which the joints oscillate, shape (n,) [rad]."""
        return self.begin if self.target is None else self.target

    def with_limb(self, limb: list[int], posture: Array, joint: int = -1, sweep: float = 0.0) -> _Moves:
        """Return these with the motion of one more limb."""
        target = self.posture.copy()
        target[limb] = posture[limb]
        swept = np.zeros(len(target)) if self.sweep is None else self.sweep.copy()
        if joint >= 0:
            swept[joint] = sweep
        return _Moves(self.begin, self.ending, (*self.limbs, limb[0]), target, swept)

    def samples(self) -> list[Array]:
        """Return angles (n,) along the motion [rad]; all limbs move with the same timing."""
        assert self.sweep is not None
        found = [self.posture + s * self.sweep for s in (-1.0, 1.0, 0.0, -0.5, 0.5)]
        found += [self.begin + s * (self.posture - self.begin) for s in np.linspace(0.1, 0.9, 9)]
        for s in np.linspace(0.1, 0.9, 9) if self.ending else ():
            back = self.posture.copy()
            back[list(self.ending)] *= s
            found.append(back)
        return found


def _slot(
    model: RobotModel, joint: int, limb: list[int], random: np.random.Generator, clearance: _Clearance, moves: _Moves
) -> Slot:
    low, high = model.q_min + _MARGIN, model.q_max - _MARGIN
    if high[joint] - low[joint] < 2.0 * _REVERSAL:
        raise ConfigError(
            f"the range of joint '{model.joint_names[joint]}' is {model.q_max[joint] - model.q_min[joint]:.2f} rad, "
            "too small for an exercise; lock it (robot.lock)"
        )
    sweep = min(_SWEEP, 0.5 * (high[joint] - low[joint]))
    low[joint], high[joint] = low[joint] + sweep, high[joint] - sweep
    low, high = np.minimum(np.maximum(low, -_REACH), high), np.maximum(np.minimum(high, _REACH), low)
    rest = np.zeros(model.n)
    rest[limb] = np.clip(0.0, low, high)[limb]
    chain = {i: model.chain(next(b for b, body in enumerate(model.bodies) if body.joint == i)) for i in limb}
    line = [i for i in limb if chain[i][-1] in chain[joint] or chain[joint][-1] in chain[i]]
    for count in (_TRIES, _MORE):
        tries = np.tile(rest, (count, 1))
        tries[1:, line] = random.uniform(low[line], high[line], (count - 1, len(line)))
        for q in sorted(tries, key=lambda q: -_loaded(model, q, joint, sweep)):
            if clearance(moves.with_limb(limb, q, joint, sweep)):
                return Slot(joint, q, sweep)
    raise ConfigError(
        f"no posture was found in which joint '{model.joint_names[joint]}' moves by {sweep:.2f} rad clear of other "
        f"links, such as {clearance.nearest}; lock it (robot.lock)"
    )


def _loaded(model: RobotModel, q: Array, joint: int, sweep: float) -> float:
    """Return a score of the gravity torque during a sweep: large value, wide range and change of sign."""
    height, there = [], q.copy()
    angles = q[joint] + sweep * np.linspace(-1.0, 1.0, 4)
    for angle in angles:
        there[joint] = angle
        kin = Kinematics(model, there, Foot.LEFT)
        height.append(kin.direction(model.root, Z) @ (kin.com - kin.point(model.root)))
    slope = np.diff(height) / np.diff(angles)  # gravity torque divided by the weight
    return float(0.3 * np.abs(slope).max() + 0.3 * np.ptp(slope) + max(0.0, min(slope.max(), -slope.min())))


class _Clearance:
    """Checks motions for self-collision and for soles that are inclined too much.

    Attributes
    ----------
    nearest : str
        The two links that were too near last.
    """

    def __init__(self, model: RobotModel) -> None:
        self._model, self._links, self.nearest = model, Clearance(model), "a sole that leans"

    def __call__(self, moves: _Moves) -> bool:
        """Return whether the last limb of a motion is clear of itself, of the limbs before it and of the root."""
        links = self._links
        known = np.isin(links.limbs, [-1, *moves.limbs]).all(axis=1) & (links.limbs == moves.limbs[-1]).any(axis=1)
        for q in moves.samples():
            kin = Kinematics(self._model, q, Foot.LEFT)
            up = kin.direction(self._model.root, Z)
            if any(kin.direction(sole.frame, Z) @ up < math.cos(_LEAN) for sole in self._model.soles.values()):
                return False
            near = known & (links.distances(q) < links.least)
            if near.any():
                self.nearest = links.names(int(np.argmax(near)))
                return False
        return True


def _motion(sweep: float) -> Array:
    """Return the motion of a joint relative to its posture, sampled as the path, shape (m,) [rad]."""
    left = _SLOT - _WAY - _REST
    slow = _triangle(sweep, 0.36 * left)
    short = np.concatenate([_triangle(min(_REVERSAL, sweep), 0.05 * left)] * 2)
    heights = [height for size in _STEPS for height in (size, 0.0, -size, 0.0)]
    edges = 0.015 * left * np.arange(len(heights) + 1)
    steps = np.interp(
        np.arange(0.0, edges[-1], _GRID),
        np.sort(np.concatenate([edges, edges + _STEP_TIME])),
        np.repeat([0.0, *heights], 2),
    )
    t = np.arange(0.0, 0.3 * left, _GRID)
    frequency = np.interp(t, [0.0, t[-1]], _CHIRP)
    phase = np.cumsum(math.tau * frequency) * _GRID
    fade = np.minimum(1.0, np.minimum(t, t[-1] - t) / 0.5)
    chirp = fade * np.minimum(0.6 * sweep, _CHIRP_SPEED / (math.tau * frequency)) * np.sin(phase)
    return np.concatenate([slow, short, steps, chirp])


def _triangle(amplitude: float, duration: float) -> Array:
    return amplitude * np.interp(
        np.arange(0.0, duration, _GRID) / duration, [0.0, 0.25, 0.75, 1.0], [0.0, 1.0, -1.0, 0.0]
    )


def duration(model: RobotModel, cycles: int) -> float:
    """Return the duration of an exercise [s]."""
    return len(path_of(model, cycles)) * _GRID


@functools.lru_cache(maxsize=4)
def path_of(model: RobotModel, cycles: int) -> Array:
    """Return the angles (m, n) of all joints, sampled every 5 ms, all zero at the beginning [rad]."""
    each = slots(model, cycles)
    size = round(_SLOT / _GRID)
    way = np.array([minimum_jerk(s)[0] for s in np.linspace(0.0, 1.0, round(_WAY / _GRID))])
    out = np.zeros((max(map(len, each)) * size + size // 4, model.n))
    for limb, in_order in zip(limbs(model), each, strict=True):
        here, at = np.zeros(model.n), 0
        for slot in in_order:
            for i in limb:
                out[at : at + size, i] = slot.posture[i]
                out[at : at + len(way), i] = here[i] + way * (slot.posture[i] - here[i])
            motion = _motion(slot.sweep)
            begin = at + size - len(motion)
            out[begin : at + size, slot.joint] += motion
            here, at = slot.posture, at + size
        for i in limb:  # back to the initial posture
            out[at : at + len(way), i] = (1.0 - way) * here[i]
            out[at + len(way) :, i] = 0.0
    return out


@jit
def _place(path: Array, elapsed: float) -> Array:
    """Return the joint angles (n,) on a path (m, n) that is sampled every 5 ms [rad]."""
    x = min(max(elapsed / _GRID, 0.0), path.shape[0] - 1.0)
    k = min(int(x), path.shape[0] - 2)
    place: Array = path[k] + (x - k) * (path[k + 1] - path[k])
    return place


@jit
def _from_path(q: Array, a: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Return the deviation (n,) from the path [rad], its gradient, and minus the velocity of the path; a = dt, path."""
    n, dt = q.shape[0], a[0]
    path = a[1:].reshape((a.shape[0] - 1) // n, n)
    place = _place(path, elapsed)
    return q - place, np.eye(n), -(_place(path, elapsed + dt) - place) / dt


@dataclass(frozen=True, kw_only=True, eq=False)
class FollowPath(Task):
    """Task that all joints follow a path without feedback, which the fit would attribute to the servos."""

    path: Array
    """Joint angles, sampled every 5 ms, shape (m, n) [rad]."""
    dt: float
    """Control period, over which the velocity of the path is averaged [s]."""
    eta: float | None = 0.0  # without feedback
    watches = (JointAngles(),)
    function = _from_path

    @property
    def parameters(self) -> Array:
        """Control period and path, shape (1 + m n,)."""
        return np.append(self.dt, self.path)


class Exercise(Walk):
    """Exercise of all joints, ``gait.cycles`` times, in one phase."""

    def __init__(self, config: Config, model: RobotModel) -> None:
        super().__init__(config, model)
        self._path = path_of(model, config.gait.cycles)  # takes seconds, so it is computed before the first state

    @staticmethod
    def phases(config: Config) -> int:
        """Return 1, the number of phases."""
        return 1

    @staticmethod
    def describe(config: Config) -> str:
        """Return a description such as ``an exercise of all joints``."""
        return "an exercise of all joints" + (f", {config.gait.cycles} times" if config.gait.cycles > 1 else "")

    @property
    def posture(self) -> Array:
        """Initial joint angles: zero, clipped to the limits, shape (n,) [rad]."""
        return np.clip(np.zeros(self.model.n), self.model.q_min, self.model.q_max)

    def following(self, phase: Phase | None, kin: Kinematics) -> Next | None:
        """Return the only phase; None after it."""
        return Next(PhaseKind.STANCE, Foot.LEFT) if phase is None else None

    def both_feet(self, kind: PhaseKind, support: Foot, kin: Kinematics) -> Phase:
        """Return the phase of the exercise."""
        return Phase(
            model=self.model,
            kind=kind,
            support=support,
            base=kin.base,
            q_start=kin.q,
            swing_target=None,
            eta=self.config.task.eta,
            damping=1e-6,
            tasks=(FollowPath(name="path", path=self._path, dt=self.config.dt),),
            equalities=(),
            inequalities=(),
            limits=joint_limits(self.config, self.model),
            rule=Timed(len(self._path) * _GRID),
        )

    def one_foot(self, support: Foot, kin: Kinematics, swing_target: Array) -> Phase:
        """Raise ConfigError: an exercise has no single support."""
        raise ConfigError("an exercise has no single support")

    def effort(self, phase: Phase, kin: Kinematics, state: State, u: Array) -> Array:
        """Return zero feedforward torques, shape (n,) [N m]."""
        return np.zeros(self.model.n)
