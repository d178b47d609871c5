"""The walking controller of section 4: one quadratic program per phase, joint velocities out [Urban2020].

A state comes in, a command goes out; `VelocityController.step` is the whole way between them.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.assembly import Evaluation
from dqwalk_ros.config import Config
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import ConfigError, PhaseError, QPError, StateError
from dqwalk_ros.estimation.delay import CommandHistory
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.qp import Problem, Solution, explained, lead_back, make_solver
from dqwalk_ros.robot import Foot, RobotModel
from dqwalk_ros.servos import Drive
from dqwalk_ros.state import Command, State
from dqwalk_ros.walk import Phase, Walk

__all__ = ["Tick", "VelocityController"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Tick:
    """The last step of a controller, in numbers.

    Attributes
    ----------
    error : float
        Norm of the phase's own task error.
    solve_time : float
        Time the solver took [s].
    iterations : int
    active : tuple of str
        Rows that held the command back, strongest first.
    """

    error: float
    solve_time: float
    iterations: int
    active: tuple[str, ...]


class VelocityController:
    """Walks `model` through the phases of a walk.

    What it measures is late, and so is what it commands; it is told how late, and how the servos answer
    (`servos.Drive`).

    Parameters
    ----------
    config : Config
    model : RobotModel
    walk : type of Walk
        Made anew for each walk.

    Attributes
    ----------
    config : Config
        In force in the phase under way.
    walk : Walk
        The walk under way.
    phase_index : int
        0, 1, ... from the beginning of the walk; -1 before the first step.
    phase_time0 : float
        Time of the state at which the phase began [s], and later by as long as the plant held.
    finished : bool
        Whether the last phase is over; commands are zero from then on.
    error : float
        Norm of the error of the phase's own task at the last state.
    problem, solution : Problem, Solution or None
        The last quadratic program and its answer.
    """

    def __init__(self, config: Config, model: RobotModel, walk: type[Walk]) -> None:
        self.config = self._tuned = config
        self.model = model
        self._imu = model.imu
        self._limit = np.minimum(model.velocity_max, config.joints.velocity or np.inf)
        self._solver = make_solver(config.qp.solver)
        self._make_walk, self._shape = walk, (model.n,)
        self._drive = Drive.of(config, model)
        self.reset()

    def reset(self) -> None:
        """Forget the walk; the next state begins a new one."""
        self.config = self._tuned
        self.walk = self._make_walk(self.config, self.model)
        self.phase_index = -1
        self.phase_time0 = math.nan
        self.finished = False
        self.error = math.nan
        self.problem: Problem | None = None
        self.solution: Solution | None = None
        self._phase: Phase | None = None
        self._kin: Kinematics | None = None
        self._last_state: State | None = None
        self._answered = math.inf
        self._sent = CommandHistory(self._drive.delay, self.model.n)
        self._x_odom_base = DQ(1.0)

    @property
    def phase(self) -> Phase:
        """The current phase; there is one after the first step."""
        if self._phase is None:
            raise RuntimeError("a walk has no phase before its first step")
        return self._phase

    @property
    def x_odom_base(self) -> Array:
        """Pose of the phase's base sole in the world of the first phase, shape (8,)."""
        return self._x_odom_base.vec8()

    @property
    def lean(self) -> float:
        """Angle between the base sole and the ground, as the inertial sensor and the joints say [rad]."""
        return math.acos(min(float(self._kin.up[2]), 1.0)) if self._kin is not None else 0.0

    @property
    def solve_time(self) -> float:
        """Time the solver took for the last command [s]."""
        return self.solution.solve_time if self.solution is not None else math.nan

    @property
    def last(self) -> Tick:
        """The last step in numbers."""
        if self.problem is None or self.solution is None:
            return Tick(self.error, math.nan, 0, ())
        return Tick(self.error, self.solution.solve_time, self.solution.iterations, self.solution.active(self.problem))

    def odometry(self) -> Array:
        """Pose of the pelvis in the world of the first phase, shape (8,)."""
        if self._kin is None:
            raise RuntimeError("a walk has no odometry before its first step")
        return (self._x_odom_base * DQ(self._kin.pose(self.model.pelvis))).vec8()

    def soles(self) -> dict[Foot, Array]:
        """Poses of both soles in the world of the first phase, shape (8,) each."""
        if self._kin is None:
            raise RuntimeError("a walk has no soles before its first step")
        kin, base = self._kin, self._x_odom_base
        return {kin.base: base.vec8(), kin.base.other: (base * DQ(kin.pose(kin.swing))).vec8()}

    def steer(self, forward: float, left: float, turn: float) -> tuple[float, float, float]:
        """Set the velocity of a walk that is steered [m/s, m/s, rad/s]; see `Walk.steer`."""
        return self.walk.steer(forward, left, turn)

    def tune(self, config: Config) -> None:
        """Go on with other parameters, all of them live, from the next phase on.

        Raises
        ------
        ConfigError
            If this walk keeps the parameters that it began with.
        """
        if not self.walk.is_tunable:
            raise ConfigError("this walk keeps the parameters that it began with")
        self._tuned = config

    def stop(self) -> None:
        """Put the feet together after the step under way, and end the walk; see `Walk.stop`."""
        self.walk.stop()

    def step(self, state: State, dt: float) -> Command:
        """Return the joint velocities for the next period.

        Parameters
        ----------
        state : State
        dt : float
            Period until the next state [s].

        Raises
        ------
        StateError
            If the state does not fit the model or is not finite.
        PhaseError
            If the phase cannot end by its rule.
        QPError
            If the quadratic program has no answer.
        """
        if state.q.shape != self._shape:
            raise StateError(f"the state has {state.q.size} joints, the model {self.model.n}")
        if self.phase_index < 0:
            self._check(state)
            self._enter(state)
        elif (held := state.time - self._answered - self.config.plant.command_timeout) > 0.0:
            self._resume(state, held)
        state = self._with_velocity(state)
        kin, now = self._look(state)
        self._answered = state.time
        while not self.finished and self._is_over(now, state.time):
            self._enter(state, kin)
            kin, now = self._look(state)
        self._kin, self.error = kin, now.error
        if self.finished:
            return Command(state.time, np.zeros(self.model.n))
        if self._drive.delay > 0.0:  # the answer is to the state in which it has its effect
            q, elapsed = state.q + self._sent.pending(state.time), kin.elapsed + self._drive.delay
            now = self.phase.evaluate(Kinematics(self.model, q, kin.base, kin.up, elapsed))
        self.problem = now.problem(dt, self._limit)  # (U6)
        self.solution = self._solve(self.problem)
        u = np.minimum(np.maximum(self.solution.u, -self._limit), self._limit)
        if self._drive.delay > 0.0:
            self._sent.add(state.time, u, dt)
        return Command(state.time, u, self._effort(kin, state, u))

    def _with_velocity(self, state: State) -> State:
        """Return a state whose joint velocities, where nobody measures them, are the differences of its angles."""
        before, self._last_state = self._last_state, state
        if state.dq is not None or before is None:
            return state
        passed = state.time - before.time
        if not 0.0 < passed <= self.config.plant.command_timeout:
            return state
        return dataclasses.replace(state, dq=(state.q - before.q) / passed)

    def _effort(self, kin: Kinematics, state: State, u: Array) -> Array | None:
        """Return the torques fed forward, those that damp the joints as the servos themselves do among them."""
        if state.up is None:
            return None
        effort = self.walk.effort(self.phase, kin.later(self._drive.delay), state) + self._drive.lead * u
        return effort if state.dq is None else effort - self._drive.damping * (state.dq - u)

    def _check(self, state: State) -> None:
        names = zip(self.model.joint_names, state.q, strict=True)
        bad = [name for name, angle in names if not math.isfinite(angle)]
        if bad:
            raise StateError(f"the angle of {', '.join(bad)} is not finite")

    def _look(self, state: State) -> tuple[Kinematics, Evaluation]:
        """Return the robot at `state`, and what the phase makes of it."""
        kin = self._kinematics(state)
        self._phase = self.walk.observe(self.phase, kin, state)
        return kin, self.phase.evaluate(kin)

    def _kinematics(self, state: State) -> Kinematics:
        return self._seen(state, self.phase.base, state.time - self.phase_time0)

    def _seen(self, state: State, base: Foot, elapsed: float = 0.0) -> Kinematics:
        kin = Kinematics(self.model, state.q, base, elapsed=elapsed)
        if not kin.finite:
            self._check(state)
        return kin if state.up is None else kin.tilted(kin.direction(self._imu, state.up))

    def _is_over(self, now: Evaluation, time: float) -> bool:
        if self.walk.is_waiting(self.phase):
            return False
        try:
            return self.phase.rule.is_over(now.error, time - self.phase_time0)
        except PhaseError as error:
            raise error.held_by(self.last.active) from error

    def _enter(self, state: State, kin: Kinematics | None = None) -> None:
        """Begin the next phase at `state`; `kin` is seen from the base of the phase before."""
        if self._tuned is not self.config:
            self.config = self._tuned
            self.walk.tune(self.config)
        before = self._phase
        following = self.walk.beginning(self._seen(state, Foot.LEFT)) if before is None else self.walk.following(before)
        if following is None:
            self.finished = True
            return
        phase = self.walk.phase(*following[:2], state.q, following[2])
        if kin is not None and phase.base is not kin.base:
            # the world moves to the other sole, as that stands now
            self._x_odom_base = (self._x_odom_base * DQ(kin.pose(kin.swing))).normalized()
        self._begin(phase, state.time)

    def _begin(self, phase: Phase, time: float) -> None:
        self._phase, self.phase_time0 = phase, time
        self.phase_index += 1
        self.problem = self.solution = None

    def _resume(self, state: State, held: float) -> None:
        """Go on after states without an answer, when the plant has moved on for its timeout and then `held` [s]."""
        phase = self.phase
        self._sent = CommandHistory(self._drive.delay, self.model.n)
        if (still := self.walk.restarts(phase)) is not None:
            self._begin(self.walk.phase(phase.kind, phase.support, state.q, phase.swing_target), state.time + still)
        else:
            self.phase_time0 += held

    def _solve(self, problem: Problem) -> Solution:
        """Return the answer of (U6); outside its constraints, where the wanted return is too fast, a slower one."""
        try:
            return self._solver.solve(problem)
        except QPError as error:
            if not error.status.endswith("Infeasible"):
                raise
            try:
                self.problem, _ = lead_back(problem)
                return self._solver.solve(self.problem)
            except QPError:
                raise explained(error, problem) from error
