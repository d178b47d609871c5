"""Decides which commands a plant executes, and detects silence, repeated faults and duplicate nodes.

These decisions of ``docs/faults.md`` need no ROS, and their clock can be replaced by tests; the nodes publish the
result. `state_gate` decides likewise which states a controller accepts. Two rules apply to both. A rejected message
changes nothing and does not feed a watchdog. A timeout is measured from the *receipt* of a message, on a steady clock;
its stamp is used for order only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqwalk_ros.robot.limits import clamp_velocity
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import StateError
from dqwalk_ros.support.wording import listed

Clock = Callable[[], float]


class JointOrder:
    """Puts values with joint names into the order of the model's joints.

    Joints that the model does not have are ignored. Any other mismatch rejects the whole message.
    """

    def __init__(self, joint_names: Sequence[str]) -> None:
        self._joints = tuple(joint_names)
        self.joints = frozenset(joint_names)
        self._names: list[str] = []
        self._seen = set[str]()  # joints that any message has named
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
        self._seen |= self.joints & place.keys()
        if missing := [joint for joint in self._joints if joint not in place]:
            extra = [name for name in names if name not in self._joints]
            also = f"; it has {listed(extra)}, which are not in the model" if extra else ""
            if self._seen.issuperset(missing):
                also += "; other messages have them, but one must have all"
            raise StateError(f"joints missing: {', '.join(missing)}{also}")
        if len(place) != len(names) and (doubled := {name for name in self.joints if names.count(name) > 1}):
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

    def __init__(self, timeout: Callable[[], float], clock: Clock) -> None:
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


class ClockSteps:
    """Tells a clock that was set from a single wrong stamp, for the stamps that do not follow the last accepted one."""

    steps = 3
    """Number of consecutive messages at another time, with advancing stamps, which indicates that a clock was set."""

    def __init__(self) -> None:
        self._count, self._last = 0, -1  # of such stamps, and the last one [ns]

    def forget(self) -> None:
        """Register a stamp that follows the last accepted one."""
        self._count = 0

    def is_one(self, stamp: int) -> bool:
        """Register a stamp at another time [ns]; return whether a clock was set."""
        self._count = self._count + 1 if stamp > self._last else 1
        self._last = stamp
        return self._count >= self.steps


UNKNOWN = "_NODE_NAME_UNKNOWN_"
"""Name of a publisher's or subscriber's node, as rclpy reports it, until the node has been discovered."""


class DuplicatePublishers:
    """Detects two publishers on a topic that must have one.

    Two different nodes are reported at once. Two publishers of the same name may be a node and its killed predecessor,
    which the middleware lists for another 20 s; they are reported when both are still listed after `ghost`.
    """

    ghost = 25.0
    """Time for which a killed publisher may remain listed [s]."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._doubled = float("inf")

    def judge(self, names: Sequence[str]) -> str:
        """Return the names of duplicate publishers, or ``""``; `names` has one entry per publisher."""
        unknown = any(name.endswith(UNKNOWN) for name in names)  # discovered, its node not yet
        if len(set(names)) > 1 or (len(names) > 1 and unknown):
            return ", ".join(sorted(set(names)))
        if len(names) < 2:
            self._doubled = float("inf")
            return ""
        self._doubled = min(self._doubled, self._clock())
        return f"{names[0]}, {len(names)} times" if self._clock() - self._doubled > self.ghost else ""


class FirstPublisher:
    """Tells the messages of one publisher from those of another that has begun later on the same topic.

    A message does not contain its sender, but the middleware numbers the messages of each publisher, so those of the
    later one have smaller numbers. It is heard once the first one has been silent for a timeout.

    Parameters
    ----------
    timeout : callable
        Returns that time [s].
    """

    unnumbered = 2**64 - 1
    """Number of each message where the middleware does not number them, such as Cyclone DDS."""

    def __init__(self, timeout: Callable[[], float], clock: Clock) -> None:
        self._heard = Watchdog(timeout, clock)
        self._last = 0

    def is_another(self, number: int) -> bool:
        """Return whether the message with a number is of another publisher; if not, register it."""
        if number <= self._last and number != self.unnumbered and not self._heard.silent:
            return True
        self._last = number
        self._heard.feed()
        return False


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
    """Number of consecutive checks with such a sign from which on two plants are reported."""
    backs = 3
    """Number of stamps that go back between two checks which is such a sign."""

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

    def __init__(self, model: RobotModel, timeout: Callable[[], float], clock: Clock) -> None:
        self._model, self._timeout, self._clock = model, timeout, clock
        self._contradicted: list[float] = []
        self.watchdog = Watchdog(timeout, clock)
        self.refused = self.ignored = ""
        self.late = self.rejected = 0
        self._zero = np.zeros(model.n)
        self._u = self._zero
        self._effort: Array | None = None
        self._stamp = self._now = -1  # of the last command, and of the last state before it [ns]

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
        if now < self._now:  # a clock was set back, so the stamps of earlier commands mean nothing
            self._stamp = -1
        self._now = now
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
        """Return the velocities (n,) with which to move for `dt` [s] from `q` (n,): clamped, zero while it holds."""
        return self._zero if self.holding else clamp_velocity(self._u, q, self._model, dt)

    def hold(self) -> None:
        """Discard the last command: stand still until the next."""
        self._u, self._effort = self._zero, None
        self.watchdog.starve()
