"""The dynamic walk: its phases, and the update of their targets for every state.

Single supports of a fixed duration alternate with short double supports. The divergent component of motion is planned
over the next footprints (`plan`), and its error is fed back to the zero-moment point, through which the ground reaction
force acts. Before and after the walk, a stance brings the CoM to rest between the feet.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.estimation.load import share_of
from dqwalk_ros.paper.constraints import FrameHeld
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import ConvexPolygon, Z
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import Next, Phase, PhaseKind, Timed
from dqwalk_ros.paper.state import Estimate
from dqwalk_ros.paper.statics import GRAVITY, Soles
from dqwalk_ros.paper.walk import Change, com_target
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.servos import Drive
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.walks.com import com_and_xi, rates
from dqwalk_ros.walks.dynamic.adjust import HURRY, Step, adjusted, left_over, transfer_time
from dqwalk_ros.walks.dynamic.flight import Flight
from dqwalk_ros.walks.dynamic.ground import Ground
from dqwalk_ros.walks.dynamic.law import GROUNDED, MEMORY, Memory, Settings, answer, notice, torques
from dqwalk_ros.walks.dynamic.pendulum import InvertedPendulum, Pendulum, swing_inertia
from dqwalk_ros.walks.dynamic.plan import Pressed, Reference, Rest, Support, single_supports
from dqwalk_ros.walks.dynamic.swing import Swing
from dqwalk_ros.walks.dynamic.upright import FOLLOWED, leans, upright_tasks
from dqwalk_ros.walks.following import AtRest, FollowPose, Target
from dqwalk_ros.walks.footprint import Footprint
from dqwalk_ros.walks.footsteps import Carried, stair_height
from dqwalk_ros.walks.stepping import JOINT_RETURN, SteppingWalk

_AHEAD = 6
"""Number of planned footprints."""
_LATE = 0.05
"""Delay at which the feedback gain is halved [s]."""
_TOLERANT = 0.02
"""Delay at which the error threshold of the step adjustment is doubled [s]."""
_TIP_TOLERANCE_PER_DELAY = math.radians(60.0)
"""A sole counts as tipping from this inclination on, times (delay - one period) [rad/s]."""
_TIPPED = math.radians(1.0)
"""Inclination against the ground above which a sole has been tipped, by a push or a stone, and not by noise [rad]."""
_STOPPED = 0.1
"""Part of the sole's length from which on a foot behind its path is stopped by an obstacle."""
_ON_THE_SPOT = 0.0, 0.0, 0.0
"""Length, side and turn of a step on the spot."""
_WAITS = 4
"""Number of steps on the spot after an obstacle has stopped a foot, before the walk tries again."""
_HIGHER = 0.002
"""Height over its planned landing from which on a foot that bears weight is on a step that is higher [m]."""
_BEARS = 0.3
"""Fraction of the weight from which on a swing foot has landed."""
_OUTWARDS = 3.0
"""Error away from the swing foot above which a push tips the sole, as a multiple of the error that adjusts a step."""
_RESIDUAL = 0.002
"""Error above which the path of the CoM approaches the measured CoM [m]."""
_APPROACH = 0.1
"""Fraction of the way by which it does so at each state."""
_CONFIRMED = 0.015
"""Time above the threshold after which a step is adjusted, to reject measurement noise; at least two states [s]."""
_LONGEST_WAIT = 3.0
"""Time after the planned end of a double support from which on it is not extended further [s]."""
_SHIFT = 0.1
"""Part of the way between the soles by which the CoM is before their middle when a foot lands, and behind it when the
other one lifts off."""
_GAP = 0.1
"""Time without a state after which the reference is reset to the measured state [s]."""


