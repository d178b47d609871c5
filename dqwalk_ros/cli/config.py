"""``dqwalk config``: list, check or print parameters."""

from __future__ import annotations

import argparse
import textwrap

from dqwalk_ros.cli.settings import config_of, parse_overrides
from dqwalk_ros.config import Config, Spec, to_yaml
from dqwalk_ros.errors import ConfigError

__all__ = ["run"]


def run(args: argparse.Namespace) -> int:
    """Do it and return the exit code."""
    if args.config is None:
        Config.from_flat(parse_overrides(args.set), source="command line")
        if not args.check:
            print(_listing(args.section))
        return 0
    config = config_of(args)
    print(f"{args.config}: can be used" if args.check else to_yaml(config), end="\n" if args.check else "")
    return 0


def _listing(section: str | None) -> str:
    specs = [spec for spec in Config.specs() if section in (None, spec.name.rpartition(".")[0])]
    if not specs:
        known = dict.fromkeys(spec.name.rpartition(".")[0] for spec in Config.specs())
        raise ConfigError(f"no section '{section}'; there are {', '.join(name for name in known if name)}")
    names = max(len(spec.name) for spec in specs)
    lines = []
    for spec in specs:
        lines.append(f"{spec.name:<{names}}  {_value(spec)}{'  ' + _range(spec) if _range(spec) else ''}")
        lines += textwrap.wrap(spec.meaning, 100, initial_indent=" " * (names + 2), subsequent_indent=" " * (names + 2))
    return "\n".join(lines)


def _value(spec: Spec) -> str:
    value = spec.default
    text = str(value).lower() if isinstance(value, bool) else "(none)" if value in ((), "") else str(value)
    return f"{text} {spec.unit}".rstrip()


def _range(spec: Spec) -> str:
    if spec.choices:
        return f"one of {', '.join(spec.choices)}"
    if spec.low is not None or spec.high is not None:
        low, high = (("" if bound is None else f"{bound:g}") for bound in (spec.low, spec.high))
        return f"in [{low}, {high}]"
    return "true or false" if spec.type is bool else "list" if spec.type is tuple else ""
