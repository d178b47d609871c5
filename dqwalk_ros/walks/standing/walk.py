"""The standing walk: statically stable steps on rectangular soles; its phases, their order and the rule that ends them.

In double support the support polygon is the convex hull of both soles, in single support it is the support sole. Each
of its edges is a plane, "as many planes as necessary" (section 3.1 [Urban2020]), moved inwards by a margin.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.paper.constraints import ComInsideEdges, Constraint, PointsOverPlane
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.features import Point
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import ConvexPolygon, Plane, Z
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import Next, Phase, PhaseKind
from dqwalk_ros.paper.state import Estimate
from dqwalk_ros.paper.walk import Change, pelvis_height
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.servos import Drive
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ConfigError, PhaseError
from dqwalk_ros.walks.following import ComPath, SwingPath
from dqwalk_ros.walks.footprint import flat
from dqwalk_ros.walks.standing.balance import Balance
from dqwalk_ros.walks.stepping import JOINT_RETURN, SteppingWalk

_STOPPED = 0.05
"""Part of the sole's length from which on a foot behind its path is stopped by an obstacle; the swing is slow."""


class StandingWalk(SteppingWalk):
    """Alternating double and single supports; at the end the feet are put together and the CoM between them."""

    def __init__(self, config: Config, model: RobotModel) -> None:
        super().__init__(config, model)
        self._requested = config  # from the next phase on
        self._balance: Balance | None = None
        self._drive = Drive.of(config, model)
        self._stopped_short = False  # an obstacle has stopped the foot that has not landed yet

    @staticmethod
    def phases(config: Config) -> int:
        """Return the number of phases: two per step, two to put the feet together, and a stance; 0 if steered."""
        if commanded := len(config.gait.footsteps):
            return 2 * commanded + 2
        return 2 * config.gait.steps + 3 if config.gait.steps else 0

    def prepare(self) -> None:
        """Check the steps; without commanded ones, that each foot reaches its place beside the other one.

        Raises
        ------
        ConfigError
            If it does not; see also `SteppingWalk.prepare`.
        """
        super().prepare()
        if not self.config.gait.footsteps and (why := self.footsteps.not_beside()):
            raise ConfigError(f"gait.step_width: {why}")

    # ------------------------------------------------------------------ order

    def tune(self, config: Config) -> None:
        """Replace the parameters from the next phase on."""
        self._requested = config

    def following(self, phase: Phase | None, kin: Kinematics) -> Next | None:
        """Return what follows `phase`; None after the last one. At first a foot that is in the air is put down."""
        self.config = self.footsteps.config = self._requested
        steps = self.config.gait.steps
        if phase is None:
            first = Next(PhaseKind.DOUBLE_SUPPORT if steps else PhaseKind.STANCE, self._first)
            return self._on_its_feet(kin) or first
        if phase.kind is PhaseKind.STANCE:
            over = not self._planned and (steps or self._stopping)
            return None if over else Next(PhaseKind.DOUBLE_SUPPORT, self._leading())
        if phase.kind is PhaseKind.SINGLE_SUPPORT:
            in_the_air = isinstance(phase.rule, PathEnd) and phase.rule.stopped
            if in_the_air and (down := self._on_its_feet(kin)) is not None:
                return down
            if self._stopped_short:
                self._stopped_short = False
                self._planned.clear()
            return Next(PhaseKind.STANCE if self._together else PhaseKind.DOUBLE_SUPPORT, phase.support.other)
        if self._planned:
            target = self._next_footprint(kin)
            self._together = not self._planned
        else:
            step = self._step()
            self._together = step is None
            target = self.footsteps.beside(phase.support) if step is None else self.footsteps.step(phase.support, *step)
            self._done += 1
        return Next(PhaseKind.SINGLE_SUPPORT, phase.support, target)

    def use(self, drive: Drive) -> None:
        """Use a model of the servos: a foot is behind its path by their delay."""
        self._drive = drive

    def observe(self, phase: Phase, kin: Kinematics, state: Estimate) -> Change | None:
        """End a swing that an obstacle stops; the next phase puts the foot down where it is.

        Commanded footsteps are dropped when it has landed: until then the plant may turn out to be dead (`restarts`).
        """
        change = super().observe(phase, kin, state)
        swing, rule = phase.tasks[0], phase.rule
        if isinstance(swing, SwingPath) and isinstance(rule, PathEnd):
            rule.stopped = bool(phase.decision)  # at the next state, so that the decision is seen
            stopped = self._stopped(phase, kin, state, *swing.at(state.elapsed), self._drive.delay, _STOPPED)
            if stopped and not rule.stopped:
                self._stopped_short = True
                return stopped
        return change

    def restarts(self, phase: Phase) -> float | None:
        """Return ``standing.transfer_duration`` in double support, 0 in single support.

        After an interruption the CoM is at rest: continuing at the velocity of the path would tip the robot. On soft
        servos it needs this time to come to rest. A swing begins again where the foot is: on its path it would be
        behind by what a plant that was killed has missed, as before an obstacle, for which nothing is dropped either.
        """
        self._stopped_short = False
        return 0.0 if phase.kind is PhaseKind.SINGLE_SUPPORT else self.config.standing.transfer_duration

    def _step(self) -> tuple[float, float, float] | None:
        """Return length, side [m] and turn [rad] of the next step; None if the feet are to be put together."""
        gait = self.config.gait
        if self._stopping:
            return None
        if gait.steps:
            return None if self._done >= gait.steps else (gait.step_length, gait.step_side, gait.step_turn)
        return self._step_at(self._twist) if any(self._twist) else None

    # ------------------------------------------------------------------ phases

    def both_feet(self, kind: PhaseKind, support: Foot, kin: Kinematics) -> Phase:
        """Return the phase that brings the CoM over the sole of `support`, in a stance between both soles."""
        s, model = self.config.standing, self.model
        base, end = model.soles[kin.base], model.soles[kin.base.other]
        over = tuple(model.soles.values()) if kind is PhaseKind.STANCE else (end,)
        pose = flat(kin.pose(end.frame))
        hull = ConvexPolygon.hull(np.concatenate([base.corners, DQ(pose).transform_point(end.corners)]))
        com = ComPath(
            name="com",
            start=kin.com_on_ground,
            over=tuple(Point(sole.frame, sole.center) for sole in over),
            duration=s.transfer_duration,
            saturation=s.saturation,
        )
        rows = (self._edges(hull), pelvis_height(self.config, model))
        rule = PathEnd(
            self.config, kind, f"{kind.value}/{support.value}", lambda: kind is PhaseKind.STANCE and self._is_idle
        )
        return self._phase(
            kind, support, kin, None, (com,), (self._held(kin),), rows, rule=rule, joint_return=JOINT_RETURN
        )

    def one_foot(self, support: Foot, kin: Kinematics, swing_target: Array) -> Phase:
        """Return the single support on the foot `support` that swings the other one to its target."""
        s, model = self.config.standing, self.model
        sole, swing = model.soles[support], model.soles[support.other]
        inequalities: tuple[Constraint, ...] = (
            self._edges(sole.outline),
            PointsOverPlane(
                name="clearance", eta=s.eta_edges, return_speed=s.recovery, frame=swing.frame, points=swing.corners,
                plane=Plane(Z, 0.0),
            ),
            self._gap(support),
            pelvis_height(self.config, model),
        )  # fmt: skip
        task = SwingPath(
            name="swing",
            weight=s.swing_weight,
            frame=swing.frame,
            start=kin.pose(swing.frame),
            goal=swing_target,
            height=self.config.gait.step_height,
            duration=s.swing_duration,
            eta=s.swing_rate,
            lever=s.lever,
        )
        inside = np.array([0.0, s.aim_inside if support is Foot.RIGHT else -s.aim_inside, 0.0])
        com = ComPath(
            name="com",
            weight=s.com_weight,
            start=kin.com_on_ground,
            over=(Point(sole.frame, sole.center + inside),),
            duration=0.5 * s.swing_duration,
            saturation=s.saturation,
        )
        kind = PhaseKind.SINGLE_SUPPORT
        rule = PathEnd(self.config, kind, f"{kind.value}/{support.value}")
        return self._phase(
            kind, support, kin, swing_target, (task, com), (), inequalities, rule=rule, joint_return=JOINT_RETURN
        )

    def _edges(self, polygon: ConvexPolygon) -> ComInsideEdges:
        """Return the constraint that keeps the CoM inside the support polygon."""
        s = self.config.standing
        return ComInsideEdges(name="edges", eta=s.eta_edges, bound=s.margin, return_speed=s.recovery, polygon=polygon)

    def effort(self, phase: Phase, kin: Kinematics, state: Estimate, u: Array) -> Array:
        """Return the torques that compensate gravity and balance the CoM on its path, shape (n,) [N m]."""
        if self._balance is None or self._balance.phase is not phase:
            self._balance = Balance(phase, self.config)
        return self._balance(kin, state)


