"""Phases and walks, and the walk of the paper: Fig. 1, sections 4.1, 4.2 and 5 [Urban2020].

A phase consists of tasks, equalities, inequalities, and the rule that ends it. Its base frame is the sole of its base
foot. A walk determines the sequence of the phases and the footsteps.
"""

from __future__ import annotations

import enum
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike

from dqwalk_ros.config import Config
from dqwalk_ros.paper.assembly import Assembly, Evaluation
from dqwalk_ros.paper.constraints import (
    AxisLevel,
    Constraint,
    JointMaximum,
    JointMinimum,
    PointInCylinder,
    PointInsideWall,
    PointOverPlane,
)
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import Cylinder, Line, Plane, wall_side
from dqwalk_ros.paper.kinematics import CenterOfMass, Kinematics, Point
from dqwalk_ros.paper.state import State
from dqwalk_ros.paper.statics import gravity_torques
from dqwalk_ros.paper.tasks import ComOverFoot, FramePose, Posture, Task
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ConfigError, PhaseError

if TYPE_CHECKING:
    from dqwalk_ros.robot.model import RobotModel

__all__ = [
    "EndRule", "PaperWalk", "Phase", "PhaseKind", "Rule", "Timed", "Walk", "com_target", "joint_limits",
    "pelvis_height",
]  # fmt: skip


_UP = np.array([0.0, 0.0, 1.0])
_X = np.array([1.0, 0.0, 0.0])
_Y = np.array([0.0, 1.0, 0.0])


class PhaseKind(enum.Enum):
    """Kind of a phase: double support, single support, or stance, a double support with the CoM between the feet."""

    DOUBLE_SUPPORT = "double_support"
    SINGLE_SUPPORT = "single_support"
    STANCE = "stance"


class Rule(Protocol):
    """Condition that ends a phase; it is evaluated once for each state of the phase."""

    def is_over(self, error: float, elapsed: float) -> bool:
        """Return whether the phase ends at the present state.

        Parameters
        ----------
        error : float
            Norm of the error of the phase's first task.
        elapsed : float
            Time since the phase began [s].

        Raises
        ------
        PhaseError
            If the phase has stalled, or takes longer than ``gait.phase_timeout``.
        """


@dataclass(frozen=True, kw_only=True, eq=False)
class Phase:
    """One phase of a walk.

    Attributes
    ----------
    model : RobotModel
    kind : PhaseKind
    support : Foot
        The foot that carries the weight at the end of the phase; it is part of the phase's name.
    base : Foot
        The foot whose sole is the base frame: the support foot in single support, the other one in double support.
    q_start : ndarray, shape (n,)
        Joint angles at the start of the phase [rad].
    swing_target : ndarray, shape (8,), or None
        x_d, the pose at which the swing sole lands, in the base frame.
    eta, damping : float
        eta [1/s] and lambda of (U6).
    tasks : tuple of Task
        The phase's rule is applied to the error of the first one.
    equalities : tuple of Constraint
        Constraints d' = -eta (d - bound).
    inequalities : tuple of Constraint
        Constraints d' >= -eta (d - bound).
    limits : tuple of JointMaximum and JointMinimum
        Joint limits (U12) and (U13), which are bounds of u in the quadratic program.
    rule : Rule
        Condition that ends the phase.
    decision : str
        Description of a change of the swing target during the phase, and its reason; empty without a change.
    """

    model: RobotModel
    kind: PhaseKind
    support: Foot
    base: Foot
    q_start: Array
    swing_target: Array | None
    eta: float
    damping: float
    tasks: tuple[Task, ...]
    equalities: tuple[Constraint, ...]
    inequalities: tuple[Constraint, ...]
    limits: tuple[JointMaximum, JointMinimum]
    rule: Rule
    decision: str = ""

    @property
    def name(self) -> str:
        """Kind and support foot, such as ``double_support/left``."""
        return f"{self.kind.value}/{self.support.value}"

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """All inequalities, including the joint limits."""
        return (*self.inequalities, *self.limits)

    @cached_property
    def assembly(self) -> Assembly:
        """Evaluates tasks and constraints; it has the names of the rows of the quadratic program."""
        kin = Kinematics(self.model, self.q_start, self.base)
        stacked = self.tasks, self.equalities, self.inequalities, self.limits
        return Assembly(kin, *stacked, eta=self.eta, damping=self.damping)

    def evaluate(self, kin: Kinematics) -> Evaluation:
        """Return errors, distances and their gradients for `kin`, which must be in the frame of `base`."""
        return self.assembly(kin)

    def distances(self, kin: Kinematics) -> dict[str, float]:
        """Return each signed distance minus its bound, by name; see `Evaluation.distances`."""
        return self.evaluate(kin).distances()


