"""The walks of a study from a file: runs one walk for given parameters, and all walks of a study."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from dqwalk_ros import report
from dqwalk_ros.config import Config
from dqwalk_ros.paper.state import Command, State
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.robot.model import RobotModel, load_model
from dqwalk_ros.simulation import simulate
from dqwalk_ros.studies.plan import Study, is_own
from dqwalk_ros.studies.runner import Store, run
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ConfigError, DqwalkError, StudyError
from dqwalk_ros.support.output import written
from dqwalk_ros.walks.table import make_controller, make_walk, refuse_endless


class StudyOutcome(msgspec.Struct, frozen=True, kw_only=True):
    """The outcome of a walk; numbers are None if it could not begin."""

    finished: bool
    end: str
    """Why it did not finish."""
    duration: float | None = None
    """[s]"""
    ticks: int | None = None
    steps: int | None = None
    error: float | None = None
    """Of the last phase."""
    paper: float | None = msgspec.field(default=None, name="margin/paper")
    true: float | None = msgspec.field(default=None, name="margin/true")
    joints: float | None = msgspec.field(default=None, name="margin/joints")
    """Smallest margin of the walk to the paper's planes and cylinder, to the edges of the soles [m], and to the joint
    limits [rad]; ``margin/paper`` and so on in files. None where it has no meaning: `paper` in a walk of another style,
    `true` for a robot whose soles have no shape."""


def walk(config: Config, seed: int, index: int, point: Mapping[str, Any]) -> StudyOutcome:
    """Run the walk of a number with its varied parameters; seed and number together fix its random numbers."""
    try:
        return _walked(config, seed, index, point)
    except DqwalkError as error:
        return StudyOutcome(finished=False, end=str(error))


def walk_all(study: Study, out: Path, *, force: bool = False, **options: Any) -> list[dict[str, Any]]:
    """Run the walks of a study that are missing in a folder, and return the rows of all walks.

    The folder has ``walks.jsonl`` and, when all walks are done, ``walks.parquet``. With `force` earlier results are
    discarded; other options and errors are those of `runner.run`.

    Returns
    -------
    list of dict
        ``walk``, the parameters, and the fields of `StudyOutcome`, in the order of the walks.
    """
    points = study.points()
    set_up(study.config, points[0])  # a wrong name is an error before the first walk
    store = Store(out / "walks.jsonl", study.digest(), points, StudyOutcome, force=force)
    done = run(functools.partial(walk, study.config, study.seed), store, **options)
    rows = [{"walk": k, **point, **msgspec.to_builtins(outcome)} for k, (point, outcome) in enumerate(done)]
    _write_parquet(rows, out / "walks.parquet")
    return rows


def _write_parquet(rows: list[dict[str, Any]], path: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    plain = [
        {k: msgspec.json.encode(v).decode() if isinstance(v, list | tuple) else v for k, v in row.items()}
        for row in rows
    ]
    try:
        with written(path, overwrite=True) as new:
            parquet.write_table(pa.Table.from_pylist(plain), new)
    except OSError as error:
        raise StudyError(f"cannot write '{path}': {error.strerror or error}") from error


def set_up(config: Config, point: Mapping[str, Any]) -> tuple[Config, RobotModel, Array]:
    """Return the configuration of the walk with the parameters `point`, its robot, and its first angles (n,) [rad].

    Raises
    ------
    ConfigError
        If there is no such joint or link, or the walk has no end.
    """
    config = config.updated({name: value for name, value in point.items() if not is_own(name)})
    refuse_endless(config)
    model = _with_masses(load_model(config.robot), point)
    q0 = make_walk(config, model).posture.copy()
    for name, value in point.items():
        if name.startswith("start."):
            joint = name.removeprefix("start.")
            if joint not in model.joint_names:
                raise ConfigError(f"'{name}': there is no such joint; there are {', '.join(model.joint_names)}")
            q0[model.joint_names.index(joint)] = value
    return config, model, q0


def _walked(config: Config, seed: int, index: int, point: Mapping[str, Any]) -> StudyOutcome:
    config, model, q0 = set_up(config, point)
    deviation = float(point.get("disturbance.velocity", 0.0))
    controller = make_controller(config, model)
    plant = _Disturbed(model, q0, deviation, np.random.default_rng([seed, index]))
    trace = simulate(controller, plant, whole=True)
    if not trace.phases:
        return StudyOutcome(finished=False, end="; ".join(trace.notes))
    found = report.report(report.analyse(trace))["walk"]
    margin = {name: found["margin"][name]["value"] for name in ("paper", "true", "joints") if name in found["margin"]}
    return StudyOutcome(
        finished=trace.finished,
        end="; ".join(trace.notes),
        duration=found["duration"],
        ticks=found["ticks"],
        steps=found["steps"],
        error=controller.error if math.isfinite(controller.error) else None,
        **margin,
    )


def _with_masses(model: RobotModel, point: Mapping[str, Any]) -> RobotModel:
    bodies = list(model.bodies)
    for name, factor in point.items():
        if not name.startswith("mass."):
            continue
        link = name.removeprefix("mass.")
        if link not in model.frames:
            raise ConfigError(f"'{name}': there is no such link; there are {', '.join(model.frames)}")
        body = model.frames[link].body
        bodies[body] = dataclasses.replace(bodies[body], mass=factor * bodies[body].mass)
    return dataclasses.replace(model, bodies=tuple(bodies)) if bodies != list(model.bodies) else model


class _Disturbed(KinematicPlant):
    """The integrator, with a random velocity added to each joint at each tick."""

    def __init__(self, model: RobotModel, q0: Array, deviation: float, rng: np.random.Generator) -> None:
        super().__init__(model, q0)
        self._deviation, self._rng = deviation, rng

    def step(self, command: Command, dt: float) -> State:
        """Return the state one period later."""
        if self._deviation:
            noise = self._deviation * self._rng.standard_normal(command.velocity.shape)
            command = dataclasses.replace(command, velocity=command.velocity + noise)
        return super().step(command, dt)