class PathEnd:
    """Ends a phase of a standing walk after the duration of its path, when the error is below a threshold.

    It does not end while `waits` returns True. A phase that runs out of time has stalled if in the second half of
    the time since the end of its path the error fell by less than what is left of it.
    """

    def __init__(self, config: Config, kind: PhaseKind, name: str, waits: Callable[[], bool] = lambda: False) -> None:
        s, swing = config.standing, kind is PhaseKind.SINGLE_SUPPORT
        self._name, self._waits, self.stopped = name, waits, False
        self._duration = s.swing_duration if swing else s.transfer_duration
        self._goal = s.swing_threshold if swing else s.com_threshold
        self._timeout = config.gait.phase_timeout
        self._halfway = math.inf  # error in the middle of the time after the path

    def is_over(self, error: Callable[[], float], elapsed: float) -> bool:
        """Return whether the phase ends at the state with this error; see `phase.Rule.is_over`."""
        if self.stopped or self._waits() or elapsed < min(self._duration - 1e-9, self._timeout):
            return self.stopped
        now, over = error(), elapsed >= self._duration - 1e-9
        if over and now < self._goal:
            return True
        if over and elapsed <= 0.5 * (self._duration + self._timeout):
            self._halfway = now
        if elapsed > self._timeout:
            stalled = self._halfway - now < now - self._goal
            raise PhaseError(
                f"{self._name} {'has stalled' if stalled else f'is not over after {self._timeout:g} s'} at an error of "
                f"{now:.4g} m (it ends below {self._goal:.4g} m)"
                f"{'' if stalled else '; gait.phase_timeout may be too short'}",
                phase=self._name,
                error=now,
                stalled=stalled,
            )
        return False