class Walk(ABC):
    """The sequence of the phases, and the footsteps.

    Parameters
    ----------
    config : Config
    model : RobotModel
    """

    def __init__(self, config: Config, model: RobotModel) -> None:
        self.config, self.model = config, model

    @staticmethod
    @abstractmethod
    def phases(config: Config) -> int:
        """Return the number of phases of the whole walk; 0 for a steered walk, which has no end."""

    @staticmethod
    @abstractmethod
    def describe(config: Config) -> str:
        """Return the extent of the walk in words, such as ``20 steps``."""

    @property
    @abstractmethod
    def posture(self) -> Array:
        """Joint angles at the start of the walk, shape (n,) [rad]."""

    @property
    def current(self) -> Config:
        """Configuration of the current phase."""
        return self.config

    is_tunable = False
    """Whether live parameters (`config.Spec.live`) may change between two phases."""

    def tune(self, config: Config) -> None:
        """Replace the parameters; the new ones apply from the next phase on."""
        self.config = config

    def is_waiting(self, phase: Phase) -> bool:
        """Return whether `phase` continues regardless of its rule."""
        return False

    @abstractmethod
    def following(self, phase: Phase | None) -> tuple[PhaseKind, Foot, Array | None] | None:
        """Return kind, support foot and swing target of the phase after `phase`; None after the last one."""

    def beginning(self, kin: Kinematics) -> tuple[PhaseKind, Foot, Array | None] | None:
        """Return kind, support foot and swing target of the first phase, for the posture of the robot in `kin`."""
        return self.following(None)

    def prepare(self) -> None:  # noqa: B027
        """Compute what the walk needs of the robot; called before the first state, so that none is answered late."""

    def phase(self, kind: PhaseKind, support: Foot, q_start: ArrayLike, swing_target: ArrayLike | None = None) -> Phase:
        """Return the phase that begins at `q_start`; the same arguments give the same phase.

        Parameters
        ----------
        kind : PhaseKind
        support : Foot
        q_start : array_like, shape (n,)
            [rad]
        swing_target : array_like, shape (8,)
            Required for single support.

        Raises
        ------
        ValueError
            If the swing target of a single support is missing.
        """
        q = np.array(q_start, dtype=np.float64)
        if kind is not PhaseKind.SINGLE_SUPPORT:
            return self.both_feet(kind, support, q)
        if swing_target is None:
            raise ValueError("a single support needs a swing target")
        return self.one_foot(support, q, np.array(swing_target, dtype=np.float64))

    @abstractmethod
    def both_feet(self, kind: PhaseKind, support: Foot, q_start: Array) -> Phase:
        """Return a phase with both feet on the ground."""

    @abstractmethod
    def one_foot(self, support: Foot, q_start: Array, swing_target: Array) -> Phase:
        """Return the single support on `support` that swings the other foot to its target."""

    joint_return = np.inf
    """Largest speed at which a joint beyond its limit is required to return [rad/s]."""

    def _phase(
        self,
        kind: PhaseKind,
        support: Foot,
        kin: Kinematics,
        swing_target: Array | None,
        tasks: Sequence[Task],
        equalities: tuple[Constraint, ...],
        inequalities: tuple[Constraint, ...],
    ) -> Phase:
        """Return the phase that begins at `kin`, with the posture task, the joint limits, and the rule of `_rule`."""
        config = self.config
        if config.task.posture_weight > 0.0:
            tasks = (*tasks, Posture(name="posture", weight=config.task.posture_weight, q_ref=self.posture))
        return Phase(
            model=self.model,
            kind=kind,
            support=support,
            base=kin.base,
            q_start=kin.q,
            swing_target=swing_target,
            eta=config.task.eta,
            damping=config.task.damping,
            tasks=tuple(tasks),
            equalities=equalities,
            inequalities=inequalities,
            limits=joint_limits(config, self.model, self.joint_return),
            rule=self._rule(kind, support),
        )

    def _rule(self, kind: PhaseKind, support: Foot) -> Rule:
        """Return the condition that ends a phase, for `_phase`; by default the switching rule of section 5."""
        return EndRule(self.config, f"{kind.value}/{support.value}", double=kind is PhaseKind.DOUBLE_SUPPORT)

    def restarts(self, phase: Phase) -> float | None:
        """Return for how long to stand before a phase begins again after an interruption of the control [s].

        None if the phase continues instead.
        """
        return None

    def observe(self, phase: Phase, kin: Kinematics, state: State) -> Phase:
        """Process a measured state before its command is computed, and return the phase to continue with.

        A walk with online planning updates the references of the tasks of `phase` here. If it changes the landing
        place, it returns a copy of the phase with the new swing target and a `decision`.
        """
        return phase

    def effort(self, phase: Phase, kin: Kinematics, state: State, u: Array) -> Array:
        """Return feedforward torques for the command `u` (n,), shape (n,) [N m]: by default they compensate gravity."""
        return gravity_torques(kin, both=phase.kind is not PhaseKind.SINGLE_SUPPORT)

    def steer(self, forward: float, left: float, turn: float) -> tuple[float, float, float]:
        """Set the velocity of a steered walk [m/s, m/s, rad/s]; at zero it puts the feet together and waits.

        Returns
        -------
        tuple of float
            The velocity of the walk, limited to the largest step.

        Raises
        ------
        ConfigError
            If this walk cannot be steered.
        """
        raise ConfigError("only a standing walk without a number of steps is steered: gait.steps: 0")

    def stop(self) -> None:
        """Put the feet together after the current step, and end the walk.

        Raises
        ------
        ConfigError
            If this walk does not support it.
        """
        raise ConfigError("the paper's walk does not put its feet together; pause it")


