"""The walk of the paper: its phases, their order and the rules that end them (Fig. 1, sections 4.1, 4.2 and 5).

A phase says what is wanted (tasks), what is held (equalities), what is kept (inequalities), and when it ends. The world
of a phase is the sole of its base foot. A walk says which phase follows which, and where the feet go.
"""

from __future__ import annotations

import enum
from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqwalk_ros.assembly import Assembly, Evaluation
from dqwalk_ros.config import Config
from dqwalk_ros.constraints import (
    AxisLevel,
    Constraint,
    JointMaximum,
    JointMinimum,
    PointInCylinder,
    PointInsideWall,
    PointOverPlane,
)
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import ConfigError, PhaseError
from dqwalk_ros.geometry import Cylinder, Line, Plane, wall_side
from dqwalk_ros.kinematics import CenterOfMass, Kinematics, Point
from dqwalk_ros.robot import Foot, RobotModel
from dqwalk_ros.state import State
from dqwalk_ros.statics import gravity_torques
from dqwalk_ros.tasks import ComOverFoot, FramePose, Posture, Task

__all__ = ["EndRule", "PaperWalk", "Phase", "PhaseKind", "Rule", "Walk", "com_target", "joint_limits", "pelvis_height"]

Array = NDArray[np.float64]

_UP = np.array([0.0, 0.0, 1.0])
_X = np.array([1.0, 0.0, 0.0])
_Y = np.array([0.0, 1.0, 0.0])


class PhaseKind(enum.Enum):
    """Both feet on the ground, or one; in a stance the weight is on both."""

    DOUBLE_SUPPORT = "double_support"
    SINGLE_SUPPORT = "single_support"
    STANCE = "stance"


class Rule(Protocol):
    """Decides, state by state, when a phase ends."""

    def is_over(self, error: float, elapsed: float) -> bool:
        """Return whether the phase ends at a state.

        Parameters
        ----------
        error : float
            Norm of the error of the phase's own task.
        elapsed : float
            Time since the phase began [s].

        Raises
        ------
        PhaseError
            If it cannot end any more, or takes longer than ``gait.phase_timeout``.
        """


@dataclass(frozen=True, kw_only=True, eq=False)
class Phase:
    """One phase of a walk.

    Attributes
    ----------
    model : RobotModel
    kind : PhaseKind
    support : Foot
        The foot that carries the weight at the end of the phase, by which the phase is named.
    base : Foot
        The foot whose sole is the world: the support foot in single support, the other one in double support.
    q_start : ndarray, shape (n,)
        Where the phase began [rad].
    swing_target : ndarray, shape (8,), or None
        x_d of the swinging sole in the base frame.
    eta, damping : float
        eta [1/s] and lambda of (U6).
    tasks : tuple of Task
        The first is the phase's own: its error ends the phase.
    equalities : tuple of Constraint
        d' = -eta (d - bound).
    inequalities : tuple of Constraint
        d' >= -eta (d - bound).
    limits : tuple of JointMaximum and JointMinimum
        Joint limits (U12) and (U13), which the quadratic program takes as bounds on u.
    rule : Rule
        When it ends.
    decision : str
        What was changed while it lasted, and why; empty where nothing was.
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
        """Such as ``double_support/left``."""
        return f"{self.kind.value}/{self.support.value}"

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """All inequalities, the joint limits among them."""
        return (*self.inequalities, *self.limits)

    @cached_property
    def _assembly(self) -> Assembly:
        kin = Kinematics(self.model, self.q_start, self.base)
        stacked = self.tasks, self.equalities, self.inequalities, self.limits
        return Assembly(kin, *stacked, eta=self.eta, damping=self.damping)

    @property
    def row_names(self) -> tuple[str, ...]:
        """Names of the rows of the quadratic program, in its order."""
        return self._assembly.names

    def evaluate(self, kin: Kinematics) -> Evaluation:
        """Return errors, distances and Jacobians at one configuration, seen from `base`."""
        return self._assembly(kin)

    def error(self, kin: Kinematics) -> float:
        """Norm of the error of the phase's own task."""
        return self.evaluate(kin).error

    def distances(self, kin: Kinematics) -> dict[str, float]:
        """Every signed distance less its bound, by name; what is kept is >= 0, what is held is 0.

        Of several rows it is the least, of an equality the one furthest from 0.
        """
        return self.evaluate(kin).distances()


