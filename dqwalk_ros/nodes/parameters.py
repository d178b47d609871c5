"""The schema of `dqwalk_ros.config` as parameters of a ROS node.

rcl drops parameters of a file that no node declares, so a misspelt key or node name would go unnoticed. Here it is an
error, before the node does anything. Parameters that clearly belong to another package are ignored, as usual in ROS:
one file may hold the parameters of a whole robot. Both are found by `config.files`, as the command line finds them.
"""

from __future__ import annotations

import itertools
import math
import pathlib
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from dqwalk_ros.config import OF_RCLPY, Config, Spec, is_foreign, resolved, sections_of
from dqwalk_ros.plants.table import defaults_of
from dqwalk_ros.support import strict_yaml
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.wording import shown


def declare(node: Node, argv: Sequence[str]) -> Config:
    """Declare all parameters of the package on a node; return their values from the command line and parameter files.

    Parameters
    ----------
    argv : sequence of str
        Name of the node, whose defaults apply, and command line of the process, whose parameter files are checked for
        sections with misspelt names.

    Raises
    ------
    ConfigError
        For a misspelt name, a wrong type or a value out of bounds; the message names similar parameters.
    """
    log = node.get_logger()
    given = {
        name: () if parameter.value is None else parameter.value  # an empty list has no type
        for name, parameter in node._parameter_overrides.items()  # rclpy has no public access to all of them
        if name.split(".")[0] not in OF_RCLPY
    }
    check_types(given, argv, (node.get_name(), node.get_fully_qualified_name()))
    files = [pathlib.Path(value) for key, value in itertools.pairwise(argv) if key == "--params-file"]
    for path in files:
        _check_sections(path, node)
    foreign = [name for name in given if is_foreign(name)]
    if foreign:
        log.info(f"ignoring parameters of other packages: {', '.join(foreign)}")
    config = defaults_of(argv[0]).updated({name: value for name, value in given.items() if name not in foreign})
    for path in files:
        config = resolved(path, config)
    for name, value in config.flat().items():
        shown: Any = (list(value) or [""]) if isinstance(value, tuple) else value
        node.declare_parameter(name, shown, _DESCRIPTORS[name], ignore_override=True)
    return config


def check_types(given: Mapping[str, Any], argv: Sequence[str], names: Collection[str]) -> None:
    """Check that no ``-p`` is lost: rcl keeps an earlier value of another type, such as the 3 of a file before 2.5.

    Parameters
    ----------
    given : mapping of str to any
        The values that rcl found.
    argv : sequence of str
        The command line, with parameter files and ``-p NAME:=VALUE``.
    names : collection of str
        Of the node.

    Raises
    ------
    ConfigError
        If a value is lost; the message names the parameter and both values.
    """
    values: dict[tuple[str, str], list[Any]] = {}  # of one section and name, in their order
    for key, text in itertools.pairwise(argv):
        if key == "--params-file":
            for section in sections_of(strict_yaml.read_text(pathlib.Path(text)), source=text):
                for name, value in section.values.items():
                    values.setdefault((section.name, name), []).append(value)
        elif key in ("-p", "--param"):
            rule, _, value = text.partition(":=")
            node, _, name = rule.rpartition(":")
            values.setdefault((node or "/**", name), []).append(strict_yaml.read(value))
    for (where, name), (*_, last) in values.items():
        kept = given.get(name, last)
        plain = all(isinstance(one, int | float | str) and not isinstance(one, bool) for one in (kept, last))
        lost = plain and str(last) != str(kept) and _number(last) != _number(kept) and type(last) is not type(kept)
        if lost and kept in values[where, name] and where in ("/**", *names):
            raise ConfigError(
                f"'{name}' is {shown(str(kept))} and later {shown(str(last))}, which is of another type and would be "
                "ignored by ROS: write numbers alike, such as 3.0 and 2.5"
            )


def _number(value: object) -> float:
    """Return a number or the text of one as a number, else nan."""
    try:
        return float(str(value))
    except ValueError:
        return math.nan


def _check_sections(path: pathlib.Path, node: Node) -> None:
    """Log a warning if a parameter file has parameters, but none for a node; for errors see `sections_of`."""
    sections = sections_of(strict_yaml.read_text(path), source=str(path))
    if any(one.values for one in sections) and not any(
        node._parameter_overrides.keys() & one.values for one in sections
    ):
        found = ", ".join(f"'{one.name}'" for one in sections)
        node.get_logger().warning(
            f"{path}: no section applies to {node.get_fully_qualified_name()} (sections: {found}); "
            "'/**' applies to every node"
        )


def _descriptor(spec: Spec) -> ParameterDescriptor:
    """Return what ``ros2 param describe`` shows."""
    unit = f" [{spec.unit}]" if spec.unit else ""
    # parameters that are not live are used once, when the walk is built
    out = ParameterDescriptor(description=f"{spec.meaning}{unit}", read_only=not spec.live)
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
