"""The schema of `dqwalk_ros.config` as parameters of a ROS node.

rcl accepts whatever a parameter file says and drops what nobody declares, so a misspelt key or node name would be
silence. Here it is an error, before the node does anything.
"""

from __future__ import annotations

import difflib
import fnmatch
import itertools
import math
import pathlib
from collections.abc import Collection, Iterator, Sequence
from typing import Any

import yaml
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from dqwalk_ros.config import Config, Spec, beside
from dqwalk_ros.errors import ConfigError

__all__ = ["changes", "declare"]

LIVE = frozenset({"plant.command_timeout", "monitor.rate", "monitor.warn_margin", "monitor.tolerance"})
"""What may change while a node runs: what shapes the walk is fixed when the walk is built."""

_OF_RCLPY = ("use_sim_time", "qos_overrides", "start_type_description_service")
"""Parameters that rclpy itself declares."""


def declare(node: Node, argv: Sequence[str], nodes: Collection[str]) -> Config:
    """Declare the whole schema on a node; return what the command line and its parameter files say.

    Parameters
    ----------
    node : rclpy.node.Node
    argv : sequence of str
        Command line of the process, whose parameter files are checked for sections that reach nobody.
    nodes : collection of str
        Names of all nodes of this package.

    Raises
    ------
    ConfigError
        For an unknown name, a wrong type or a value out of bounds; the message names the close matches.
    """
    for path in _parameter_files(argv):
        check_sections(path, node.get_fully_qualified_name(), nodes)
    config = Config.from_flat(
        {
            name: () if parameter.value is None else parameter.value  # an empty list has no type
            for name, parameter in node._parameter_overrides.items()  # rclpy has no public way to ask for all of them
            if name.split(".")[0] not in _OF_RCLPY
        }
    )
    for path in _parameter_files(argv):
        config = beside(path, config)
    for name, value in config.flat().items():
        given: Any = (list(value) or [""]) if isinstance(value, tuple) else value
        node.declare_parameter(name, given, _DESCRIPTORS[name], ignore_override=True)
    return config


def changes(parameters: Sequence[Parameter]) -> dict[str, Any]:
    """Return the values of those parameters that are of the schema, for `Config.updated`."""
    return {p.name: p.value for p in parameters if p.name.split(".")[0] not in _OF_RCLPY}


def _descriptor(spec: Spec) -> ParameterDescriptor:
    """Return what ``ros2 param describe`` shows."""
    unit = f" [{spec.unit}]" if spec.unit else ""
    out = ParameterDescriptor(description=f"{spec.meaning}{unit}", read_only=spec.name not in LIVE)
    if spec.choices:
        out.additional_constraints = f"one of {', '.join(spec.choices)}"
    low = -math.inf if spec.low is None else spec.low
    high = math.inf if spec.high is None else spec.high
    if spec.type is float:
        out.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
    elif spec.type is int and math.isfinite(low) and math.isfinite(high):
        out.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
    return out


_DESCRIPTORS = {spec.name: _descriptor(spec) for spec in Config.specs()}


def _parameter_files(argv: Sequence[str]) -> Iterator[pathlib.Path]:
    """Yield the parameter files of a command line."""
    for key, value in itertools.pairwise(argv):
        if key == "--params-file":
            yield pathlib.Path(value)


def check_sections(path: pathlib.Path, node: str, nodes: Collection[str]) -> None:
    """Check that the sections of a parameter file reach the nodes they were written for.

    Sections of nodes that are not ours are left alone.

    Parameters
    ----------
    path : Path
    node : str
        Full name, such as ``"/poppy/controller"``.
    nodes : collection of str
        Names of all nodes of this package.

    Raises
    ------
    ConfigError
        If no section applies to this node, one is written for it but does not reach it, or one has a name that is
        nearly that of a node of ours.
    """
    try:
        tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        raise ConfigError(f"cannot read '{path}': {' '.join(str(error).split())}") from error
    own = node.rpartition("/")[2]
    sections = list(_sections(tree, ""))
    applied = [section for section in sections if _matches(section, node)]
    for section in sections:
        last = section.rpartition("/")[2]
        if last == own and section not in applied:
            raise ConfigError(f"{path}: the section '{section}' does not reach {node}; write '/**/{own}' or '{node}'")
        close = difflib.get_close_matches(last, nodes, n=1, cutoff=0.8)
        if close and last not in nodes:
            raise ConfigError(f"{path}: the section '{section}' is for no node of ours; did you mean '{close[0]}'?")
    if not applied:
        found = ", ".join(f"'{section}'" for section in sections) or "none"
        raise ConfigError(f"{path}: no section reaches {node} (sections: {found}); write '/**' for all nodes")


def _sections(tree: Any, prefix: str) -> Iterator[str]:
    if not isinstance(tree, dict):
        return
    for key, value in tree.items():
        if key == "ros__parameters":
            yield prefix
        elif isinstance(key, str):
            yield from _sections(value, f"{prefix}/{key}" if prefix and not key.startswith("/") else prefix + key)


def _matches(section: str, node: str) -> bool:
    """Tell whether rcl applies a section to a node: ``*`` is one part of the name, ``**`` any number of them."""
    pattern = section if section.startswith("/") else f"/{section}"

    def match(parts: list[str], names: list[str]) -> bool:
        if not parts:
            return not names
        if parts[0] == "**":
            return any(match(parts[1:], names[i:]) for i in range(len(names) + 1))
        return bool(names) and fnmatch.fnmatchcase(names[0], parts[0]) and match(parts[1:], names[1:])

    return match(pattern.strip("/").split("/"), node.strip("/").split("/"))