class Walk(ABC):
    """Which phase follows which, and where the feet go.

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
        """Return how many phases the whole walk has; 0 where it is steered and has no end."""

    @staticmethod
    @abstractmethod
    def describe(config: Config) -> str:
        """Return in words how far the walk goes."""

    @property
    @abstractmethod
    def posture(self) -> Array:
        """The posture in which the walk begins, shape (n,) [rad]."""

    is_tunable = False
    """Whether parameters that the schema calls live may change between two phases."""

    def tune(self, config: Config) -> None:
        """Go on with other parameters, from the next phase on."""
        self.config = config

    def is_waiting(self, phase: Phase) -> bool:
        """Return whether `phase` goes on although its rule may say that it is over."""
        return False

    @abstractmethod
    def following(self, phase: Phase | None) -> tuple[PhaseKind, Foot, Array | None] | None:
        """Return kind, support foot and swing target of the phase after `phase`; None after the last one."""

    def beginning(self, kin: Kinematics) -> tuple[PhaseKind, Foot, Array | None] | None:
        """Return kind, support foot and swing target of the first phase of a robot that stands as in `kin`."""
        return self.following(None)

    def phase(self, kind: PhaseKind, support: Foot, q_start: ArrayLike, swing_target: ArrayLike | None = None) -> Phase:
        """Return the phase that begins at `q_start`; the same arguments give the same phase.

        Parameters
        ----------
        kind : PhaseKind
        support : Foot
        q_start : array_like, shape (n,)
            [rad]
        swing_target : array_like, shape (8,)
            For single support.

        Raises
        ------
        ValueError
            If a single support comes without its target.
        """
        q = np.array(q_start, dtype=np.float64)
        if kind is not PhaseKind.SINGLE_SUPPORT:
            return self.both_feet(kind, support, q)
        if swing_target is None:
            raise ValueError("a single support needs the target of its swing foot")
        return self.one_foot(support, q, np.array(swing_target, dtype=np.float64))

    @abstractmethod
    def both_feet(self, kind: PhaseKind, support: Foot, q_start: Array) -> Phase:
        """Return a phase with both feet on the ground."""

    @abstractmethod
    def one_foot(self, support: Foot, q_start: Array, swing_target: Array) -> Phase:
        """Return the single support on `support` that swings the other foot to its target."""

    def restarts(self, phase: Phase) -> float | None:
        """Return for how long to stand before a phase begins anew after states without an answer [s].

        None where the phase goes on where it was.
        """
        return None

    def observe(self, phase: Phase, kin: Kinematics, state: State) -> Phase:
        """Look at a state before it is answered, and return the phase as it goes on.

        A walk that plans anew sets here what the tasks of `phase` follow. Where it decides that the foot lands
        elsewhere, it returns the phase with that swing target and its decision in words.
        """
        return phase

    def effort(self, phase: Phase, kin: Kinematics, state: State) -> Array:
        """Return torques to be fed forward, shape (n,) [N m]: those that hold the robot against gravity."""
        return gravity_torques(kin, both=phase.kind is not PhaseKind.SINGLE_SUPPORT)

    def steer(self, forward: float, left: float, turn: float) -> tuple[float, float, float]:
        """Set the velocity of a walk that is steered [m/s, m/s, rad/s]; zero puts the feet together and waits.

        Returns
        -------
        tuple of float
            The velocity it walks with, within what the legs can do.

        Raises
        ------
        ConfigError
            If this walk cannot be steered.
        """
        raise ConfigError("only a standing walk without a number of steps is steered: gait.steps: 0")

    def stop(self) -> None:
        """Put the feet together after the step under way, and end the walk.

        Raises
        ------
        ConfigError
            If this walk cannot end so.
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
        """Return four for each cycle."""
        return PaperWalk.PHASES_PER_CYCLE * config.gait.cycles

    @staticmethod
    def describe(config: Config) -> str:
        """Return such as ``2 cycles``."""
        return f"{config.gait.cycles} cycle{'s' if config.gait.cycles > 1 else ''}"

    @property
    def posture(self) -> Array:
        """The posture of ``standing.posture``, shape (n,) [rad]: all joints at zero (section 5) unless it is given."""
        return self.model.posture(self.config.standing.posture)

    @staticmethod
    def phase_at(config: Config, index: int) -> tuple[PhaseKind, Foot] | None:
        """Return kind and support foot of the phase `index` (0, 1, ...) of Fig. 1, or None after the last one.

        Double support to the first support foot, single support on it, and the same with the other foot.
        """
        if index >= PaperWalk.phases(config):
            return None
        first = Foot(config.gait.first_support)
        support = first if index % PaperWalk.PHASES_PER_CYCLE < 2 else first.other
        return (PhaseKind.SINGLE_SUPPORT if index % 2 else PhaseKind.DOUBLE_SUPPORT), support

    def following(self, phase: Phase | None) -> tuple[PhaseKind, Foot, Array | None] | None:
        """Return kind, support foot and swing target of the next phase of Fig. 1; None after the last one."""
        self._index += 1
        at = self.phase_at(self.config, self._index)
        if at is None:
            return None
        kind, support = at
        return kind, support, self.footstep(support) if kind is PhaseKind.SINGLE_SUPPORT else None

    def footstep(self, support: Foot) -> Array:
        """Return x_d of the swinging sole in the support sole's frame, shape (8,): ahead, and flat."""
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
        return self._phase(
            PhaseKind.DOUBLE_SUPPORT,
            support,
            base,
            q_start,
            None,
            ComOverFoot(name="com", foot=center),
            tuple(ground),
            (
                PointInCylinder(name="sliding", eta=dsp.eta_sliding, point=tip, cylinder=sliding),  # (U7)
                wall("tip_plane", dsp.eta_tip, base_sole.tip, tip, base_sole.heel),  # (U9)
                wall("back_plane", dsp.eta_back, base_sole.heel, heel, base_sole.tip),  # (U10)
                pelvis_height(self.config, model),  # (U11)
            ),
        )

    def one_foot(self, support: Foot, q_start: Array, swing_target: Array) -> Phase:
        """Return the single support on the foot `support` that swings the other one to its target, section 4.2."""
        ssp, model = self.config.ssp, self.model
        cylinder = Cylinder(Line.through(model.soles[support].center, _UP), ssp.com_radius)
        return self._phase(
            PhaseKind.SINGLE_SUPPORT,
            support,
            support,
            q_start,
            swing_target,
            FramePose(name="swing", frame=model.soles[support.other].frame, target=swing_target),
            (),
            (
                PointInCylinder(name="com_cylinder", eta=ssp.eta_com, point=CenterOfMass(), cylinder=cylinder),  # (U14)
                pelvis_height(self.config, model),  # (U11)
            ),
        )

    def _phase(
        self,
        kind: PhaseKind,
        support: Foot,
        base: Foot,
        q_start: Array,
        swing_target: Array | None,
        task: Task,
        equalities: tuple[Constraint, ...],
        inequalities: tuple[Constraint, ...],
    ) -> Phase:
        config, tasks = self.config, [task]
        if config.task.posture_weight > 0.0:
            tasks.append(Posture(name="posture", weight=config.task.posture_weight, q_ref=self.posture))
        return Phase(
            model=self.model,
            kind=kind,
            support=support,
            base=base,
            q_start=q_start,
            swing_target=swing_target,
            eta=config.task.eta,
            damping=config.task.damping,
            tasks=tuple(tasks),
            equalities=equalities,
            inequalities=inequalities,
            limits=joint_limits(config, self.model),
            rule=EndRule(config, f"{kind.value}/{support.value}", double=kind is PhaseKind.DOUBLE_SUPPORT),
        )


