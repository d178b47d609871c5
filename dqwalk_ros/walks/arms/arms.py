"""Arms beside a walk: they hold a posture, swing with the legs, and follow trajectories of joints and poses of hands.

What they do is two kinds of tasks in the quadratic program of the walk, with little weight: the walk has priority, and
limits and distances are kept by all joints. A pose of a hand is one in the trunk, so that its task moves the arm only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.paper.assembly import Evaluation
from dqwalk_ros.paper.collisions import capsules_in
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.features import JointAngles, Point
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import Phase
from dqwalk_ros.paper.qp.problem import Problem, Solution
from dqwalk_ros.paper.state import State
from dqwalk_ros.paper.tasks import Task
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ConfigError, StateError
from dqwalk_ros.support.wording import listed, shown
from dqwalk_ros.walks.arms.paths import JointPath, Limits, checked
from dqwalk_ros.walks.arms.priority import Priority
from dqwalk_ros.walks.arms.tasks import Beside, Hand, HandInTrunk, parts

_LOOSE = 0.03
"""Factor of the errors of joints whose hand follows a pose: their posture decides what the pose leaves free."""
_LONGEST_WAIT = 60.0
"""Largest time from the last state to the beginning of a trajectory [s]: a longer one is that of another clock."""
_PATIENCE = 2.0
"""Time without progress after which a hand or joint has stopped short of where it was sent [s]."""
_OF_HAND, _OF_JOINT = 0.005, 0.02
"""Least progress of a hand [m] and of a joint [rad] towards where it was sent (`_Approach.enough`)."""
_UNPROTECTED = (
    "nothing keeps the arms from the body: collision.pairs has no link of an arm; `dqwalk config FILE --capsules` "
    "prints pairs and capsules"
)


@dataclass
class _Approach:
    """Whether something comes closer to where it was sent."""

    enough: float
    """Least progress within `_PATIENCE`, and half of the distance that counts as arrived [m, rad]."""
    least: float = math.inf
    since: float = math.nan
    told: bool = False

    def stops(self, time: float, distance: float) -> bool:
        """Return True once, at the first state at which it has stopped at a distance [m, rad]."""
        if distance < self.least - self.enough:
            self.least, self.since = distance, time
        stopped = distance > 2.0 * self.enough and time - self.since > _PATIENCE and not self.told
        self.told |= stopped
        return stopped


class Arms:
    """What the arms of a robot do beside a walk.

    The newest command of an arm counts: a trajectory ends the pose of its hand, and a pose the trajectories of its
    joints. After a trajectory its last point is held.

    Parameters
    ----------
    posture : ndarray, shape (n,)
        Angles that the arms hold without a command [rad].

    Attributes
    ----------
    names : tuple of str
        The joints of the arms.
    hands : dict of str to Hand
        By side, ``left`` and ``right``, where the configuration has a link.

    Raises
    ------
    ConfigError
        If the section ``arms`` names joints or links that do not move, or joints of the legs.
    """

    def __init__(self, config: Config, model: RobotModel, posture: Array) -> None:
        self._config, self._model = config.arms, model
        a, indices = config.arms, {k for pattern in config.arms.joints for k in model.matching(pattern, "arms.joints")}
        legs = set[int]()  # what moves one sole, but not the other
        for foot in Foot:
            legs ^= {model.bodies[body].joint for body in model.chain(model.frames[model.soles[foot].frame].body)}
        if wrong := [model.joint_names[k] for k in sorted(indices & legs)]:
            raise ConfigError(f"arms.joints names {', '.join(wrong)} of the legs, which carry the robot")
        self._joints = np.array(sorted(indices))
        self.names = tuple(model.joint_names[k] for k in self._joints)
        self._posture = posture[self._joints]
        self._swing = model.posture(a.swing, "arms.swing")
        if wrong := [model.joint_names[k] for k in np.flatnonzero(self._swing) if k not in indices]:
            raise ConfigError(f"arms.swing names {', '.join(wrong)}, which is not in arms.joints")
        self._swing = self._swing[self._joints]
        margin, most = config.joints.margin, config.joints.velocity or np.inf
        self._limits = Limits(
            self.names,
            model.q_min[self._joints] + margin,
            model.q_max[self._joints] - margin,
            np.minimum(model.velocity_max[self._joints], min(most, a.joint_speed)),
        )
        named = {"left": a.left_hand, "right": a.right_hand}
        if a.left_hand and a.left_hand == a.right_hand:
            raise ConfigError(f"arms.left_hand and arms.right_hand are both '{a.left_hand}'")
        self.hands = {side: self._hand(side, link) for side, link in named.items() if link}
        self._paths: dict[int, tuple[JointPath, float]] = {}  # path and its beginning [s], by the place in `names`
        self._asked: list[tuple[int, JointPath, float | None]] = []  # since the last state
        apart = {
            pair.name
            for pair in capsules_in(config, model)
            if any(self._moved_with(capsule.frame) for capsule in (pair.one, pair.other))
        }
        tasks = ("arms", *(f"{side}_hand" for side in self.hands))
        self._priority = Priority(self._joints, tasks, apart, a.weight)
        self._base: Foot | None = None
        self._time, self._q = math.nan, self._posture  # of the last state [s, rad]
        self._given_up = set[int]()  # joints that hold still, by the place in `names`
        self._approaches: dict[str, _Approach] = {}  # of hands and joints with a command
        self._news = [] if apart else [_UNPROTECTED]
        size = len(self._joints)
        self._numbers = {foot: np.zeros(size * (model.n + 5)) for foot in Foot}
        for foot in Foot:
            self._set(foot, self._posture, np.zeros(size), np.ones(size), self._swing)

    def _hand(self, side: str, link: str) -> Hand:
        model = self._model
        if link not in model.frames:
            raise ConfigError(f"arms.{side}_hand is '{link}', and the robot has no such link")
        moved = self._moved_with(link)
        if not moved:
            raise ConfigError(f"arms.{side}_hand is '{link}', which no joint of arms.joints moves")
        trunk = model.links[model.bodies[moved[0]].parent]
        joints = np.isin(self._joints, [model.bodies[body].joint for body in moved])
        return Hand(link, trunk, np.flatnonzero(joints))

    def _moved_with(self, link: str) -> list[int]:
        """Return the bodies between root and link whose joints are those of an arm."""
        model = self._model
        chain = model.chain(model.frames[link].body)
        return [body for body in chain if model.bodies[body].joint in self._joints]

    # ------------------------------------------------------------------ tasks

    def tasks(self, base: Foot) -> tuple[Task, ...]:
        """Return the tasks of a phase on the sole `base`."""
        a, model = self._config, self._model
        sole = model.soles[base.other]
        joints = Beside(
            name="arms", weight=a.weight, eta=a.rate, saturation=a.joint_speed / a.rate, size=len(self._joints),
            features=(JointAngles(), Point(sole.frame, sole.center)), numbers=self._numbers[base],
        )  # fmt: skip
        hands = (
            HandInTrunk(
                name=f"{side}_hand", weight=a.hand_weight, eta=a.rate, saturation=a.hand_speed / a.rate,
                hand=hand.link, trunk=hand.trunk, numbers=hand.numbers,
            )
            for side, hand in self.hands.items()
        )  # fmt: skip
        return (joints, *hands)

    def _set(self, base: Foot, q: Array, dq: Array, factor: Array, swing: Array) -> None:
        """Set the task of the joints: q - q_d - g d, where d is by how much the left foot is ahead, times a factor."""
        k = len(self._joints)
        b, rate, A = parts(self._numbers[base], k)
        b[:], rate[:] = factor * q, factor * dq
        A[np.arange(k), self._joints] = factor
        A[:, self._model.n] = factor * swing * (1.0 if base is Foot.LEFT else -1.0)

    def update(self, phase: Phase, kin: Kinematics, state: State) -> None:
        """Set the tasks for a state, with the robot `kin` in the base sole of `phase`."""
        if phase.base is not self._base:
            if self._base is not None:
                moved = DQ(kin.pose(kin.swing))  # the previous base sole
                for hand in self.hands.values():
                    hand.pose = moved * hand.pose if hand.fixed and hand.pose is not None else hand.pose
            self._base = phase.base
        self._time, self._q = state.time, kin.q[self._joints]
        for place, path, begin in self._asked:
            if path.times[0] > 0.0:
                path = path.beginning_at(float(self._q[place]))
            self._paths[place] = path, self._time if begin is None else begin
            self._approaches[self.names[place]] = _Approach(_OF_JOINT)
        self._asked = []
        q, dq, swing, factor = self._posture.copy(), np.zeros(len(self._joints)), self._swing, np.ones(len(self.names))
        self._set_paths(q, dq)
        if self._paths:
            swing = swing.copy()
            swing[list(self._paths)] = 0.0
        self._set_hands(kin, state.dq, factor)
        self._set(phase.base, q, dq, factor, swing)

    def _set_paths(self, q: Array, dq: Array) -> None:
        """Set the angles (k,) and velocities (k,) of the joints that follow a path, and forget the paths that end."""
        fastest = self._limits.fastest
        for place, (path, begin) in list(self._paths.items()):
            end = begin + float(path.times[-1])
            if self._is_over(end):
                self._release([place])
                continue
            q[place], speed = path.at(self._time - begin)
            dq[place] = min(max(speed, -fastest[place]), fastest[place])  # also to a first point
            if self._time > end:
                self._note(self.names[place], abs(float(self._q[place] - q[place])), "rad")

    def _set_hands(self, kin: Kinematics, dq: Array | None, factor: Array) -> None:
        """Set the tasks of the hands, and the factors (k,) of the joints that move those with a pose."""
        for side, hand in self.hands.items():
            if hand.pose is not None:
                hand.since = self._time if math.isnan(hand.since) else hand.since
                if self._is_over(hand.since):
                    hand.pose = None
                else:
                    factor[hand.joints] = _LOOSE
            hand.set(kin, dq, self._config.lever)
            if hand.pose is not None:
                self._note(f"the {side} hand", hand.distance(kin), "m")

    def _note(self, what: str, distance: float, unit: str) -> None:
        """Note, once for each command, that a hand or joint has stopped before it is where it was sent."""
        if self._approaches[what].stops(self._time, distance):
            pressed = self._time - self._priority.pressed < _PATIENCE
            why = f"the body is in the way ({self._priority.by})" if pressed else "it is out of reach"
            self._news.append(f"{what} stops {distance:.2g} {unit} from where it was sent: {why}")

    def news(self) -> list[str]:
        """Return what has happened to commands since the last call, in sentences."""
        news, self._news = self._news, []
        return news

    def give_up(self, joint: int) -> NDArray[np.intp]:
        """Let the arm of a joint that does not follow hold still where it is, until its next command.

        Returns
        -------
        ndarray of int
            The joints that hold still; none if this is no joint of an arm, or the arm holds still already.
        """
        place = np.flatnonzero(self._joints == joint)
        arm = next((hand.joints for hand in self.hands.values() if np.isin(place, hand.joints).any()), place)
        if not arm.size or self._given_up & {*place.tolist()}:
            return np.zeros(0, np.intp)
        self._end_poses(arm)
        self._release(arm)
        self._given_up |= {*arm.tolist()}
        for one in arm.tolist():
            self._paths[one] = JointPath(np.zeros(1), self._q[[one]]), self._time
            self._approaches[self.names[one]] = _Approach(_OF_JOINT)
        self._news.append(
            f"{self.names[place[0]]} does not follow: its arm holds still where it is; something blocks it"
        )
        return self._joints[arm]

    def _is_over(self, last: float) -> bool:
        """Return whether the timeout of a command has passed, which ended or began at the time `last` [s]."""
        return 0.0 < self._config.timeout < self._time - last

    # ------------------------------------------------------------------ the program

    def solved(self, now: Evaluation, solve: Callable[[Problem], Solution]) -> Solution:
        """Return the solution of the quadratic program of an evaluation, in which the walk has priority.

        Parameters
        ----------
        solve : callable
            Returns the solution of a program.
        """
        return self._priority.solved(now, self._slowed(now.problem), solve, self._time)

    def _slowed(self, problem: Problem) -> Problem:
        """Return a program in which no joint with a command is quicker than allowed, such as a stretched elbow."""
        places = [*self._paths, *(one for hand in self.hands.values() if hand.pose is not None for one in hand.joints)]
        if not places:
            return problem
        most = np.full(self._model.n, np.inf)
        most[self._joints[places]] = self._limits.fastest[places]
        return problem.replaced(lower=np.clip(problem.lower, -most, most), upper=np.clip(problem.upper, -most, most))

    # ------------------------------------------------------------------ commands

    def follow(
        self,
        names: Sequence[str],
        times: ArrayLike,
        angles: ArrayLike,
        velocities: ArrayLike | None = None,
        begin: float | None = None,
    ) -> None:
        """Follow a trajectory of some joints; without points they return to their posture.

        Parameters
        ----------
        times : array_like, shape (k,)
            Times of the points since the beginning [s].
        angles, velocities : array_like, shape (k, joints)
            [rad, rad/s]
        begin : float, optional
            Time at which it begins [s]; by default with the next state.

        Raises
        ------
        StateError
            If it is not a trajectory of joints of the arms within their limits; the message names the point.
        """
        places = self._places(names)
        if begin is not None and not abs(begin - self._time) < _LONGEST_WAIT:
            late = begin - self._time
            raise StateError(
                f"the trajectory begins {late:.3g} s after the last state; without a stamp it does at once"
            )
        paths = checked(self._limits, places, times, angles, velocities)
        self._release(places)
        self._asked += [(place, path, begin) for place, path in zip(places, paths, strict=False)]
        self._end_poses(places)

    def _places(self, names: Sequence[str]) -> list[int]:
        if not names:
            raise StateError("the trajectory names no joint")
        if unknown := [name for name in names if name not in self.names]:
            raise StateError(f"{listed(unknown)} is no joint of the arms; they are {', '.join(self.names)}")
        if len(set(names)) < len(names):
            raise StateError("the trajectory names a joint twice")
        return [self.names.index(name) for name in names]

    def reach(self, side: str, pose: DQ | None, frame: str = "") -> None:
        """Move a hand to a pose; None lets the arm return to its posture.

        Parameters
        ----------
        side : str
            ``left`` or ``right``.
        frame : str
            A link of the body that carries the arm. Empty: the present base sole; the pose stays where it is on the
            ground while the robot walks on.

        Raises
        ------
        StateError
            If there is no such hand or link, or no base sole yet.
        """
        if side not in self.hands:
            raise StateError(f"there is no {side} hand (arms.{side}_hand)")
        hand, frames = self.hands[side], self._model.frames
        if pose is not None and frame:
            trunk = frames[hand.trunk]
            if frame not in frames or frames[frame].body != trunk.body:
                given = shown(frame)
                raise StateError(f"the pose of the {side} hand is in '{given}', which is not fixed to '{hand.trunk}'")
            pose = DQ(trunk.pose).conj() * DQ(frames[frame].pose) * pose
        elif pose is not None and self._base is None:
            raise StateError("the walk has not begun, so it has no place on the ground")
        hand.pose, hand.fixed, hand.since = pose, not frame, math.nan
        self._approaches[f"the {side} hand"] = _Approach(_OF_HAND)
        self._release(hand.joints)

    def _end_poses(self, places: Iterable[int]) -> None:
        """Forget the poses of hands that some joints move."""
        for hand in self.hands.values():
            if set(hand.joints) & set(places):
                hand.pose = None

    def _release(self, places: Iterable[int]) -> None:
        """Forget the trajectories of some joints, and that they have been given up."""
        gone = set(places)
        self._given_up -= gone
        self._asked = [one for one in self._asked if one[0] not in gone]
        self._paths = {place: path for place, path in self._paths.items() if place not in gone}

    def pose_in_trunk(self, side: str, kin: Kinematics) -> DQ:
        """Return the pose of a hand in the link that carries the arm."""
        hand = self.hands[side]
        return DQ(kin.pose(hand.trunk)).conj() * DQ(kin.pose(hand.link))
