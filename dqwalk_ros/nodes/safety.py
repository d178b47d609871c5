"""Decides which states a controller accepts, which commands a plant executes, and when either must stop.

The decisions of ``docs/faults.md`` that need no ROS are made here, with a clock that tests can replace; the nodes call
this file and publish the result. Two rules apply everywhere. A rejected message changes nothing and does not feed a
watchdog. A timeout is measured from the *receipt* of a message, on a steady clock; its stamp is used for order only.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqwalk_ros.paper.state import State
from dqwalk_ros.robot.limits import FASTEST, clamp_velocity, named_angles, outside_limits, unreachable
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import StateError, listed

__all__ = [
    "BodyGate",
    "CommandGate",
    "Contradictions",
    "DuplicatePublishers",
    "DuplicateStates",
    "FaultCounter",
    "JointOrder",
    "StateGate",
    "Watchdog",
]

Clock = Callable[[], float]


class JointOrder:
    """Sorts values that have joint names into the order of the model's joints.

    Joints that the model does not have are ignored. Any other mismatch rejects the whole message.
    """

    def __init__(self, joint_names: Sequence[str]) -> None:
        self._joints = tuple(joint_names)
        self.joints = frozenset(joint_names)
        self._names: list[str] = []
        self._index: NDArray[np.intp] | None = None

    def __call__(self, names: Sequence[str], values: ArrayLike, what: str, *, finite: bool = True) -> Array:
        """Return the values of the model's joints, shape (n,); `what` is the name of the values in error messages.

        Raises
        ------
        StateError
            If joints are missing or named twice, a length is wrong or, with `finite`, a value is not finite; the
            message names the joints.
        """
        if self._index is None or names != self._names:
            self._index = self._order(names)
            self._names = list(names)
        given = np.asarray(values, dtype=np.float64)
        if given.shape != (len(self._names),):
            raise StateError(f"{len(self._names)} names, but {given.size} numbers in '{what}'")
        out: Array = given[self._index]
        if finite and not (math.isfinite(sum(out.tolist())) or np.isfinite(out).all()):  # the sum is a fast first test
            bad = ", ".join(f"{self._joints[i]} = {out[i]}" for i in np.flatnonzero(~np.isfinite(out)))
            raise StateError(f"not a finite {what}: {bad}")
        return out

    def _order(self, names: Sequence[str]) -> NDArray[np.intp]:
        place = {name: i for i, name in enumerate(names)}
        if missing := [joint for joint in self._joints if joint not in place]:
            extra = [name for name in names if name not in self._joints]
            also = f"; it has {listed(extra)}, which are not in the model" if extra else ""
            raise StateError(f"joints missing: {', '.join(missing)}{also}")
        if len(place) != len(names):
            seen: set[str] = set()
            doubled = {name for name in names if name in seen or seen.add(name)}  # type: ignore[func-returns-value]
            raise StateError(f"joints named twice: {listed(doubled)}")
        return np.array([place[joint] for joint in self._joints], np.intp)


class Watchdog:
    """Detects a timeout by the time of receipt.

    Parameters
    ----------
    timeout : callable
        Returns the timeout [s]; called each time, because the parameter may change.
    clock : callable
        Steady time [s].
    """

    def __init__(self, timeout: Callable[[], float], clock: Clock = time.monotonic) -> None:
        self._timeout, self._clock = timeout, clock
        self._fed = -float("inf")

    @property
    def age(self) -> float:
        """Time since the last accepted message [s]; infinite before the first."""
        return self._clock() - self._fed

    @property
    def silent(self) -> bool:
        """Whether no message was accepted for longer than the timeout."""
        return not self.age <= self._timeout()

    def feed(self) -> None:
        """Register an accepted message."""
        self._fed = self._clock()

    def starve(self) -> None:
        """Set the state to silent until the next `feed`."""
        self._fed = -float("inf")


class FaultCounter:
    """Counts consecutive faults; at a limit the fault is latched until a reset.

    Parameters
    ----------
    limit : int
        Number of consecutive faults that latches.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.count, self.reason = 0, ""

    def fault(self, reason: str) -> bool:
        """Register a fault; return whether it is latched now."""
        self.count += 1
        if self.count >= self.limit and not self.reason:
            self.reason = reason
        return bool(self.reason)

    def good(self) -> None:
        """Register a success; it resets the count, but not a latched fault."""
        if not self.reason:
            self.count = 0

    def reset(self) -> None:
        """Clear the count and a latched fault."""
        self.count, self.reason = 0, ""

    def __bool__(self) -> bool:
        return bool(self.reason)