def pelvis_height(config: Config, model: RobotModel) -> Constraint:
    """Return (U11): the pelvis stays above a height."""
    plane = Plane(_UP, config.pelvis.height)
    return PointOverPlane(name="pelvis", eta=config.pelvis.eta, point=Point(model.pelvis), plane=plane)


def joint_limits(config: Config, model: RobotModel, return_speed: float = np.inf) -> tuple[JointMaximum, JointMinimum]:
    """Return (U12) and (U13)."""
    eta, margin = config.joints.eta, config.joints.margin
    return (
        JointMaximum(name="joint_max", eta=eta, bound=margin, return_speed=return_speed, q_max=model.q_max),  # (U12)
        JointMinimum(name="joint_min", eta=eta, bound=margin, return_speed=return_speed, q_min=model.q_min),  # (U13)
    )


def com_target(model: RobotModel, kind: PhaseKind, base: Foot, q_start: Array) -> Array:
    """Return where on the ground the CoM goes with both feet down, shape (3,) [m], as seen where the phase begins.

    To the other sole's centre, in a stance halfway to it.
    """
    end = model.soles[base.other]
    there = Kinematics(model, q_start, base).point(end.frame, end.center)
    if kind is PhaseKind.STANCE:
        there = 0.5 * (there + model.soles[base].center)
    return np.array([there[0], there[1], 0.0])


_STALLED_WINDOWS = 10
"""After so many windows in a row in which the error falls too slowly to arrive in time, a phase has stalled."""


class EndRule:
    """The switching rule of section 5.

    A double support is over when its error has stopped falling and the CoM projection is inside the cylinder of
    the end foot as it then stands; a single support when its error is below the threshold.

    Parameters
    ----------
    config : Config
    name : str
        Of the phase, for the message.
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
        self._hopeless = 0
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
            raise self._failed(f"is not over after {timeout:g} s", error)
        if full:
            # at the rate of the last window the goal is further away than the time limit
            hopeless = fall * timeout < (error - self._goal) * self._window
            self._hopeless = self._hopeless + 1 if hopeless else 0
            if self._hopeless * self._dt > _STALLED_WINDOWS * self._window:
                raise self._failed("has stalled", error)
        return False

    def _failed(self, what: str, error: float) -> PhaseError:
        unit = " m" if self._double else ""
        return PhaseError(
            f"{self._name} {what} at an error of {error:.4g}{unit} (it ends below {self._goal:.4g}{unit})",
            phase=self._name,
            error=error,
        )
