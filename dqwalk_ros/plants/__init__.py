"""Plants: what stands on the other side of the command."""

from __future__ import annotations

from typing import Protocol

from dqwalk_ros.controllers import Command, State

__all__ = ["Plant"]


class Plant(Protocol):
    """A simulator or a robot."""

    @property
    def state(self) -> State:
        """The state now."""

    def step(self, command: Command, dt: float) -> State:
        """Return the state one period `dt` [s] later."""