_UNKNOWN = "_NODE_NAME_UNKNOWN_"
"""Name of a publisher's node, as rclpy reports it, until the node has been discovered."""


class DuplicatePublishers:
    """Detects two publishers on a topic that must have one.

    Two different nodes are reported at once. Two publishers of the same name may be a node and its killed predecessor,
    which the middleware lists for another 20 s; they are reported when both are still listed after `ghost`.
    """

    ghost = 25.0
    """Time for which a killed publisher may remain listed [s]."""

    def __init__(self, clock: Clock = time.monotonic) -> None:
        self._clock = clock
        self._doubled = float("inf")

    def judge(self, names: Sequence[str]) -> str:
        """Return the names of duplicate publishers, or ``""``; `names` has one entry per publisher."""
        unknown = any(name.endswith(_UNKNOWN) for name in names)  # discovered, its node not yet
        if len(set(names)) > 1 or (len(names) > 1 and unknown):
            return ", ".join(sorted(set(names)))
        if len(names) < 2:
            self._doubled = float("inf")
            return ""
        self._doubled = min(self._doubled, self._clock())
        return f"{names[0]}, {len(names)} times" if self._clock() - self._doubled > self.ghost else ""


class DuplicateStates:
    """Detects two plants, as opposed to one plant and other publishers on the same topic.

    Several nodes may publish joint_states, each for different joints: a hand, a head, a joint_state_publisher. Two
    plants are two publishers of the *model's* joints. Signs of them are different lists of joints, more messages than
    the stamps account for, or stamps that go back and forth, in two consecutive checks.

    Parameters
    ----------
    period : float
        Period of the states until it has been measured [s].
    """

    looks = 2
    backs = 3

    def __init__(self, period: float) -> None:
        self._period = period
        self._suspected = 0
        self._forget()

    def _forget(self) -> None:
        self._lists: set[tuple[str, ...]] = set()
        self._count = self._backs = 0
        self._first = self._last = -1

    def note(self, names: Sequence[str], stamp: int) -> None:
        """Register a message that names joints of the model, and its stamp [ns]."""
        if not self._count:
            self._first = stamp
        elif stamp < self._last:
            self._backs += 1
        self._count, self._last = self._count + 1, stamp
        if len(self._lists) < 2:
            self._lists.add(tuple(names))

    def judge(self, publishers: Sequence[str]) -> str:
        """Return the names of the publishers if there are two plants; empty otherwise.

        Parameters
        ----------
        publishers : sequence of str
            Names of the nodes that publish the topic, one entry per publisher.
        """
        advance = 1e-9 * (self._last - self._first)
        if len(publishers) < 2:
            self._suspected = 0
            if self._count > 10 and advance > 0.0:
                self._period = advance / (self._count - 1)
        else:
            too_many = self._count > 3 + 1.5 * advance / self._period
            two = len(self._lists) > 1 or too_many or self._backs >= self.backs
            self._suspected = self._suspected + 1 if two else 0
        self._forget()
        return ", ".join(sorted(set(publishers))) if self._suspected >= self.looks else ""


