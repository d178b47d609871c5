"""The walking controller of section 4: one quadratic program per phase, joint velocities out [Urban2020]."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.controllers import Command, State, Tick
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import ConfigError, PhaseError, QPError, StateError
from dqwalk_ros.feasibility import explained, lead_back
from dqwalk_ros.gait import EndRule, PaperGait, StandingEnd, StandingGait, make_gait, make_rule
from dqwalk_ros.kernels import clip
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.model import RobotModel
from dqwalk_ros.phases import Phase, PhaseKind, assemble, make_phase
from dqwalk_ros.qp import Problem, Solution, make_solver
from dqwalk_ros.standing.balance import balance_torques

__all__ = ["VelocityController"]

Array = NDArray[np.float64]


class VelocityController:
    """Walks `model` as `config` says.

    Parameters
    ----------
    config : Config
    model : RobotModel

    Attributes
    ----------
    problem, solution : Problem, Solution or None
        The last quadratic program and its answer.
    """

    def __init__(self, config: Config, model: RobotModel) -> None:
        self.config = config
        self.model = model
        self._imu = model.imu
        self._limit = np.minimum(model.velocity_max, config.joints.velocity or np.inf)
        self._solver = make_solver(config.qp.solver)
        self._shape, self._timeout = (model.n,), config.plant.command_timeout
        self.reset()

    def reset(self) -> None:
        """Forget the walk; the next state begins a new one."""
        self.problem: Problem | None = None
        self.solution: Solution | None = None
        self._phase: Phase | None = None
        self._gait = make_gait(self.config, self.model)
        self._rule: EndRule | StandingEnd | None = None
        self._may_wait = False
        self._kin: Kinematics | None = None
        self._index = -1
        self._time0 = math.nan
        self._answered = math.inf
        self._finished = False
        self._x_odom_base = DQ(1.0)
        self._error = math.nan

    @property
    def phase(self) -> Phase:
        """The current phase; there is one after the first step."""
        if self._phase is None:
            raise RuntimeError("a walk has no phase before its first step")
        return self._phase

    @property
    def phase_index(self) -> int:
        """0, 1, ... from the beginning of the walk; -1 before the first step."""
        return self._index

    @property
    def phase_time0(self) -> float:
        """Time of the state at which the phase began [s], and later by as long as the plant held."""
        return self._time0

    @property
    def finished(self) -> bool:
        """Whether the last phase is over; commands are zero from then on."""
        return self._finished

    @property
    def x_odom_base(self) -> Array:
        """Pose of the phase's base sole in the world of the first phase, shape (8,)."""
        return self._x_odom_base.vec8()

    @property
    def error(self) -> float:
        """Norm of the error of the phase's own task at the last state."""
        return self._error

    @property
    def solve_time(self) -> float:
        """Time the solver took for the last command [s]."""
        return self.solution.solve_time if self.solution is not None else math.nan

    @property
    def last(self) -> Tick:
        """What there is to say about the last step."""
        if self.problem is None or self.solution is None:
            return Tick(self._error, math.nan, 0, ())
        return Tick(self._error, self.solution.solve_time, self.solution.iterations, self.solution.active(self.problem))

    def odometry(self) -> Array:
        """Pose of the pelvis in the world of the first phase, shape (8,)."""
        if self._kin is None:
            raise RuntimeError("a walk has no odometry before its first step")
        return (self._x_odom_base * DQ(self._kin.pose(self.model.pelvis))).vec8()

    def steer(self, forward: float, left: float, turn: float) -> tuple[float, float, float]:
        """Set the velocity of a walk that is steered [m/s, m/s, rad/s]; zero puts the feet together and waits.

        Returns
        -------
        tuple of float
            What it walks with, within what the legs can do.

        Raises
        ------
        ConfigError
            If this walk goes its own way: it has ``gait.style: paper``, or ``gait.steps`` to count.
        """
        if isinstance(self._gait, PaperGait) or self.config.gait.steps:
            raise ConfigError("only a standing walk without a number of steps is steered: gait.steps: 0")
        return self._gait.steer(forward, left, turn)

    def stop(self) -> None:
        """Put the feet together after the step under way, and end the walk.

        Raises
        ------
        ConfigError
            If the walk is the paper's, which has no such end.
        """
        if isinstance(self._gait, PaperGait):
            raise ConfigError("the paper's walk does not put its feet together; pause it")
        self._gait.stop()

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
        time = state.time
        if self._index < 0:
            self._refuse_nonsense(state)
            self._enter(0, state)
        elif (held := time - self._answered - self._timeout) > 0.0:
            self._refuse_nonsense(state)
            self._resume(state, held)
        kin = self._seen(state)
        self._answered = time
        while not self._finished and self._over(time):
            self._enter(self._index + 1, state, kin)
            kin = self._seen(state)
        self._kin = kin
        if self._finished:
            return Command(time, np.zeros(self.model.n))
        limit = self._limit
        self.problem = problem = assemble(self.phase, kin, dt, limit)
        self.solution = solution = self._solved(problem)
        effort = None
        if state.up is not None and self._imu in self.model.frames:
            effort = balance_torques(self.phase, kin, state, self.config.standing, self._imu)
        velocity = np.empty(self.model.n)
        clip(solution.u, limit, velocity)
        return Command(time, velocity, effort)

    def _resume(self, state: State, held: float) -> None:
        """Go on after states without an answer, when the plant has moved on for its timeout and then `held` [s].

        A swing goes on where it was. A CoM that was stopped sets out anew: taken up at the path's velocity it tips the
        robot.
        """
        phase = self.phase
        if phase.kind is PhaseKind.SINGLE_SUPPORT or isinstance(self._gait, PaperGait):
            self._time0 += held
        else:
            again = make_phase(self.config, self.model, phase.kind, phase.support, state.q, phase.swing_target)
            self._begin(self._index + 1, again, state.time)

    def _solved(self, problem: Problem) -> Solution:
        """Return the answer of (6); where the robot is outside and cannot return at the wanted rate, a slower one."""
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

    def _seen(self, state: State) -> Kinematics:
        phase, q = self.phase, state.q
        if q.shape != self._shape:
            self._refuse_nonsense(state)
        kin = Kinematics(self.model, q, phase.base, elapsed=state.time - self._time0)
        if not kin.finite:
            self._refuse_nonsense(state)
        if state.up is not None and self._imu in self.model.frames:
            kin = kin.tilted(kin.direction(self._imu, state.up))
        self._error = phase.error(kin)
        return kin

    def _refuse_nonsense(self, state: State) -> None:
        if state.q.shape != (self.model.n,):
            raise StateError(f"the state has {state.q.size} joints, the model {self.model.n}")
        bad = [name for name, angle in zip(self.model.joint_names, state.q, strict=True) if not math.isfinite(angle)]
        if bad:
            raise StateError(f"the angle of {', '.join(bad)} is not finite")

    def _over(self, time: float) -> bool:
        assert self._rule is not None  # set with the phase
        if self._may_wait and isinstance(self._gait, StandingGait) and self._gait.waiting:
            return False
        elapsed = time - self._time0
        try:
            return self._rule.over(self._error, elapsed)
        except PhaseError:
            # said again with the rows that held the robot back
            return self._rule.over(self._error, elapsed, self.last.active)

    def _enter(self, index: int, state: State, kin: Kinematics | None = None) -> None:
        """Begin the phase `index` at `state`; `kin` is seen from the base of the phase before."""
        following = self._gait.following(self._phase)
        if following is None:
            self._finished = True
            return
        phase = make_phase(self.config, self.model, *following[:2], state.q, following[2])
        if kin is not None and phase.base is not kin.base:
            # the world moves to the other sole, as that stands now
            self._x_odom_base = (self._x_odom_base * DQ(kin.pose(kin.swing))).normalized()
        self._begin(index, phase, state.time)

    def _begin(self, index: int, phase: Phase, time: float) -> None:
        self._phase, self._index, self._time0 = phase, index, time
        self._rule = make_rule(self.config, self.model, phase)
        self._may_wait = phase.kind is PhaseKind.STANCE
        self.problem = self.solution = None
