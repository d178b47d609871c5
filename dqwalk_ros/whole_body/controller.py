"""The whole-body controller: joint torques from one hierarchical least-squares problem per period [Sherikov2014]."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from dqwalk_ros.config import Config
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.state import Command, State
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import StateError
from dqwalk_ros.whole_body.dynamics import Dynamics, Multibody, rotation_error
from dqwalk_ros.whole_body.equations import Scene, hierarchy
from dqwalk_ros.whole_body.hierarchy import Answer, Hierarchy, HierarchySolver
from dqwalk_ros.whole_body.objectives import Distance, FrameOrientation, FramePosition, JointPosture, Objective
from dqwalk_ros.whole_body.preview import PointMass, Stepping, previewed

_EPS = 1e-9
_LOW = 0.2
"""Relative error of the CoM's height that counts as a fall."""
_LEANS = 1.0
"""Inclination of the torso that counts as a fall [rad], also if bent legs keep the CoM at its height."""


@dataclass(slots=True, eq=False, kw_only=True)
class BodyState(State):
    """A state of the whole body: joint angles and velocities, and pose and velocity of the root link in the world."""

    dq: Array = field()  # required here, optional in `State`
    """Joint velocities, shape (n,) [rad/s]."""
    x_base: Array
    """Pose of the root link, shape (8,)."""
    v_base: Array
    """Its linear and angular velocity in its own axes, shape (6,) [m/s, rad/s]."""

    @property
    def v(self) -> Array:
        """Generalized velocity, shape (6 + n,)."""
        return np.concatenate([self.v_base, self.dq])


@dataclass(slots=True, eq=False, kw_only=True)
class BodyCommand(Command):
    """Joint torques for the next period, and the predicted motion: `velocity` is that at its end."""

    effort: Array
    """tau of (S1), shape (n,) [N m]."""
    stance: tuple[Foot, ...]
    """Feet on the ground."""
    landing: Foot | None = None
    """The foot that touches down at the end of the period."""


@dataclass(frozen=True)
class BodyTick:
    """Problem and solution of one control period."""

    scene: Scene
    """Dynamics, stance and preview."""
    problem: Hierarchy
    answer: Answer
    """Solution of the problem."""
    wrenches: Mapping[Foot, Array]
    """Planned force and moment of the ground on each standing foot, about its sole link's origin, in world axes, shape
    (6,) [N, N m]."""
    times: tuple[float, float, float, float]
    """Time taken by model, assembly and solution, and in total [s]."""

    @property
    def footsteps(self) -> Array:
        """The landing places previewed, shape (K, 2) [m]."""
        return self.scene.footsteps(self.answer.x)


