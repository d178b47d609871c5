"""What the gates of states and commands decide by: silence, faults in a row, and clocks that are set.

These decisions of ``docs/faults.md`` need no ROS, and their clock can be replaced by tests. A rejected message changes
nothing and does not feed a watchdog. A timeout is measured from the *receipt* of a message, on a steady clock; its
stamp is used for order only.
"""

from __future__ import annotations

from collections.abc import Callable

Clock = Callable[[], float]


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
    """Tells a clock that was set from a single wrong stamp."""

    steps = 3
    """Number of consecutive messages at another time, with advancing stamps, which indicates that a clock was set."""

    def __init__(self) -> None:
        self._count, self._last = 0, -1  # of stamps at another time, and the last stamp [ns]

    def accepts(self, stamp: int, *, follows: bool) -> bool:
        """Return whether a stamp [ns] counts: it `follows` the last one that did, or a clock was set."""
        self._count = 0 if follows else self._count + 1 if stamp > self._last else 1
        self._last = stamp
        return follows or self._count >= self.steps