class PaperWalk(Walk):
    """The cycle of Fig. 1, ``gait.cycles`` times."""

    PHASES_PER_CYCLE = 4

    def __init__(self, config: Config, model: RobotModel) -> None:
        super().__init__(config, model)
        self._index = -1

    @staticmethod
    def phases(config: Config) -> int:
        """Return the number of phases, four for each cycle."""
        return PaperWalk.PHASES_PER_CYCLE * config.gait.cycles

    @staticmethod
    def describe(config: Config) -> str:
        """Return the number of cycles in words, such as ``2 cycles``."""
        return f"{config.gait.cycles} cycle{'s' if config.gait.cycles > 1 else ''}"

    @property
    def posture(self) -> Array:
        """Joint angles of ``standing.posture``, shape (n,) [rad]; by default all are zero (section 5)."""
        return self.model.posture(self.config.standing.posture)

    @staticmethod
    def phase_at(config: Config, index: int) -> tuple[PhaseKind, Foot] | None:
        """Return kind and support foot of the phase `index` (0, 1, ...) of Fig. 1, or None after the last one.

        The cycle is: double support that moves the CoM to the first support foot, single support on this foot, and the
        same two phases with the other foot.
        """
        if index >= PaperWalk.phases(config):
            return None
        first = Foot(config.gait.first_support)
        support = first if index % PaperWalk.PHASES_PER_CYCLE < 2 else first.other
        return (PhaseKind.SINGLE_SUPPORT if index % 2 else PhaseKind.DOUBLE_SUPPORT), support

    def following(self, phase: Phase | None) -> tuple[PhaseKind, Foot, Array | None] | None:
        """Return kind, support foot and swing target of the next phase of Fig. 1; None after the last one."""
        self._index += 1
        found = self.phase_at(self.config, self._index)
        if found is None:
            return None
        kind, support = found
        return kind, support, self.footstep(support) if kind is PhaseKind.SINGLE_SUPPORT else None

    def footstep(self, support: Foot) -> Array:
        """Return x_d of the swing sole in the support sole's frame, shape (8,): a step ahead, flat on the ground."""
        width = self.config.gait.step_width
        if width == 0.0:
            kin = Kinematics(self.model, np.zeros(self.model.n), support)
            width = abs(float(kin.point(kin.swing)[1]))
        y = -width if support is Foot.LEFT else width
        return DQ.from_pose([self.config.gait.step_length, y, 0.0]).vec8()

    def both_feet(self, kind: PhaseKind, support: Foot, q_start: Array) -> Phase:
        """Return the double support that brings the CoM over the foot `support`, section 4.1."""
        dsp, model = self.config.dsp, self.model
        base = support.other
        kin = Kinematics(model, q_start, base)
        base_sole, end_sole = model.soles[base], model.soles[support]
        end = end_sole.frame
        tip, heel, center = (Point(end, offset) for offset in (end_sole.tip, end_sole.heel, end_sole.center))

        def wall(name: str, eta: float, fixed: Array, moving: Point, inside: Array) -> PointInsideWall:
            side = wall_side(fixed, kin.value(moving), inside)
            return PointInsideWall(name=name, eta=eta, point=CenterOfMass(), fixed=fixed, moving=moving, side=side)

        ground: list[Constraint] = [
            PointOverPlane(name="ground", eta=dsp.eta_ground, point=tip, plane=Plane(_UP, 0.0)),  # (U8)
        ]
        if dsp.flat_feet:
            ground += [
                AxisLevel(name="flat_pitch", eta=dsp.eta_ground, frame=end, direction=_X),
                AxisLevel(name="flat_roll", eta=dsp.eta_ground, frame=end, direction=_Y),
            ]
        sliding = Cylinder(Line.through(kin.value(tip), _UP), dsp.sliding_radius)
        inequalities = (
            PointInCylinder(name="sliding", eta=dsp.eta_sliding, point=tip, cylinder=sliding),  # (U7)
            wall("tip_plane", dsp.eta_tip, base_sole.tip, tip, base_sole.heel),  # (U9)
            wall("back_plane", dsp.eta_back, base_sole.heel, heel, base_sole.tip),  # (U10)
            pelvis_height(self.config, model),  # (U11)
        )
        task = ComOverFoot(name="com", foot=center)
        return self._phase(PhaseKind.DOUBLE_SUPPORT, support, kin, None, (task,), tuple(ground), inequalities)

    def one_foot(self, support: Foot, q_start: Array, swing_target: Array) -> Phase:
        """Return the single support on the foot `support` that swings the other one to its target, section 4.2."""
        ssp, model = self.config.ssp, self.model
        kin = Kinematics(model, q_start, support)
        cylinder = Cylinder(Line.through(model.soles[support].center, _UP), ssp.com_radius)
        inequalities = (
            PointInCylinder(name="com_cylinder", eta=ssp.eta_com, point=CenterOfMass(), cylinder=cylinder),  # (U14)
            pelvis_height(self.config, model),  # (U11)
        )
        task = FramePose(name="swing", frame=kin.swing, target=swing_target)
        return self._phase(PhaseKind.SINGLE_SUPPORT, support, kin, swing_target, (task,), (), inequalities)


