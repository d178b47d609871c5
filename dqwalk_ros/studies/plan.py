"""What a study varies: a file, checked, and the list of its walks.

::

    config: paper                       # name or path, as of --config
    set: {gait.cycles: 1}               # the same in every walk
    sample: grid                        # grid, latin_hypercube or sobol
    count: 64                           # walks, for latin_hypercube and sobol
    seed: 0
    vary:
      gait.step_length: {from: 0.03, to: 0.12, steps: 10}
      robot.drop: [[abs_y], []]         # any list of values
      start.l_knee_y: {from: 0.0, to: 0.3, steps: 4}

Besides every parameter of `dqwalk config` a study may vary ``start.JOINT`` (first angle [rad]), ``mass.LINK`` (factor
on the mass of the body that carries the link) and ``disturbance.velocity`` (standard deviation of a random velocity
added to every joint at every tick [rad/s]).
"""

from __future__ import annotations

import hashlib
import itertools
import json
import pathlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml

from dqwalk_ros.config import Config, load
from dqwalk_ros.errors import ConfigError

__all__ = ["OWN", "Study", "read"]

OWN = ("start.", "mass.", "disturbance.velocity")
"""Beginnings of the names that are a study's own, not parameters of the configuration."""
SAMPLES = ("grid", "latin_hypercube", "sobol")


@dataclass(frozen=True)
class Range:
    """From `low` to `high`; a grid takes `steps` values, ends included."""

    low: float
    high: float
    steps: int

    def at(self, fraction: float) -> float:
        """Return the value at a fraction of the way; of twelve digits, so that a grid reads as it was meant."""
        return float(f"{self.low + fraction * (self.high - self.low):.12g}")


@dataclass(frozen=True)
class Study:
    """A study, checked.

    Attributes
    ----------
    name : str
    config : Config
        With what is the same in every walk put in.
    sample : str
        ``"grid"``, ``"latin_hypercube"`` or ``"sobol"``.
    count, seed : int
    vary : mapping of str to Range or tuple
        A range, or the values themselves.
    """

    name: str
    config: Config
    sample: str
    count: int
    seed: int
    vary: Mapping[str, Range | tuple[Any, ...]]

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
        """Return a text that changes with anything that changes a walk."""
        text = json.dumps([self.config.flat(), self.points(), self.seed], sort_keys=True, default=list)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def _pick(of: Range | tuple[Any, ...], x: float) -> Any:
    return of.at(x) if isinstance(of, Range) else of[min(int(x * len(of)), len(of) - 1)]


def read(path: str | pathlib.Path) -> Study:
    """Read a study.

    Raises
    ------
    ConfigError
        If the file cannot be used; the message names the key.
    """
    source = pathlib.Path(path)
    try:
        tree = yaml.safe_load(source.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot read the study '{path}': {error}") from error
    except yaml.YAMLError as error:
        raise ConfigError(f"{path}: not YAML: {' '.join(str(error).split())}") from error
    keys = ("config", "set", "sample", "count", "seed", "vary")
    if not isinstance(tree, dict) or not isinstance(tree.get("vary"), dict) or not tree["vary"]:
        raise ConfigError(f"{path}: a study needs 'vary' with at least one parameter; `dqwalk study --help` shows one")
    if unknown := sorted(map(str, set(tree) - set(keys))):
        raise ConfigError(f"{path}: unknown key {', '.join(unknown)}; there are {', '.join(keys)}")
    sample, count, seed = tree.get("sample", "grid"), tree.get("count", 64), tree.get("seed", 0)
    if sample not in SAMPLES:
        raise ConfigError(f"{path}: 'sample' must be one of {', '.join(SAMPLES)}, not {sample!r}")
    for key, value, low in (("count", count, 1), ("seed", seed, 0)):
        if type(value) is not int or value < low:
            raise ConfigError(f"{path}: '{key}' must be a whole number from {low} on, not {value!r}")
    if sample == "sobol" and count & (count - 1):
        raise ConfigError(f"{path}: 'count' must be a power of two for sobol, not {count}")
    fixed = tree.get("set") or {}
    if not isinstance(fixed, dict):
        raise ConfigError(f"{path}: 'set' must be a table of parameters")
    config = load(str(tree.get("config", "paper"))).updated(fixed, source=str(path))
    vary = {str(name): _range(str(name), value, path) for name, value in tree["vary"].items()}
    study = Study(source.stem, config, sample, count, seed, vary)
    for name, of in vary.items():  # what cannot be walked is said now, not after an hour
        for value in (of.low, of.high) if isinstance(of, Range) else of:
            if name.startswith(OWN):
                if isinstance(value, bool) or not isinstance(value, int | float):
                    raise ConfigError(f"{path}: '{name}' must be a number, not {value!r}")
            else:
                config.updated({name: value}, source=str(path))
    return study


def _range(name: str, value: Any, path: str | pathlib.Path) -> Range | tuple[Any, ...]:
    if isinstance(value, list) and value:
        return tuple(value)
    if isinstance(value, dict) and {"from", "to"} <= set(value) <= {"from", "to", "steps"}:
        low, high, steps = value["from"], value["to"], value.get("steps", 5)
        numbers = all(isinstance(x, int | float) and np.isfinite(x) for x in (low, high))
        if numbers and type(steps) is int and steps >= 1:
            return Range(float(low), float(high), steps)
    raise ConfigError(f"{path}: '{name}' must be a list of values or {{from: A, to: B, steps: N}}, not {value!r}")