class WholeBodyController:
    """Controls a robot that walks as its objectives require, and that can stop within the preview at any time.

    Parameters
    ----------
    model : RobotModel
        A robot whose ankles pitch and roll.
    objectives : sequence of Objective
        Additional objectives, besides (S17) to (S19).
    distances : sequence of Distance
        Additional constraints, besides those of section II.
    clock : callable
        Clock for the times in `last` [s].

    Attributes
    ----------
    weight : float
        m g [N].
    stepping : Stepping
    point_mass : PointMass

    Raises
    ------
    ModelError
        If the robot lacks a link that `config` names, or cannot stand in the configured posture.
    ConfigError
        If ``whole_body.posture`` or ``whole_body.free`` has an invalid entry, or names a joint that the robot lacks.
    """

    def __init__(
        self,
        config: Config,
        model: RobotModel,
        *,
        objectives: Sequence[Objective] = (),
        distances: Sequence[Distance] = (),
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.config, self.model = config, model
        self._own, self._distances, self._clock = tuple(objectives), tuple(distances), clock
        settings = config.whole_body
        self._soles = {foot: model.soles[foot].frame for foot in Foot}
        own = [frame for objective in self._own for frame in objective.frames]
        own += [frame for distance in self._distances for frame in distance.frames]
        self._body = Multibody(model, dict.fromkeys([*self._soles.values(), settings.torso, settings.hand, *own]))
        self.weight = self._body.mass * GRAVITY
        self.stepping = Stepping.of(config)
        posture = model.posture(settings.posture, "whole_body.posture")
        self._start = self._body.stand(posture, settings.feet_distance, settings.torso)
        still = self._body.at(*self._start, np.zeros(self._body.nv))
        self.point_mass = PointMass(float(still.com[2]), settings.interval, settings.intervals)
        free = np.zeros(model.n, dtype=bool)
        for pattern in settings.free:
            free[model.matching(pattern, "whole_body.free")] = True
        kp = np.where(free, 0.0, settings.joint_kp)
        kd = np.where(free, settings.joint_kd, 2.0 * math.sqrt(settings.joint_kp))
        self._upright = FrameOrientation(
            name="torso", weight=settings.torso_weight, kp=settings.torso_kp, frame=settings.torso
        )
        self._posture = JointPosture(
            name="joints", weight=settings.joint_weight, reference=self._start[1], stiffness=kp, damping=kd
        )
        self.reset()

    def reset(self) -> None:
        """Discard the walk and the hand's target; the next state begins a new walk."""
        self._solver = HierarchySolver(clock=self._clock)
        self._places: dict[int, Array] = {}
        self._landing: Array | None = None
        self._last: BodyTick | None = None
        self._reach: FramePosition | None = None

    @property
    def last(self) -> BodyTick:
        """Problem and solution of the last step."""
        if self._last is None:
            raise RuntimeError("there is no tick before the first step")
        return self._last

    @property
    def posture_error(self) -> tuple[float, float]:
        """Error of the CoM's height [m], and inclination of the torso [rad], at the last step."""
        d = self.last.scene.dynamics
        tilt = rotation_error(d.frames[self.config.whole_body.torso].rotation)
        return float(d.com[2] - self.point_mass.height), float(np.linalg.norm(tilt))

    @property
    def finished(self) -> bool:
        """Whether the walk is over, because the robot has fallen at the last step."""
        height_error, tilt = self.posture_error
        return abs(height_error) > _LOW * self.point_mass.height or tilt > _LEANS

    @property
    def start(self) -> BodyState:
        """The initial state of a walk: at rest, the middle between the feet at the origin of the world."""
        x_base, q = self._start
        return BodyState(0.0, q, dq=np.zeros(self.model.n), x_base=x_base, v_base=np.zeros(6))

    @property
    def target(self) -> Array | None:
        """Target of the hand in the world, shape (3,) [m]; None without a target."""
        return None if self._reach is None else self._reach.target

    def reach(self, target: ArrayLike | None) -> None:
        """Set the target of the hand (S17) in the world (3,) [m], at any time; with None the robot walks in place.

        Raises
        ------
        StateError
            If the target is not three finite numbers.
        """
        self._reach = self._hand(target)

    def footsteps_for(self, target: ArrayLike | None) -> Array:
        """Return the footsteps that the last step would have previewed for another target of the hand, (K, 2) [m].

        Raises
        ------
        StateError
            If the target is not three finite numbers.
        RuntimeError
            Before the first step.
        """
        scene = self.last.scene
        return scene.footsteps(HierarchySolver().solve(self._hierarchy(scene, self._hand(target))).x)

    def _hand(self, target: ArrayLike | None) -> FramePosition | None:
        """Return the objective (S17) for a target; None without one."""
        if target is None:
            return None
        place = np.asarray(target, dtype=np.float64)
        if place.shape != (3,) or not np.isfinite(place).all():
            raise StateError(f"a target is three finite coordinates, got {target}")
        s = self.config.whole_body
        return FramePosition(
            name="hand", weight=s.hand_weight, kp=s.hand_kp, frame=s.hand, target=place, saturation=s.hand_saturation
        )

    def _hierarchy(self, scene: Scene, reach: FramePosition | None) -> Hierarchy:
        objectives = [*([reach] if reach else []), self._upright, self._posture, *self._own]
        return hierarchy(self.config.whole_body, self.model, scene, objectives, self._distances)

    def step(self, state: BodyState, dt: float) -> BodyCommand:
        """Return the joint torques for the next period.

        Parameters
        ----------
        dt : float
            Period until the next state [s].

        Raises
        ------
        StateError
            If the state does not fit the model or is not finite.
        QPError
            If the equations of motion and the contact constraints have no solution.
        """
        self._check(state)
        times = [self._clock()]
        d = self._body.at(state.x_base, state.q, state.v)
        times.append(self._clock())
        scene = self._look(state.time, dt, d)
        problem = self._hierarchy(scene, self._reach)
        times.append(self._clock())
        answer = self._solver.solve(problem)
        acceleration, wrenches = answer.x[: d.nv], scene.wrenches(self.config.whole_body, answer.x)
        effort = d.H[6:] @ acceleration + d.h[6:]
        for foot, wrench in wrenches.items():
            effort -= scene.stance[foot].jacobian[:, 6:].T @ wrench
        if scene.swing is not None and scene.settled is None:
            self._landing = scene.footsteps(answer.x)[0]
        spent = (times[1] - times[0], times[2] - times[1], answer.solve_time, self._clock() - times[0])
        self._last = BodyTick(scene, problem, answer, wrenches, spent)
        return BodyCommand(
            state.time,
            state.dq + dt * acceleration[6:],
            effort=effort,
            stance=tuple(scene.stance),
            landing=self.stepping.landing(state.time, dt),
        )

    def _check(self, state: BodyState) -> None:
        n = self.model.n
        sizes = {"q": n, "dq": n, "x_base": 8, "v_base": 6}
        for what, shape in sizes.items():
            value = getattr(state, what)
            if value.shape != (shape,) or not np.isfinite(value).all():
                raise StateError(f"the state's {what} must be {shape} finite numbers, got {value}")

    def _look(self, now: float, dt: float, dynamics: Dynamics) -> Scene:
        """Return the scene: positions of the standing feet, the swing, and the preview."""
        settings, stepping, soles = self.config.whole_body, self.stepping, self._soles
        swing = stepping.swing(now)
        here = {foot: dynamics.frames[frame].position[:2] for foot, frame in soles.items()}
        if not self._places:
            self._places[-1] = 0.5 * (here[Foot.LEFT] + here[Foot.RIGHT])
        for index in range(max(self._places) + 1, stepping.landed(now) + 1):
            self._places[index], self._landing = here[stepping.foot(index)].copy(), None
        self._places = {index: self._places[index] for index in sorted(self._places)[-2:]}
        settled = swing is not None and swing.remaining < settings.freeze - _EPS
        return Scene(
            dt=dt,
            dynamics=dynamics,
            mass=self.point_mass,
            weight=self.weight,
            stance={foot: dynamics.frames[soles[foot]] for foot in stepping.stance(now)},
            preview=previewed(settings, stepping, self.point_mass, now, dynamics.com, self._places),
            support=self._places[max(self._places)],
            swing=swing,
            sole=None if swing is None else dynamics.frames[soles[swing.foot]],
            settled=self._landing if settled else None,
        )