class StateGate:
    """Decides which measured states a controller accepts.

    Parameters
    ----------
    dt : float
        Period of the states [s].
    timeout : callable
        Returns the timeout of the states [s].
    outside : float
        Largest excess over the joint limits of an accepted state [rad].
    jumps : int
        Consecutive jumps after which every state is rejected until `reset`.
    by_stamp : bool
        In lockstep: time is measured by the stamps, not by the steady clock.

    Attributes
    ----------
    watchdog : Watchdog
        Fed by accepted states only.
    jumped : FaultCounter
    overtaken : int
        Number of states ignored because of their stamp.
    """

    repeats = 5
    """Number of consecutive states with the stamp of the last one that indicates stamps which do not advance."""
    may_repeat = False
    """Whether the plant publishes a state again until it is answered."""

    def __init__(
        self,
        model: RobotModel,
        dt: float,
        timeout: Callable[[], float],
        *,
        outside: float = 0.1,
        jumps: int = 5,
        by_stamp: bool = False,
        clock: Clock = time.monotonic,
    ) -> None:
        self._model, self._dt, self._outside, self._by_stamp = model, dt, outside, by_stamp
        self._timeout = timeout
        self.watchdog = Watchdog(timeout, clock)
        self.jumped = FaultCounter(jumps)
        self.overtaken = 0
        self._q: Array | None = None
        self._stamp = -1
        self._repeated = 0  # consecutive states with this stamp
        self._passed = 0.0  # from the last accepted state to the first jump after it [s]

    def is_new(self, stamp: int) -> bool:
        """Return whether a stamp [ns] is newer than the last accepted one, or the plant's clock was set back.

        An older state arrived out of order; after a timeout it is accepted as the first one of a clock set back. The
        same stamp again is not a clock set back.
        """
        repeated = stamp == self._stamp and not self.may_repeat
        self._repeated = self._repeated + 1 if repeated else 0
        if stamp > self._stamp or (self.watchdog.silent and not repeated):
            return True
        self.overtaken += 1
        return False

    @property
    def stuck(self) -> str:
        """Why every state is ignored, if the stamps do not advance while states arrive; empty otherwise."""
        if self._repeated < self.repeats:
            return ""
        return (
            f"they all have the stamp {1e-9 * self._stamp:.9g}: set header.stamp to the time of the measurement, "
            "a new one for each state"
        )

    def accept(self, stamp: int, q: Array) -> None:
        """Accept a state, or raise an error and change nothing.

        Raises
        ------
        StateError
            If it is outside the joint limits, or further from the last one than the joints can move; the message
            names the joints.
        """
        if self.jumped:
            raise StateError(self.jumped.reason)
        if outside := outside_limits(q, self._model, self._outside):
            raise StateError(f"outside the joint limits: {outside} ({self._outside:g} rad are tolerated)")
        if self._q is not None:
            passed = (stamp - self._stamp) * 1e-9
            if not self._by_stamp:  # a stamp may be wrong; the time of receipt bounds the error
                age = self.watchdog.age
                passed = min(max(passed, age), age + self._timeout())
            if self.jumped.count:  # waiting does not make a jump plausible
                passed = min(passed, self._passed)
            self._passed = passed
            speed = np.minimum(self._model.velocity_max, FASTEST)
            beyond = unreachable(q, self._q, passed, speed, self._dt * speed)
            if far := named_angles(self._model, np.abs(q - self._q), beyond):
                raise self._jump(f"a jump that the velocity limits do not allow: {far}")
        self.jumped.good()
        self._q, self._stamp = q, stamp
        self.watchdog.feed()

    def reset(self) -> None:
        """Accept any joint angles in the next state."""
        self.jumped.reset()
        self._q, self._stamp, self._repeated = None, -1, 0
        self.watchdog.starve()

    def _jump(self, why: str) -> StateError:
        """Count a jump and return its error."""
        latched = self.jumped.fault(f"{why}; {self.jumped.limit} in a row, rejecting all states until ~/reset")
        return StateError(self.jumped.reason if latched else why)


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
        self._place: Array | None = None

    def accept_body(self, stamp: int, q: Array, dq: Array, place: Array, v_base: Array) -> None:
        """Accept a state, or raise an error and change nothing.

        Parameters
        ----------
        stamp : int
            [ns]
        q, dq : ndarray, shape (n,)
            [rad, rad/s]
        place : ndarray, shape (3,)
            Of the base [m].
        v_base : ndarray, shape (6,)
            [m/s, rad/s]

        Raises
        ------
        StateError
            If a number is not finite, a velocity is too large, or joints or base jumped.
        """
        if not all(np.isfinite(part).all() for part in (q, dq, place, v_base)):
            raise StateError("a number is not finite")
        if not (np.abs(dq) <= self._model.velocity_max).all():
            joint = int(np.argmax(np.abs(dq) / self._model.velocity_max))
            raise StateError(f"{self._model.joint_names[joint]} turns at {dq[joint]:.3g} rad/s")
        if not (np.abs(v_base[:3]).max() <= self.speed and np.abs(v_base[3:]).max() <= self.turn):
            raise StateError(f"the base moves at {np.abs(v_base[:3]).max():.3g} m/s")
        if self._place is not None and not self.jumped:
            moved = float(np.linalg.norm(place - self._place))
            if not moved <= self.speed * (max((stamp - self._stamp) * 1e-9, 0.0) + self._dt):
                raise self._jump(f"the base jumped by {moved:.3g} m")
        self.accept(stamp, q)
        self._place = place