class DynamicWalk(SteppingWalk):
    """Walk with steps whose duration depends on their length only, which begins and ends with a stance.

    Attributes
    ----------
    pendulum : InvertedPendulum
        The pendulum model of the robot in its initial posture, which `prepare` computes.

    Raises
    ------
    ConfigError
        If the longest step, which ``dynamic.quicken`` makes quicker, has a support shorter than a period.
    """

    def __init__(self, config: Config, model: RobotModel) -> None:
        super().__init__(config, model)
        shortest = min(self._durations(config.gait.most_length))
        if shortest < config.dt:
            raise ConfigError(
                f"a support of a step of gait.most_length lasts {shortest:g} s, less than dt, {config.dt:g} s: "
                f"lower dynamic.quicken ({config.dynamic.quicken:g} s) or dt, or raise standing.transfer_duration and "
                "standing.swing_duration"
            )
        self._step_now: Sequence[float] = _ON_THE_SPOT  # length, side and turn of the current step
        self._resumes = 0  # step before which it steps on the spot
        self._onto: dict[Foot, list[Array]] = {}  # footprints onto what has stopped a foot, with ``gait.climb``
        self._assume(Drive.of(config, model))
        self._known: Phase | None = None
        self._now: Pendulum
        self._time = -math.inf
        self._confirmed = max(round(_CONFIRMED / config.dt), 2)  # number of states
        self._force, self._measured = GRAVITY * Z, np.zeros((2, 2))  # c and xi at the last state
        self._commanded, self._u, self._acceleration = -math.inf, np.zeros(model.n), np.zeros(model.n)
        self._in_posture = Kinematics(model, self.posture, self._first)
        self._height = float(self._in_posture.com[2])  # of the CoM in the posture [m]
        self._climb = 0.0, 0.0  # height of the CoM over that in the posture, when the phase begins and ends [m]
        self.pendulum: InvertedPendulum
        self._inertia: dict[Foot, Array]  # (n, n) of the swing leg with its rotors, for each base sole [kg m^2]
        self._ground: Ground
        self._reference: Reference
        self._flight: Flight | None = None
        self._tipped: Array | None = None  # the least inclined vertical since a foot landed beside a tipped sole
        self._transfer = config.standing.transfer_duration  # planned duration of the current double support [s]
        self._pushed = self._pausing = False
        self._rests = False  # whether a stance has brought the CoM to rest
        self._descends = False  # whether the swing foot of the next single support is in the air already
        pose = Target(np.zeros(7), np.zeros(6))
        self._targets = {"swing": pose, **{name: Target(np.zeros(k), np.zeros(k)) for name, k in FOLLOWED.items()}}
        # the first one of each kind and support foot, from which others differ in the targets, which are the walk's
        self._phases: dict[tuple[PhaseKind, Foot], Phase] = {}
        self._held_at: Array  # place of the other sole when a phase on both feet began (7,)
        self._trunk_roll: AtRest | None = None
        self._trunk_held: bool | None = None
        self._outwards = 0.0  # that of the step before this phase [m]
        self._kept: Memory  # that of the law, and its table, which is made again if an array is replaced
        self._table: Any = None

    @staticmethod
    def phases(config: Config) -> int:
        """Return the number of phases, with both stances and the steps that place the feet together; 0 if steered."""
        if commanded := len(config.gait.footsteps):
            return 2 * commanded + 2
        return 2 * config.gait.steps + 4 if config.gait.steps else 0

    def prepare(self) -> None:
        """Check the footsteps; compute the constants of the pendulum and of the swing leg, in the initial posture."""
        super().prepare()
        kin = Kinematics(self.model, self.posture, self._first)
        found = InvertedPendulum.of(self.one_foot(self._first, kin, kin.pose(kin.swing)), kin)
        self.pendulum = replace(found, omega=found.omega * np.array([1.0, self.config.dynamic.side_frequency]))
        self._now, self._inertia = Pendulum(self.pendulum.omega, self._drive.delay, self.config.dt), {}
        for base in Foot:
            M = swing_inertia(Kinematics(self.model, self.posture, base))
            self._inertia[base] = M + np.diag(np.where(M.diagonal() > 0.0, self._drive.armature, 0.0))
        if self.config.gait.climb:
            self._onto = {foot: self.footsteps.climbing(foot) for foot in Foot}

    def _carried(self) -> Carried:
        """Return where the CoM is while both feet stand: halfway between the soles, or about so if it need not lean."""
        kin = Kinematics(self.model, self.posture, Foot.LEFT)
        shift = 0.0 if leans(kin) else _SHIFT
        return Carried((0.5 - shift, 0.5 + shift), float(kin.com[2]))

    def use(self, drive: Drive) -> None:
        """Use a model of the servos: its delay moves the references ahead, and lowers the gain."""
        self._assume(drive)
        self._now.use(drive.delay)
        self._table = None

    def _assume(self, drive: Drive) -> None:
        self._drive, delay = drive, drive.delay
        self._advance = max(delay - self.config.dt, 0.0)
        self._gain = self.config.standing.balance / (1.0 + delay / _LATE)
        self._threshold = self.config.dynamic.catch_beyond * (1.0 + delay / _TOLERANT)
        self._unsure = _TIP_TOLERANCE_PER_DELAY * self._advance

    # ------------------------------------------------------------------ order

    def following(self, phase: Phase | None, kin: Kinematics) -> Next | None:
        """Return what follows `phase`; None after the last one. At first a foot that is in the air is put down."""
        if phase is None:
            return self._on_its_feet(kin) or Next(PhaseKind.STANCE, self._first)
        if phase.kind is PhaseKind.STANCE:
            ended = self._stopping or 0 < self.config.gait.steps <= self._done
            over = self._together and ended and not self._planned
            return None if over else Next(PhaseKind.DOUBLE_SUPPORT, self._leading())
        if phase.kind is PhaseKind.SINGLE_SUPPORT:
            return Next(PhaseKind.STANCE if self._together else PhaseKind.DOUBLE_SUPPORT, phase.support.other)
        self._step_now, self._together = self._after(self._step_now, self._done, phase.support)
        self._done += 1
        if self._planned:
            return Next(PhaseKind.SINGLE_SUPPORT, phase.support, self._next_footprint(kin))
        footprint, self._aimed = self.footsteps.wanted(phase.support, *self._step_now), None
        return Next(PhaseKind.SINGLE_SUPPORT, phase.support, footprint)

    def pause(self, wanted: bool) -> None:
        """Put the feet together after the current step and stand, or continue: in mid-step the robot would fall.

        Commanded footsteps are cancelled.
        """
        self._pausing = wanted
        if wanted:
            self._planned.clear()

    def may_hold(self, phase: Phase) -> bool:
        """Return whether `phase` is a stance that has brought the CoM to rest."""
        return phase.kind is PhaseKind.STANCE and self._rests

    @property
    def _is_idle(self) -> bool:
        """Whether a stance continues: that of a paused walk, or of one that is steered with zero velocity."""
        return self._pausing or super()._is_idle

    def restarts(self, phase: Phase) -> float | None:
        """Return 0: after an interruption a phase begins again immediately, because its reference has advanced."""
        return 0.0

    def _after(self, step: Sequence[float], done: int, support: Foot) -> tuple[Sequence[float], bool]:
        """Return the step on `support` after `step` and `done` steps, and whether a stance follows it."""
        ahead = done - self._done
        if ahead < len(self._planned):
            return self.footsteps.step_to(support, self._planned[ahead]), ahead + 1 == len(self._planned)
        gait, ramp = self.config.gait, self.config.dynamic.ramp
        stopping, on_the_spot = self._stopping or self._pausing, done < self._resumes
        if gait.steps:
            ramp = min(ramp, (gait.steps - 1) // 2)
            full = gait.step_length, gait.step_side, gait.step_turn
            most, ended = [*map(abs, full)], stopping or done >= gait.steps
            wanted = _ON_THE_SPOT if on_the_spot or ended or done >= gait.steps - ramp else full
        else:
            most = [gait.most_length, gait.most_side, gait.most_turn]
            wanted = _ON_THE_SPOT if stopping else self._step_at(self._twist)
            ended = not any(wanted)
            wanted = _ON_THE_SPOT if on_the_spot else wanted
        # what no step may have, such as the turn that was left of a commanded footprint, ends at once
        changes = [part / (ramp + 1) if part > 0.0 else math.inf for part in most]
        now = zip(step, wanted, changes, strict=True)
        new = [was + min(max(to - was, -change), change) for was, to, change in now]
        return new, ended and max(map(abs, new)) < 1e-9

    def _durations(self, length: float) -> tuple[float, float]:
        """Return the durations of double and single support [s] of a step of a length [m]: longer ones are quicker."""
        s, most = self.config.standing, self.config.gait.most_length
        part = min(abs(length) / most, 1.0) if most else 0.0
        less = 0.5 * self.config.dynamic.quicken * part**2
        return s.transfer_duration - less, s.swing_duration - less

    def _period(self, length: float) -> float:
        """Return the duration [s] of a step of a length [m]."""
        return sum(self._durations(length))

    def _period_at(self, forward: float) -> float:
        """Return the duration P [s] of a step at a forward velocity v [m/s].

        P = P(0) - q (v P / L)², with q and L ``dynamic.quicken`` and ``gait.most_length``; at least P(L).
        """
        longest, most = self._period(0.0), self.config.gait.most_length
        a = self.config.dynamic.quicken * min(abs(forward) / most, 1e9) ** 2 if most else 0.0
        return max(2.0 * longest / (1.0 + math.sqrt(1.0 + 4.0 * a * longest)), self._period(most))

    # ------------------------------------------------------------------ phases

    def both_feet(self, kind: PhaseKind, support: Foot, kin: Kinematics) -> Phase:
        """Return the phase that moves the CoM to the sole of `support`, or in a stance to the middle of both soles."""
        d, s = self.config.dynamic, self.config.standing
        stance = kind is PhaseKind.STANCE
        rule = Timed(d.stop_duration if stance else s.transfer_duration, lambda: stance and self._is_idle)
        self._aim_over(com_target(kind, kin)[:2])
        held = self._held(kin)
        self._held_at = held.parameters.copy()
        if (kind, support) not in self._phases:
            upright = upright_tasks(self.config.dynamic, self._in_posture, self._targets)
            given = (kind, support, kin, None, upright, (held,), ())
            self._phases[kind, support] = self._phase(*given, rule=rule, joint_return=JOINT_RETURN)
        phase = self._phases[kind, support].again(kin, None, rule)
        _hold(phase, self._held_at)
        return phase

    def one_foot(self, support: Foot, kin: Kinematics, swing_target: Array) -> Phase:
        """Return the single support on the foot `support` in which the other foot moves to `swing_target` (8,)."""
        s, x = self.config.standing, DQ(swing_target)
        # here, so that a monitor, which has the phases only, knows it, too
        self._on_stairs |= bool(stair_height(float(x.translation()[2]), self.config))
        kind, rule, target = PhaseKind.SINGLE_SUPPORT, Timed(s.swing_duration), self._targets["swing"]
        self._aim_over(self.model.soles[support].center[:2])
        target.set(np.array([*x.translation(), *swing_target[:4]]), 0.0)
        if (kind, support) not in self._phases:
            upright = upright_tasks(self.config.dynamic, self._in_posture, self._targets)
            given = {"weight": s.swing_weight, "eta": s.swing_rate, "lever": s.lever}
            tasks = (FollowPose(name="swing", frame=kin.swing, target=target, **given), *upright)
            rows = (), (self._gap(support),)
            first = self._phase(kind, support, kin, swing_target, tasks, *rows, rule=rule, joint_return=JOINT_RETURN)
            self._phases[kind, support] = first
        return self._phases[kind, support].again(kin, swing_target, rule)

    def _aim_over(self, place: Array) -> None:
        """Set the targets with which a phase begins: the CoM over a `place` (2,) [m], everything at rest."""
        for name, value in (("com", place), ("height", self._height), ("upright", 0.0)):
            self._targets[name].set(value, 0.0)

    # ------------------------------------------------------------------ update for every state

    def observe(self, phase: Phase, kin: Kinematics, state: Estimate) -> Change | None:
        """Update the targets of the phase, adjust the step, and compute the desired ground reaction force."""
        super().observe(phase, kin, state)
        share, up, now = self._share(phase, state), kin.up, self._now
        dt = state.time - self._time
        self._time = state.time
        if not 0.0 <= dt <= _GAP:
            dt, (c, xi) = 0.0, com_and_xi(kin, state, self.pendulum.omega, share)
            now.reset(c, xi, xi if self._descends else c)
            self._ground, self._table = Ground(up), None
        if phase is not self._known:
            self._begin(phase, kin)
        if self._table is None:
            self._kept = self._memory(phase, kin)
            self._table = MEMORY.table(self._kept)
        robot = kin.com, kin.com_jacobian, kin.lines, kin.poses
        notice(self._table, state.time, dt, up, share, *robot, *rates(state))
        if self._tipped is not None:
            self._keep_on_ground(phase, self._tipped, up)
        assert isinstance(phase.rule, Timed)
        t = state.elapsed + phase.rule.begun
        self._rests = t >= phase.rule.duration
        flight, change = self._flight, None
        if flight is not None:
            change = self._adjust_step(flight, phase, t)
            change = self._meets(flight, phase, kin, state) or change
        elif isinstance(self._reference, Pressed):
            change = self._adjust_transfer(self._reference, phase, phase.rule, t)
        self._answer(phase, phase.rule, state, up, t)
        if self._trunk_roll is not None:
            most = flight.outwards if flight is not None else self._outwards
            held = most > _OUTWARDS * self._threshold and phase.kind is not PhaseKind.STANCE
            if held is not self._trunk_held:
                self._trunk_held = held
                self._trunk_roll.switch(held)
        return change

    def _answer(self, phase: Phase, rule: Timed, state: Estimate, up: Array, t: float) -> None:
        """Set the targets of the tasks and the force of the ground, `t` [s] after the beginning of the phase."""
        flight = self._flight
        answer(
            self._table, state.time, t, rule.duration, up, *self._reference.compiled,
            phase.kind is PhaseKind.DOUBLE_SUPPORT, flight is not None,
            *(GROUNDED if flight is None else flight.swing.compiled),
        )  # fmt: skip

    def _memory(self, phase: Phase, kin: Kinematics) -> Memory:
        """Return what the control law reads and writes in a phase."""
        d, model, frames = self.config.dynamic, self.model, kin.tree.frames
        margin = self.config.standing.pressure_margin
        alone = {foot: np.array([*self._aim(foot, Footprint()), 0.0]) for foot in Foot}
        (c, xi), (n, offsets), (begin, end) = self._measured, self._support, self._climb
        return Memory(
            Settings(self._advance, self._gain, self._unsure, margin, d.land_late, self.pendulum.swing, self._height),
            self._now.compiled, c, xi, self._ground.vertical, n, offsets, begin, end,
            **{name: target.numbers for name, target in self._targets.items()},
            force=self._force, other=frames[kin.swing], sensor=frames[model.imu], mass=model.mass,
            acceleration=self._acceleration, inertia=self._inertia[phase.base], legs=frames[model.pelvis].moves,
            soles=Soles.of(model, phase.base, both=phase.double, at=alone),
        )  # fmt: skip

    def _keep_on_ground(self, phase: Phase, least: Array, up: Array) -> None:
        """Hold the foot that has landed in the plane of the ground while the base sole, which was tipped, comes down.

        In the plane of the tipped sole it would be lifted again, and bear no weight. As soon as the base sole itself
        bears none, its inclination is that of the legs, so the least one since the landing counts.
        """
        if self._ground.inclination(up) < self._ground.inclination(least):
            self._tipped = least = up
        _hold(phase, self._ground.tipped(least, 0.0, self._held_at))

    @staticmethod
    def _share(phase: Phase, state: Estimate) -> float:
        """Return the fraction of the weight on the foot that is not the base of `phase`; none in single support."""
        if state.loads is None or phase.kind is PhaseKind.SINGLE_SUPPORT:
            return 0.0
        return share_of(phase.base.other, state.loads)

    def _adjust_step(self, flight: Flight, phase: Phase, t: float) -> Change | None:
        """Adjust time and position of the landing to the measured xi, `t` [s] after lift-off.

        Return the change as soon as the landing can no longer be adjusted.
        """
        d, rule, step, xi = self.config.dynamic, flight.rule, flight.step, self._now.smooth
        if not d.catch or t < d.untouched:
            return None
        if t > rule.duration - d.settled:
            return None if phase.decision or flight.lost < self._confirmed else flight.landing(phase)
        if flight.lost < self._confirmed:
            over, _ = left_over(step, xi, t, step.duration - t)
            flight.lost = flight.lost + 1 if max(map(abs, over.tolist())) > self._threshold else 0
            if flight.lost < self._confirmed:
                return None
        rule.duration, flight.shift, over = adjusted(step, xi, t, rule.duration, flight.shift, d)
        end = step.landing + step.offset + flight.shift
        assert isinstance(self._reference, Pressed)
        self._reference = replace(self._reference, duration=rule.duration, end=end)
        flight.swing.goal = flight.goal + flight.shift
        flight.most = max(flight.most, float(np.abs(over).max()))
        flight.outwards = max(flight.outwards, float(over[1]) * (1.0 if phase.base is Foot.LEFT else -1.0))
        if np.abs(over).max() > _RESIDUAL:
            self._now.c += _APPROACH * (self._measured[0] - self._now.c)
        return None

    def _adjust_transfer(self, reference: Pressed, phase: Phase, rule: Timed, t: float) -> Change | None:
        """Extend a double support until the measured xi has arrived, `t` [s] after its beginning.

        A push towards the swing foot brings it to the ground early, and the impact throws the robot back. A single
        support that begins with xi too far behind would have to end sooner than the other foot can land. A robot that
        is held does not wait for ever. Return the change at the last state of the phase.
        """
        left, planned = reference.duration - t, self._transfer
        due, z = reference.at(t)
        waits, xi = left > 1e-9 and t < planned + _LONGEST_WAIT, self._now.smooth
        if self.config.dynamic.catch and abs(xi[1] - due[1]) > self._threshold and waits:
            left += min(max(transfer_time(reference, z, xi, planned - t) - left, -HURRY), HURRY)
            rule.duration = t + left
            a = reference.b - (reference.b - z) * rule.duration / left
            self._reference = replace(reference, a=a, duration=rule.duration)
        longer = rule.duration - planned
        if left > 1.5 * self.config.dt or longer < self.config.dt or phase.decision:
            return None
        return Change(
            f"the double support lasts {1e3 * longer:.0f} ms longer, until the divergent component has arrived"
        )

    def _meets(self, flight: Flight, phase: Phase, kin: Kinematics, state: Estimate) -> Change | None:
        """Let the swing foot land where it is if it has met an obstacle, or a step that is higher than planned.

        Return that as a change. After an obstacle commanded footsteps are dropped. With ``gait.climb``, and if the
        loads of the feet are known, the robot climbs it, unless it did so already; otherwise it steps on the spot.
        """
        assert phase.swing_target is not None
        swings = phase.base.other
        if flight.up > 0.0 and state.loads is not None and share_of(swings, state.loads) > _BEARS:
            here = kin.point(kin.swing)
            higher = float(here[2]) - flight.up
            if higher > _HIGHER and flight.swing.is_over(here[:2]):
                self._aimed = None
                self._land_here(flight, phase, here, float(here[2]))
                return Change(f"the foot is on a step, {1e3 * higher:.0f} mm higher than planned")
        stopped = self._stopped(phase, kin, state, *flight.swing.along, self._advance, _STOPPED)
        if stopped is not None:
            here = kin.point(kin.swing)
            ahead, aside = (DQ(phase.swing_target).translation() - here)[:2].tolist()
            climbs = self._onto and state.loads is not None and self._aimed is None and ahead > abs(aside)
            self._planned, self._aimed = deque(self._onto[swings] if climbs else ()), None
            self._step_now, self._resumes = _ON_THE_SPOT, self._done + _WAITS
            self._land_here(flight, phase, here)
        return stopped

    def _land_here(self, flight: Flight, phase: Phase, place: Array, height: float | None = None) -> None:
        """Let the swing foot land at `place` (>= 2,) [m], at which it is now; see `Swing.stop` for the `height`."""
        assert phase.swing_target is not None
        assert isinstance(self._reference, Pressed)
        here = flight.swing.stop(place[:2], height)
        missed = here - DQ(phase.swing_target).translation()[:2]
        target = (DQ.from_pose([*missed, 0.0]) * DQ(phase.swing_target)).vec8()
        _, ((_, end), *_) = self._plan(phase.support, Footprint(), target)
        landing = self._aim(phase.base.other, Footprint.of(target))
        flight.step = replace(flight.step, landing=landing, offset=end - landing, reach=np.zeros(2))
        self._reference = replace(self._reference, end=end)
        flight.goal, flight.shift = here, np.zeros(2)

    def _begin(self, phase: Phase, kin: Kinematics) -> None:
        """Plan a phase for the current poses of the feet, in the axes of the base sole of the phase."""
        before, self._known = self._known, phase
        other, level = Footprint.of(kin.pose(kin.swing)), self._level(kin)
        changes = before is not None and before.base is not phase.base
        if changes:  # transform from the previous base sole
            self._ground.change_base(other)
            self._now.change_base(other)
        self._trunk_roll = next((task for task in phase.tasks if isinstance(task, AtRest)), None)
        self._trunk_held = None  # as the last phase of this kind has left it
        landed = before is not None and before.kind is PhaseKind.SINGLE_SUPPORT and before.base is phase.base
        tilt = self._ground.inclination(kin.up) if landed else 0.0
        self._tipped = kin.up if tilt > _TIPPED else None
        self._pushed = self._flight.most > self._threshold if self._flight else self._pushed
        self._outwards = self._flight.outwards if self._flight else 0.0
        if landed and not self._on_stairs and self._outwards <= _OUTWARDS * self._threshold:
            self._ground.end_step(tilt)  # not of a sole that stands over an edge, nor of one that a push has tipped
        self._flight = None
        omega, rule, sole = self.pendulum.omega, phase.rule, self.model.soles[phase.base]
        outline = sole.outline
        assert isinstance(rule, Timed)
        above = end = self._climb[1] + (level if changes else 0.0)  # over the base sole
        if phase.swing_target is not None:
            self._reference = self._flight_reference(phase, kin, rule)
            end = min(float(DQ(phase.swing_target).translation()[2]), 0.0)
        else:
            beside = other.points(self.model.soles[phase.base.other].corners[:, :2])
            outline = ConvexPolygon.hull(np.concatenate([sole.corners[:, :2], beside]))
            if phase.kind is PhaseKind.STANCE:
                middle = 0.5 * (self._aim(phase.base, Footprint()) + self._aim(phase.base.other, other))
                self._reference = Rest(self._now.xi.copy(), middle, rule.duration, omega)
            else:
                self._reference = self._transfer_reference(phase, other, rule, before)
        self._climb = above, end
        self._support, self._table = outline.edges(), None

    def _transfer_reference(self, phase: Phase, other: Footprint, rule: Timed, before: Phase | None) -> Reference:
        """Return the reference of a double support, which ends on the foot at `other`."""
        omega, (supports, ends) = self.pendulum.omega, self._plan(phase.support, other)
        start, _ = ends[0]
        if before is None or before.kind is not PhaseKind.SINGLE_SUPPORT:
            rule.duration = self.config.dynamic.start_duration
            return Rest(self._now.xi.copy(), start, rule.duration, omega)
        rule.duration = self._transfer = supports[0].double
        left = self._aim(phase.base, Footprint()) + self._roll(Footprint(), self._step_now)
        return Pressed(left, supports[0].first, start, rule.duration, omega)

    def _flight_reference(self, phase: Phase, kin: Kinematics, rule: Timed) -> Pressed:
        """Initialize a single support and return its reference."""
        d, omega, target = self.config.dynamic, self.pendulum.omega, phase.swing_target
        assert target is not None
        supports, ends = self._plan(phase.support, Footprint(), target)
        support, (_, end) = supports[0], ends[0]
        rule.duration = support.single
        reference = Pressed(support.first, support.last, end, rule.duration, omega)
        sole, landing = self.model.soles[phase.base], self._aim(phase.base.other, Footprint.of(target))
        half = 0.5 * np.array([sole.length, sole.width]) - d.catch_margin
        # a commanded footprint is where there is room for a foot, such as on a stair
        ahead = min(d.catch_length, self.config.gait.footstep_tolerance) if self._aimed is not None else d.catch_length
        step = Step(
            z=support.aim, landing=landing, offset=end - landing, duration=rule.duration, omega=omega,
            low=sole.center[:2] - half, high=sole.center[:2] + half, reach=np.array([ahead, d.catch_side]),
        )  # fmt: skip
        descends, self._descends = self._descends, False
        start = (DQ(self._ground.tip(kin.up, self._unsure)).conj() * DQ(kin.pose(kin.swing))).vec8()
        whole, level = (rule.duration, 0.0) if descends else (0.0, self._level(kin))
        still = d.land_late / (rule.duration + d.land_late)  # while the foot only comes down
        gait, up = self.config.gait, float(DQ(target).translation()[2])
        lift = gait.step_height + (max(gait.climb - up, 0.0) if up > 0.0 else 0.0)
        swing = Swing(start, target, lift, whole, level, still)
        rule.begun = swing.begun
        # after an adjusted step, the next step is adjusted from its beginning
        self._flight = Flight(rule, step, swing, swing.goal, up, lost=self._confirmed if self._pushed else 0)
        return reference

    def _plan(
        self, foot: Foot, stands: Footprint, target: Array | None = None
    ) -> tuple[list[Support], list[tuple[Array, Array]]]:
        """Plan from the single support on `foot` at the pose `stands`, in which the other foot moves to `target` (8,).

        Return the supports, and xi (2,) [m] at the beginning and at the end of each but the last. Without a target the
        single support has not begun.
        """
        step, together, done = self._step_now, self._together and target is not None, self._done
        landing = None if target is None else Footprint.of(target)
        supports = []
        while True:
            if landing is None:
                step, together = self._after(step, done, foot)
                done += 1
                landing = self.footsteps.stride(foot, *step)
            supports.append(self._support_on(foot, stands, step))
            foot, stands, landing = foot.other, stands.then(landing), None
            if together or len(supports) == _AHEAD:
                break
        supports.append(self._support_on(foot, stands, step))
        return supports, single_supports(supports, self.pendulum.omega, ends=together)

    def _support_on(self, foot: Foot, stands: Footprint, step: Sequence[float]) -> Support:
        """Return the support on `foot` at the pose `stands`, during which a step (3,) is taken."""
        return Support(self._aim(foot, stands), self._roll(stands, step), *self._durations(step[0]))

    def _roll(self, stands: Footprint, step: Sequence[float]) -> Array:
        """Return by how much the CoP on a sole is ahead of its aim at the end of a step (3,), shape (2,) [m].

        It moves from the heel towards the toe, so that the reaction of the swing leg, first ahead and then back, and
        the motion of the CoM over the foot need less of the sole.
        """
        ahead = self.config.dynamic.roll * step[0] * stands.ahead
        return np.array([ahead.real, ahead.imag])

    def _aim(self, foot: Foot, stands: Footprint) -> Array:
        """Return the middle of the CoP's planned path on the sole of `foot` at the pose `stands`, shape (2,) [m]."""
        d, sole, side = self.config.dynamic, self.model.soles[foot], 1.0 if foot is Foot.LEFT else -1.0
        inside = d.aim_inside + self._ground.inward * sole.width
        return stands.points(sole.center[:2] + np.array([d.aim_ahead, -side * inside]))

    def effort(self, phase: Phase, kin: Kinematics, state: Estimate, u: Array) -> Array:
        """Return the feedforward torques for a ground reaction force through the zero-moment point, shape (n,) [N m].

        The joints of the swing leg are accelerated as commanded by `u` (n,) [rad/s].
        """
        passed = state.time - self._commanded
        robot = kin.com, kin.com_jacobian, kin.lines, kin.poses
        tau: Array = torques(self._table, self._u, u, passed if passed <= _GAP else 0.0, kin.up, *robot)
        self._commanded, self._u = state.time, u
        return tau


def _hold(phase: Phase, place: Array) -> None:
    """Hold the sole that a phase holds at another place (7,), position [m] and unit quaternion."""
    for held in phase.equalities:
        if isinstance(held, FrameHeld):
            held.hold(place)
