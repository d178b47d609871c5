"""A walk, the sequence of its phases; and the walk of the paper: Fig. 1, sections 4.1, 4.2 and 5 [Urban2020]."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from dqwalk_ros.config import Config
from dqwalk_ros.paper.assembly import Evaluation
from dqwalk_ros.paper.collisions import capsules_in
from dqwalk_ros.paper.constraints import (
    AxisLevel,
    Constraint,
    JointMaximum,
    JointMinimum,
    Look,
    PointInCylinder,
    PointInsideWall,
    PointOverPlane,
)
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.features import CenterOfMass, Point
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import Cylinder, Line, Plane, X, Y, Z, wall_side
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import EndRule, Next, Phase, PhaseKind, Rule
from dqwalk_ros.paper.qp.problem import Problem, Solution
from dqwalk_ros.paper.state import Estimate
from dqwalk_ros.paper.statics import gravity_torques
from dqwalk_ros.paper.tasks import ComOverFoot, FramePose, Posture, Task
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ConfigError

if TYPE_CHECKING:
    from dqwalk_ros.robot.model import RobotModel
    from dqwalk_ros.robot.servos import Drive

_LOOKS = {
    "sliding": Look("sliding (U7)", (0, 140, 150)),
    "tip_plane": Look("tip plane (U9)", (31, 95, 180)),
    "back_plane": Look("back plane (U10)", (120, 80, 190)),
    "com_cylinder": Look("CoM cylinder (U14)", (29, 154, 78)),
    "pelvis": Look("pelvis plane (U11)", (110, 119, 129)),
    "joint_max": Look("upper joint limits (U12)"),
    "joint_min": Look("lower joint limits (U13)"),
}


@dataclass(frozen=True)
class Change:
    """What a walk changes in a phase that has begun."""

    decision: str
    """What is changed, and why; it is published and recorded."""
    swing_target: Array | None = None
    """The new x_d, shape (8,)."""
    walk: Walk | None = None
    """A walk that takes over at the next state, until it has no more phases."""


class Walk(ABC):
    """The sequence of the phases, and the footsteps."""

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

    def prepare(self) -> None:  # noqa: B027
        """Compute what the walk needs of the robot; called before the first state, so that none is answered late."""

    # ------------------------------------------------------------------ order

    @abstractmethod
    def following(self, phase: Phase | None, kin: Kinematics) -> Next | None:
        """Return what follows `phase`, which is None before the first phase; None after the last one.

        Parameters
        ----------
        kin : Kinematics
            The robot at the end of the phase, in its base frame; before the first phase in that of the left sole.
        """

    def restarts(self, phase: Phase) -> float | None:
        """Return for how long to stand before a phase begins again after an interruption of the control [s].

        None if the phase continues instead.
        """
        return None

    # ------------------------------------------------------------------ phases

    def phase(
        self,
        kind: PhaseKind,
        support: Foot,
        q_start: ArrayLike,
        swing_target: ArrayLike | None = None,
        up: Array | None = None,
    ) -> Phase:
        """Return the phase that begins at `q_start`; the same arguments give the same phase.

        Parameters
        ----------
        q_start : array_like, shape (n,)
            [rad]
        swing_target : array_like, shape (8,)
            Required for single support.
        up : ndarray, shape (3,), optional
            Unit vector against gravity in the inertial sensor's frame; by default the base sole is level.

        Raises
        ------
        ValueError
            If the swing target of a single support is missing.
        """
        if kind is not PhaseKind.SINGLE_SUPPORT:
            return self.both_feet(kind, support, Kinematics.measured(self.model, q_start, support.other, up))
        if swing_target is None:
            raise ValueError("a single support needs a swing target")
        kin = Kinematics.measured(self.model, q_start, support, up)
        return self.one_foot(support, kin, np.array(swing_target, dtype=np.float64))

    @abstractmethod
    def both_feet(self, kind: PhaseKind, support: Foot, kin: Kinematics) -> Phase:
        """Return a phase with both feet on the ground, which begins at `kin`, in the frame of the other foot's sole."""

    @abstractmethod
    def one_foot(self, support: Foot, kin: Kinematics, swing_target: Array) -> Phase:
        """Return the single support from `kin`, in the frame of its sole, that swings the other foot to a pose (8,)."""

    def _phase(
        self,
        kind: PhaseKind,
        support: Foot,
        kin: Kinematics,
        swing_target: Array | None,
        tasks: Sequence[Task],
        equalities: tuple[Constraint, ...],
        inequalities: tuple[Constraint, ...],
        *,
        rule: Rule,
        joint_return: float = np.inf,
    ) -> Phase:
        """Return the phase that begins at `kin`, with posture and further tasks, joint limits, and bodies kept apart.

        `joint_return` is the largest speed at which a joint beyond its limit is required to return [rad/s].
        """
        config = self.config
        if config.task.posture_weight > 0.0:
            tasks = (*tasks, Posture(name="posture", weight=config.task.posture_weight, q_ref=self.posture))
        tasks = (*tasks, *self.beside(kin.base))
        if config.collision.pairs:
            inequalities = (*inequalities, *capsules_in(config, self.model))
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
            limits=joint_limits(config, self.model, joint_return),
            rule=rule,
        )

    def beside(self, base: Foot) -> tuple[Task, ...]:
        """Return further tasks of every phase on the sole `base`, by default none."""
        return ()

    # ------------------------------------------------------------------ update for every state

    def observe(self, phase: Phase, kin: Kinematics, state: Estimate) -> Change | None:
        """Process a measured state before its command is computed, and return what the walk changes in the phase.

        A walk with online planning updates the targets of the tasks of `phase` here.
        """
        return None

    def solved(self, now: Evaluation, solve: Callable[[Problem], Solution]) -> Solution:
        """Return the solution of the quadratic program of an evaluation by `solve`."""
        return solve(now.problem)

    def effort(self, phase: Phase, kin: Kinematics, state: Estimate, u: Array) -> Array:
        """Return feedforward torques for the command `u` (n,), shape (n,) [N m]: by default they compensate gravity."""
        return gravity_torques(kin, both=phase.double)

    # ------------------------------------------------------------------ requests from outside

    def use(self, drive: Drive) -> None:  # noqa: B027
        """Use the model of the servos that the controller has learned."""

    def tune(self, config: Config) -> None:
        """Replace the parameters from the next phase on (`config.Spec.live`).

        Raises
        ------
        ConfigError
            If this walk does not support it.
        """
        raise ConfigError("this walk keeps the parameters that it began with")

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
        raise ConfigError("this walk is not steered by velocity; set gait.steps: 0 with gait.style standing or dynamic")

    def pause(self, wanted: bool) -> None:  # noqa: B027
        """Bring the robot to a posture in which it may hold still (`may_hold`), or continue the walk."""

    def may_hold(self, phase: Phase) -> bool:
        """Return whether the robot stands without commands in `phase`: by default in every posture."""
        return True

    def stop(self) -> None:
        """Put the feet together after the current step, and end the walk.

        Raises
        ------
        ConfigError
            If this walk does not support it.
        """
        raise ConfigError("this walk cannot stop after a step; pause it")


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

    def following(self, phase: Phase | None, kin: Kinematics) -> Next | None:
        """Return the next phase of Fig. 1; None after the last one."""
        self._index += 1
        found = self.phase_at(self.config, self._index)
        if found is None:
            return None
        kind, support = found
        return Next(kind, support, self.footstep(support) if kind is PhaseKind.SINGLE_SUPPORT else None)

    def footstep(self, support: Foot) -> Array:
        """Return x_d of the swing sole in the support sole's frame, shape (8,): a step ahead, flat on the ground."""
        width = self.config.gait.step_width
        if width == 0.0:
            kin = Kinematics(self.model, np.zeros(self.model.n), support)
            width = abs(float(kin.point(kin.swing)[1]))
        y = -width if support is Foot.LEFT else width
        return DQ.from_pose([self.config.gait.step_length, y, 0.0]).vec8()

    def both_feet(self, kind: PhaseKind, support: Foot, kin: Kinematics) -> Phase:
        """Return the double support that brings the CoM over the foot `support`, section 4.1."""
        dsp, model = self.config.dsp, self.model
        base_sole, end_sole = model.soles[kin.base], model.soles[support]
        end = end_sole.frame
        tip, heel, center = (Point(end, offset) for offset in (end_sole.tip, end_sole.heel, end_sole.center))

        def wall(name: str, eta: float, fixed: Array, moving: Point, inside: Array) -> PointInsideWall:
            side = wall_side(fixed, moving.value(kin), inside)
            return PointInsideWall(
                name=name, eta=eta, point=CenterOfMass(), fixed=fixed, moving=moving, side=side,
                depth=base_sole.length, look=_LOOKS[name],
            )  # fmt: skip

        ground: list[Constraint] = [
            PointOverPlane(name="ground", eta=dsp.eta_ground, point=tip, plane=Plane(Z, 0.0)),  # (U8)
        ]
        if dsp.flat_feet:
            ground += [
                AxisLevel(name="flat_pitch", eta=dsp.eta_ground, frame=end, direction=X),
                AxisLevel(name="flat_roll", eta=dsp.eta_ground, frame=end, direction=Y),
            ]
        sliding = Cylinder(Line.through(tip.value(kin), Z), dsp.sliding_radius)
        inequalities = (
            PointInCylinder(
                name="sliding", eta=dsp.eta_sliding, point=tip, cylinder=sliding, look=_LOOKS["sliding"]
            ),  # (U7)
            wall("tip_plane", dsp.eta_tip, base_sole.tip, tip, base_sole.heel),  # (U9)
            wall("back_plane", dsp.eta_back, base_sole.heel, heel, base_sole.tip),  # (U10)
            pelvis_height(self.config, model),
        )
        task, kind = ComOverFoot(name="com", foot=center), PhaseKind.DOUBLE_SUPPORT
        rule = EndRule(self.config, f"{kind.value}/{support.value}", double=True)
        return self._phase(kind, support, kin, None, (task,), tuple(ground), inequalities, rule=rule)

    def one_foot(self, support: Foot, kin: Kinematics, swing_target: Array) -> Phase:
        """Return the single support on the foot `support` that swings the other one to its target, section 4.2."""
        ssp, model = self.config.ssp, self.model
        cylinder = Cylinder(Line.through(model.soles[support].center, Z), ssp.com_radius)
        look = _LOOKS["com_cylinder"]
        inequalities = (
            PointInCylinder(
                name="com_cylinder", eta=ssp.eta_com, point=CenterOfMass(), cylinder=cylinder, look=look
            ),  # (U14)
            pelvis_height(self.config, model),
        )
        task, kind = FramePose(name="swing", frame=kin.swing, target=swing_target), PhaseKind.SINGLE_SUPPORT
        rule = EndRule(self.config, f"{kind.value}/{support.value}", double=False)
        return self._phase(kind, support, kin, swing_target, (task,), (), inequalities, rule=rule)


