"""Decides which measured states a controller accepts: every number is compared with what is possible.

The nodes need no other check of a state. One impossible value is rejected and counted; `safety.jumps` in a row are a
fault that only ``~/reset`` clears.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from dqwalk_ros.estimation.vertical import turning
from dqwalk_ros.nodes.safety import Clock, ClockSteps, FaultCounter, Watchdog
from dqwalk_ros.paper.state import State
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.robot.limits import FASTEST, named_angles, outside_limits, unreachable
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import StateError


class Felt(NamedTuple):
    """What an inertial sensor measures, in its frame."""

    up: Array
    """Unit vector against gravity, shape (3,)."""
    gyro: Array
    """Angular velocity, shape (3,) [rad/s]."""
    acceleration: Array | None
    """Specific force, shape (3,) [m/s^2]."""


class InertialGate:
    """Decides which measurements of the inertial sensor a controller uses, and what it uses instead of the others.

    Instead of an impossible one it uses the last one, with the vertical turned by its angular velocity. Within the one
    or two periods for which this lasts, the angular velocity hardly changes, so the vertical is as exact as a measured
    one; without a vertical the balance would be interrupted, and without an answer the walk.

    Parameters
    ----------
    limit : int
        Consecutive impossible measurements that are a fault.
    longest : callable
        Returns the time between two measurements above which nothing follows from the first about the second [s].
    since : callable, optional
        Returns the longest time that can have passed since the last state, whatever the stamps say [s].

    Attributes
    ----------
    impossible : FaultCounter
        Of vertical and angular velocity.
    rejected : int
        Number of impossible measurements.
    reason : str
        Why the last measurement is not used as it is; empty if it is.
    """

    tilt, turn = 0.1, 2.0
    """Accepted difference of the vertical from the last one turned by the gyroscope [rad], and per time [rad/s].
    Walks with noise, and falls, remain below 0.025 rad."""
    rate, jolt, angular = 35.0, 3.0, 200.0
    """Largest angular velocity, 2000 degrees/s [rad/s]; accepted change [rad/s], and per time [rad/s^2]. Falls remain
    below 2 rad/s in 5 ms."""
    strongest = 16.0 * GRAVITY
    """Largest acceleration, the range of the usual sensors [m/s^2]; only the odometry uses it."""

    def __init__(self, limit: int, longest: Callable[[], float], since: Callable[[], float] = lambda: math.inf) -> None:
        self._longest, self._since = longest, since
        self.impossible, self._too_strong = FaultCounter(limit), FaultCounter(limit)
        self.rejected = 0
        self.reset()

    def reset(self) -> None:
        """Accept any measurement next, as the first one."""
        self.impossible.reset()
        self._too_strong.reset()
        self.reason = ""
        self._judged = self._accepted = -1  # stamps of the last measurement, and of the last accepted one [ns]
        self._last: Felt | None = None  # accepted
        self._used: Felt | None = None

    def use(self, stamp: int, felt: Felt | StateError) -> Felt:
        """Return the measurement to be used for the one with a stamp [ns], which may be given again.

        Parameters
        ----------
        felt : Felt or StateError
            What was measured, all numbers finite, or why the message is invalid.

        Raises
        ------
        StateError
            If it is impossible and cannot be replaced, because it is the first one, or one of too many in a row.
        """
        if stamp == self._judged and self._used is not None:
            return self._used
        self._judged, passed = stamp, 1e-9 * (stamp - self._accepted)
        last = self._last if abs(passed) <= self._longest() else None  # it may be late, so that it follows a newer one
        if isinstance(felt, StateError):
            self.reason = str(felt)
        else:
            felt = felt._replace(acceleration=self._possible(felt.acceleration))
            self.reason = self._why(last, felt, passed)
            if self.impossible:  # the walk has ended; whether the robot lies is still of interest
                return Felt(felt.up, np.zeros(3), None)
            if not self.reason:
                self.impossible.good()
                self._accepted = stamp
                self._last = self._used = felt
                return felt
        self.rejected, self._used = self.rejected + 1, None
        if self._last is None:  # nothing has been measured yet
            raise StateError(self.reason)
        if self.impossible.fault(f"{self.reason}; {self.impossible.limit} in a row, until ~/reset"):
            raise StateError(self.impossible.reason)
        if last is None:
            raise StateError(self.reason)
        most = self._since()
        self._used = last._replace(up=_turned(last.up, last.gyro, min(max(passed, -most), most)))
        return self._used

    def _why(self, last: Felt | None, felt: Felt, passed: float) -> str:
        """Return why a measurement is impossible, `passed` [s] after the last accepted one; empty if it is possible."""
        if not (fastest := float(np.abs(felt.gyro).max())) <= self.rate:
            return f"the inertial sensor turns at {fastest:.3g} rad/s, beyond {self.rate:g} rad/s"
        if last is None:
            return ""
        time = min(abs(passed), self._since())  # within which it can have changed
        if not (change := float(np.abs(felt.gyro - last.gyro).max())) <= self.jolt + time * self.angular:
            return f"the angular velocity of the inertial sensor jumped by {change:.3g} rad/s"
        expected = _turned(last.up, 0.5 * (last.gyro + felt.gyro), passed)
        if not (off := float(np.linalg.norm(felt.up - expected))) <= self.tilt + time * self.turn:
            return (
                f"the vertical of the inertial sensor jumped by {math.degrees(off):.0f} degrees, "
                "which its gyroscope does not confirm"
            )
        return ""

    def _possible(self, acceleration: Array | None) -> Array | None:
        """Return an acceleration, or instead of a single impossible one the last one; None if there are more."""
        if acceleration is None or (strongest := float(np.abs(acceleration).max())) <= self.strongest:
            self._too_strong.good()
            return acceleration
        self.rejected += 1
        self._too_strong.fault(f"imu: an acceleration of {strongest:.3g} m/s^2; the odometry does without")
        return None if self._too_strong or self._last is None else self._last.acceleration

    @property
    def warning(self) -> str:
        """What is wrong with the accelerometer; empty if nothing is."""
        return self._too_strong.reason


def _turned(up: Array, omega: Array, time: float) -> Array:
    """Return the vertical `up` (3,) in a frame that turns by the angular velocity `omega` (3,) for a `time` [s]."""
    turned = up + time * turning(up, omega)
    out: Array = turned / math.sqrt(float(turned @ turned))
    return out


class VelocityGate:
    """Decides whether measured joint velocities are used: their integral must be the motion of the angles.

    Those in another unit, of the other sign, or always zero would unbalance the robot, which walks as well without.

    Parameters
    ----------
    joint_names : tuple of str
        The n joints.
    limit : int
        Consecutive windows with a wrong integral after which velocities are not used until `reset`.

    Attributes
    ----------
    wrong : FaultCounter
    """

    window = 0.1
    """Time over which velocities are integrated [s]."""
    slack, part = 0.02, 0.7
    """Accepted norm of the difference from the motion [rad], and its part of the larger one of both."""
    shows = 0.1
    """Norm of the motion in a window from which on it shows that velocities are right: at rest zeros are, too [rad]."""

    def __init__(self, joint_names: tuple[str, ...], limit: int) -> None:
        self._names, self.wrong = joint_names, FaultCounter(limit)
        self.reset()

    def reset(self) -> None:
        """Use velocities until they are wrong."""
        self.wrong.reset()
        self._q: Array | None = None  # at the beginning of the window
        self._dq = self._integral = np.zeros(len(self._names))  # of the last state; since the beginning [rad]
        self._time = 0.0  # since then [s]
        self._doubted = False  # from a wrong integral on, until a window shows that they are right

    def use(self, q: Array, dq: Array | None, passed: float) -> Array | None:
        """Return the velocities (n,) [rad/s] at the angles `q` (n,), `passed` [s] after the last ones, or None.

        They are not used as soon as their integral is wrong, in the middle of a window, too: a robot that is balanced
        by them falls before `wrong` is sure.
        """
        if dq is None:
            return None
        if self._q is None:
            self._q, self._integral, self._time = q, np.zeros(len(q)), 0.0
        else:
            self._integral = self._integral + 0.5 * passed * (self._dq + dq)
            self._time += passed
            moved = q - self._q
            most = max(float(np.linalg.norm(moved)), float(np.linalg.norm(self._integral)))
            fits = float(np.linalg.norm(self._integral - moved)) <= self.slack + self.part * most
            over = self._time > self.window - 1e-9
            self._doubted = not fits or (self._doubted and not (over and most > self.shows))
            if over:
                self._judge(moved, fits=fits)
                self._q, self._integral, self._time = q, np.zeros(len(q)), 0.0
        self._dq = dq
        return None if self.wrong or self._doubted else dq

    def _judge(self, moved: Array, *, fits: bool) -> None:
        """Count a window in which the joints moved by (n,) [rad]."""
        if fits:
            self.wrong.good()
            return
        k = int(np.abs(self._integral - moved).argmax())
        self.wrong.fault(
            "the velocities of joint_states are not those of the angles, and are not used until ~/reset: "
            f"{self._names[k]} turned by {moved[k]:.3g} rad in {self._time:.2g} s, "
            f"and by {self._integral[k]:.3g} rad at its velocity; is that in rad/s?"
        )


class StateGate:
    """Decides which measured states a controller accepts, and at what time of the walk.

    Every number of a state is compared with what is possible since the last accepted one. The time of the walk advances
    by the stamps, and where those jump, because a clock was set, by the time of receipt.

    Parameters
    ----------
    dt : float
        Period of the states [s].
    timeout : callable
        Returns the timeout of the states [s].
    outside : float
        Largest excess over the joint limits of an accepted state [rad].
    jumps : int
        Consecutive impossible states after which every state is rejected until `reset`.
    by_stamp : bool
        In lockstep: time is measured by the stamps, not by the steady clock.

    Attributes
    ----------
    watchdog : Watchdog
        Fed by accepted states only.
    impossible : FaultCounter
        Of states with impossible joint angles or velocities.
    inertial : InertialGate
    velocities : VelocityGate
    overtaken : int
        Number of states ignored because of their stamp.
    stepped : float
        By how much the stamp of the last accepted state had jumped, because a clock was set [s]; 0 if it had not.
    """

    repeats = 5
    """Number of consecutive states with the stamp of the last one that indicates stamps which do not advance."""
    soon = 0.25
    """Part of a period; a state that follows the last one sooner is ignored, because no velocity follows from it."""
    late = 2.0
    """Periods by which a message may arrive earlier than it should, because the one before was late."""
    may_repeat = False
    """Whether the plant publishes a state again until it is answered."""

    def __init__(
        self,
        model: RobotModel,
        dt: float,
        timeout: Callable[[], float],
        *,
        outside: float = 0.1,
        jumps: int = 3,
        by_stamp: bool = False,
        clock: Clock = time.monotonic,
    ) -> None:
        self._model, self._dt, self._outside, self._by_stamp = model, dt, outside, by_stamp
        self._speed = np.minimum(model.velocity_max, FASTEST)
        self._timeout = timeout
        self.watchdog = Watchdog(timeout, clock)
        self.impossible = FaultCounter(jumps)
        since = (lambda: math.inf) if by_stamp else (lambda: self.watchdog.age + self.late * dt)
        self.inertial = InertialGate(jumps, timeout, since)
        self.velocities = VelocityGate(model.joint_names, jumps)
        self.overtaken = 0
        self.reset()

    def reset(self) -> None:
        """Accept any state next, as the first one."""
        self.impossible.reset()
        self.inertial.reset()
        self.velocities.reset()
        self.watchdog.starve()
        self._q: Array | None = None
        self._stamp = -1
        self._repeated = 0  # consecutive states with this stamp
        self._steps = ClockSteps()
        self._offset = 0  # of the stamps from the time of the walk [ns]
        self._passed = 0.0  # from the last accepted state to the first impossible one after it [s]
        self.stepped = 0.0

    @property
    def fault(self) -> str:
        """Why every state is rejected until `reset`; empty if that is not so."""
        return self.impossible.reason or self.inertial.impossible.reason

    def is_new(self, stamp: int) -> bool:
        """Return whether a stamp [ns] follows the last accepted one, or a clock was set.

        All other states have overtaken each other, or have a wrong stamp. After a timeout any stamp but the last one is
        accepted.
        """
        repeated = stamp == self._stamp and not self.may_repeat
        self._repeated = self._repeated + 1 if repeated else 0
        passed = 1e-9 * (stamp - self._stamp)
        follows = self.soon * self._dt <= passed <= self._farthest
        if self._stamp < 0 or (self.watchdog.silent and not repeated) or follows:
            self._steps.forget()
            return True
        if not 0.0 <= passed <= self._farthest and self._steps.is_one(stamp):
            return True
        self.overtaken += 1
        return False

    @property
    def _farthest(self) -> float:
        """Longest time by which the stamps can have advanced since the last accepted state [s]."""
        return self.watchdog.age + self._timeout()

    @property
    def stuck(self) -> str:
        """Why every state is ignored, if the stamps do not advance while states arrive; empty otherwise."""
        if self._repeated < self.repeats:
            return ""
        return (
            f"they all have the stamp {1e-9 * self._stamp:.9g}: set header.stamp to the time of the measurement, "
            "a new one for each state"
        )

    def accept(self, stamp: int, state: State) -> State:
        """Return a state with the time of the walk, without velocities that are wrong; or raise and change nothing.

        Parameters
        ----------
        stamp : int
            [ns]
        state : State
            As measured, all numbers finite.

        Raises
        ------
        StateError
            If it is outside the joint limits, further from the last one than the joints can move, or has velocities
            that are not those of the angles; the message names the joints.
        """
        if self.impossible:
            raise StateError(self.impossible.reason)
        elapsed = self._elapsed(stamp)
        passed, q = 1e-9 * elapsed, state.q
        if outside := outside_limits(q, self._model, self._outside):
            raise self._reject(f"outside the joint limits: {outside} ({self._outside:g} rad are tolerated)")
        moved = np.zeros(self._model.n) if self._q is None else q - self._q
        if self._q is not None:
            reach = passed if self._by_stamp else max(passed, self.watchdog.age)
            if self.impossible.count:  # waiting does not make a jump plausible
                reach = min(reach, self._passed)
            self._passed = reach
            beyond = unreachable(q, self._q, reach, self._speed, self._dt * self._speed)
            if far := named_angles(self._model, np.abs(moved), beyond):
                raise self._reject(f"a jump that the velocity limits do not allow: {far}")
        if state.dq is not None and not self.velocities.wrong:
            wrong = unreachable(state.dq, moved / max(passed, self._dt), 1.0, self._speed, 0.0)
            if wrong.any():
                turning = ", ".join(f"{self._model.joint_names[i]} {state.dq[i]:.3g}" for i in np.flatnonzero(wrong))
                raise self._reject(f"joint velocities that are not those of the angles: {turning} rad/s")
        self.impossible.good()
        step = stamp - self._stamp - elapsed
        self._offset, self.stepped = self._offset + step, 1e-9 * step
        self._q, self._stamp = q, stamp
        self.watchdog.feed()
        dq = self.velocities.use(q, state.dq, passed)
        return dataclasses.replace(state, time=self.time_of(stamp), dq=dq)

    def time_of(self, stamp: int) -> float:
        """Return the time of the walk [s] of a stamp [ns], by the clock of the last accepted state."""
        return 1e-9 * (stamp - self._offset)

    def _elapsed(self, stamp: int) -> int:
        """Return the time since the last accepted state, until one with a stamp [ns]: by receipt if a clock was set."""
        passed = stamp - self._stamp
        if self._by_stamp or 0 < passed <= self._farthest * 1e9:
            return passed
        age = self.watchdog.age
        return round(1e9 * (max(age, self._dt) if age < math.inf else self._dt))  # infinite before the first state

    def _reject(self, why: str) -> StateError:
        """Count an impossible state and return its error."""
        if self._q is None:  # nothing moves yet
            return StateError(why)
        latched = self.impossible.fault(f"{why}; {self.impossible.limit} in a row, rejecting all states until ~/reset")
        return StateError(self.impossible.reason if latched else why)


class BodyGate(StateGate):
    """Decides which states of the whole body, joints and base, a controller accepts.

    Time is measured by the stamps. A push or a touchdown can accelerate the joints beyond the limits of the motors, so
    joint velocities up to `fast` times their limits are accepted.
    """

    may_repeat = True
    fast = 3.0
    """Largest accepted joint velocity, in units of its limit."""
    speed, turn = 10.0, 30.0
    """Largest accepted velocities of the base [m/s, rad/s]."""

    def __init__(self, model: RobotModel, dt: float, timeout: Callable[[], float], **options: Any) -> None:
        able = dataclasses.replace(model, velocity_max=self.fast * model.velocity_max)
        super().__init__(able, dt, timeout, **{**options, "by_stamp": True})

    def reset(self) -> None:
        """Accept any state next, as the first one."""
        super().reset()
        self._place: Array | None = None

    def accept_body(self, stamp: int, state: State, place: Array, v_base: Array) -> None:
        """Accept a state, or raise an error and change nothing.

        Parameters
        ----------
        stamp : int
            [ns]
        state : State
            With the velocities of the joints.
        place : ndarray, shape (3,)
            Of the base [m].
        v_base : ndarray, shape (6,)
            [m/s, rad/s]

        Raises
        ------
        StateError
            If a number is not finite, a velocity is too large, or joints or base jumped.
        """
        assert state.dq is not None
        if not all(np.isfinite(part).all() for part in (state.q, state.dq, place, v_base)):
            raise StateError("a number is not finite")
        if self.velocities.wrong:  # no torque follows from angles alone
            raise self._reject(self.velocities.wrong.reason)
        for does, rates, most, unit in (
            ("moves", v_base[:3], self.speed, "m/s"),
            ("turns", v_base[3:], self.turn, "rad/s"),
        ):
            if not (fastest := float(np.abs(rates).max())) <= most:
                raise self._reject(f"the base {does} at {fastest:.3g} {unit}")
        if self._place is not None and not self.impossible:
            moved = float(np.linalg.norm(place - self._place))
            if not moved <= self.speed * (max((stamp - self._stamp) * 1e-9, 0.0) + self._dt):
                raise self._reject(f"the base jumped by {moved:.3g} m")
        self.accept(stamp, state)
        self._place = place
