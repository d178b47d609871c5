"""Simulates a walk in physics for many combinations of robot and floor parameters; one cell per combination."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.report.binding import acting, limits_reached, most_loaded
from dqwalk_ros.report.metrics import analyse
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.simulation import simulate
from dqwalk_ros.studies.plan import MAX_WALKS, digest
from dqwalk_ros.studies.runner import Store, drawn, run
from dqwalk_ros.support.errors import ConfigError, DqwalkError
from dqwalk_ros.walks.table import make_controller, refuse_endless

LATENCY_ERROR = "latency_error"
"""An axis that is not a parameter: error of the latency that the controller assumes [s]."""


def axes_of(config: Config) -> dict[str, tuple[float, ...]]:
    """Return the axes that are varied by default.

    The controller knows stiffness, damping, rate and latency of the servos, but not the other parameters. Stiffness is
    varied relative to the robot's own, which grows with its weight and height. For a robot with servos of known types,
    the axes are the highest P gain and half of it, and the seed of the sensor errors.
    """
    if config.servo.types:
        return {"servo.p_gain": (254, 127), "sensors.seed": tuple(range(20))}
    return {
        "physics.friction": (0.4, 0.8, 1.2),
        "physics.mass_scale": (0.9, 1.0, 1.1),
        "servo.stiffness": tuple(round(part * config.servo.stiffness / 12.0, 6) for part in (5.0, 8.0, 12.0, 18.0)),
        "servo.backlash": (0.0, 0.0058),
        "servo.rate": (200.0, 50.0),
        "servo.latency": (0.0, 0.02, 0.04),
    }


class CellOutcome(msgspec.Struct, frozen=True):
    """The outcome of a walk."""

    stood: bool
    """Whether the robot was upright at the end of the walk, and its soles covered the path of its steps."""
    time: float
    """Time at which the walk ended [s]."""
    steps: int
    """Number of completed steps."""
    reason: str
    """Why it did not stand."""
    tilt: float | None = None
    """Largest tilt of the loaded sole [rad]."""
    load: float | None = None
    """Largest part of its torque-speed curve that a servo needed; 1: it cannot do more."""
    joint: str = ""
    """The joint of that servo."""
    reached: Mapping[str, int] = {}
    """Number of ticks of the steps on which the velocity of a joint was at a limit, by the limit's name."""


Cell = tuple[Mapping[str, float], CellOutcome]
"""A combination of parameters, and the outcome of its walk."""


def cells(axes: Mapping[str, Sequence[float]], sample: int = 0, seed: int = 0) -> list[dict[str, float]]:
    """Return all combinations of the axes, or `sample` of them drawn at random.

    Raises
    ------
    ConfigError
        If there are too many.
    """
    count = math.prod(map(len, axes.values()))
    if count > MAX_WALKS:
        raise ConfigError(f"{count:.3g} combinations are too many, at most {MAX_WALKS}")
    every = [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]
    return drawn(every, sample, seed)


def assumed(config: Config, latency_error: float = 0.0) -> dict[str, float]:
    """Return the controller's assumptions about its servos: the true values, except for `latency_error` [s].

    How much of the damping is fed forward, ``servo.assumed_lead``, is a choice of the configuration.
    """
    s = config.servo
    return {
        "servo.assumed_stiffness": s.stiffness,
        "servo.assumed_damping": s.damping,
        "servo.assumed_lead": min(s.assumed_lead, s.damping),
        "servo.assumed_latency": max(s.latency + config.sensors.age + latency_error, 0.0),
        "servo.assumed_rate": s.rate or 1.0 / config.dt,
    }


def walk(config: Config, index: int, values: Mapping[str, Any]) -> CellOutcome:
    """Simulate one combination in physics, until the walk ends or the robot falls."""
    parameters = {name: value for name, value in values.items() if name != LATENCY_ERROR}
    try:
        varied = config.updated(parameters)
        varied = varied.updated({**assumed(varied, values.get(LATENCY_ERROR, 0.0)), **parameters})
        refuse_endless(varied)
        model = load_model(varied.robot)
        plant = make_plant(varied.plant.name or "physics", varied, model)
        trace = simulate(make_controller(varied, model), plant, whole=True)
        series = analyse(trace)
        ground = series.judged
    except DqwalkError as error:
        return CellOutcome(False, 0.0, 0, str(error))
    load = most_loaded(trace)
    reason = ground.failure
    steps = sum(not span.double and span.ending is not None for span in series.spans)
    needed: dict[str, Any] = {"load": load.part, "joint": load.joint} if load else {}
    reached, tilt = limits_reached(series, acting(trace)[0]), float(np.nanmax(ground.tilt))
    return CellOutcome(not reason, float(trace.time[-1]), steps, reason, tilt, reached=reached, **needed)


def walk_all(
    config: Config, combinations: Sequence[Mapping[str, float]], out: Path, *, force: bool = False, **options: Any
) -> list[Cell]:
    """Simulate the walks that are missing in ``cells.jsonl`` of a folder, and return all cells in order.

    With `force` earlier results are discarded; other options and errors are those of `runner.run`.
    """
    refuse_endless(config)
    make_controller(config, load_model(config.robot))  # a wrong name is an error before the first walk
    store = Store(out / "cells.jsonl", digest(config, list(combinations)), combinations, CellOutcome, force=force)
    return run(functools.partial(walk, config), store, **options)
