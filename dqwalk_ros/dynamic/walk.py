"""The walk that moves: its phases, and what they follow from state to state.

Single supports of a fixed time, short double supports between them; the divergent component of motion is planned over
the footprints ahead (`plan`) and fed back through the zero-moment point, which the ground's force goes through. A
stance brings the CoM to rest between the feet, before the walk and after it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.constraints import Constraint
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.dynamic.adjust import Step, adjusted, left_over
from dqwalk_ros.dynamic.pendulum import Pendulum
from dqwalk_ros.dynamic.plan import Course, Pressed, Rest, single_supports
from dqwalk_ros.dynamic.swing import Swing
from dqwalk_ros.dynamic.tasks import Follow, FollowPose, Target
from dqwalk_ros.errors import StateError
from dqwalk_ros.geometry import ConvexPolygon
from dqwalk_ros.kinematics import CenterOfMass, CenterOfMassOnGround, Direction, Kinematics
from dqwalk_ros.robot import Foot, RobotModel
from dqwalk_ros.servos import Drive
from dqwalk_ros.standing.balance import com_velocity
from dqwalk_ros.standing.footsteps import Footprint
from dqwalk_ros.standing.walk import StandingWalk
from dqwalk_ros.state import State
from dqwalk_ros.statics import GRAVITY, ground_torques
from dqwalk_ros.tasks import Task
from dqwalk_ros.walk import Phase, PhaseKind, Rule, com_target

__all__ = ["DynamicWalk"]

Array = NDArray[np.float64]

_UP = np.array([0.0, 0.0, 1.0])
_AHEAD = 6
"""So many footprints are planned ahead."""
_LATE = 0.05
"""A delay as long as this halves the gain of the feedback [s]."""
_UNSURE = 0.02
"""A delay as long as this doubles what the ankle may leave over before a step is adjusted [s]."""
_BEYOND, _YIELD = 0.002, 0.1
"""While more than this is left over [m], the CoM's path gives way to the CoM by this part at each state."""
_SURE = 3
"""After so many such states in a row a step is adjusted: the noise of one state is no push."""
_SMOOTH = 0.02
"""Time constant with which xi, by which a step is adjusted, follows what is measured [s]."""
_GAP = 0.1
"""After a longer time without a state the reference begins anew where the robot is [s]."""


class Timed:
    """A phase is over after a time, which may change while it lasts.

    Attributes
    ----------
    duration : float
        [s]
    """

    def __init__(self, duration: float) -> None:
        self.duration = duration

    def is_over(self, error: float, elapsed: float) -> bool:
        """Return whether the time is up; see `walk.Rule.is_over`."""
        return elapsed >= self.duration - 1e-9


@dataclass(eq=False)
class _Flight:
    """What may change while a foot is in the air.

    `goal` is where it was to land, `shift` how far that was moved; `lost` counts states in a row that the ankle alone
    cannot bring back, `most` is the most that it left over [m].
    """

    rule: Timed
    course: Pressed
    step: Step
    swing: Swing
    goal: Array
    shift: Array = field(default_factory=lambda: np.zeros(2))
    lost: int = 0
    most: float = 0.0


