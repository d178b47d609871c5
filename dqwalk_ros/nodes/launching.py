"""What the launch files share: their arguments, inclusion, and which machines can discover their nodes."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction, SetEnvironmentVariable
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import EnvironmentVariable, LaunchConfiguration

from dqwalk_ros.config import Config, find_share
from dqwalk_ros.support.errors import ConfigError

Arguments = Mapping[str, tuple[str, str, Sequence[str] | None]]
"""Default, description and choices of each argument."""
_PARAMETERS = {spec.name for spec in Config.specs()}
_DISCOVERY = "ROS_AUTOMATIC_DISCOVERY_RANGE"


def values_of(context: LaunchContext, arguments: Arguments) -> dict[str, str]:
    """Return the values of the arguments.

    `ros2 launch` ignores an argument that no launch file declares: with ``confg:=my_robot/robot.yaml`` another robot's
    walk would start.

    Raises
    ------
    ConfigError
        If the command line has the name of an argument misspelt, or that of a parameter.
    """
    for name in (word.partition(":=")[0] for word in context.argv):
        if close := [one for one in difflib.get_close_matches(name, arguments, n=1, cutoff=0.75) if one != name]:
            raise ConfigError(f"there is no argument '{name}:='; did you mean '{close[0]}:='?")
        if name in _PARAMETERS:
            raise ConfigError(f"'{name}' is a parameter: set:='{name}=VALUE'")
    return {name: LaunchConfiguration(name).perform(context) for name in arguments}


def included(name: str, given: Mapping[str, str]) -> IncludeLaunchDescription:
    """Return the inclusion of another launch file of this package, with the values of its arguments."""
    source = PythonLaunchDescriptionSource(str(find_share("launch", f"{name}.launch.py")))
    return IncludeLaunchDescription(source, launch_arguments=given.items())


def description(
    arguments: Arguments, nodes: Callable[[dict[str, str]], Sequence[object]], *, discovery: bool = True
) -> LaunchDescription:
    """Return the description of a launch file.

    Parameters
    ----------
    nodes : callable
        Returns what is started with the values of the arguments (`values_of`).
    discovery : bool
        Whether to add an argument that says which machines can discover the nodes, by default only this one.
    """
    declared: list[Any] = [
        DeclareLaunchArgument(name, default_value=default, description=text, choices=choices)
        for name, (default, text, choices) in arguments.items()
    ]
    if discovery:
        declared += [
            DeclareLaunchArgument(
                "discovery",
                default_value=EnvironmentVariable(_DISCOVERY, default_value="LOCALHOST"),
                choices=["LOCALHOST", "SUBNET", "OFF", "SYSTEM_DEFAULT"],
                description="which machines can discover the nodes: LOCALHOST only this one, SUBNET also the network",
            ),
            SetEnvironmentVariable(_DISCOVERY, LaunchConfiguration("discovery")),
        ]
    start = OpaqueFunction(function=lambda context: nodes(values_of(context, arguments)))
    return LaunchDescription([*declared, start])
