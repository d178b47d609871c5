"""Does a walk in physics stand when the robot is not the one it was tuned for? One cell per combination."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import json
import multiprocessing
import os
import random
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

from dqwalk_ros.config import Config, to_yaml
from dqwalk_ros.errors import ConfigError, DqwalkError
from dqwalk_ros.robot import load_model
from dqwalk_ros.simulation import make_controller, make_plant
from dqwalk_ros.walk import PhaseKind

__all__ = ["AXES", "Cell", "Kept", "cells", "run", "told", "walk"]

AXES: dict[str, tuple[float, ...]] = {
    "physics.friction": (0.4, 0.8, 1.2),
    "physics.mass_scale": (0.9, 1.0, 1.1),
    "servo.stiffness": (25.0, 40.0, 60.0, 90.0),
    "servo.backlash": (0.0, 0.0058),
    "servo.rate": (200.0, 50.0),
    "servo.latency": (0.0, 0.02, 0.04),
}
"""What is varied. The controller is told stiffness, damping, rate and latency of the servos, nothing of the rest."""


@dataclass(frozen=True)
class Cell:
    """The walk of one combination.

    Attributes
    ----------
    values : dict of str to float
        What was varied.
    stood : bool
        Whether the walk came to its end upright.
    time : float
        When it ended [s].
    steps : int
        Steps that were landed.
    reason : str
        Why it did not stand.
    """

    values: Mapping[str, float]
    stood: bool
    time: float
    steps: int = 0
    reason: str = ""


def cells(axes: Mapping[str, Sequence[float]], sample: int = 0, seed: int = 0) -> list[dict[str, float]]:
    """Return all combinations of the axes, or `sample` of them drawn at random."""
    every = [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]
    return random.Random(seed).sample(every, sample) if 0 < sample < len(every) else every


def told(config: Config) -> dict[str, float]:
    """Return what the controller is told of its servos where it is told what is so."""
    s = config.servo
    return {
        "servo.assumed_stiffness": s.stiffness,
        "servo.assumed_damping": s.damping,
        "servo.assumed_latency": s.latency + config.sensors.age,
        "servo.assumed_rate": s.rate or 1.0 / config.dt,
    }


def walk(config: Config, values: Mapping[str, float]) -> Cell:
    """Walk one combination in physics, to the end or to the fall."""
    varied = config.updated(values)
    varied = varied.updated({**told(varied), **values})
    model = load_model(varied.robot)
    controller, time, steps, phase = make_controller(varied, model), 0.0, 0, None
    try:
        plant = make_plant("physics", varied, model)
        state = plant.state
        while True:
            command = controller.step(state, varied.dt)
            if controller.finished:
                return Cell(values, True, state.time, steps)
            if controller.phase is not phase:
                steps += phase is not None and phase.kind is PhaseKind.SINGLE_SUPPORT
                phase = controller.phase
            state = plant.step(command, varied.dt)
            time = state.time
            if getattr(plant, "fallen", False):
                return Cell(values, False, time, steps, f"fell in {phase.name}")
    except DqwalkError as error:
        return Cell(values, False, time, steps, str(error))


class Kept:
    """The cells that were walked, a line each in a file, so that a run that was stopped goes on from there.

    Parameters
    ----------
    path : path-like
    config : Config
        The walk that is varied.
    force : bool
        Begin anew whatever is there.

    Raises
    ------
    ConfigError
        If the file holds cells of another walk.
    """

    def __init__(self, path: str | os.PathLike[str], config: Config, *, force: bool = False) -> None:
        self._path = Path(path)
        self._done: dict[tuple[tuple[str, float], ...], Cell] = {}
        walk = hashlib.sha256(to_yaml(config).encode()).hexdigest()[:16]
        if self._path.exists() and not force:
            text = self._path.read_text(encoding="utf-8")
            first, *lines = text.splitlines() or [""]
            if first != json.dumps({"walk": walk}):
                raise ConfigError(
                    f"'{self._path}' holds cells of another walk; choose another folder with --out, or replace it "
                    "with --force"
                )
            for line in lines:
                try:
                    cell = Cell(**json.loads(line))
                except (ValueError, TypeError):
                    continue  # the last line of a run that was killed
                self._done[tuple(cell.values.items())] = cell
            if not text.endswith("\n"):
                with self._path.open("a", encoding="utf-8") as file:
                    file.write("\n")
        else:
            self._path.write_text(json.dumps({"walk": walk}) + "\n", encoding="utf-8")

    def get(self, values: Mapping[str, float]) -> Cell | None:
        """Return the cell of a combination; None if it was not walked."""
        return self._done.get(tuple(values.items()))

    def stood(self, values: Mapping[str, float]) -> bool:
        """Return whether a combination was walked and stood."""
        cell = self.get(values)
        return cell is not None and cell.stood

    def add(self, cell: Cell) -> None:
        """Keep a cell."""
        self._done[tuple(cell.values.items())] = cell
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(dataclasses.asdict(cell)) + "\n")


def run(
    config: Config,
    combinations: Sequence[Mapping[str, float]],
    *,
    jobs: int = 1,
    kept: Kept | None = None,
    progress: Callable[[int, Cell], None] | None = None,
) -> list[Cell]:
    """Walk every combination, `jobs` at a time in processes of their own, and return the cells in order.

    They are walked in a random order, so that what is there when the run is stopped, by Ctrl-C, is a fair sample.

    Parameters
    ----------
    config : Config
    combinations : sequence of mapping
    jobs : int
    kept : Kept, optional
        What is there already is not walked again, what is walked goes there.
    progress : callable, optional
        Called with the number of cells done and the last one.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # for the processes that are about to start
    out: dict[int, Cell] = {}
    for k, values in enumerate(combinations):
        if kept is not None and (cell := kept.get(values)) is not None:
            out[k] = cell
    missing = [k for k in range(len(combinations)) if k not in out]
    random.Random(0).shuffle(missing)
    if missing:
        with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
            asked = {pool.submit(walk, config, combinations[k]): k for k in missing}
            try:
                for future in as_completed(asked):
                    cell = out[asked[future]] = future.result()
                    if kept is not None:
                        kept.add(cell)
                    if progress is not None:
                        progress(len(out), cell)
            except KeyboardInterrupt:
                pool.shutdown(wait=False, cancel_futures=True)
    return [out[k] for k in sorted(out)]
