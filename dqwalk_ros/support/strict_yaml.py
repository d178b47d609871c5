"""Reader of YAML files: scalars as rcl reads them, without anchors and duplicate keys, at most 1 MiB long."""

from __future__ import annotations

import copy
import os
import re
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, ClassVar

import yaml

from dqwalk_ros.support.errors import ConfigError

_MAX_BYTES = 1 << 20
"""Largest size of a file."""
_MOST_NESTED = 50
"""Largest depth of nested lists and dictionaries; the parser itself would overflow the stack."""
_BLANK = re.compile(r"[^\S \t\n\r]|[\u200b-\u200d\u2060\ufeff]")
"""A character that looks like a space, or like nothing, and is part of the text beside it."""
_NO_TEXT = re.compile("[\ud800-\udfff]")
"""A byte that Python could not decode."""


class _Loader(yaml.CSafeLoader):
    """Loader that refuses merge keys and duplicate keys."""

    bool_values: ClassVar[dict[str, bool]] = {**yaml.CSafeLoader.bool_values, "y": True, "n": False}

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


# PyYAML reads YAML 1.1, which has other numbers: 1:30 is 90, 1_0 is 10, and 1e-3 is a text
_Loader.yaml_implicit_resolvers = {}
for _tag, _pattern in {
    "bool": r"(?:[yYnN]|yes|Yes|YES|no|No|NO|true|True|TRUE|false|False|FALSE|on|On|ON|off|Off|OFF)$",
    "int": r"[-+]?(?:0x[0-9a-fA-F]+|0[0-7]*|[1-9]\d*)$",
    "float": r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?$|[-+]?\.(?:inf|Inf|INF)$|\.(?:nan|NaN|NAN)$",
    "merge": r"<<$",
    "null": r"(?:~|null|Null|NULL|)$",
}.items():
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(_pattern, re.ASCII), None)


def _at(place: Any, problem: str) -> yaml.MarkedYAMLError:
    """Return an error with the position of a node or event."""
    return yaml.MarkedYAMLError(problem=problem, problem_mark=place.start_mark)


def read_text(path: str | os.PathLike[str]) -> str:
    """Return the text of a file of at most 1 MiB.

    Raises
    ------
    ConfigError
        If the file cannot be read, is not UTF-8, or is longer than 1 MiB.
    """
    try:
        with open(path, encoding="utf-8") as file:
            text = file.read(_MAX_BYTES + 1)
    except UnicodeDecodeError as error:
        raise ConfigError(f"cannot read '{path}': it is not a text in UTF-8 (byte {error.start})") from error
    except OSError as error:
        raise ConfigError(f"cannot read '{path}': {error.strerror}") from error
    if len(text) > _MAX_BYTES:
        raise ConfigError(f"{path}: longer than {_MAX_BYTES >> 20} MiB")
    return text


def read(text: str, *, source: str = "text") -> Any:
    """Return the content of a YAML text as dictionaries, lists and scalars.

    Raises
    ------
    ConfigError
        If the text is not YAML, or has an anchor, a merge key or a duplicate key; the message names the line.
    """
    if len(text) > _MAX_BYTES:
        raise ConfigError(f"{source}: longer than {_MAX_BYTES >> 20} MiB")
    if _NO_TEXT.search(text):  # bytes of a command line that are not of its encoding
        raise ConfigError(f"{source}: it is not a text in UTF-8; is the locale of this terminal right (LANG)?")
    try:
        return copy.deepcopy(_parsed(text))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f"line {mark.line + 1}: " if mark is not None else ""
        problem = error.problem or error.context
        if mark is not None and text[mark.index : mark.index + 1] == "\t":
            problem = "a tab; YAML is indented by spaces"
        raise ConfigError(f"{source}: {line}not YAML: {problem}") from error
    except (yaml.YAMLError, ValueError, OverflowError, KeyError, AttributeError, TypeError) as error:
        # a date that does not exist, a number with 5000 digits, a control character, ...
        raise ConfigError(f"{source}: not YAML: {' '.join(str(error).split())[:300]}") from error


@lru_cache(maxsize=8)
def _parsed(text: str) -> Any:
    """Return the content of a text; cached, because the same tables are read for every walk of a process."""
    _check_events(text)
    return yaml.load(text, _Loader)


def _check_events(text: str) -> None:
    """Check that a text has no anchors, aliases and odd blanks, and is nested at most `_MOST_NESTED` deep.

    Raises
    ------
    yaml.YAMLError
        If it has, or is not YAML.
    """
    depth = 0
    for event in yaml.parse(text, _Loader):
        if getattr(event, "anchor", None):
            raise _at(event, "anchors and aliases are not allowed")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _MOST_NESTED:
            raise _at(event, "nested too deeply")
        if isinstance(event, yaml.ScalarEvent) and not event.style and (odd := _BLANK.search(event.value)):
            raise _at(event, f"the blank U+{ord(odd[0]):04X}, as from a web page, is not a space in YAML: retype it")


@lru_cache(maxsize=1)
def _composed(text: str) -> Any:
    """Return the syntax tree of a text; cached, as `line_of` is called for many keys of the same text."""
    return yaml.compose(text, _Loader)


def line_of(text: str, path: Sequence[str]) -> int:
    """Return the line (from 1) of the key `path` in a YAML text that `read` accepts.

    Where the text does not contain the whole path, it is the line of the deepest key that it does contain.
    """
    node, left, line = _composed(text), ".".join(path), 1
    while left and isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if left == key.value or left.startswith(f"{key.value}."):  # a key may be dotted
                node, left, line = value, left[len(key.value) + 1 :], key.start_mark.line + 1
                break
        else:
            break
    return line
