"""A clock that a test advances, so that no result depends on the speed of the machine."""

from __future__ import annotations


class SteppedTime:
    """Attributes: now, and the time by which it advances when it is read [s]."""

    passes = 0.0

    def __init__(self, now: float = 0.0) -> None:
        self.now = now

    def __call__(self) -> float:
        self.now += self.passes
        return self.now
