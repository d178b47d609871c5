"""Detects several publishers on a topic that must have one."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from dqwalk_ros.nodes.watchdog import Clock, Watchdog

UNKNOWN = "a node that is being discovered"
"""Name of a publisher's or subscriber's node until the node has been discovered."""


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
        unknown = UNKNOWN in names
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
