"""Stand-ins for the classes of `launch` and `launch_ros`, which the wheels of ROS lack."""

from __future__ import annotations

import types
from typing import Any

MODULES = (
    *("launch", "launch.actions", "launch.conditions", "launch.event_handlers", "launch.events", "launch.logging"),
    *("launch.events.process", "launch.launch_description_sources", "launch.substitutions"),
    *("launch_ros", "launch_ros.actions", "launch_ros.parameter_descriptions"),
)


class StandIn:
    """Keeps its arguments."""

    def __init__(self, *args: Any, **given: Any) -> None:
        self.args, self.given = args, given

    def perform(self, context: Context) -> str:
        """Return the value of a LaunchConfiguration."""
        return context[self.args[0]]


class Context(dict[str, str]):
    """The values of the arguments of a launch file, and the command line."""

    argv: tuple[str, ...] = ()


class Launch(types.ModuleType):
    """A module in which every name is a subclass of `StandIn`."""

    def __getattr__(self, name: str) -> type[StandIn]:
        if name.startswith("__"):
            raise AttributeError(name)
        setattr(self, name, type(name, (StandIn,), {}))
        return getattr(self, name)
