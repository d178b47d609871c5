"""YAML as a parameter file needs it: small, plain, every key once, and every key's line known.

What rcl refuses (anchors and aliases) is refused here too, so that a file means the same to ROS and to Python; what
YAML would pass over in silence, a key given twice, is an error.
"""

from __future__ import annotations

from typing import Any

import yaml

from dqwalk_ros.errors import ConfigError

__all__ = ["MAX_BYTES", "read"]

MAX_BYTES = 1 << 20
"""A parameter file is not longer than this."""
_DEPTH = 20
"""Nor deeper."""


class _Loader(yaml.SafeLoader):
    """SafeLoader without aliases, with unique keys, and with the line of every key."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.lines: dict[tuple[str, ...], int] = {}
        self._depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent):
            raise _at(event.start_mark, "an alias, which ROS parameter files do not have")
        if getattr(event, "anchor", None):
            raise _at(event.start_mark, "an anchor, which ROS parameter files do not have")
        self._depth += 1
        if self._depth > _DEPTH:
            raise _at(event.start_mark, f"nested deeper than {_DEPTH} levels")
        try:
            return super().compose_node(parent, index)
        finally:
            self._depth -= 1


def _at(mark: Any, what: str) -> yaml.YAMLError:
    return yaml.MarkedYAMLError(problem=what, problem_mark=mark)


def read(text: str, *, source: str = "") -> tuple[Any, dict[tuple[str, ...], int]]:
    """Return the tree of a YAML text, and the line (from 1) of every key by its path.

    Raises
    ------
    ConfigError
        If it is not YAML, or more than a parameter file may be; the message names the line.
    """
    where = f"{source}: " if source else ""
    if len(text) > MAX_BYTES:
        raise ConfigError(f"{where}not a parameter file: longer than {MAX_BYTES >> 20} MiB")
    lines: dict[tuple[str, ...], int] = {}
    try:
        loader = _Loader(text)
        try:
            node = loader.get_single_node()
            if node is None:
                return None, lines
            _check_keys(node, (), lines)
            return loader.construct_document(node), lines
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f"line {mark.line + 1}: " if mark is not None else ""
        raise ConfigError(f"{where}{line}not YAML: {error.problem or error.context}") from error
    except (yaml.YAMLError, RecursionError, ValueError, OverflowError, KeyError, AttributeError, TypeError) as error:
        # a date that does not exist, a number with 5000 digits, a control character, ...
        raise ConfigError(f"{where}not YAML: {' '.join(str(error).split())[:300]}") from error


def _check_keys(node: Any, path: tuple[str, ...], lines: dict[tuple[str, ...], int]) -> None:
    if isinstance(node, yaml.SequenceNode):
        for item in node.value:
            _check_keys(item, path, lines)
    if not isinstance(node, yaml.MappingNode):
        return
    seen: dict[str, int] = {}
    for key, value in node.value:
        line = key.start_mark.line + 1
        if not isinstance(key, yaml.ScalarNode):
            raise _at(key.start_mark, "a key that is no text")
        if key.tag == "tag:yaml.org,2002:merge":
            raise _at(key.start_mark, "a merge key, which ROS parameter files do not have")
        if key.value in seen:
            raise _at(key.start_mark, f"the key '{key.value}' was given in line {seen[key.value]} already")
        seen[key.value] = line
        lines[(*path, key.value)] = line
        _check_keys(value, (*path, key.value), lines)