def pelvis_height(config: Config, model: RobotModel) -> Constraint:
    """Return the constraint (U11): the pelvis stays above ``pelvis.height``."""
    plane = Plane(_UP, config.pelvis.height)
    return PointOverPlane(name="pelvis", eta=config.pelvis.eta, point=Point(model.pelvis), plane=plane)


def joint_limits(config: Config, model: RobotModel, return_speed: float = np.inf) -> tuple[JointMaximum, JointMinimum]:
    """Return the constraints (U12) and (U13) on the joint angles; `return_speed` [rad/s] as in `Constraint`."""
    eta, margin = config.joints.eta, config.joints.margin
    return (
        JointMaximum(name="joint_max", eta=eta, bound=margin, return_speed=return_speed, q_max=model.q_max),  # (U12)
        JointMinimum(name="joint_min", eta=eta, bound=margin, return_speed=return_speed, q_min=model.q_min),  # (U13)
    )


def com_target(model: RobotModel, kind: PhaseKind, base: Foot, q_start: Array) -> Array:
    """Return the goal of the CoM on the ground in a double support, shape (3,) [m], in the frame of the base sole.

    It is the centre of the other sole at the start of the phase; in a stance, the middle between both soles.
    """
    end = model.soles[base.other]
    goal = Kinematics(model, q_start, base).point(end.frame, end.center)
    if kind is PhaseKind.STANCE:
        goal = 0.5 * (goal + model.soles[base].center)
    return np.array([goal[0], goal[1], 0.0])


