"""Arms beside a walk: they hold a posture, swing with the legs, and follow trajectories of joints and poses of hands.

What they do is two kinds of tasks in the quadratic program of the walk, with little weight: the walk has priority, and
limits and distances are kept by all joints. A pose of a hand is one in the trunk, so that its task moves the arm only.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.paper.assembly import Evaluation
from dqwalk_ros.paper.collisions import capsules_in
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.features import Affine, Direction, Feature, JointAngles, Point
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import Phase
from dqwalk_ros.paper.qp.problem import Problem, Solution
from dqwalk_ros.paper.state import State
from dqwalk_ros.paper.tasks import Task
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.support.errors import ConfigError, StateError
from dqwalk_ros.support.wording import listed, shown

_LOOSE = 0.03
"""Factor of the errors of joints whose hand follows a pose: their posture decides what the pose leaves free."""
_LONGEST_WAIT = 60.0
"""Largest time from the last state to the beginning of a trajectory [s]: a longer one is that of another clock."""
_FIRST = 10.0
"""Weight of the walk's joint velocities when those of the arms are chosen, much larger than those of the arms."""
_FREE = 0.5
"""Time for which an arm must not have pressed on the body until it is free again [s]: its rows come and go."""
_PATIENCE = 2.0
"""Time without progress after which an arm has stopped short of where it was sent [s]."""
_NEAR = 0.005, 0.02
"""Least progress of a hand [m] and of a joint [rad] towards where it was sent (`_Approach.enough`)."""
_SPEEDS = "arms.joint_speed, joints.velocity, or the joint's own"
"""What limits the speed of an arm's joint."""
_UNPROTECTED = (
    "nothing keeps the arms from the body: collision.pairs has no link of an arm; `dqwalk config FILE --capsules` "
    "prints pairs and capsules"
)
_MOST_POINTS = 10_000
"""Largest number of points of a trajectory."""


class Live:
    """Part of a task whose `numbers`, a one-dimensional array, may all change with every state."""

    numbers: Array

    @property
    def parameters(self) -> Array:
        """All numbers, which are live."""
        return self.numbers

    @property
    def live(self) -> Array:
        """All numbers."""
        return self.numbers


@dataclass(frozen=True, kw_only=True)
class Beside(Live, Affine, Task):
    """Task e = A s - b of which all numbers may change with every state."""

    features: tuple[Feature, ...]
    """With m coordinates s."""
    numbers: Array
    """b, its derivative by time, and the rows of A, shape (k (m + 2),)."""
    size: int
    """Number k of errors."""

    @property
    def watches(self) -> tuple[Feature, ...]:
        """The features."""
        return self.features

    @property
    def A(self) -> Array:
        """The present gradient, shape (k, m)."""
        return _parts(self.numbers, self.size)[2]


def _parts(numbers: Array, size: int) -> tuple[Array, Array, Array]:
    """Return views of b (k,), its derivative (k,) and A (k, m) of the numbers of `Beside`."""
    return numbers[:size], numbers[size : 2 * size], numbers[2 * size :].reshape(size, -1)


@dataclass(frozen=True)
class JointPath:
    """Path of one joint: cubic where velocities are given at the points, otherwise straight from point to point."""

    times: Array
    """Increasing, shape (k,) [s]."""
    angles: Array
    """Shape (k,) [rad]."""
    velocities: Array | None = None
    """Shape (k,) [rad/s]."""

    def at(self, time: float) -> tuple[float, float]:
        """Return angle [rad] and velocity [rad/s] at a time [s]; before and after the path the joint is at rest."""
        times, q, v = self.times, self.angles, self.velocities
        k = int(np.searchsorted(times, time, side="right")) - 1
        if k < 0 or k >= len(times) - 1:
            return float(q[max(k, 0)]), 0.0
        h, way = times[k + 1] - times[k], q[k + 1] - q[k]
        s = (time - times[k]) / h
        if v is None:
            return float(q[k] + s * way), float(way / h)
        a, c, d = _cubic(h, way, v[k], v[k + 1])
        return float(q[k] + s * (a + s * (c + s * d))), float((a + s * (2.0 * c + 3.0 * s * d)) / h)

    def fastest(self) -> list[float]:
        """Return the largest speed between each two points [rad/s]."""
        out, v = [], self.velocities
        for k, (h, way) in enumerate(zip(np.diff(self.times).tolist(), np.diff(self.angles).tolist(), strict=True)):
            if v is None:
                out.append(abs(way) / h)
                continue
            a, c, d = _cubic(h, way, v[k], v[k + 1])  # its velocity is a parabola
            top = min(max(-c / (3.0 * d), 0.0), 1.0) if d else 0.0
            out.append(max(abs(a + s * (2.0 * c + 3.0 * s * d)) / h for s in (0.0, top, 1.0)))
        return out


