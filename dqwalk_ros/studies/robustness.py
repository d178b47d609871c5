"""Does a walk in physics stand when the robot is not the one it was tuned for? One cell per combination."""

from __future__ import annotations

import functools
import itertools
import math
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from dqwalk_ros.config import Config
from dqwalk_ros.errors import ConfigError, DqwalkError
from dqwalk_ros.robot import load_model
from dqwalk_ros.simulation import closed_loop, make_controller, make_plant
from dqwalk_ros.studies.plan import MAX_WALKS, digest
from dqwalk_ros.studies.runner import Store, run
from dqwalk_ros.walk import PhaseKind

__all__ = ["Cell", "Outcome", "axes_of", "cells", "told", "walk", "walk_all"]


LATENCY_ERROR = "latency_error"
"""An axis of its own: so much more latency is the controller told than there is [s]."""
_LOOK = 0.02
"""The tilt of the soles is looked at this often [s]."""


def axes_of(config: Config) -> dict[str, tuple[float, ...]]:
    """Return what is varied by default.

    The controller is told stiffness, damping, rate and latency of the servos, nothing of the rest. Stiffness is varied
    relative to the robot's own, which grows with its weight and height. Servos of a type are what they are: at the
    highest P gain and half of it, with other faults of the sensors in each walk.
    """
    if config.servo.types:
        return {"servo.p_gain": (255, 127), "sensors.seed": tuple(range(20))}
    return {
        "physics.friction": (0.4, 0.8, 1.2),
        "physics.mass_scale": (0.9, 1.0, 1.1),
        "servo.stiffness": tuple(round(part * config.servo.stiffness / 12.0, 6) for part in (5.0, 8.0, 12.0, 18.0)),
        "servo.backlash": (0.0, 0.0058),
        "servo.rate": (200.0, 50.0),
        "servo.latency": (0.0, 0.02, 0.04),
    }


class Outcome(msgspec.Struct, frozen=True):
    """What came of a walk.

    Attributes
    ----------
    stood : bool
        Whether the walk came to its end upright.
    time : float
        When it ended [s].
    steps : int
        Steps that were landed.
    reason : str
        Why it did not stand.
    tilt : float or None
        The most that the sole that carries leaned [rad].
    """

    stood: bool
    time: float
    steps: int
    reason: str
    tilt: float | None = None


@dataclass(frozen=True)
class Cell:
    """A combination and its walk: `Outcome` with `values`, what was varied."""

    values: Mapping[str, float]
    stood: bool
    time: float
    steps: int = 0
    reason: str = ""
    tilt: float | None = None


def cells(axes: Mapping[str, Sequence[float]], sample: int = 0, seed: int = 0) -> list[dict[str, float]]:
    """Return all combinations of the axes, or `sample` of them drawn at random.

    Raises
    ------
    ConfigError
        If there are too many.
    """
    count = math.prod(map(len, axes.values()))
    if count > MAX_WALKS:
        raise ConfigError(f"{count:.3g} combinations are too many, {MAX_WALKS} is the most")
    every = [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]
    return random.Random(seed).sample(every, sample) if 0 < sample < len(every) else every


def told(config: Config, latency_error: float = 0.0) -> dict[str, float]:
    """Return what the controller is told of its servos; all of it is so but for `latency_error` [s]."""
    s = config.servo
    damping = {"servo.assumed_lead": s.damping} if s.assumed_lead else {"servo.assumed_damping": s.damping}
    return {
        "servo.assumed_stiffness": s.stiffness,
        **damping,
        "servo.assumed_latency": max(s.latency + config.sensors.age + latency_error, 0.0),
        "servo.assumed_rate": s.rate or 1.0 / config.dt,
    }


def walk(config: Config, index: int, values: Mapping[str, Any]) -> Outcome:
    """Walk one combination in physics, to the end or to the fall."""
    time, steps, phase, tilt = 0.0, 0, None, 0.0
    parameters = {name: value for name, value in values.items() if name != LATENCY_ERROR}
    try:
        varied = config.updated(parameters)
        varied = varied.updated({**told(varied, values.get(LATENCY_ERROR, 0.0)), **parameters})
        model = load_model(varied.robot)
        controller, plant = make_controller(varied, model), make_plant("physics", varied, model)
        for state, _ in closed_loop(controller, plant):
            if state.time >= time + _LOOK - 1e-9 and (truth := plant.truth) is not None:
                time, tilt = state.time, max(tilt, truth.tilt)
            if controller.phase is not phase:
                steps += phase is not None and phase.kind is PhaseKind.SINGLE_SUPPORT
                phase = controller.phase
    except DqwalkError as error:
        return Outcome(False, time, steps, str(error), tilt)
    reason = "" if controller.finished else f"fell in {controller.phase.name}"
    return Outcome(not reason, time, steps, reason, tilt)


def walk_all(
    config: Config, combinations: Sequence[Mapping[str, float]], out: Path, *, force: bool = False, **options: Any
) -> list[Cell]:
    """Make the walks that are missing in a folder, and return all cells that are there, in order.

    Parameters
    ----------
    config : Config
    combinations : sequence of mapping
    out : Path
        Folder of ``cells.jsonl``.
    force : bool
        Begin anew.
    **options
        As `runner.run`.
    """
    store = Store(out / "cells.jsonl", digest(config, list(combinations)), combinations, Outcome, force=force)
    try:
        done = run(functools.partial(walk, config), combinations, store, **options)
    finally:
        store.close()
    return [Cell(combinations[k], **msgspec.to_builtins(outcome)) for k, outcome in done.items()]
