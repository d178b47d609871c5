"""Reads the file of a study, whose form `dqwalk study --help` shows, checks it, and lists its walks."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import pathlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import msgspec

from dqwalk_ros.config import Config, load
from dqwalk_ros.support import strict_yaml
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.wording import missing

MAX_WALKS = 100_000
"""Largest number of walks of a study."""


class Range(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Range from `low` to `high`; a grid uses `steps` values, including both ends."""

    low: float = msgspec.field(name="from")
    high: float = msgspec.field(name="to")
    steps: Annotated[int, msgspec.Meta(ge=1, le=MAX_WALKS)] = 5

    def at(self, fraction: float) -> float:
        """Return the value at a fraction of the range, rounded to twelve digits."""
        return float(f"{self.low + fraction * (self.high - self.low):.12g}")


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The keys of a study's file."""

    vary: Annotated[dict[str, Any], msgspec.Meta(min_length=1)]
    config: str = "paper"
    set: dict[str, Any] = {}
    sample: Literal["grid", "latin_hypercube", "sobol"] = "grid"
    count: Annotated[int, msgspec.Meta(ge=1, le=MAX_WALKS)] = 64
    seed: Annotated[int, msgspec.Meta(ge=0)] = 0


@dataclass(frozen=True)
class Study:
    """A valid study."""

    name: str
    config: Config
    """The configuration common to all walks."""
    sample: str
    """``"grid"``, ``"latin_hypercube"`` or ``"sobol"``."""
    count: int
    seed: int
    vary: Mapping[str, Range | tuple[Any, ...]]
    """A range, or a tuple of values."""

    def points(self) -> list[dict[str, Any]]:
        """Return the parameters of every walk; the same study gives the same list."""
        if self.sample == "grid":
            axes = [
                [of.at(i / max(1, of.steps - 1)) for i in range(of.steps)] if isinstance(of, Range) else of
                for of in self.vary.values()
            ]
            return [dict(zip(self.vary, values, strict=True)) for values in itertools.product(*axes)]
        from scipy.stats import qmc

        kind = qmc.LatinHypercube if self.sample == "latin_hypercube" else qmc.Sobol
        unit = kind(d=len(self.vary), seed=self.seed).random(self.count)
        return [
            {name: _pick(of, float(x)) for (name, of), x in zip(self.vary.items(), row, strict=True)} for row in unit
        ]

    def digest(self) -> str:
        """Return a hash of everything that affects a walk."""
        vary = {name: msgspec.to_builtins(of) for name, of in self.vary.items()}
        return digest(self.config, self.sample, self.count, self.seed, list(vary.items()))


def is_own(name: str) -> bool:
    """Return whether only studies have a parameter of this name, not the configuration."""
    return name.startswith(("start.", "mass.")) or name == "disturbance.velocity"


def digest(config: Config, *more: Any) -> str:
    """Return a hash of a configuration and of everything else that affects an outcome."""
    text = json.dumps([config.flat(), *more], sort_keys=True, default=list)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _pick(of: Range | tuple[Any, ...], x: float) -> Any:
    return of.at(x) if isinstance(of, Range) else of[min(int(x * len(of)), len(of) - 1)]


def read(path: str | pathlib.Path) -> Study:
    """Read a study.

    Raises
    ------
    ConfigError
        If the file is invalid; the message names the key.
    """
    source = pathlib.Path(path)
    if not source.is_file():
        raise ConfigError(missing("study file", source))
    tree = strict_yaml.read(strict_yaml.read_text(source), source=str(path))
    if isinstance(tree, dict) and any(isinstance(part, dict) and "ros__parameters" in part for part in tree.values()):
        raise ConfigError(f"{path}: this is a configuration, not a study; `dqwalk study --help` shows a study")
    try:
        file = msgspec.convert(tree, _File)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{path}: {error}; `dqwalk study --help` shows a study") from None
    if file.sample == "grid" and (wrong := sorted({"count", "seed"} & tree.keys())):
        raise ConfigError(f"{path}: '{wrong[0]}' belongs to 'sample: latin_hypercube' or sobol; a grid has 'steps'")
    if file.sample == "sobol" and file.count & (file.count - 1):
        raise ConfigError(f"{path}: 'count' must be a power of two for sobol, not {file.count}")
    vary = {name: _range(name, value, path) for name, value in file.vary.items()}
    sizes = [of.steps if isinstance(of, Range) else len(of) for of in vary.values()]
    walks = math.prod(sizes) if file.sample == "grid" else file.count
    if walks > MAX_WALKS:
        raise ConfigError(
            f"{path}: {walks:.3g} walks are too many for one study, at most {MAX_WALKS}; use fewer steps, or "
            "'sample: latin_hypercube' with a 'count'"
        )
    if twice := sorted(file.set.keys() & vary):
        raise ConfigError(f"{path}: '{twice[0]}' is in 'set' and in 'vary'; remove one of them")
    config = load(file.config).updated(file.set, source=str(path))
    kinds = {spec.name: spec.type for spec in Config.specs()}
    for name, of in vary.items():  # invalid values are rejected before the first walk
        if isinstance(of, Range) and kinds.get(name, float) is not float:
            raise ConfigError(f"{path}: '{name}' is varied by a list of values, such as [1, 2], not by a range")
        for value in (of.low, of.high) if isinstance(of, Range) else of:
            if not is_own(name):
                config.updated({name: value}, source=str(path))
            elif isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise ConfigError(f"{path}: '{name}' must be a finite number, not {value!r:.80}")
            elif not name.startswith("start.") and value < 0.0:
                raise ConfigError(f"{path}: '{name}' must not be negative, it is {value}")
    return Study(source.stem, config, file.sample, file.count, file.seed, vary)


def _range(name: str, value: Any, path: str | pathlib.Path) -> Range | tuple[Any, ...]:
    if isinstance(value, list) and value:
        return tuple(value)
    try:
        made = msgspec.convert(value, Range)
    except msgspec.ValidationError:
        made = None
    if made is None or not (math.isfinite(made.low) and math.isfinite(made.high)):
        raise ConfigError(
            f"{path}: {name!r} must be a list of values or {{from: A, to: B, steps: N}}, not {value!r:.80}"
        )
    return made