_STALLED_WINDOWS = 10
"""A phase has stalled when the error decreases too slowly to reach its goal in time for this many windows in a row."""


class EndRule:
    """The switching rule of section 5.

    A double support ends when its error has stopped decreasing and the projection of the CoM is inside the cylinder of
    (U14) around the end foot. A single support ends when its error is below the threshold.

    Parameters
    ----------
    config : Config
    name : str
        Name of the phase, for messages.
    double : bool
        Whether it is a double support.
    """

    def __init__(self, config: Config, name: str, *, double: bool) -> None:
        self._name, self._double = name, double
        window = max(1, round(config.dsp.stall_window / config.dt))
        self._errors: deque[float] = deque(maxlen=window + 1)
        self._window = window * config.dt
        # the error of the double support is the distance of the CoM from the end foot's centre
        self._goal = config.ssp.com_radius if double else config.ssp.threshold
        self._slow_states = 0
        self._stall, self._timeout, self._dt = config.dsp.stall_rate, config.gait.phase_timeout, config.dt

    def is_over(self, error: float, elapsed: float) -> bool:
        """Return whether the phase ends at the state with this error, by the switching rule of section 5."""
        errors = self._errors
        errors.append(error)
        full = len(errors) == errors.maxlen
        fall = errors[0] - error
        if self._double:
            if full and fall < self._stall and error < self._goal:
                return True
        elif error < self._goal:
            return True
        timeout = self._timeout
        if elapsed > timeout:
            raise self._failed(f"is not over after {timeout:g} s", error, stalled=False)
        if full:
            # at the mean rate of the last window the goal is not reached within the timeout
            too_slow = fall * timeout < (error - self._goal) * self._window
            self._slow_states = self._slow_states + 1 if too_slow else 0
            if self._slow_states * self._dt > _STALLED_WINDOWS * self._window:
                raise self._failed("has stalled", error, stalled=True)
        return False

    def _failed(self, what: str, error: float, *, stalled: bool) -> PhaseError:
        unit = " m" if self._double else ""
        hint = "" if stalled else "; gait.phase_timeout may be too short"
        return PhaseError(
            f"{self._name} {what} at an error of {error:.4g}{unit} (it ends below {self._goal:.4g}{unit}){hint}",
            phase=self._name,
            error=error,
            stalled=stalled,
        )


class Timed:
    """Rule that ends a phase after a duration, which may change during the phase.

    Attributes
    ----------
    duration : float
        [s]
    begun : float
        Part of the duration that has passed when the phase begins, because its swing foot is in the air already [s].
    """

    def __init__(self, duration: float) -> None:
        self.duration, self.begun = duration, 0.0

    def is_over(self, error: float, elapsed: float) -> bool:
        """Return whether the time is up; see `Rule.is_over`."""
        return elapsed + self.begun >= self.duration - 1e-9
