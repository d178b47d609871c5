"""YAML as rcl reads parameter files, and stricter: no anchors, no key twice, never longer than 1 MiB."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import yaml

from dqwalk_ros.errors import ConfigError

__all__ = ["MAX_BYTES", "line_of", "read", "read_text"]

MAX_BYTES = 1 << 20
"""Longest file."""


class _Loader(yaml.SafeLoader):
    """SafeLoader without anchors, aliases and merge keys, where every key of a table is given once."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        if getattr(event, "anchor", None):
            raise _at(event, "anchors and aliases are not allowed")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        lines: dict[Any, int] = {}
        for key, _ in node.value:
            if key.tag == "tag:yaml.org,2002:merge":
                raise _at(key, "merge keys are not allowed")
            text = str(key.value)
            if text in lines:
                raise _at(key, f"the key {text!r:.80} was given in line {lines[text]} already")
            lines[text] = key.start_mark.line + 1
        return super().construct_mapping(node, deep=deep)


# YAML 1.1 takes 1e-3 for a text; rcl and YAML 1.2 take it for a number
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def _at(place: Any, problem: str) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=place.start_mark)


def read_text(path: str | os.PathLike[str]) -> str:
    """Return the text of a small file.

    Raises
    ------
    ConfigError
        If it cannot be read, is not UTF-8, or is longer than 1 MiB.
    """
    try:
        with open(path, encoding="utf-8") as file:
            text = file.read(MAX_BYTES + 1)
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot read '{path}': {error}") from error
    if len(text) > MAX_BYTES:
        raise ConfigError(f"{path}: longer than {MAX_BYTES >> 20} MiB")
    return text


def read(text: str, *, source: str = "text") -> Any:
    """Return the tree of a YAML text without anchors, each key once.

    Raises
    ------
    ConfigError
        If it is not such a text; the message names the line.
    """
    if len(text) > MAX_BYTES:
        raise ConfigError(f"{source}: longer than {MAX_BYTES >> 20} MiB")
    try:
        return yaml.load(text, _Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f"line {mark.line + 1}: " if mark is not None else ""
        raise ConfigError(f"{source}: {line}not YAML: {error.problem or error.context}") from error
    except RecursionError as error:
        raise ConfigError(f"{source}: nested too deeply") from error
    except (yaml.YAMLError, ValueError, OverflowError, KeyError, AttributeError, TypeError) as error:
        # a date that does not exist, a number with 5000 digits, a control character, ...
        raise ConfigError(f"{source}: not YAML: {' '.join(str(error).split())[:300]}") from error


@lru_cache(maxsize=1)
def _composed(text: str) -> Any:
    """Return the nodes of a text; a file with many keys is asked for many lines."""
    return yaml.compose(text, _Loader)


def line_of(text: str, path: Sequence[str]) -> int:
    """Return the line (from 1) of a key of a YAML text that `read` has read; of the deepest key that it has."""
    node, left, line = _composed(text), ".".join(path), 1
    while left and isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if left == key.value or left.startswith(f"{key.value}."):  # a key may be dotted
                node, left, line = value, left[len(key.value) + 1 :], key.start_mark.line + 1
                break
        else:
            break
    return line
