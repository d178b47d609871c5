"""The walk that stands and steps on true soles: its phases, their order and the rule that ends them.

With both feet on the ground the support polygon is the convex hull of both soles, with one foot it is its sole; each
edge is a plane, "as many planes as necessary" (section 3.1 [Urban2020]), moved in by a margin.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.constraints import ComInsideEdges, Constraint, FrameHeld, PointsOverPlane
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import PhaseError
from dqwalk_ros.geometry import ConvexPolygon, Plane
from dqwalk_ros.kinematics import Kinematics, Point
from dqwalk_ros.robot import Foot, RobotModel
from dqwalk_ros.standing.balance import Balance
from dqwalk_ros.standing.footsteps import Footsteps, flat
from dqwalk_ros.standing.paths import ComPath, SwingPath
from dqwalk_ros.state import State
from dqwalk_ros.tasks import Posture, Task
from dqwalk_ros.walk import Phase, PhaseKind, Rule, Walk, joint_limits, pelvis_height

__all__ = ["StandingWalk"]

Array = NDArray[np.float64]

_UP = np.array([0.0, 0.0, 1.0])
_JOINT_RETURN = 0.5
"""A joint beyond its limit returns no faster than this [rad/s]."""
_LIFTED = 0.004
"""A sole that is higher than the other one by more than this is in the air [m]."""


class StandingWalk(Walk):
    """Double support to a foot, single support on it, and so on; at the end the feet are put together.

    The CoM comes to rest between them. With ``gait.steps: 0`` the walk waits in a stance for `steer`.
    """

    def __init__(self, config: Config, model: RobotModel) -> None:
        super().__init__(config, model)
        self.footsteps = Footsteps(config, model, self.posture)
        self._twist = (0.0, 0.0, 0.0)
        self._stopping = False
        self._together = False
        self._done = 0
        self._planned: deque[Array] = deque()  # commanded footprints to come, each in the sole it is stepped from
        self._stands_first: Foot | None = None  # on the way to them
        self._first = Foot(config.gait.first_support)
        self._balance: Balance | None = None

    is_tunable = True

    def tune(self, config: Config) -> None:
        """Go on with other parameters, from the next phase on."""
        super().tune(config)
        self.footsteps.config = config

    @staticmethod
    def phases(config: Config) -> int:
        """Return two for each step, two for the feet together, and a stance; 0 where it is steered."""
        return 2 * config.gait.steps + 3 if config.gait.steps else 0

    @staticmethod
    def describe(config: Config) -> str:
        """Return such as ``20 steps``."""
        steps = config.gait.steps
        return f"{steps} step{'s' if steps > 1 else ''}" if steps else "steered by cmd_vel"

    @cached_property
    def posture(self) -> Array:
        """The posture of ``standing.posture``, shape (n,) [rad]."""
        return self.model.posture(self.config.standing.posture)

    # ------------------------------------------------------------------ order

    def steer(self, forward: float, left: float, turn: float) -> tuple[float, float, float]:
        """Set the velocity of a steered walk; all three are made smaller alike until a step keeps within its limits.

        The limits are ``gait.most_length``, ``gait.most_side`` and ``gait.most_turn`` together; see `Walk.steer`.
        """
        if self.config.gait.steps:
            return super().steer(forward, left, turn)
        gait, period = self.config.gait, self._period
        asked = (forward * period, left * period, turn * period)
        most = (gait.most_length, gait.most_side, gait.most_turn)
        # a direction the legs cannot go is left out; the others share the step
        parts = [min(max(a / m, -1e9), 1e9) if m else 0.0 for a, m in zip(asked, most, strict=True)]
        size = max(1.0, math.hypot(*parts))
        x, y, z = (part * m / (size * period) for part, m in zip(parts, most, strict=True))
        self._twist = (x, y, z)
        return self._twist

    def stop(self) -> None:
        """Put the feet together after the step under way, and end the walk."""
        self._stopping = True

    def place(self, support: Foot, footprints: Sequence[Array]) -> None:
        """Step on commanded footprints (8,), each in the sole it is stepped from, then wait on them; none cancels.

        Raises
        ------
        StateError
            If one cannot be stepped on; see `Footsteps.planned`.
        """
        self._planned = deque(self.footsteps.planned(support, footprints))
        self._stands_first = support

    @property
    def placed(self) -> int:
        """Number of commanded footprints that are still to be stepped on."""
        return len(self._planned)

    def is_waiting(self, phase: Phase) -> bool:
        """Return whether it is a stance of a steered walk with nothing to do."""
        idle = not (self.config.gait.steps or self._stopping or any(self._twist) or self._planned)
        return idle and phase.kind is PhaseKind.STANCE

    @property
    def _period(self) -> float:
        """Time of a step [s]."""
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
        """Return the first phase; a foot in the air, of a walk that was broken off in mid-swing, is put down first."""
        height = {
            foot: min(float(kin.up @ kin.point(sole.frame, corner)) for corner in sole.corners)
            for foot, sole in self.model.soles.items()
        }
        support = min(height, key=lambda foot: height[foot])
        if height[support.other] - height[support] <= _LIFTED:
            return self.following(None)
        below = Kinematics(self.model, kin.q, support).pose(self.model.soles[support.other].frame)
        return PhaseKind.SINGLE_SUPPORT, support, self.footsteps.reachable(support, flat(below))

    def restarts(self, phase: Phase) -> float | None:
        """Return the time of a transfer, with both feet down.

        A CoM that was stopped, taken up at the path's velocity, tips the robot; on soft servos it comes to rest first.
        """
        return None if phase.kind is PhaseKind.SINGLE_SUPPORT else self.config.standing.transfer_duration

    def _step(self) -> tuple[float, float, float] | None:
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
        """Return the foot to stand on first: the one on the side the robot turns away from or leaves."""
        if self._planned and self._stands_first is not None:
            return self._stands_first
        _, left, turn = self._twist
        sideways = turn if turn else left
        return self._first if not sideways else Foot.RIGHT if sideways > 0.0 else Foot.LEFT

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
        com = ComPath(
            name="com",
            weight=s.com_weight,
            start=kin.com_on_ground,
            over=(Point(sole.frame, sole.center),),
            duration=0.5 * s.swing_duration,
            saturation=s.saturation,
        )
        return self._phase(PhaseKind.SINGLE_SUPPORT, support, kin, swing_target, (task, com), (), inequalities)

    def _held(self, kin: Kinematics) -> FrameHeld:
        """Hold the other sole flat where it is."""
        s, frame = self.config.standing, kin.swing
        pose = flat(kin.pose(frame))
        return FrameHeld(name="end_sole", eta=s.eta_feet, return_speed=s.recovery, frame=frame, pose=pose)

    def _gap(self, support: Foot) -> PointsOverPlane:
        """Keep the swing sole on its side of the support sole's inner edge."""
        s, sole, swing = self.config.standing, self.model.soles[support], self.model.soles[support.other]
        side = 1.0 if support is Foot.RIGHT else -1.0
        inner = Plane(side * np.array([0.0, 1.0, 0.0]), side * float(sole.center[1]) + 0.5 * sole.width)
        return PointsOverPlane(
            name="sole_gap", eta=s.eta_edges, bound=s.sole_gap, return_speed=s.recovery, frame=swing.frame,
            points=swing.corners, plane=inner,
        )  # fmt: skip

    def _edges(self, polygon: ConvexPolygon) -> ComInsideEdges:
        s = self.config.standing
        return ComInsideEdges(name="edges", eta=s.eta_edges, bound=s.margin, return_speed=s.recovery, polygon=polygon)

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
        config = self.config
        back = Posture(name="posture", weight=config.task.posture_weight, q_ref=self.posture)
        return Phase(
            model=self.model,
            kind=kind,
            support=support,
            base=kin.base,
            q_start=kin.q,
            swing_target=swing_target,
            eta=config.task.eta,
            damping=config.task.damping,
            tasks=(*tasks, back),
            equalities=equalities,
            inequalities=inequalities,
            limits=joint_limits(config, self.model, _JOINT_RETURN),
            rule=self._rule(kind, support),
        )

    def _rule(self, kind: PhaseKind, support: Foot) -> Rule:
        return PathEnd(self.config, kind, f"{kind.value}/{support.value}")

    def effort(self, phase: Phase, kin: Kinematics, state: State) -> Array:
        """Return the torques that hold the robot against gravity and draw its CoM to its path, shape (n,) [N m]."""
        if self._balance is None or self._balance.phase is not phase:
            self._balance = Balance(phase, self.config)
        return self._balance(kin, state)


class PathEnd:
    """A phase of a standing walk is over when its path is done and its error is below a threshold."""

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
                f"(it ends below {self._goal:.4g} m)",
                phase=self._name,
                error=error,
            )
        return False