def _cubic(h: float, way: float, begin: float, end: float) -> tuple[float, float, float]:
    """Return a, c and d of the way a s + c s^2 + d s^3, s in [0, 1], in a time h [s], by the velocities at its ends."""
    a, b = h * begin, h * end
    return a, 3.0 * way - 2.0 * a - b, a + b - 2.0 * way


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


@jit
def _hand_in_trunk(s: Array, a: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Return the error (9,) of a hand in its trunk [m], its gradient (9, 21), and minus the rate of the target (9,).

    `s` (21,) are position and first two axes of the hand, origin and axes l_k of the trunk. The errors are
    l_k . (p - o) - p_k, and those of the two axes times a lever. `a` (14,) are the desired position and axes in the
    trunk, the velocity of that position, the lever, and 1, or 0 for no task.
    """
    w, lever, on = s[:3] - s[9:12], a[12], a[13]
    e, G, rate = np.zeros(9), np.zeros((9, 21)), np.zeros(9)
    for k in range(3):
        at = 12 + 3 * k
        axis = s[at : at + 3]
        e[k] = on * (axis @ w - a[k])
        G[k, :3], G[k, 9:12], G[k, at : at + 3] = on * axis, -on * axis, on * w
        rate[k] = -on * a[9 + k]
        for j in range(2):
            row, own = 3 + 3 * j + k, 3 + 3 * j
            of_hand = s[own : own + 3]
            e[row] = on * lever * (axis @ of_hand - a[own + k])
            G[row, own : own + 3], G[row, at : at + 3] = on * lever * axis, on * lever * of_hand
    return e, G, rate


@dataclass(frozen=True, kw_only=True)
class HandInTrunk(Live, Task):
    """Task that a hand follows a pose in the trunk, which may change with every state."""

    hand: str
    trunk: str
    """Links."""
    numbers: Array
    """Parameters of `_hand_in_trunk`, shape (14,)."""
    function = _hand_in_trunk

    @property
    def watches(self) -> tuple[Feature, ...]:
        """Position and two axes of the hand, position and three axes of the trunk."""
        of_hand = (Direction(self.hand, axis) for axis in np.eye(3)[:2])
        return Point(self.hand), *of_hand, Point(self.trunk), *(Direction(self.trunk, axis) for axis in np.eye(3))


@dataclass(eq=False)
class Hand:
    """A hand, and the pose that it follows."""

    link: str
    trunk: str
    """Link that carries the arm."""
    joints: NDArray[np.intp]
    """Which of the joints of `Arms` move the hand against the trunk, shape (k,)."""
    pose: DQ | None = None
    """The pose it follows, in the trunk or, if `fixed`, in the base sole; None without a command."""
    fixed: bool = False
    since: float = math.nan
    """Time of the first state after the command [s]."""
    numbers: Array = field(default_factory=lambda: np.zeros(14))
    """Parameters of `_hand_in_trunk`, shape (14,)."""

    def set(self, kin: Kinematics, dq: Array | None, lever: float) -> None:
        """Set the task for a state with the joint velocities `dq` (n,) [rad/s].

        A pose on the ground moves in the trunk, with the velocity that its point of the trunk has, reversed.
        """
        self.numbers[:] = 0.0
        if self.pose is None:
            return
        trunk = DQ(kin.pose(self.trunk))
        x = trunk.conj() * self.pose if self.fixed else self.pose
        p = x.translation()
        self.numbers[:9] = *p, *x.rotation_matrix().T[:2].ravel()
        if self.fixed and dq is not None:
            self.numbers[9:12] = -trunk.rotation_matrix().T @ kin.point_jacobian(self.trunk, p) @ dq
        self.numbers[12:] = lever, 1.0

    def distance(self, kin: Kinematics) -> float:
        """Return the distance of the hand from its position [m]."""
        p = DQ(kin.pose(self.trunk)).conj().transform_point(kin.point(self.link))
        return float(np.linalg.norm(p - self.numbers[:3]))


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
        self._low, self._high = model.q_min[self._joints] + margin, model.q_max[self._joints] - margin
        self._fastest = np.minimum(model.velocity_max[self._joints], min(most, a.joint_speed))
        named = {"left": a.left_hand, "right": a.right_hand}
        if a.left_hand and a.left_hand == a.right_hand:
            raise ConfigError(f"arms.left_hand and arms.right_hand are both '{a.left_hand}'")
        self.hands = {side: self._hand(side, link) for side, link in named.items() if link}
        self._paths: dict[int, tuple[JointPath, float]] = {}  # path and its beginning [s], by the place in `names`
        self._asked: list[tuple[int, JointPath, float | None]] = []  # since the last state
        self._apart = {
            pair.name
            for pair in capsules_in(config, model)
            if any(self._moved_with(capsule.frame) for capsule in (pair.one, pair.other))
        }
        self._tasks = ("arms", *(f"{side}_hand" for side in self.hands))
        self._base: Foot | None = None
        self._time, self._q = math.nan, self._posture  # of the last state [s, rad]
        self._given_up = set[int]()  # joints that hold still, by the place in `names`
        self._pressed, self._rows = math.nan, ""  # when and by which rows an arm was last kept from the body [s]
        self._approaches: dict[str, _Approach] = {}  # of hands and joints with a command
        self._news = [] if self._apart else [_UNPROTECTED]
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
        b, rate, A = _parts(self._numbers[base], k)
        b[:], rate[:] = factor * q, factor * dq
        A[np.arange(k), self._joints] = factor
        A[:, self._model.n] = factor * swing * (1.0 if base is Foot.LEFT else -1.0)

    def update(self, phase: Phase, kin: Kinematics, state: State) -> None:
        """Set the tasks for a state, with the robot `kin` in the base sole of `phase`."""
        time = state.time
        if phase.base is not self._base:
            if self._base is not None:
                moved = DQ(kin.pose(kin.swing))  # the previous base sole
                for hand in self.hands.values():
                    hand.pose = moved * hand.pose if hand.fixed and hand.pose is not None else hand.pose
            self._base = phase.base
        self._time, self._q = time, kin.q[self._joints]
        for place, path, begin in self._asked:
            if path.times[0] > 0.0:
                path = _from_here(path, float(kin.q[self._joints[place]]))
            self._paths[place] = path, time if begin is None else begin
            self._approaches[self.names[place]] = _Approach(_NEAR[1])
        self._asked = []
        q, dq, swing, factor = self._posture.copy(), np.zeros(len(self._joints)), self._swing, np.ones(len(self.names))
        for place, (path, begin) in list(self._paths.items()):
            if self._is_over(begin + float(path.times[-1]), time):
                self._release([place])
            else:
                q[place], speed = path.at(time - begin)
                dq[place] = min(max(speed, -self._fastest[place]), self._fastest[place])  # also to a first point
                if time > begin + path.times[-1]:
                    self._note(self.names[place], abs(float(kin.q[self._joints[place]] - q[place])), "rad")
        if self._paths:
            swing = swing.copy()
            swing[list(self._paths)] = 0.0
        for side, hand in self.hands.items():
            if hand.pose is not None:
                hand.since = time if math.isnan(hand.since) else hand.since
                if self._is_over(hand.since, time):
                    hand.pose = None
                else:
                    factor[hand.joints] = _LOOSE
            hand.set(kin, state.dq, self._config.lever)
            if hand.pose is not None:
                self._note(f"the {side} hand", hand.distance(kin), "m")
        self._set(phase.base, q, dq, factor, swing)

    def _note(self, what: str, distance: float, unit: str) -> None:
        """Note, once for each command, that a hand or joint has stopped before it is where it was sent."""
        if self._approaches[what].stops(self._time, distance):
            pressed = self._time - self._pressed < _PATIENCE
            why = f"the body is in the way ({self._rows})" if pressed else "it is out of reach"
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
            self._approaches[self.names[one]] = _Approach(_NEAR[1])
        self._news.append(
            f"{self.names[place[0]]} does not follow: its arm holds still where it is; something blocks it"
        )
        return self._joints[arm]

    def _is_over(self, last: float, time: float) -> bool:
        return 0.0 < self._config.timeout < time - last

    # ------------------------------------------------------------------ priority of the walk

    def solved(self, now: Evaluation, solve: Callable[[Problem], Solution]) -> Solution:
        """Return the solution of the quadratic program of an evaluation, in which the walk has priority.

        A task of the arms has no gradient in other joints, but a row that keeps an arm from the body has: while one is
        active, the program would turn the trunk away from an arm that presses on it. Then the walk is solved without
        arms; next the arms, to which the other joints yield only if the rows have no other solution; and at last the
        whole robot, with these velocities as the only task of the arms.

        Parameters
        ----------
        solve : callable
            Returns the solution of a program.
        """
        problem, of_arms = self._slowed(now.problem), self._of_arms(now.problem)
        if not of_arms.any():
            return solve(problem)
        if not self._time - self._pressed < _FREE:
            solution = solve(problem)
            self._note_pressing(of_arms, problem, solution)
            if self._pressed != self._time:
                return solution
        n, arms, weight = self._model.n, self._joints, self._config.weight
        others = np.delete(np.arange(n), arms)
        H, c = now.share(self._tasks)
        walk_H, walk_c = problem.H - H, problem.c - c
        walk_H[arms, arms] += weight
        keeps = ~of_arms
        names = (*itertools.compress(problem.names, keeps), *problem.names[len(keeps) :])
        u = solve(problem.replaced(H=walk_H, c=walk_c, W=problem.W[keeps], w=problem.w[keeps], names=names)).u
        H[arms, arms] += now.assembly.damping**2
        H[others, others] += _FIRST
        c[others] -= _FIRST * u[others]
        chosen = problem.replaced(H=H, c=c)
        solution = solve(chosen)
        self._note_pressing(of_arms, chosen, solution)
        c = walk_c.copy()
        c[arms] -= weight * solution.u[arms]
        return solve(problem.replaced(H=walk_H, c=c))

    def _slowed(self, problem: Problem) -> Problem:
        """Return a program in which no joint with a command is quicker than allowed, such as a stretched elbow."""
        places = [*self._paths, *(one for hand in self.hands.values() if hand.pose is not None for one in hand.joints)]
        if not places:
            return problem
        most = np.full(self._model.n, np.inf)
        most[self._joints[places]] = self._fastest[places]
        return problem.replaced(lower=np.clip(problem.lower, -most, most), upper=np.clip(problem.upper, -most, most))

    def _of_arms(self, problem: Problem) -> NDArray[np.bool_]:
        """Return which rows of a program keep a link of an arm from others, shape (l + m,)."""
        return np.array([name in self._apart for name in problem.names[: len(problem.w)]], dtype=bool)

    def _note_pressing(self, of_arms: NDArray[np.bool_], problem: Problem, solution: Solution) -> None:
        """Note the time if one of the rows `of_arms` is active."""
        least = 1e-6 * max(float(np.abs(problem.c).max()), 1e-300)
        if (active := of_arms & (solution.z[: len(of_arms)] > least)).any():
            self._pressed = self._time
            self._rows = ", ".join(itertools.compress(problem.names, active))

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
        t, q = np.atleast_1d(np.asarray(times, dtype=np.float64)), np.asarray(angles, dtype=np.float64)
        places = self._places(names)
        if begin is not None and not abs(begin - self._time) < _LONGEST_WAIT:
            late = begin - self._time
            raise StateError(
                f"the trajectory begins {late:.3g} s after the last state; without a stamp it does at once"
            )
        if len(t) > _MOST_POINTS:
            raise StateError(f"the trajectory has {len(t)} points; {_MOST_POINTS} at most")
        v = None if velocities is None else np.asarray(velocities, dtype=np.float64)
        for what, matrix in (("positions", q), ("velocities", v)):
            if len(t) and matrix is not None and matrix.shape != (len(t), len(names)):
                raise StateError(f"the trajectory has {matrix.shape} {what} for {len(t)} points of {len(names)} joints")
        if len(t) and not (np.isfinite(t).all() and t[0] >= 0.0 and (np.diff(t) > 0.0).all()):
            raise StateError("the times of the trajectory's points are not finite, not positive or not increasing")
        for column, place in enumerate(places):
            for k in range(len(t)):
                self._check(place, k, float(q[k, column]), 0.0 if v is None else float(v[k, column]))
        paths = [
            JointPath(t, q[:, k].copy(), None if v is None else v[:, k].copy())
            for k in range(len(places) if len(t) else 0)
        ]
        for place, path in zip(places, paths, strict=False):
            for k, needed in enumerate(path.fastest(), start=2):
                if needed > self._fastest[place] * (1.0 + 1e-9):
                    raise StateError(
                        f"{self.names[place]} needs {needed:.3g} rad/s to point {k} of the trajectory; "
                        f"its limit is {self._fastest[place]:g} ({_SPEEDS})"
                    )
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

    def _check(self, place: int, k: int, q: float, v: float) -> None:
        """Raise a `StateError` if an angle or a velocity of a point is not within the limits of its joint."""
        where, low, high = f"point {k + 1} of {self.names[place]}", self._low[place], self._high[place]
        if not low <= q <= high:
            raise StateError(f"{where} is {q:.4g} rad; its limits are {low:.4g} and {high:.4g}")
        if not abs(v) <= self._fastest[place]:
            raise StateError(f"{where} has {v:.4g} rad/s; its limit is {self._fastest[place]:g} ({_SPEEDS})")

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
        self._approaches[f"the {side} hand"] = _Approach(_NEAR[0])
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


def _from_here(path: JointPath, q: float) -> JointPath:
    """Return a path that begins at time 0 at rest at the angle `q` [rad]."""
    v = None if path.velocities is None else np.append(0.0, path.velocities)
    return JointPath(np.append(0.0, path.times), np.append(q, path.angles), v)