class Contradictions:
    """Detects joints that do not follow their commands, and inertial measurements that contradict each other.

    The difference between measured and expected motion is integrated with a decay. The sag of servos and the bias of a
    gyroscope stay small in this sum; an angle that is frozen, has slipped or drifts does not.

    Between two states that are further apart than two periods, states were lost, or the plant was late. In the first
    case it moved all the time; in the second for two periods only, because no plant makes up for lost time. Only motion
    outside these two limits counts.

    Parameters
    ----------
    limit : float
        Largest sum [rad].
    period : float
        Period of the states [s].
    timeout : callable
        Returns the timeout of the states [s].
    """

    memory = 10.0, 1.0
    """Time constants of the decay, of the joints and of the vertical [s]."""

    def __init__(self, joint_names: Sequence[str], limit: float, period: float, timeout: Callable[[], float]) -> None:
        self._names, self._limit, self._period, self._timeout = joint_names, limit, period, timeout
        self.forget()

    def forget(self) -> None:
        """Clear the sums; the next state is compared with nothing."""
        self._before: State | None = None
        self._off, self._turned = np.zeros(len(self._names)), np.zeros(3)

    def judge(self, state: State, commanded: Array, *, leaning: bool = False) -> str:
        """Return a description of the contradiction, empty if there is none.

        Parameters
        ----------
        commanded : ndarray, shape (n,)
            Velocities commanded since the previous state [rad/s].
        leaning : bool
            Whether the base sole seems to be tilted, which a wrong angle causes; the limit is then halved.
        """
        before, self._before = self._before, state
        passed = state.time - before.time if before is not None else 0.0
        if before is None or not 0.0 < passed <= self._timeout():  # after a gap it may have moved
            self.forget()
            self._before = state
            return ""
        moved, most, least = state.q - before.q, passed * commanded, min(passed, 2.0 * self._period) * commanded
        beyond = moved - np.clip(moved, np.minimum(least, most), np.maximum(least, most))
        self._off = math.exp(-passed / self.memory[0]) * (self._off + beyond)
        if (worst := np.abs(self._off)).max() > (0.5 * self._limit if leaning else self._limit):
            k = int(worst.argmax())
            return (
                f"{self._names[k]} does not follow its commands, it is {worst[k]:.2f} rad off: it is blocked or "
                "without power, or its angle is frozen or has slipped"
            )
        if before.up is None or before.gyro is None or state.up is None:
            return ""
        (a, b, c), (x, y, z) = before.up, before.gyro
        turning = passed * np.array([b * z - c * y, c * x - a * z, a * y - b * x])
        self._turned = math.exp(-passed / self.memory[1]) * (self._turned + state.up - before.up - turning)
        if (off := math.sqrt(float(self._turned @ self._turned))) > self._limit:
            return (
                f"the inertial sensor contradicts itself: the rotation of its vertical differs by {off:.2f} rad from "
                "that of its gyroscope; check its mounting"
            )
        return ""


