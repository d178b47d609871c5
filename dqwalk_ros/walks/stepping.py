"""What the standing and the dynamic walk have in common: steps, steering, the last step, and how a walk begins."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.paper.assembly import Evaluation
from dqwalk_ros.paper.constraints import FrameHeld, PointsOverPlane
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import Plane, Y
from dqwalk_ros.paper.kinematics import Kinematics, point_at
from dqwalk_ros.paper.phase import Next, Phase, PhaseKind
from dqwalk_ros.paper.qp.problem import Problem, Solution
from dqwalk_ros.paper.state import Estimate
from dqwalk_ros.paper.tasks import Task
from dqwalk_ros.paper.walk import Change, Walk
from dqwalk_ros.robot.limits import outside_limits
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.support.errors import ConfigError, StateError
from dqwalk_ros.walks.arms.arms import Arms
from dqwalk_ros.walks.footprint import flat
from dqwalk_ros.walks.footsteps import Carried, Footsteps, parsed, stair_height

JOINT_RETURN = 0.5
"""Largest speed at which a joint beyond its limit is required to return [rad/s]."""
_LAGS = 2.0
"""Part of its sole's length by which a foot may be further behind its path, per second of the servos' delay [1/s]."""
_AT_REST = 0.1
"""Time in which a foot that is stopped does not even move by as much as it is behind its path [s]."""
_LIFTED = 0.004
"""Height of a sole above the plane of the other one from which on it is in the air [m]."""


class SteppingWalk(Walk):
    """A walk of steps; with ``gait.steps: 0`` it is steered (`steer`) and waits in a stance while its velocity is zero.

    Attributes
    ----------
    footsteps : Footsteps
    arms : Arms or None
        None if ``arms.joints`` is empty.

    Raises
    ------
    ConfigError
        If ``standing.posture`` is outside the joint limits by more than ``safety.outside``; errors of `Arms`.
    """

    def __init__(self, config: Config, model: RobotModel) -> None:
        super().__init__(config, model)
        if outside := outside_limits(self.posture, model, config.safety.outside):
            raise ConfigError(f"standing.posture is outside the joint limits: {outside}")
        self.footsteps = Footsteps(config, model, self.posture, self._carried())
        self._planned: deque[Array] = deque()  # remaining commanded footprints, each in the frame of its support sole
        self._taken = 0
        self._stands_first: Foot | None = None  # support foot of the first commanded footprint
        self._aimed: Array | None = None  # where the last commanded footprint was to be, in its support sole
        self._on_stairs = False
        self.arms = Arms(config, model, self.posture) if config.arms.joints else None
        self._twist = (0.0, 0.0, 0.0)
        self._stopping = False
        self._together = False
        self._done = 0
        self._first = Foot(config.gait.first_support)

    @staticmethod
    def describe(config: Config) -> str:
        """Return the number of steps in words, such as ``20 steps``."""
        commanded = len(config.gait.footsteps)
        steps, what = commanded or config.gait.steps, "footstep" if commanded else "step"
        return f"{steps} {what}{'s' if steps > 1 else ''}" if steps else "steered by cmd_vel"

    @cached_property
    def posture(self) -> Array:
        """Joint angles of ``standing.posture``, shape (n,) [rad]."""
        return self.model.posture(self.config.standing.posture)

    def beside(self, base: Foot) -> tuple[Task, ...]:
        """Return the tasks of the arms."""
        return () if self.arms is None else self.arms.tasks(base)

    def observe(self, phase: Phase, kin: Kinematics, state: Estimate) -> Change | None:
        """Set the tasks of the arms for a state; see `Walk.observe`."""
        if self.arms is not None:
            self.arms.update(phase, kin, state)
        return None

    def solved(self, now: Evaluation, solve: Callable[[Problem], Solution]) -> Solution:
        """Return the solution, in which the walk has priority over the arms; see `Arms.solved`."""
        return solve(now.problem) if self.arms is None else self.arms.solved(now, solve)

    def _carried(self) -> Carried:
        """Return where the CoM is while both feet stand."""
        return Carried()

    def prepare(self) -> None:
        """Check the steps of ``gait.footsteps``, on the last of which the walk ends.

        Raises
        ------
        ConfigError
            If a step violates a limit, or ``gait.steps`` is not 0.
        """
        gait = self.config.gait
        if not gait.footsteps:
            return
        if gait.steps:
            raise ConfigError(f"gait.footsteps are the steps of the walk; gait.steps is {gait.steps}, it must be 0")
        support, prints = self._first, []
        for length, side, turn, up in parsed(gait.footsteps):
            pose = DQ(self.footsteps.wanted(support, length, side, turn))
            prints.append((DQ.from_pose([0.0, 0.0, up]) * pose).vec8())
            support = support.other
        try:
            self.place(self._first, prints)
        except StateError as error:
            raise ConfigError(f"gait.footsteps: {error}") from None
        self._stopping = True

    def place(self, support: Foot, footprints: Sequence[Array]) -> None:
        """Step on commanded footprints (8,), and wait on the last one; an empty sequence cancels the remaining ones.

        Raises
        ------
        StateError
            If a footprint violates a limit; see `Footsteps.planned`, also for the frames of the footprints.
        """
        self._planned, self._aimed = deque(self.footsteps.planned(support, footprints)), None
        self._taken = 0
        self._stands_first = support

    def _next_footprint(self, kin: Kinematics) -> Array:
        """Take the next commanded footprint, (8,) in the frame of its support sole, at the end of a double support.

        `kin` is in the frame of the other sole. What the support foot has missed is made up for, so that the errors of
        the landings do not add up: by up to ``gait.footstep_tolerance`` in this step, and the rest in the next ones.
        """
        footprint, back = DQ(self._planned.popleft()), DQ(1.0)
        self._taken += 1
        if self._aimed is not None:
            missed = DQ(flat(kin.pose(kin.swing))).conj() * DQ(flat(self._aimed))
            off, most = missed.translation(), self.config.gait.footstep_tolerance
            footprint = missed * footprint
            if (far := float(np.linalg.norm(off))) > most:
                back = DQ.from_pose((most / far - 1.0) * off)
        self._aimed = footprint.vec8()
        return (back * footprint).vec8()

    @property
    def placed(self) -> int:
        """Number of remaining commanded footprints."""
        return len(self._planned)

    @property
    def taken(self) -> int:
        """Number of the last commanded footprints on which the robot has stepped or steps."""
        return self._taken

    def steer(self, forward: float, left: float, turn: float) -> tuple[float, float, float]:
        """Set the velocity of a steered walk, scaled down if a step would exceed its limits; see `Walk.steer`.

        The limit is the ellipsoid with the half axes ``gait.most_length``, ``gait.most_side`` and ``gait.most_turn``.
        """
        gait = self.config.gait
        if gait.steps:
            return super().steer(forward, left, turn)
        most = (gait.most_length, gait.most_side, gait.most_turn)
        # a direction with the limit zero is ignored
        wanted = self._step_at((forward, left, turn))
        parts = [min(max(a / m, -1e9), 1e9) if m else 0.0 for a, m in zip(wanted, most, strict=True)]
        size = max(1.0, math.hypot(*parts))
        step = [part * m / size for part, m in zip(parts, most, strict=True)]
        x, y, z = (part / self._period(step[0]) for part in step)
        self._twist = (x, y, z)
        return self._twist

    def stop(self) -> None:
        """Put the feet together after the current step, and end the walk."""
        self._planned.clear()
        self._stopping = True

    @property
    def _is_idle(self) -> bool:
        """Whether a stance continues: that of a steered walk with zero velocity, and without footsteps."""
        return not (self.config.gait.steps or self._stopping or any(self._twist) or self._planned)

    def _period(self, length: float) -> float:
        """Return the duration [s] of a step of a length [m]."""
        s = self.config.standing
        return s.transfer_duration + s.swing_duration

    def _period_at(self, forward: float) -> float:
        """Return the duration [s] of a step at a forward velocity [m/s]."""
        return self._period(0.0)

    def _step_at(self, twist: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return length, side [m] and turn [rad] of a step at a velocity [m/s, m/s, rad/s]."""
        period = self._period_at(twist[0])
        forward, left, turn = twist
        return forward * period, left * period, turn * period

    def _on_its_feet(self, kin: Kinematics) -> Next | None:
        """Return the phase that puts a foot down which is in the air, after an interrupted swing; None without one."""
        height = {
            foot: min(float(kin.up @ kin.point(sole.frame, corner)) for corner in sole.corners)
            for foot, sole in self.model.soles.items()
        }
        support = min(height, key=lambda foot: height[foot])
        kin, other = Kinematics(self.model, kin.q, support), self.model.soles[support.other]
        # above the plane of the lower sole, because on a slope to the side the soles differ in height
        if min(float(kin.point(other.frame, corner)[2]) for corner in other.corners) <= _LIFTED:
            return None
        return Next(
            PhaseKind.SINGLE_SUPPORT, support, self.footsteps.nearest(support, flat(kin.pose(other.frame))).pose
        )

    def _leading(self) -> Foot:
        """Return the first support foot: that of commanded footprints, or that opposite to a turn or lateral motion."""
        if self._planned and self._stands_first is not None:
            return self._stands_first
        _, left, turn = self._twist
        to_left = turn if turn else left
        return self._first if not to_left else Foot.RIGHT if to_left > 0.0 else Foot.LEFT

    def _stopped(
        self, phase: Phase, kin: Kinematics, state: Estimate, place: Array, velocity: Array, delay: float, least: float
    ) -> Change | None:
        """Return the change if an obstacle stops the swing foot; it must not be pushed on, or the robot falls.

        `place` (>= 2,) [m] and `velocity` (>= 2,) [m/s] are those of its path, which it follows with the `delay` [s] of
        the servos. It is stopped if it is in the air, at rest, and behind by the fraction `least` of the length of its
        sole, without a delay.
        """
        body, pose, _ = kin.tree.frames[kin.swing]
        behind, z = _behind(kin.poses, body, pose, place, velocity, delay)
        length = self.model.soles[phase.base.other].length
        if phase.swing_target is None or z < _LIFTED or behind < (least + _LAGS * delay) * length:
            return None
        if state.dq is not None:
            moves = math.hypot(*(kin.point_jacobian(kin.swing)[:2] @ state.dq).tolist())
            if moves > behind / _AT_REST:
                return None
        missed = math.hypot(*(DQ(phase.swing_target).translation() - kin.point(kin.swing))[:2].tolist())
        return Change(f"an obstacle stops the foot {1e3 * missed:.0f} mm from its target")

    def _held(self, kin: Kinematics) -> FrameHeld:
        """Return the equality that holds the other sole level at its present pose."""
        s, frame = self.config.standing, kin.swing
        pose = flat(kin.pose(frame), self._level(kin))
        return FrameHeld(name="end_sole", eta=s.eta_feet, return_speed=s.recovery, frame=frame, pose=pose)

    def _level(self, kin: Kinematics) -> float:
        """Return the height of the other sole over the base sole [m]; 0 if both count as level, as without stairs.

        Without stairs a sole that is higher has been kept up by a stone or a push, and is to come down.
        """
        return stair_height(float(kin.point(kin.swing)[2]), self.config) if self._on_stairs else 0.0

    def _gap(self, support: Foot) -> PointsOverPlane:
        """Return the constraint that keeps the swing sole beside the support sole's inner edge, at ``sole_gap``."""
        s, sole, swing = self.config.standing, self.model.soles[support], self.model.soles[support.other]
        side = 1.0 if support is Foot.RIGHT else -1.0
        inner = Plane(side * Y, side * float(sole.center[1]) + 0.5 * sole.width)
        return PointsOverPlane(
            name="sole_gap", eta=s.eta_edges, bound=s.sole_gap, return_speed=s.recovery, frame=swing.frame,
            points=swing.corners, plane=inner,
        )  # fmt: skip


@jit
def _behind(poses: Array, body: int, pose: Array, place: Array, velocity: Array, delay: float) -> tuple[float, float]:
    """Return how far a sole is along the ground from its path `delay` [s] ago, and its height [m].

    `pose` (8,) is that of the sole in its body, of which `poses` has those of all; `place` and `velocity` are of now.
    """
    p = point_at(poses, body, pose, np.zeros(3))
    x, y = place[0] - delay * velocity[0] - p[0], place[1] - delay * velocity[1] - p[1]
    return math.sqrt(x * x + y * y), p[2]
