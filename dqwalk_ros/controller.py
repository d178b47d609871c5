"""The walking controller of section 4 [Urban2020]: joint velocities from one quadratic program per control period.

`VelocityController.step` computes the command for a measured state; the tasks and constraints are those of the phase.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.estimation.load import FootLoads
from dqwalk_ros.estimation.predictor import Predictor
from dqwalk_ros.estimation.vertical import filtered_vertical, low_passed
from dqwalk_ros.paper.assembly import Evaluation
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import angle_of
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import Next, Phase, PhaseKind
from dqwalk_ros.paper.qp import make_solver
from dqwalk_ros.paper.qp.infeasible import explained, lead_back
from dqwalk_ros.paper.qp.problem import Problem, Shape, Solution, parts
from dqwalk_ros.paper.state import Command, Estimate, State
from dqwalk_ros.paper.walk import Walk
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.servos import Drive
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.support.errors import PhaseError, QPError, StateError


class VelocityController:
    """Controls `model` through the phases of a walk.

    Another walk may take over, such as steps that catch a push (`Change.walk`); after its last phase the first walk
    continues.

    Delays of measurement and command, and the response of the servos, are compensated by the model `servos.Drive`.
    Where torques are fed forward, its delay is corrected by what the joints show (`Predictor`).

    Parameters
    ----------
    walk : type of Walk
        Class of the walk; `reset` creates a new instance.

    Attributes
    ----------
    config : Config
        Configuration of the current phase.
    walk : Walk
        The walk, also while another one has taken over.
    phase_index : int
        Number of the current phase, from 0; -1 before the first step.
    phase_began : float
        Time of the state at which the phase began, shifted by pauses [s].
    finished : bool
        Whether the last phase is over; commands are zero from then on.
    predictor : Predictor
        The model of the drive, and what the joints have shown of it since the walk began.
    kin : Kinematics or None
        Kinematics at the last state.
    loads : ndarray, shape (2,), or None
        Force of the ground on the left and on the right sole along its vertical at the last state [N]; None if the
        torques of the joints are not measured.
    problem, solution : Problem, Solution or None
        The last quadratic program and its solution.
    """

    def __init__(self, config: Config, model: RobotModel, walk: type[Walk]) -> None:
        self.config = self._requested = config  # of the current phase, and of the next walk
        self.model = model
        self._solver = make_solver(config.qp.solver)
        self._make_walk = walk
        self.reset()

    def reset(self) -> None:
        """Discard the walk; the next state begins a new one."""
        self._use(self._requested)
        self.walk = self._active = self._make_walk(self._requested, self.model)
        self.walk.prepare()
        self._taking_over: Walk | None = None  # at the next state
        self._interrupted: Phase | None = None  # phase after which `walk` continues
        self.phase_index = -1
        self.phase_began = math.nan
        self.finished = False
        self._error: Callable[[], float] = lambda: math.nan
        self.problem: Problem | None = None
        self.solution: Solution | None = None
        self._solved: list[Solution] = []  # for the last command: several while an arm presses on the body
        self._phase: Phase | None = None
        self.kin: Kinematics | None = None
        self.loads: Array | None = None
        self._foot_loads = FootLoads(self.config, self.model)
        self.predictor = Predictor(Drive.of(self.config, self.model))
        self._last_state: State | None = None
        self._last_gyro: Array | None = None  # as measured
        self._u, self._tau = np.zeros((2, self.model.n))  # the last command
        self._x_odom_base = DQ(1.0)

    def _use(self, config: Config) -> None:
        """Set the configuration of the current phase."""
        self.config = config
        self._limit = np.minimum(self.model.velocity_max, config.joints.velocity or np.inf)

    @property
    def phase(self) -> Phase:
        """The current phase; not available before the first step."""
        if self._phase is None:
            raise RuntimeError("a walk has no phase before its first step")
        return self._phase

    @property
    def error(self) -> float:
        """Norm of the error of the phase's first task at the last state; nan before the first one."""
        return self._error()

    @property
    def x_odom_base(self) -> Array:
        """Pose of the base sole of the phase in the base frame of the first phase, shape (8,)."""
        return self._x_odom_base.vec8()

    @property
    def lean(self) -> float:
        """Inclination of the base sole, from the inertial sensor and the joint angles [rad]; 0 without the sensor."""
        return angle_of(float(self.kin.up[2])) if self.kin is not None else 0.0

    @property
    def solve_time(self) -> float:
        """Time taken by the solver for all programs of the last command [s]; nan without one."""
        return sum(one.solve_time for one in self._solved) if self.solution is not None else math.nan

    @property
    def iterations(self) -> int:
        """Number of iterations of the solver for all programs of the last command; 0 without one."""
        return sum(one.iterations for one in self._solved) if self.solution is not None else 0

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the active inequalities of the last command, in decreasing order of their multipliers."""
        return self.solution.active(self.problem) if self.solution is not None and self.problem is not None else ()

    def soles(self) -> dict[Foot, Array]:
        """Poses of both soles in the base frame of the first phase, shape (8,) each."""
        if self.kin is None:
            raise RuntimeError("a walk has no soles before its first step")
        kin, base = self.kin, self._x_odom_base
        return {kin.base: base.vec8(), kin.base.other: (base * DQ(kin.pose(kin.swing))).vec8()}

    def steer(self, forward: float, left: float, turn: float) -> tuple[float, float, float]:
        """Set the velocity of a steered walk [m/s, m/s, rad/s]; see `Walk.steer`."""
        return self.walk.steer(forward, left, turn)

    def tune(self, config: Config) -> None:
        """Replace live parameters; the new configuration applies from the next phase on.

        Raises
        ------
        ConfigError
            If the parameters of this walk cannot be changed.
        """
        self.walk.tune(config)
        self._requested = config

    def stop(self) -> None:
        """Put the feet together after the current step, and end the walk; see `Walk.stop`."""
        self.walk.stop()

    def pause(self, wanted: bool) -> None:
        """Bring the walk to a posture in which the robot may hold still, or continue; see `Walk.pause`."""
        self.walk.pause(wanted)

    @property
    def may_hold(self) -> bool:
        """Whether the robot stands without commands: always in a walk that is at rest in every posture."""
        return self._phase is None or self._active.may_hold(self._phase)

    def first_base(self, state: State) -> Foot:
        """Return the foot whose sole would be the base frame of a walk that begins at `state`."""
        begins = self._make_walk(self._requested, self.model).following(None, self._kinematics(state, Foot.LEFT))
        assert begins is not None  # every walk has a phase
        return begins.support if begins.kind is PhaseKind.SINGLE_SUPPORT else begins.support.other

    def step(self, measured: State, dt: float) -> Command:
        """Return the joint velocities for the next period.

        Parameters
        ----------
        dt : float
            Period until the next state [s].

        Raises
        ------
        StateError
            If the state does not fit the model or is not finite.
        PhaseError
            If the phase has stalled or takes too long.
        QPError
            If the quadratic program has no solution.
        """
        if measured.q.shape != (self.model.n,):
            raise StateError(f"the state has {measured.q.size} joints, the model {self.model.n}")
        last = self._last_state
        state = self._estimated(measured)
        if self.phase_index < 0:
            self._begin_next_phase(state, self._kinematics(state, Foot.LEFT))
        elif last is not None and (held := state.time - last.time - self.config.plant.command_timeout) > 0.0:
            self._resume(state, held)
        elif self._taking_over is not None:
            self._begin_next_phase(state, self._kinematics(state, self.phase.base))
        kin, now = self._evaluate(state, dt)
        self._last_state = state
        while not self.finished and self._is_over(state.elapsed):
            self._begin_next_phase(state, kin)
            kin, now = self._evaluate(state, dt)
        self.kin = kin
        if self.finished:
            return Command(state.time, np.zeros(self.model.n))
        state.elapsed += self.predictor.drive.delay
        self._solved = []
        self.solution = self._active.solved(now, self._solve)
        assert self.problem is not None  # the last one solved
        u = _bounded(self.solution.u, self.problem.numbers, self.problem.shape, self._u, self.model.velocity_max)
        effort = self._effort(kin, state, u)
        self._u = u
        self._learn(state, u, effort, dt)
        return Command(state.time, u, effort)

    def _estimated(self, measured: State) -> Estimate:
        """Return the state with filtered vertical and angular velocity, and with joint velocities in any case."""
        before, dq, up, gyro = self._last_state, measured.dq, measured.up, measured.gyro
        if before is not None and 0.0 < (passed := measured.time - before.time) <= self.config.plant.command_timeout:
            up = filtered_vertical(before.up, self._last_gyro, measured, passed)
            if dq is not None:
                gyro = low_passed(before.gyro, gyro, self.config.servo.assumed_velocity_filter, passed)
            else:
                dq = (measured.q - before.q) / passed
        self._last_gyro = measured.gyro
        given = measured.acceleration, measured.effort, measured.forces
        return Estimate(measured.time, measured.q, dq, up, gyro, *given)

    def _effort(self, kin: Kinematics, state: Estimate, u: Array) -> Array | None:
        """Return the feedforward torques (n,) [N m], including damping; None without an inertial sensor."""
        if state.up is None:
            return None
        effort, dq = self._active.effort(self.phase, kin, state, u), u if state.dq is None else state.dq
        self._tau = _damped(effort, self.predictor.drive.damping, dq, u, self._tau, self.model.effort_max)
        return self._tau

    def _learn(self, state: State, u: Array, effort: Array | None, dt: float) -> None:
        """Include the command in the prediction, and tell the walk of another drive."""
        drive = self.predictor.drive
        self.predictor.add(state.time, state.q, u, effort, dt)
        if self.predictor.drive is not drive:
            self.walk.use(self.predictor.drive)

    def _evaluate(self, state: Estimate, dt: float) -> tuple[Kinematics, Evaluation]:
        """Return the kinematics at `state`, and the evaluation at the predicted state at which the command acts.

        Both are those of the present phase, which the walk may update first.
        """
        kin, state.elapsed = self._kinematics(state, self.phase.base), state.time - self.phase_began
        self.loads = state.loads = self._foot_loads.update(kin, state)
        if (change := self._active.observe(self.phase, kin, state)) is not None:
            self.phase.decide(change.decision, change.swing_target)
            self._taking_over = change.walk
        phase, delay = self.phase, self.predictor.drive.delay
        now = phase.evaluate(self.predictor.acting(state.time, state.q), kin.up, state.elapsed + delay, dt, self._limit)
        self._error = functools.partial(phase.assembly.error, kin, state.elapsed) if delay > 0.0 else lambda: now.error
        return kin, now

    def _kinematics(self, state: State, base: Foot) -> Kinematics:
        kin = Kinematics.measured(self.model, state.q, base, state.up)
        if not kin.finite:
            names = zip(self.model.joint_names, state.q, strict=True)
            bad = [name for name, angle in names if not math.isfinite(angle)]
            raise StateError(f"the angle of {', '.join(bad)} is not finite")
        return kin

    def _is_over(self, elapsed: float) -> bool:
        try:
            return self.phase.rule.is_over(self._error, elapsed)
        except PhaseError as failure:
            raise failure.held_by(self.active) from failure

    def _begin_next_phase(self, state: State, kin: Kinematics) -> None:
        """Begin the next phase at `state`; `kin` is in the base frame of the previous phase."""
        following = self._following(kin)
        if following is None:
            self.finished = True
            return
        if self._active.config is not self.config:
            self._use(self._active.config)
        begins, before = self._phase_at(state, following), self._phase
        if before is not None and begins.base is not before.base:
            # the base frame changes to the other sole at its present pose
            self._x_odom_base = (self._x_odom_base * DQ(kin.pose(kin.swing))).normalized()
        self._begin(begins, state.time)

    def _following(self, kin: Kinematics) -> Next | None:
        """Return what follows the current phase, of a walk that takes over, or of the first one when that is over."""
        if self._taking_over is not None:
            self._active, self._taking_over, self._interrupted = self._taking_over, None, self._phase
        following = self._active.following(self._phase, kin)
        if following is None and self._active is not self.walk:
            self._active = self.walk
            following = self.walk.following(self._interrupted, kin)
        return following

    def _phase_at(self, state: State, begins: Next) -> Phase:
        """Return the phase that begins at `state`."""
        return self._active.phase(begins.kind, begins.support, state.q, begins.swing_target, state.up)

    def _begin(self, phase: Phase, time: float) -> None:
        self._phase, self.phase_began = phase, time
        self.phase_index += 1
        self.problem = self.solution = None

    def _resume(self, state: State, held: float) -> None:
        """Continue after an interruption, in which the plant held still for `held` [s] after its command timeout."""
        phase, self._u = self.phase, np.zeros(self.model.n)
        self.predictor.interrupt()
        if (still := self._active.restarts(phase)) is not None:
            again = Next(phase.kind, phase.support, phase.swing_target)
            self._begin(self._phase_at(state, again), state.time + still)
        else:
            self.phase_began += held

    def _solve(self, problem: Problem) -> Solution:
        """Return the solution of (U6), or, if it is infeasible, of the problem with a slower return (`lead_back`)."""
        self.problem = problem
        try:
            solution = self._solver.solve(problem)
        except QPError as error:
            if not error.status.endswith("Infeasible"):
                raise
            try:
                self.problem, _ = lead_back(problem)
                solution = self._solver.solve(self.problem)
            except QPError:
                raise explained(error, problem) from error
        self._solved.append(solution)
        return solution


@jit
def _within(values: Array, lower: Array, upper: Array, before: Array, most: Array) -> Array:
    """Return the numbers of a command (n,) within two bounds, within +-`most`, and changed by no more in a period.

    Walks and pushes stay below; the bounds limit the effect of a measurement that is wrong but possible.
    """
    least, largest = np.maximum(before - most, -most), np.minimum(before + most, most)
    return np.minimum(np.maximum(np.minimum(np.maximum(values, lower), upper), least), largest)


@jit
def _bounded(u: Array, numbers: Array, shape: Shape, before: Array, most: Array) -> Array:
    """Return the velocities of a command (n,), as `_within` does, within the bounds of a `Problem`."""
    _, _, _, _, lower, upper = parts(numbers, shape)
    bounded: Array = _within(u, lower, upper, before, most)
    return bounded


@jit
def _damped(effort: Array, damping: Array, dq: Array, u: Array, before: Array, most: Array) -> Array:
    """Return the torques of a command (n,) less the damping of the difference between measured and commanded rates.

    They are limited as `_within` does.
    """
    damped: Array = _within(effort - damping * (dq - u), -most, most, before, most)
    return damped