class CommandGate:
    """Decides how a plant moves: as the last accepted command says, or not at all.

    Parameters
    ----------
    timeout : callable
        Returns the timeout of the commands, after which the plant holds [s].

    Attributes
    ----------
    watchdog : Watchdog
    refused : str
        Reason to hold regardless of the commands, such as a second controller; empty if there is none.
    late, rejected : int
        Number of commands ignored because of their stamp, and rejected because of their values.
    ignored : str
        Why the last command was ignored; empty if it was accepted.
    """

    contradictions = 3
    """Number of different commands with the stamp of one state, within a second, that indicates two controllers."""

    def __init__(self, model: RobotModel, timeout: Callable[[], float], clock: Clock = time.monotonic) -> None:
        self._model, self._timeout, self._clock = model, timeout, clock
        self._contradicted: list[float] = []
        self.watchdog = Watchdog(timeout, clock)
        self.refused = self.ignored = ""
        self.late = self.rejected = 0
        self._zero = np.zeros(model.n)
        self._u = self._zero
        self._effort: Array | None = None
        self._stamp = -1

    @property
    def effort(self) -> Array | None:
        """Feed-forward torques of the last command (n,) [N m]; None if it has none, or the plant holds.

        A drive that holds keeps its last torques, because the robot would sag without them.
        """
        return None if self.holding else self._effort

    @property
    def holding(self) -> bool:
        """Whether the plant stands still, regardless of the last command."""
        return bool(self.refused) or self.contradicted or self.watchdog.silent

    @property
    def ready(self) -> bool:
        """Whether commands are executed; true before the first command, false after a timeout."""
        timed_out = self.watchdog.silent and self.watchdog.age < math.inf
        return not (self.refused or self.contradicted or timed_out)

    @property
    def contradicted(self) -> bool:
        """Whether two controllers answer the same states with different commands."""
        now = self._clock()
        self._contradicted = [at for at in self._contradicted if now - at < 1.0]
        return len(self._contradicted) >= self.contradictions

    def accept(self, stamp: int, u: Array, now: int, effort: Array | None = None, *, clock: int | None = None) -> bool:
        """Accept a command and return True, or ignore it, change nothing, and return False.

        A command is accepted if its stamp is that of a state not older than the timeout, as sent by the controllers of
        this package; or within the timeout of the clock, as sent by a node that stamps its messages on sending; or
        zero, which in ROS means "not stamped".

        Parameters
        ----------
        stamp : int
            [ns]
        u : ndarray, shape (n,)
            Velocities [rad/s], or torques [N m] for a plant with torque input; finite.
        now : int
            Stamp of the last state published by the plant [ns].
        effort : ndarray, shape (n,), optional
            Feed-forward torques [N m], finite.
        clock : int, optional
            Time of the node's clock [ns].
        """
        unstamped = stamp == 0
        if stamp == self._stamp and not unstamped and not np.array_equal(u, self._u):
            # a controller that stops sends zero once with the stamp of a state it has answered already
            self._contradicted.append(self._clock())
        self.ignored = "" if unstamped else self._out_of_time(stamp, now, clock)
        if self.ignored:
            self.late += 1
            return False
        self._u, self._stamp, self._effort = u, stamp, effort
        self.watchdog.feed()
        return True

    def _out_of_time(self, stamp: int, now: int, clock: int | None) -> str:
        """Return why a stamp [ns] is not accepted; empty if it is."""
        if stamp < self._stamp and not self.watchdog.silent:
            return "older than the last command"
        timeout = self._timeout() * 1e9
        if 0 <= now - stamp <= timeout or (clock is not None and abs(clock - stamp) <= timeout):
            return ""
        off = 1e-9 * (stamp - now)
        return f"stamped {abs(off):.3f} s {'after' if off > 0.0 else 'before'} the last state"

    def velocity(self, q: Array, dt: float) -> Array:
        """Return the velocities with which to move for `dt` [s] from `q`: clamped, and zero while the plant holds."""
        return self._zero if self.holding else clamp_velocity(self._u, q, self._model, dt)

    def hold(self) -> None:
        """Discard the last command: stand still until the next."""
        self._u, self._effort = self._zero, None
        self.watchdog.starve()
