"""Configurations as files: ROS parameter files of this package or of a user, and what the file of a plant replaces."""

from __future__ import annotations

import difflib
import itertools
import logging
import os
import pathlib
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from dqwalk_ros.config.configuration import Config
from dqwalk_ros.config.schema import Value
from dqwalk_ros.support import strict_yaml
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.node_table import NODES
from dqwalk_ros.support.wording import listed, missing

_MOST = 2000
"""Largest number of parameters of one section; this package has less than 300."""
OF_RCLPY = ("use_sim_time", "qos_overrides", "start_type_description_service")
"""Parameters that rclpy declares for every node; ``ros2 param dump`` writes them, `from_yaml` ignores them."""

SHIPPED = ("paper", "poppy", "poppy_dynamic", "poppy_dynamic_50hz", "whole_body")
"""Names of the configurations in ``config/``."""
OVERLAYS = ("arms", "climb", "rough", "rough_50hz", "stairs", "stairs_down")
"""Names of the parameter files in ``config/overlays/``."""


def find_share(folder: str, name: str) -> pathlib.Path:
    """Return the path of a data file of this package (``config/``, ``urdf/``, ``launch/``).

    It is searched in the source tree, in the ament index and in ``sys.prefix``, in this order.

    Raises
    ------
    ConfigError
        If the file is not found; the message lists the folders searched.
    """
    roots = [pathlib.Path(__file__).resolve().parents[2]]
    prefixes = [p for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    roots += [pathlib.Path(p) / "share" / "dqwalk_ros" for p in [*prefixes, sys.prefix]]
    for root in roots:
        path = root / folder / name
        if path.is_file():
            return path
    raise ConfigError(f"no file '{name}' in {folder}/ of this package; looked in {', '.join(map(str, roots))}")


def find_file(what: str, source: str | os.PathLike[str], folder: str, names: Sequence[str]) -> pathlib.Path:
    """Return the path of a file of the user, or of a file of this package in `folder`, which is named without suffix.

    Parameters
    ----------
    what : str
        What it is, in messages.
    source : path
        A path, or one of `names`; a folder of such a name, as that of earlier results, is not meant.
    names : sequence of str
        Names of files in `folder`; those without suffix are YAML files.

    Raises
    ------
    ConfigError
        If it is neither.
    """
    path = pathlib.Path(source)
    try:
        if path.is_file():
            return path
    except OSError as error:  # a folder that may not be searched, a name that is too long
        raise ConfigError(f"cannot read the {what} '{path}': {error.strerror}") from error
    if str(source) in names and (path.is_dir() or not os.path.lexists(path)):
        return find_share(folder, path.name if path.suffix else f"{path}.yaml")
    if not str(source).strip():
        raise ConfigError(f"the name of the {what} is empty")
    if len(path.parts) > 1 or path.suffix or os.path.lexists(path):
        raise ConfigError(missing(what, path))
    raise ConfigError(f"no {what} '{path}': neither a file nor one of {', '.join(names)}")


def find_params(source: str | os.PathLike[str]) -> pathlib.Path:
    """Return a parameter file that changes a configuration: a path, or one of `OVERLAYS`.

    Raises
    ------
    ConfigError
        If it is neither.
    """
    return find_file("parameter file", source, "config/overlays", OVERLAYS)


def is_whole_body(config: Config) -> bool:
    """Return whether a configuration is one of the whole-body controller, which has no walk of phases."""
    return config.whole_body != Config().whole_body


def find_config(source: str | os.PathLike[str]) -> pathlib.Path:
    """Return the file of a configuration: a path, or the name of a shipped one (``"paper"``).

    Raises
    ------
    ConfigError
        If it is neither.
    """
    return find_file("configuration", source, "config", SHIPPED)


def load(source: str | os.PathLike[str]) -> Config:
    """Read a configuration: a path, or the name of a shipped one (``"paper"``).

    Raises
    ------
    ConfigError
        If the file is missing, is not YAML, has an unknown key or a value out of bounds, or is for other nodes only.
    """
    path = find_config(source)
    return resolved(path, _of_file(path))


def resolved(path: pathlib.Path, config: Config) -> Config:
    """Return `config`, read from the file `path`, with absolute paths of the files that it names relative to it."""
    named = {"robot.urdf": config.robot.urdf, "gait.recover": config.gait.recover}
    found = {name: path.parent / file for name, file in named.items() if file and (path.parent / file).is_file()}
    return config.updated({name: str(file.resolve()) for name, file in found.items()}) if found else config


def _of_file(path: pathlib.Path, onto: Config | None = None) -> Config:
    """Return the configuration of a parameter file; raise ConfigError if all of it is for other packages."""
    text, source = strict_yaml.read_text(path), str(path)
    config = from_yaml(text, source=source, onto=onto)
    sections = sections_of(text, source=source)
    own = [section.values for section in sections if section.is_ours]
    if not own or (any(own) and all(map(is_foreign, itertools.chain(*own)))):
        names = listed([section.name for section in sections])
        raise ConfigError(
            f"{source}: no parameter of this package, only of others in {names}; `dqwalk config` prints ours"
        )
    return config


def from_yaml(text: str, *, source: str = "text", onto: Config | None = None) -> Config:
    """Read a configuration from the text of a ROS parameter file; all other parameters are those of `onto`.

    The sections of all nodes of this package are read in their order. Those of other packages are ignored, and so are
    parameters of other packages in a section such as ``/**``, as the nodes do.

    Raises
    ------
    ConfigError
        As `load`; the message names the line.
    """
    config = onto or Config()
    for section in sections_of(text, source=source):
        if not section.is_ours:
            continue
        if len(section.values) > _MOST:
            raise ConfigError(f"{source}: '{section.name}' has {len(section.values)} parameters; at most {_MOST}")
        foreign = [name for name in section.values if is_foreign(name)]
        if foreign:
            logging.getLogger("dqwalk_ros").warning(
                f"{source}: ignoring parameters of other packages: {listed(foreign)}"
            )
        values = {name: value for name, value in section.values.items() if name not in foreign}
        if not isinstance(values.get("use_sim_time", True), bool):
            line = strict_yaml.line_of(text, [*section.path, "use_sim_time"])
            raise ConfigError(f"{source}, line {line}: 'use_sim_time' must be true or false")
        values = {name: value for name, value in values.items() if name.split(".")[0] not in OF_RCLPY}
        try:
            config = config.updated(values)
        except ConfigError:
            for name, value in values.items():  # find the parameter, for the line in the message
                line = strict_yaml.line_of(text, [*section.path, *name.split(".")])
                config.updated({name: value}, source=f"{source}, line {line}")
            raise
    return config


@dataclass(frozen=True)
class Section:
    """The parameters of one node, or of the nodes that a pattern matches, in a ROS parameter file."""

    path: tuple[str, ...]
    """The keys that lead to the parameters."""
    values: dict[str, Any]
    """By dotted name."""

    @property
    def name(self) -> str:
        """Name of the node with its namespace, or a pattern."""
        return "/".join(self.path[:-1]).replace("//", "/")

    @property
    def is_ours(self) -> bool:
        """Whether it is for a node of this package, in any namespace."""
        last = self.name.rpartition("/")[2]
        return last in NODES or last in ("*", "**")


def sections_of(text: str, *, source: str) -> list[Section]:
    """Return the sections of a ROS parameter file, also those in nested namespaces and of nodes of other packages.

    Raises
    ------
    ConfigError
        If the text cannot be read, has a duplicate key, or a section is named similarly to a node of this package.
    """
    tree = strict_yaml.read(text, source=source)
    if not isinstance(tree, dict):
        raise ConfigError(f"{source}: expected '/**: {{ros__parameters: {{...}}}}'")
    out = list(_sections(tree, (), source))
    for section in out:
        last = section.name.rpartition("/")[2]
        close = difflib.get_close_matches(last, NODES, n=1, cutoff=0.8)
        if close and not section.is_ours:
            raise ConfigError(f"{source}: the section '{section.name}' matches no node; did you mean '{close[0]}'?")
    return out


def _sections(tree: Mapping[Any, Any], above: tuple[str, ...], source: str) -> Iterator[Section]:
    for key, value in tree.items():
        path = (*above, str(key))
        if not isinstance(value, dict):
            holds = "expected '/**: {ros__parameters: {...}}' around the parameters"
            if key == "ros__parameters" and above:
                holds = "must hold parameters, below it and farther to the right"
            raise ConfigError(f"{source}: {'.'.join(path)[:80]!r}: {holds}")
        if key == "ros__parameters" and above:
            yield Section(path, _flattened(value, "", source))
        else:
            yield from _sections(value, path, source)


def is_foreign(name: str) -> bool:
    """Return whether a parameter clearly belongs to another package, so that it is ignored.

    It is not in the schema, not in one of its sections, and not similar to one of its names.
    """
    if name.split(".")[0] in (*OF_RCLPY, *Config.__dataclass_fields__):
        return False
    known = [spec.name for spec in Config.specs()]
    return not difflib.get_close_matches(name[:100], known, n=1, cutoff=0.8)


def with_files(config: Config, files: Iterable[pathlib.Path]) -> Config:
    """Return a configuration with the parameters of files applied, one after the other.

    They are found as by `find_params`.

    Raises
    ------
    ConfigError
        If a file is missing or cannot be used.
    """
    for given in files:
        config = _of_file(find_params(given), config)
    return config


def overlaid(config: Config, plant: str) -> Config:
    """Return a configuration with the parameters of ``config/plants/NAME.yaml`` applied."""
    return with_files(config, [find_share("config/plants", f"{plant}.yaml")])


def replaced(own: Config, plant: str, used: Config, how: str) -> str:
    """Return a warning that names the values of a configuration which ``config/plants/NAME.yaml`` replaces; or "".

    Values that are the default, and ``monitor.*``, are replaced without a warning.

    Parameters
    ----------
    own : Config
        The configuration without the plant's file.
    used : Config
        The configuration with the plant's file and with all that is applied after it.
    how : str
        How to apply a value after the plant's file.
    """
    given, of_plant, last = own.flat(), overlaid(own, plant).flat(), used.flat()
    changes = [
        f"{spec.name} {_shown(given[spec.name])} by {_shown(of_plant[spec.name])}"
        for spec in Config.specs()
        if not spec.name.startswith("monitor.")
        and given[spec.name] not in (spec.default, of_plant[spec.name])
        and last[spec.name] == of_plant[spec.name]
    ]
    if not changes:
        return ""
    return f"config/plants/{plant}.yaml replaces values of the configuration: {', '.join(changes)}; to keep one: {how}"


def _shown(value: Value) -> str:
    return str(value).lower() if isinstance(value, bool) else str(list(value) if isinstance(value, tuple) else value)


def _flattened(tree: Mapping[Any, Any], prefix: str, source: str) -> dict[str, Any]:
    """Return ``{dotted name: value}`` of nested dictionaries."""
    out: dict[str, Any] = {}
    for key, value in tree.items():
        if not isinstance(key, str):
            comma = "; is a number before it written with a comma instead of a point?" if type(key) is int else ""
            raise ConfigError(f"{source}: the key {prefix}{key!r} is not a text{comma}")
        found = _flattened(value, f"{prefix}{key}.", source) if isinstance(value, dict) else {prefix + key: value}
        if duplicates := [name for name in found if name in out]:  # gait.cycles and gait: {cycles: }
            raise ConfigError(f"{source}: '{duplicates[0]}' is given twice")
        out.update(found)
    return out


_SINCE = "# in force from the state with the stamp {} ns"


def applies_from(text: str) -> int | None:
    """Return the stamp [ns] of the state from which a configuration written by `to_yaml` applies; None: from the start.

    A configuration that was changed during a walk contains this stamp as a comment.
    """
    found = re.match(_SINCE.format(r"(-?\d+)"), text)
    return int(found.group(1)) if found else None


def to_yaml(config: Config, since: int | None = None) -> str:
    """Return the configuration as the text of a ROS parameter file; `from_yaml` reads it back exactly.

    An empty list has no type in a ROS parameter file and is written as a list with one empty text. `since` is the stamp
    [ns] of the first state that the configuration applies to, if it was changed during the walk; see `applies_from`.
    """
    tree: dict[str, Any] = {}
    for name, value in config.flat().items():
        section, _, key = name.rpartition(".")
        target = tree.setdefault(section, {}) if section else tree
        target[key] = (list(value) or [""]) if isinstance(value, tuple) else value
    begin = "" if since is None else _SINCE.format(since) + "\n"
    return begin + yaml.dump({"/**": {"ros__parameters": tree}}, Dumper=yaml.CSafeDumper, sort_keys=False)