class DynamicWalk(StandingWalk):
    """Steps of a fixed rhythm; order, steering and the end are those of the standing walk, with a stance before it."""

    is_tunable = False  # its plan reaches beyond the next phase

    def __init__(self, config: Config, model: RobotModel) -> None:
        super().__init__(config, model)
        self._step_now = np.zeros(3)  # length, side and turn of the step under way
        delay = Drive.of(config, model).delay
        self._early = max(delay - config.dt, 0.0)
        self._gain = config.standing.balance / (1.0 + delay / _LATE)
        self._beyond = config.dynamic.catch_beyond * (1.0 + delay / _UNSURE)
        self._known: Phase | None = None
        self._time = -math.inf
        self._com = self._xi = self._smooth = np.zeros(2)
        self._force, self._pressure = GRAVITY * _UP, np.zeros(2)
        self._course: Course
        self._flight: _Flight | None = None
        self._pushed = False
        self._targets: dict[str, Target] = {}
        self._legs = np.empty(0, dtype=np.intp)  # joints between the base sole and the pelvis

    @staticmethod
    def phases(config: Config) -> int:
        """Return two for each step and for the feet together, and a stance before and after; 0 where it is steered."""
        return 2 * config.gait.steps + 4 if config.gait.steps else 0

    @cached_property
    def pendulum(self) -> Pendulum:
        """The robot in its posture as a pendulum."""
        kin = Kinematics(self.model, self.posture, self._first)
        phase = self.one_foot(self._first, self.posture, kin.pose(kin.swing))
        found = Pendulum.of(phase, kin)
        return replace(found, omega=found.omega * np.array([1.0, self.config.dynamic.side_frequency]))

    @cached_property
    def _height(self) -> Array:
        """Height of the CoM in the posture, shape (1,) [m]."""
        return Kinematics(self.model, self.posture, self._first).com[2:]

    # ------------------------------------------------------------------ order

    @property
    def _period(self) -> float:
        s = self.config.standing
        return s.transfer_duration + s.swing_duration

    def place(self, support: Foot, footprints: Sequence[Array]) -> None:
        """Refuse commanded footprints: this walk plans its own ahead; none of them cancels nothing.

        Raises
        ------
        StateError
            If there is one.
        """
        if footprints:
            raise StateError("a dynamic walk takes no footsteps; gait.style must be standing")

    def following(self, phase: Phase | None) -> tuple[PhaseKind, Foot, Array | None] | None:
        """Return kind, support foot and swing target of the phase after `phase`; None after the last one."""
        steps = self.config.gait.steps
        if phase is None:
            return PhaseKind.STANCE, self._first, None
        if phase.kind is PhaseKind.STANCE:
            over = self._together and (steps or self._stopping)
            return None if over else (PhaseKind.DOUBLE_SUPPORT, self._leading(), None)
        if phase.kind is PhaseKind.DOUBLE_SUPPORT:
            self._step_now, self._together = self._after(self._step_now, self._done)
            self._done += 1
            footprint = self.footsteps.wanted(phase.support, *self._step_now.tolist())
            return PhaseKind.SINGLE_SUPPORT, phase.support, footprint
        kind = PhaseKind.STANCE if self._together else PhaseKind.DOUBLE_SUPPORT
        return kind, phase.support.other, None

    def restarts(self, phase: Phase) -> float | None:
        """Return 0: what is followed has moved on without the robot."""
        return 0.0

    def _after(self, step: Array, done: int) -> tuple[Array, bool]:
        """Return the step after `step`, when `done` are done, and whether it puts the feet together."""
        gait, ramp = self.config.gait, self.config.dynamic.ramp
        if gait.steps:
            ramp = min(ramp, (gait.steps - 1) // 2)
            full = np.array([gait.step_length, gait.step_side, gait.step_turn])
            most, ended = np.abs(full), self._stopping or done >= gait.steps
            wanted = np.zeros(3) if ended or done >= gait.steps - ramp else full
        else:
            most = np.array([gait.most_length, gait.most_side, gait.most_turn])
            wanted = np.zeros(3) if self._stopping else np.array(self._twist) * self._period
            ended = not wanted.any()
        change = most / (ramp + 1)
        new = step + np.clip(wanted - step, -change, change)
        return new, bool(ended and np.abs(new).max() < 1e-9)

    # ------------------------------------------------------------------ phases

    def both_feet(self, kind: PhaseKind, support: Foot, q_start: Array) -> Phase:
        """Return the phase that brings the CoM to the sole of `support`, in a stance between both soles."""
        kin = Kinematics(self.model, q_start, support.other)
        goal = com_target(self.model, kind, kin.base, q_start)[:2]
        return self._phase(kind, support, kin, None, (self._com_task(goal),), (self._held(kin),), ())

    def one_foot(self, support: Foot, q_start: Array, swing_target: Array) -> Phase:
        """Return the single support on the foot `support` that swings the other one to its target."""
        s = self.config.standing
        kin = Kinematics(self.model, q_start, support)
        x = DQ(swing_target)
        task = FollowPose(
            name="swing",
            weight=s.swing_weight,
            frame=kin.swing,
            target=Target(np.array([*x.translation(), *swing_target[:4]]), np.zeros(6)),
            convergence=s.swing_rate,
            lever=s.lever,
        )
        com = self._com_task(self.model.soles[support].center[:2])
        return self._phase(PhaseKind.SINGLE_SUPPORT, support, kin, swing_target, (task, com), (), (self._gap(support),))

    def _com_task(self, place: Array) -> Task:
        d, target = self.config.dynamic, Target(place, np.zeros(2))
        return Follow(
            name="com", weight=d.com_weight, feature=CenterOfMassOnGround(), target=target, convergence=d.com_rate
        )

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
        d = self.config.dynamic
        also = (
            Follow(
                name="height",
                weight=d.height_weight,
                feature=CenterOfMass(),
                A=_UP[None],
                target=Target(self._height, np.zeros(1)),
                convergence=d.height_rate,
            ),
            Follow(
                name="upright",
                weight=d.upright_weight,
                feature=Direction(self.model.pelvis, _UP),
                A=np.eye(2, 3),
                target=Target(np.zeros(2), np.zeros(2)),
                convergence=d.upright_rate,
            ),
        )
        return super()._phase(kind, support, kin, swing_target, (*tasks, *also), equalities, inequalities)

    def _rule(self, kind: PhaseKind, support: Foot) -> Rule:
        return Timed(self._duration(kind))

    def _duration(self, kind: PhaseKind) -> float:
        s, d = self.config.standing, self.config.dynamic
        if kind is PhaseKind.STANCE:
            return d.stop_duration
        return s.swing_duration if kind is PhaseKind.SINGLE_SUPPORT else s.transfer_duration

    # ------------------------------------------------------------------ from state to state

    def observe(self, phase: Phase, kin: Kinematics, state: State) -> Phase:
        """Move on what the phase follows, find the ground's force that draws the robot to it, and adjust the step."""
        omega, up = self.pendulum.omega, kin.up
        dt = state.time - self._time
        self._time = state.time
        c, v = _along_ground(kin.com, up), _along_ground(self._com_velocity(kin, state), up)
        if known := 0.0 <= dt <= _GAP:
            self._com = self._com + dt * omega * (self._xi - self._com)  # c' = w (xi - c)
        else:
            dt, self._com, self._xi = 0.0, c, c
        if phase is not self._known:
            self._begin(phase, kin)
        t = kin.elapsed
        xi = c + v / omega
        moved = self._smooth + dt * omega * (self._smooth - self._pressure) if known else xi  # xi' = w (xi - z)
        self._smooth = moved + dt / (_SMOOTH + dt) * (xi - moved)
        flight = self._flight
        if flight is not None:
            phase = self._catch(flight, phase, c, self._smooth, t)
        self._xi, z = self._course.at(t)
        if flight is None:  # what is asked for now is so a delay later
            _, z = self._course.at(t + self._early)
        z = z + (1.0 + self._gain) * (xi - self._xi)
        if flight is not None:  # and the foot is to be down when the weight comes
            place, velocity, acceleration = flight.swing.step(t, flight.rule.duration - self._early)
            self._targets["swing"].set(place, velocity)
            z[0] += self.pendulum.swing * acceleration[0]
        self._pressure = z = self._inside(z)
        a = omega**2 * (c - z)  # of the pendulum
        self._force = GRAVITY * up + np.array([a[0], a[1], -(a @ up[:2]) / up[2]])
        self._targets["com"].set(self._com, omega * (self._xi - self._com))
        self._targets["upright"].set(up[:2], np.zeros(2))
        self._known = phase
        return phase

    def _com_velocity(self, kin: Kinematics, state: State) -> Array:
        """Return the velocity of the CoM, shape (3,) [m/s]; zero where no joint velocities are known."""
        if state.dq is None:
            return np.zeros(3)
        body, pose = kin.tree.frames[self.model.imu]
        gyro = np.empty(0) if state.gyro is None else state.gyro
        v: Array = com_velocity(
            kin.com, kin.com_jacobian, kin.lines, kin.poses, body, pose, kin.tree.moves[body], state.dq, gyro
        )
        return v

    def _catch(self, flight: _Flight, phase: Phase, c: Array, xi: Array, t: float) -> Phase:
        """Adjust time and place of the step under way to xi (2,) as it is measured, `t` [s] into it.

        Return the phase: where nothing can be changed any more, with what was decided.
        """
        d, rule, step = self.config.dynamic, flight.rule, flight.step
        if not d.catch or t < d.untouched:
            return phase
        if t > rule.duration - d.settled:
            return phase if phase.decision or flight.lost < _SURE else self._decided(flight, phase)
        if flight.lost < _SURE:
            over, _ = left_over(step, xi, t, np.array([step.duration - t]))
            flight.lost = flight.lost + 1 if np.abs(over).max() > self._beyond else 0
            if flight.lost < _SURE:
                return phase
        rule.duration, flight.shift, over = adjusted(step, xi, t, rule.duration, flight.shift, d)
        flight.course.duration = rule.duration
        flight.course.end = step.landing + step.offset + flight.shift
        flight.swing.goal = flight.goal + flight.shift
        flight.most = max(flight.most, float(np.abs(over).max()))
        if np.abs(over).max() > _BEYOND:
            self._com = self._com + _YIELD * (c - self._com)
        return phase

    def _decided(self, flight: _Flight, phase: Phase) -> Phase:
        """Return the phase with the landing place that was decided, and why."""
        late, ahead = flight.rule.duration - flight.step.duration, float(flight.shift[0])
        when, where = "later" if late > 0.0 else "sooner", "ahead" if ahead > 0.0 else "back"
        text = (
            f"the step lands {1e3 * abs(late):.0f} ms {when} and {1e3 * abs(ahead):.0f} mm further {where}: "
            f"the ankle left over {1e3 * flight.most:.0f} mm"
        )
        assert phase.swing_target is not None
        moved = DQ.from_pose([*flight.shift, 0.0]) * DQ(phase.swing_target)
        return replace(phase, swing_target=moved.vec8(), decision=text)

    def _begin(self, phase: Phase, kin: Kinematics) -> None:
        """Plan a phase as its feet stand; the plan is in the axes of its base sole."""
        before, self._known = self._known, phase
        other = Footprint.of(kin.pose(kin.swing))
        if before is not None and before.base is not phase.base:  # the base sole was the other one
            self._com, self._xi = other.points(self._com), other.points(self._xi)
            self._smooth, self._pressure = other.points(self._smooth), other.points(self._pressure)
        self._targets = {task.name: task.target for task in phase.tasks if isinstance(task, Follow | FollowPose)}
        self._pushed = self._flight.most > self._beyond if self._flight else self._pushed
        self._flight = None
        base, end = self._aim(phase.base, Footprint()), self._aim(phase.base.other, other)
        corners, omega, rule = self.model.soles[phase.base].corners[:, :2], self.pendulum.omega, phase.rule
        assert isinstance(rule, Timed)
        if phase.swing_target is not None:
            self._course = self._flight_course(phase, kin, rule, base)
        else:
            corners = np.concatenate([corners, other.points(self.model.soles[phase.base.other].corners[:, :2])])
            if phase.kind is PhaseKind.STANCE:
                self._course = Rest(self._xi, 0.5 * (base + end), rule.duration, omega)
            else:
                start, _ = self._plan(phase.support, other, self._step_now, self._done)
                if before is not None and before.kind is PhaseKind.SINGLE_SUPPORT:
                    self._course = Pressed(base, end, start, rule.duration, omega)
                else:
                    rule.duration = self.config.dynamic.start_duration
                    self._course = Rest(self._xi, start, rule.duration, omega)
        self._support = ConvexPolygon.hull(corners).edges()
        tree = kin.tree
        self._legs = np.flatnonzero(tree.moves[tree.frames[self.model.pelvis][0]])

    def _flight_course(self, phase: Phase, kin: Kinematics, rule: Timed, base: Array) -> Pressed:
        """Begin a single support, and return its course."""
        d, omega, target = self.config.dynamic, self.pendulum.omega, phase.swing_target
        assert target is not None
        _, end = self._plan(phase.support, Footprint(), self._step_now, self._done, target)
        course = Pressed(base, base, end, rule.duration, omega)
        sole, landing = self.model.soles[phase.base], self._aim(phase.base.other, Footprint.of(target))
        half = 0.5 * np.array([sole.length, sole.width]) - d.catch_margin
        step = Step(
            z=base, landing=landing, offset=end - landing, duration=rule.duration, omega=omega,
            low=sole.center[:2] - half, high=sole.center[:2] + half, reach=np.array([d.catch_length, d.catch_side]),
        )  # fmt: skip
        swing = Swing(kin.pose(kin.swing), target, self.config.gait.step_height)
        # the step after one that was pushed is adjusted from the beginning
        self._flight = _Flight(rule, course, step, swing, swing.goal, lost=_SURE if self._pushed else 0)
        return course

    def _plan(
        self, foot: Foot, stands: Footprint, step: Array, done: int, target: Array | None = None
    ) -> tuple[Array, Array]:
        """Return xi (2,) at the beginning and the end of the single support on a foot that stands there."""
        together = self._together and target is not None
        landing = None if target is None else Footprint.of(target)
        aims = [self._aim(foot, stands)]
        while len(aims) <= _AHEAD:
            if landing is None:
                step, together = self._after(step, done)
                done += 1
                landing = self.footsteps.stride(foot, *step.tolist())
            foot, stands, landing = foot.other, stands.then(landing), None
            aims.append(self._aim(foot, stands))
            if together:
                break
        s = self.config.standing
        plan = single_supports(aims, s.swing_duration, s.transfer_duration, self.pendulum.omega, ends=together)
        return plan[0]

    def _aim(self, foot: Foot, stands: Footprint) -> Array:
        """Return where the zero-moment point is to be on a sole, shape (2,) [m]."""
        d, side = self.config.dynamic, 1.0 if foot is Foot.LEFT else -1.0
        return stands.points(self.model.soles[foot].center[:2] + np.array([d.aim_ahead, -side * d.aim_inside]))

    def _inside(self, z: Array) -> Array:
        """Return the point nearest to `z` (2,) that keeps its distance from all edges of the support polygon [m]."""
        n, edge = self._support
        for _ in range(6):
            short = np.maximum(edge + self.config.standing.pressure_margin - n @ z, 0.0)
            if not short.any():
                break
            k = int(np.argmax(short))
            z = z + short[k] * n[k]
        return z

    def effort(self, phase: Phase, kin: Kinematics, state: State) -> Array:
        """Return the torques by which the ground bears the robot through the zero-moment point, shape (n,) [N m].

        The joints between the base sole and the pelvis bear the ground's force less the weight of what is below them:
        the leg that stands hardly moves, so all inertia is above it.
        """
        m, f, up = self.model.mass, self._force, kin.up
        both = phase.kind is not PhaseKind.SINGLE_SUPPORT
        tau = ground_torques(kin, m * f, self._pressure, both=both)
        line, moment = kin.lines[:, :3], kin.lines[:, 3:]
        z, a = np.array([*self._pressure, 0.0]), f - GRAVITY * up
        # (l x z + m).f - (l x c + m).(g up), and (l x z).f = l.(z x f)
        through = line @ (_cross(z, f) - _cross(kin.com, GRAVITY * up)) + moment @ a
        tau[self._legs] += m * (through - a @ kin.com_jacobian)[self._legs]
        return tau


def _along_ground(v: Array, up: Array) -> Array:
    """Return a vector (3,) without its part along `up` (3,) that takes it to the ground, shape (2,)."""
    along: Array = v[:2] - v[2] / up[2] * up[:2]
    return along


def _cross(a: Array, b: Array) -> Array:
    """Return a x b of vectors (3,); numpy's own takes ten times as long."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])
