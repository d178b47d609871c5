"""The standing walk: statically stable steps on rectangular soles; its phases, their order and the rule that ends them.

In double support the support polygon is the convex hull of both soles, in single support it is the support sole. Each
of its edges is a plane, "as many planes as necessary" (section 3.1 [Urban2020]), moved inwards by a margin.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.paper.constraints import ComInsideEdges, Constraint, FrameHeld, PointsOverPlane
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import ConvexPolygon, Plane
from dqwalk_ros.paper.kinematics import Kinematics, Point
from dqwalk_ros.paper.paths import ComPath, SwingPath
from dqwalk_ros.paper.state import State
from dqwalk_ros.paper.walk import Phase, PhaseKind, Rule, Walk, pelvis_height
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import PhaseError
from dqwalk_ros.walks.standing.balance import Balance
from dqwalk_ros.walks.standing.footsteps import Footsteps, flat

__all__ = ["StandingWalk"]


_UP = np.array([0.0, 0.0, 1.0])
_LIFTED = 0.004
"""Height of a sole above the plane of the other one from which on it is in the air [m]."""


class StandingWalk(Walk):
    """Alternating double and single supports; at the end the feet are put together and the CoM between them.

    With ``gait.steps: 0`` the walk is steered (`steer`) and waits in a stance while its velocity is zero.
    """

    def __init__(self, config: Config, model: RobotModel) -> None:
        super().__init__(config, model)
        self.footsteps = Footsteps(config, model, self.posture)
        self._twist = (0.0, 0.0, 0.0)
        self._stopping = False
        self._together = False
        self._done = 0
        self._planned: deque[Array] = deque()  # remaining commanded footprints, each in the frame of its support sole
        self._stands_first: Foot | None = None  # support foot of the first commanded footprint
        self._first = Foot(config.gait.first_support)
        self._balance: Balance | None = None
        self._observed: Phase | None = None

    is_tunable = True
    joint_return = 0.5

    def tune(self, config: Config) -> None:
        """Replace the parameters; the new ones apply from the next phase on."""
        super().tune(config)
        self.footsteps.config = config

    @staticmethod
    def phases(config: Config) -> int:
        """Return the number of phases: two per step, two to put the feet together, and a stance; 0 if steered."""
        return 2 * config.gait.steps + 3 if config.gait.steps else 0

    @staticmethod
    def describe(config: Config) -> str:
        """Return the number of steps in words, such as ``20 steps``."""
        steps = config.gait.steps
        return f"{steps} step{'s' if steps > 1 else ''}" if steps else "steered by cmd_vel"

    @cached_property
    def posture(self) -> Array:
        """Joint angles of ``standing.posture``, shape (n,) [rad]."""
        return self.model.posture(self.config.standing.posture)

    # ------------------------------------------------------------------ order

    def steer(self, forward: float, left: float, turn: float) -> tuple[float, float, float]:
        """Set the velocity of a steered walk, scaled down if a step would exceed its limits; see `Walk.steer`.

        The limit is the ellipsoid with the half axes ``gait.most_length``, ``gait.most_side`` and ``gait.most_turn``.
        """
        if self.config.gait.steps:
            return super().steer(forward, left, turn)
        gait, period = self.config.gait, self._period
        wanted = (forward * period, left * period, turn * period)
        most = (gait.most_length, gait.most_side, gait.most_turn)
        # a direction with the limit zero is ignored
        parts = [min(max(a / m, -1e9), 1e9) if m else 0.0 for a, m in zip(wanted, most, strict=True)]
        size = max(1.0, math.hypot(*parts))
        x, y, z = (part * m / (size * period) for part, m in zip(parts, most, strict=True))
        self._twist = (x, y, z)
        return self._twist

    def stop(self) -> None:
        """Put the feet together after the current step, and end the walk."""
        self._stopping = True

    def place(self, support: Foot, footprints: Sequence[Array]) -> None:
        """Step on commanded footprints (8,), and wait on the last one; an empty sequence cancels the remaining ones.

        Raises
        ------
        StateError
            If a footprint violates a limit; see `Footsteps.planned`, also for the frames of the footprints.
        """
        self._planned = deque(self.footsteps.planned(support, footprints))
        self._stands_first = support

    @property
    def placed(self) -> int:
        """Number of remaining commanded footprints."""
        return len(self._planned)

    def observe(self, phase: Phase, kin: Kinematics, state: State) -> Phase:
        """Return the phase; with an inertial sensor, its CoM path begins at the CoM's projection along gravity."""
        if state.up is not None and phase is not self._observed:
            start = kin.com_on_ground
            tasks = (replace(task, start=start) if isinstance(task, ComPath) else task for task in phase.tasks)
            self._observed = phase = replace(phase, tasks=tuple(tasks))
        return phase

    def is_waiting(self, phase: Phase) -> bool:
        """Return whether `phase` is a stance of a steered walk with zero velocity and without footprints."""
        idle = not (self.config.gait.steps or self._stopping or any(self._twist) or self._planned)
        return idle and phase.kind is PhaseKind.STANCE

    @property
    def _period(self) -> float:
        """Duration of a step [s]."""
        s = self.config.standing
        return s.transfer_duration + s.swing_duration

    def following(self, phase: Phase | None) -> tuple[PhaseKind, Foot, Array | None] | None:
        """Return kind, support foot and swing target of the phase after `phase`; None after the last one."""
        steps = self.config.gait.steps
        if phase is None:
            return (PhaseKind.DOUBLE_SUPPORT, self._first, None) if steps else (PhaseKind.STANCE, self._first, None)
        if phase.kind is PhaseKind.STANCE:
            return None if steps or self._stopping else (PhaseKind.DOUBLE_SUPPORT, self._leading(), None)
        if phase.kind is PhaseKind.DOUBLE_SUPPORT and self._planned and not self._stopping:
            target = self._planned.popleft()
            self._together = not self._planned
            return PhaseKind.SINGLE_SUPPORT, phase.support, target
        if phase.kind is PhaseKind.DOUBLE_SUPPORT:
            step = self._step()
            self._together = step is None
            target = self.footsteps.beside(phase.support) if step is None else self.footsteps.step(phase.support, *step)
            self._done += 1
            return PhaseKind.SINGLE_SUPPORT, phase.support, target
        if self._together:
            return PhaseKind.STANCE, phase.support.other, None
        return PhaseKind.DOUBLE_SUPPORT, phase.support.other, None

    def beginning(self, kin: Kinematics) -> tuple[PhaseKind, Foot, Array | None] | None:
        """Return the first phase; if a foot is in the air, after an interrupted swing, it is put down first."""
        height = {
            foot: min(float(kin.up @ kin.point(sole.frame, corner)) for corner in sole.corners)
            for foot, sole in self.model.soles.items()
        }
        support = min(height, key=lambda foot: height[foot])
        kin, other = Kinematics(self.model, kin.q, support), self.model.soles[support.other]
        # above the plane of the lower sole, because on a slope to the side the soles differ in height
        if min(float(kin.point(other.frame, corner)[2]) for corner in other.corners) <= _LIFTED:
            return self.following(None)
        return PhaseKind.SINGLE_SUPPORT, support, self.footsteps.reachable(support, flat(kin.pose(other.frame)))

    def restarts(self, phase: Phase) -> float | None:
        """Return ``standing.transfer_duration`` in double support, None in single support.

        After an interruption the CoM is at rest: continuing at the velocity of the path would tip the robot. On soft
        servos it needs this time to come to rest.
        """
        return None if phase.kind is PhaseKind.SINGLE_SUPPORT else self.config.standing.transfer_duration

    def _step(self) -> tuple[float, float, float] | None:
        """Return length, side [m] and turn [rad] of the next step; None if the feet are to be put together."""
        gait = self.config.gait
        if self._stopping:
            return None
        if gait.steps:
            return None if self._done >= gait.steps else (gait.step_length, gait.step_side, gait.step_turn)
        if not any(self._twist):
            return None
        forward, left, turn = (v * self._period for v in self._twist)
        return forward, left, turn

    def _leading(self) -> Foot:
        """Return the first support foot: the one on the side opposite to the direction of turn or lateral motion."""
        if self._planned and self._stands_first is not None:
            return self._stands_first
        _, left, turn = self._twist
        to_left = turn if turn else left
        return self._first if not to_left else Foot.RIGHT if to_left > 0.0 else Foot.LEFT

    # ------------------------------------------------------------------ phases

    def both_feet(self, kind: PhaseKind, support: Foot, q_start: Array) -> Phase:
        """Return the phase that brings the CoM over the sole of `support`, in a stance between both soles."""
        s, model = self.config.standing, self.model
        kin = Kinematics(model, q_start, support.other)
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
        return self._phase(kind, support, kin, None, (com,), (self._held(kin),), rows)

    def one_foot(self, support: Foot, q_start: Array, swing_target: Array) -> Phase:
        """Return the single support on the foot `support` that swings the other one to its target."""
        s, model = self.config.standing, self.model
        kin = Kinematics(model, q_start, support)
        sole, swing = model.soles[support], model.soles[support.other]
        inequalities: tuple[Constraint, ...] = (
            self._edges(ConvexPolygon.hull(sole.corners)),
            PointsOverPlane(
                name="clearance", eta=s.eta_edges, return_speed=s.recovery, frame=swing.frame, points=swing.corners,
                plane=Plane(_UP, 0.0),
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
            convergence=s.swing_rate,
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
        return self._phase(PhaseKind.SINGLE_SUPPORT, support, kin, swing_target, (task, com), (), inequalities)

    def _held(self, kin: Kinematics) -> FrameHeld:
        """Return the equality that holds the other sole flat at its present pose."""
        s, frame = self.config.standing, kin.swing
        pose = flat(kin.pose(frame))
        return FrameHeld(name="end_sole", eta=s.eta_feet, return_speed=s.recovery, frame=frame, pose=pose)

    def _gap(self, support: Foot) -> PointsOverPlane:
        """Return the constraint that keeps the swing sole beside the support sole's inner edge, at ``sole_gap``."""
        s, sole, swing = self.config.standing, self.model.soles[support], self.model.soles[support.other]
        side = 1.0 if support is Foot.RIGHT else -1.0
        inner = Plane(side * np.array([0.0, 1.0, 0.0]), side * float(sole.center[1]) + 0.5 * sole.width)
        return PointsOverPlane(
            name="sole_gap", eta=s.eta_edges, bound=s.sole_gap, return_speed=s.recovery, frame=swing.frame,
            points=swing.corners, plane=inner,
        )  # fmt: skip

    def _edges(self, polygon: ConvexPolygon) -> ComInsideEdges:
        """Return the constraint that keeps the CoM inside the support polygon."""
        s = self.config.standing
        return ComInsideEdges(name="edges", eta=s.eta_edges, bound=s.margin, return_speed=s.recovery, polygon=polygon)

    def _rule(self, kind: PhaseKind, support: Foot) -> Rule:
        return PathEnd(self.config, kind, f"{kind.value}/{support.value}")

    def effort(self, phase: Phase, kin: Kinematics, state: State, u: Array) -> Array:
        """Return the torques that compensate gravity and balance the CoM on its path, shape (n,) [N m]."""
        if self._balance is None or self._balance.phase is not phase:
            self._balance = Balance(phase, self.config)
        return self._balance(kin, state)


class PathEnd:
    """Ends a phase of a standing walk after the duration of its path, when the error is below a threshold."""

    def __init__(self, config: Config, kind: PhaseKind, name: str) -> None:
        s, swing = config.standing, kind is PhaseKind.SINGLE_SUPPORT
        self._name = name
        self._duration = s.swing_duration if swing else s.transfer_duration
        self._goal = s.swing_threshold if swing else s.com_threshold
        self._timeout = config.gait.phase_timeout

    def is_over(self, error: float, elapsed: float) -> bool:
        """Return whether the phase ends at the state with this error; see `walk.Rule.is_over`."""
        if elapsed >= self._duration - 1e-9 and error < self._goal:
            return True
        if elapsed > self._timeout:
            raise PhaseError(
                f"{self._name} is not over after {self._timeout:g} s at an error of {error:.4g} m "
                f"(it ends below {self._goal:.4g} m); gait.phase_timeout may be too short",
                phase=self._name,
                error=error,
            )
        return False
