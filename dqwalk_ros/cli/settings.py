"""From the arguments to a `Config`."""

from __future__ import annotations

import argparse
from typing import Any

import yaml

from dqwalk_ros.config import Config, load
from dqwalk_ros.exceptions import ConfigError

__all__ = ["config_of", "parse_overrides"]


def config_of(args: argparse.Namespace) -> Config:
    """Return the configuration of ``--config``, with ``--cycles``, ``--first`` and ``--set`` put in.

    Raises
    ------
    ConfigError
        If any of it cannot be used.
    """
    values = parse_overrides(args.set)
    if getattr(args, "cycles", None) is not None:
        values["gait.cycles"] = args.cycles
    if getattr(args, "first", None) is not None:
        values["gait.first_support"] = args.first
    return load(args.config).updated(values, source="command line")


def parse_overrides(pairs: list[str]) -> dict[str, Any]:
    """Return ``{key: value}`` of texts ``key=value``; a value is read as YAML.

    Raises
    ------
    ConfigError
        If a text is not of that form.
    """
    values: dict[str, Any] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals or not key.strip():
            raise ConfigError(f"--set wants KEY=VALUE, such as gait.step_length=0.04, not '{pair}'")
        try:
            values[key.strip()] = _number(yaml.safe_load(text))
        except yaml.YAMLError as error:
            raise ConfigError(f"--set {key}: not a value: {text!r}") from error
    return values


def _number(value: Any) -> Any:
    """Read 1e-3 as the number it is; YAML 1.1 takes it for a text."""
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return value
    return value
