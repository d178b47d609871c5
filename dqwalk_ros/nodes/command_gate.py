"""Decides which commands a plant executes."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from dqwalk_ros.nodes.watchdog import Clock, Watchdog
from dqwalk_ros.robot.limits import clamp_velocity
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array


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