def pelvis_height(config: Config, model: RobotModel) -> Constraint:
    """Return the constraint (U11): the pelvis stays above ``pelvis.height``."""
    plane, look = Plane(Z, config.pelvis.height), _LOOKS["pelvis"]  # (U11)
    return PointOverPlane(name="pelvis", eta=config.pelvis.eta, point=Point(model.pelvis), plane=plane, look=look)


def joint_limits(config: Config, model: RobotModel, return_speed: float = np.inf) -> tuple[JointMaximum, JointMinimum]:
    """Return the constraints (U12) and (U13) on the joint angles; `return_speed` [rad/s] as in `Constraint`."""
    given = {"eta": config.joints.eta, "bound": config.joints.margin, "return_speed": return_speed}
    return (
        JointMaximum(name="joint_max", q_max=model.q_max, look=_LOOKS["joint_max"], **given),  # (U12)
        JointMinimum(name="joint_min", q_min=model.q_min, look=_LOOKS["joint_min"], **given),  # (U13)
    )


def com_target(kind: PhaseKind, kin: Kinematics) -> Array:
    """Return the goal of the CoM on the ground in a double support that begins at `kin`, in its base frame (3,) [m].

    It is the centre of the other sole; in a stance, the middle between both soles.
    """
    base, end = (kin.model.soles[foot] for foot in (kin.base, kin.base.other))
    goal = kin.point(end.frame, end.center)
    if kind is PhaseKind.STANCE:
        goal = 0.5 * (goal + base.center)
    return np.array([goal[0], goal[1], 0.0])


def kind_with_target(kin: Kinematics, place: Array) -> PhaseKind:
    """Return the kind of a phase on both feet, begun at `kin`, whose `com_target` is nearest to a place (2,) [m]."""
    kinds = PhaseKind.DOUBLE_SUPPORT, PhaseKind.STANCE
    return min(kinds, key=lambda kind: float(np.linalg.norm(place - com_target(kind, kin)[:2])))
