"""The controller: each period one hierarchy over the motion now and its preview, joint torques out [Sherikov2014]."""

from __future__ import annotations

import fnmatch
import math
import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.errors import ConfigError, ModelError, StateError
from dqwalk_ros.robot import Foot, RobotModel
from dqwalk_ros.whole_body.dynamics import GRAVITY, Dynamics, Multibody, rotation_error
from dqwalk_ros.whole_body.equations import Layout, Scene, hierarchy, wrenches
from dqwalk_ros.whole_body.hierarchy import Answer, Hierarchy, HierarchySolver
from dqwalk_ros.whole_body.objectives import Distance, FrameOrientation, FramePosition, JointPosture, Objective
from dqwalk_ros.whole_body.preview import PointMass, Stepping, previewed
from dqwalk_ros.whole_body.records import BodyCommand, BodyState, BodyTick, Wrench

__all__ = ["WholeBodyController"]

Array = NDArray[np.float64]

_EPS = 1e-9


class WholeBodyController:
    """Walks wherever its objectives lead, and keeps able to stop.

    Parameters
    ----------
    config : Config
    model : RobotModel
        With ankles that pitch and roll.
    objectives : sequence of Objective
        Wanted besides (17) to (19).
    distances : sequence of Distance
        Kept besides the constraints of section II.
    clock : callable
        What the times in `last` are measured with [s].
    hot : bool
        Guess the active set from the tick before; without it every tick goes to Clarabel.

    Attributes
    ----------
    weight : float
        m g [N].
    stepping : Stepping
    point_mass : PointMass
    hierarchy, layout, answer : Hierarchy, Layout, Answer or None
        The last problem and its answer.

    Raises
    ------
    ModelError
        If the robot lacks a link or a joint that `config` names, or cannot stand as it says.
    """

    def __init__(
        self,
        config: Config,
        model: RobotModel,
        *,
        objectives: Sequence[Objective] = (),
        distances: Sequence[Distance] = (),
        clock: Callable[[], float] = time.perf_counter,
        hot: bool = True,
    ) -> None:
        self.config, self.model = config, model
        self._own, self._distances = tuple(objectives), tuple(distances)
        self._clock, self._hot = clock, hot
        settings = config.whole_body
        self._soles = {foot: model.soles[foot].frame for foot in Foot}
        own = [frame for wish in self._own for frame in wish.frames]
        own += [frame for distance in self._distances for frame in distance.frames]
        self._body = Multibody(model, dict.fromkeys([*self._soles.values(), settings.torso, settings.hand, *own]))
        self.weight = self._body.mass * GRAVITY
        self.stepping = Stepping.of(settings, Foot(config.gait.first_support))
        half = 0.5 * settings.feet_distance
        self._start = self._body.stand(
            _posture(settings.posture, model), {Foot.LEFT: [0.0, half], Foot.RIGHT: [0.0, -half]}, settings.torso
        )
        still = self._body.at(*self._start, np.zeros(self._body.nv))
        self.point_mass = PointMass(float(still.com[2]), settings.interval, settings.intervals, GRAVITY)
        free = _named(settings.free, model)
        kp = np.where(free, 0.0, settings.joint_kp)
        kd = np.where(free, settings.joint_kd, 2.0 * math.sqrt(settings.joint_kp))
        self._upright = FrameOrientation(
            name="torso", weight=settings.torso_weight, kp=settings.torso_kp, frame=settings.torso
        )
        self._posture = JointPosture(
            name="joints", weight=settings.joint_weight, reference=self._start[1], stiffness=kp, damping=kd
        )
        self._reach: FramePosition | None = None
        self.reset()

    def reset(self) -> None:
        """Forget the walk and the target; the next state begins a new one."""
        self._solver = HierarchySolver(clock=self._clock, hot=self._hot)
        self._places: dict[int, Array] = {}
        self._landing: Array | None = None
        self._last: BodyTick | None = None
        self._scene_now: Scene | None = None
        self.hierarchy: Hierarchy | None = None
        self.layout: Layout | None = None
        self.answer: Answer | None = None
        self.reach(None)

    @property
    def last(self) -> BodyTick:
        """What there is to say about the last step."""
        if self._last is None:
            raise RuntimeError("nothing to say before the first step")
        return self._last

    @property
    def start(self) -> BodyState:
        """The state at rest in which a walk begins, the middle of the feet at the world's origin."""
        x_base, q = self._start
        return BodyState(0.0, q, dq=np.zeros(self.model.n), x_base=x_base, v_base=np.zeros(6))

    @property
    def target(self) -> Array | None:
        """Where the hand should be, shape (3,) [m]."""
        return None if self._reach is None else self._reach.target

    @property
    def step_bounds(self) -> tuple[Array, Array]:
        """Bounds (12) of the displacements previewed at the last step, shapes (K, 2) [m]."""
        if self._scene_now is None:
            raise RuntimeError("no preview before the first step")
        return self._scene_now.preview.lower, self._scene_now.preview.upper

    def sole(self, foot: Foot) -> Array:
        """Place of a sole's link at the last step, shape (3,) [m]."""
        if self._scene_now is None:
            raise RuntimeError("no place before the first step")
        return self._scene_now.dynamics.frames[self._soles[foot]].position

    def reach(self, target: ArrayLike | None) -> None:
        """Move the hand's target (17), at any time; without one the robot walks in place.

        Raises
        ------
        StateError
            If the target is not three finite numbers.
        """
        self._reach = self._wish(target)

    def footsteps_for(self, target: ArrayLike | None) -> Array:
        """Return the footsteps previewed had the hand's target been another at the last step, shape (K, 2) [m].

        Raises
        ------
        StateError
            If the target is not three finite numbers.
        RuntimeError
            Before the first step.
        """
        if self._scene_now is None:
            raise RuntimeError("no preview before the first step")
        problem, layout = self._hierarchy(self._scene_now, self._wish(target))
        x = HierarchySolver(hot=False).solve(problem).x
        return _footsteps(self._scene_now, layout, x)

    def _wish(self, target: ArrayLike | None) -> FramePosition | None:
        if target is None:
            return None
        place = np.asarray(target, dtype=np.float64)
        if place.shape != (3,) or not np.isfinite(place).all():
            raise StateError(f"a target is three finite coordinates, got {target}")
        s = self.config.whole_body
        return FramePosition(
            name="hand", weight=s.hand_weight, kp=s.hand_kp, frame=s.hand, target=place, saturation=s.hand_saturation
        )

    def _hierarchy(self, scene: Scene, reach: FramePosition | None) -> tuple[Hierarchy, Layout]:
        wanted = [*([reach] if reach else []), self._upright, self._posture, *self._own]
        return hierarchy(self.config.whole_body, self.model, scene, wanted, self._distances)

    def step(self, state: BodyState, dt: float) -> BodyCommand:
        """Return the joint torques for the next period.

        Parameters
        ----------
        state : BodyState
        dt : float
            Period until the next state [s].

        Raises
        ------
        StateError
            If the state does not fit the model or is not finite.
        QPError
            If no motion satisfies the laws of motion and of contact.
        """
        self._check(state)
        began = self._clock()
        dynamics = self._body.at(state.x_base, state.q, state.v)
        modelled = self._clock()
        scene, stance = self._scene(state.time, dynamics)
        self._scene_now = scene
        problem, layout = self._hierarchy(scene, self._reach)
        assembled = self._clock()
        answer = self._solver.solve(problem)
        self.hierarchy, self.layout, self.answer = problem, layout, answer
        times = (modelled - began, assembled - modelled, answer.solve_time)
        return self._command(state, dt, scene, stance, layout, answer, times)

    def _check(self, state: BodyState) -> None:
        n = self.model.n
        sizes = {"q": n, "dq": n, "x_base": 8, "v_base": 6}
        for what, shape in sizes.items():
            value = getattr(state, what)
            if value.shape != (shape,) or not np.isfinite(value).all():
                raise StateError(f"the state's {what} must be {shape} finite numbers, got {value}")

    def _scene(self, now: float, dynamics: Dynamics) -> tuple[Scene, tuple[Foot, ...]]:
        """Say who stands where, and what comes next."""
        settings, stepping = self.config.whole_body, self.stepping
        swing, step = stepping.swing(now), stepping.step(now)
        here = {foot: dynamics.frames[frame].position[:2] for foot, frame in self._soles.items()}
        if not self._places:
            self._places[-1] = 0.5 * (here[Foot.LEFT] + here[Foot.RIGHT])
        landed = step + (swing is None) if step >= 0 else 0 if now >= settings.first_double_support - _EPS else -1
        for index in range(max(self._places) + 1, landed + 1):
            self._places[index], self._landing = here[stepping.foot(index)].copy(), None
        self._places = {index: self._places[index] for index in sorted(self._places)[-2:]}
        base = max(self._places)
        settled = swing is not None and swing.remaining < settings.freeze - _EPS
        stance = tuple(Foot) if swing is None else (swing.foot.other,)
        scene = Scene(
            dynamics=dynamics,
            mass=self.point_mass,
            weight=self.weight,
            stance=tuple(dynamics.frames[self._soles[foot]] for foot in stance),
            preview=previewed(settings, stepping, now, self._places),
            support=self._places[base],
            swing=swing,
            sole=None if swing is None else dynamics.frames[self._soles[swing.foot]],
            settled=self._landing if settled else None,
        )
        return scene, stance

    def _command(
        self,
        state: BodyState,
        dt: float,
        scene: Scene,
        stance: tuple[Foot, ...],
        layout: Layout,
        answer: Answer,
        times: tuple[float, float, float],
    ) -> BodyCommand:
        """Read the answer."""
        d, x, settings = scene.dynamics, answer.x, self.config.whole_body
        footsteps = _footsteps(scene, layout, x)
        if scene.swing is not None and scene.settled is None:
            self._landing = footsteps[0]
        acceleration = x[: layout.nv]
        effort = d.H[6:] @ acceleration + d.h[6:]
        found, pressed = {}, np.zeros(3)  # f_z, and f_z times the CoP
        contacts = zip(stance, scene.stance, wrenches(settings, layout, self.weight, x), strict=True)
        for foot, sole, (force, moment) in contacts:
            effort = effort - sole.jacobian[:, 6:].T @ np.concatenate([force, moment])
            found[foot] = Wrench(force, moment)
            pressed += [force[2] * sole.position[0] - moment[1], force[2] * sole.position[1] + moment[0], force[2]]
        torso = d.frames[settings.torso].rotation
        self._last = BodyTick(
            com=d.com,
            com_velocity=d.com_velocity,
            hand=d.frames[settings.hand].position,
            wrenches=found,
            cop=pressed[:2] / pressed[2],
            cop_preview=d.com[:2] - self.point_mass.zeta * x[layout.com : layout.com + 2],
            support=scene.support,
            footsteps=footsteps,
            height_error=float(d.com[2] - self.point_mass.height),
            tilt=float(np.linalg.norm(rotation_error(torso))),
            capturability=answer.residual,
            violation=answer.violation,
            method=answer.method,
            iterations=answer.iterations,
            times=times,
        )
        ends = scene.swing is not None and scene.swing.remaining <= dt + _EPS
        return BodyCommand(
            state.time,
            state.dq + dt * acceleration[6:],
            acceleration=acceleration,
            effort=effort,
            stance=stance,
            landing=scene.swing.foot if scene.swing is not None and ends else None,
        )


def _footsteps(scene: Scene, layout: Layout, x: Array) -> Array:
    """Return where the feet previewed land, shape (K, 2) [m]."""
    steps = np.stack([x[layout.feet(0)], x[layout.feet(1)]], axis=1)
    return scene.support + np.cumsum(steps, axis=0)


def _posture(lines: Sequence[str], model: RobotModel) -> Array:
    """Read 'joint: angle', ..."""
    q = np.zeros(model.n)
    for line in lines:
        name, _, angle = line.partition(":")
        if name.strip() not in model.joint_names:
            raise ModelError(f"whole_body.posture names the joint '{name.strip()}', which '{model.name}' does not have")
        try:
            q[model.joint_names.index(name.strip())] = float(angle)
        except ValueError:
            raise ConfigError(f"whole_body.posture wants 'joint: angle', as 'L_knee: 0.87', not '{line}'") from None
    return q


def _named(patterns: Sequence[str], model: RobotModel) -> NDArray[np.bool_]:
    """Return which joints match."""
    for pattern in patterns:
        if not fnmatch.filter(model.joint_names, pattern):
            raise ModelError(f"whole_body.free names '{pattern}', and '{model.name}' has no such joint")
    return np.array([any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns) for name in model.joint_names])
