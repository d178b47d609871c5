"""One walk of a study, in whatever process: numbers in, numbers out."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from dqwalk_ros import report
from dqwalk_ros.config import Config, RobotConfig
from dqwalk_ros.errors import ConfigError, DqwalkError
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.robot import RobotModel, load_model
from dqwalk_ros.simulation import make_controller, simulate
from dqwalk_ros.state import Command, State
from dqwalk_ros.studies.plan import OWN

__all__ = ["walk"]


def walk(config: Config, point: Mapping[str, Any], index: int, seed: int) -> dict[str, Any]:
    """Walk once and return what came of it.

    Parameters
    ----------
    config : Config
    point : mapping of str to value
        What this walk has of its own.
    index, seed : int
        Number of the walk and seed of the study; together they fix its random numbers.

    Returns
    -------
    dict
        ``walk``, the parameters, ``finished``, ``end`` (why it did not finish), ``duration`` [s], ``ticks``, ``steps``,
        ``error`` of the last phase, ``margin/paper``, ``margin/true``, ``margin/joints`` (least of the walk; None where
        there was no walk), all plain types.
    """
    row: dict[str, Any] = {"walk": index, **point}
    try:
        return row | _walked(config, point, index, seed)
    except DqwalkError as error:
        return row | _outcome(False, str(error))


def _outcome(finished: bool, end: str, **numbers: Any) -> dict[str, Any]:
    names = ("duration", "ticks", "steps", "error", "margin/paper", "margin/true", "margin/joints")
    return {"finished": finished, "end": end} | {name: numbers.get(name) for name in names}


def _walked(config: Config, point: Mapping[str, Any], index: int, seed: int) -> dict[str, Any]:
    own = {name: value for name, value in point.items() if name.startswith(OWN)}
    config = config.updated({name: value for name, value in point.items() if name not in own})
    model = _with_masses(_model(config.robot), own)
    q0 = np.zeros(model.n)
    for name, value in own.items():
        if name.startswith("start."):
            joint = name.removeprefix("start.")
            if joint not in model.joint_names:
                raise ConfigError(f"'{name}': there is no such joint; there are {', '.join(model.joint_names)}")
            q0[model.joint_names.index(joint)] = value
    controller = make_controller(config, model)
    plant = _Disturbed(model, q0, float(own.get("disturbance.velocity", 0.0)), np.random.default_rng([seed, index]))
    trace = simulate(controller, plant)
    if not trace.phases:
        return _outcome(False, "; ".join(trace.notes))
    found = report.report(report.analyse(trace))["walk"]
    margins = {f"margin/{name}": found["margin"][name]["value"] for name in ("paper", "true", "joints")}
    error = controller.error if math.isfinite(controller.error) else None
    numbers = {name: found[name] for name in ("duration", "ticks", "steps")} | {"error": error} | margins
    return _outcome(trace.finished, "; ".join(trace.notes), **numbers)


@functools.lru_cache(maxsize=8)
def _model(config: RobotConfig) -> RobotModel:
    return load_model(config)


def _with_masses(model: RobotModel, own: Mapping[str, Any]) -> RobotModel:
    bodies = list(model.bodies)
    for name, factor in own.items():
        if not name.startswith("mass."):
            continue
        link = name.removeprefix("mass.")
        if link not in model.frames:
            raise ConfigError(f"'{name}': there is no such link; there are {', '.join(model.frames)}")
        if factor < 0.0:
            raise ConfigError(f"'{name}' must not be negative, it is {factor}")
        body = model.frames[link].body
        bodies[body] = dataclasses.replace(bodies[body], mass=factor * bodies[body].mass)
    return dataclasses.replace(model, bodies=tuple(bodies)) if bodies != list(model.bodies) else model


class _Disturbed(KinematicPlant):
    """The integrator, with a random velocity added to each joint at each tick."""

    def __init__(self, model: RobotModel, q0: np.ndarray[Any, Any], deviation: float, rng: np.random.Generator) -> None:
        super().__init__(model, q0)
        self._deviation, self._rng = deviation, rng

    def step(self, command: Command, dt: float) -> State:
        """Return the state one period later."""
        if self._deviation:
            noise = self._deviation * self._rng.standard_normal(command.velocity.shape)
            command = dataclasses.replace(command, velocity=command.velocity + noise)
        return super().step(command, dt)
