"""From the arguments to a `Config`."""

from __future__ import annotations

import argparse
from typing import Any

import yaml

from dqwalk_ros.config import Config, find_share, from_yaml, load
from dqwalk_ros.errors import ConfigError
from dqwalk_ros.standing.course import Course

__all__ = ["config_of", "overlaid", "parse_overrides"]


def config_of(args: argparse.Namespace) -> Config:
    """Return the configuration of ``--config``, with ``--cycles``, ``--first`` and ``--set`` put in.

    Raises
    ------
    ConfigError
        If any of it cannot be used.
    """
    values: dict[str, Any] = {}
    if getattr(args, "cmd_vel", None):
        Course.parse(args.cmd_vel)  # what cannot be read is said before anything starts
        values["gait.steps"] = 0
    values |= parse_overrides(args.set)
    if getattr(args, "cycles", None) is not None:
        values["gait.cycles"] = args.cycles
    if getattr(args, "first", None) is not None:
        values["gait.first_support"] = args.first
    config = load(args.config)
    plant = getattr(args, "plant", None)
    if plant in ("physics", "poppy"):
        config = overlaid(config, plant)
    return config.updated(values, source="command line")


def overlaid(config: Config, plant: str) -> Config:
    """Return a configuration with what ``config/plants/NAME.yaml`` asks of all nodes put in."""
    return from_yaml(find_share("config/plants", f"{plant}.yaml").read_text(encoding="utf-8"), onto=config)


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
