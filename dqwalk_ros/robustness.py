"""Does a walk in physics stand when the robot is not the one it was tuned for? One cell per combination."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import random
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass

from dqwalk_ros.config import Config
from dqwalk_ros.controllers import make_controller
from dqwalk_ros.exceptions import DqwalkError
from dqwalk_ros.model import load_model
from dqwalk_ros.plants import make_plant

__all__ = ["AXES", "Cell", "cells", "run", "walk"]

AXES: dict[str, tuple[float, ...]] = {
    "physics.friction": (0.4, 0.8, 1.2),
    "physics.mass_scale": (0.9, 1.0, 1.1),
    "servo.stiffness": (25.0, 40.0, 60.0, 90.0),
    "servo.backlash": (0.0, 0.0058),
    "servo.rate": (0.0, 50.0),
    "servo.latency": (0.0, 0.02, 0.04),
}
"""What is varied; the stiffness is a setting, so the controller knows it, the rest it does not know."""


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
    reason : str
        Why it did not stand.
    """

    values: Mapping[str, float]
    stood: bool
    time: float
    reason: str = ""


def cells(axes: Mapping[str, Sequence[float]], sample: int = 0, seed: int = 0) -> list[dict[str, float]]:
    """Return all combinations of the axes, or `sample` of them drawn at random."""
    every = [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]
    return random.Random(seed).sample(every, sample) if 0 < sample < len(every) else every


def walk(config: Config, values: Mapping[str, float]) -> Cell:
    """Walk one combination in physics, to the end or to the fall."""
    changed = dict(values)
    if "servo.stiffness" in changed and config.servo.assumed_stiffness > 0.0:
        changed.setdefault("servo.assumed_stiffness", changed["servo.stiffness"])
    varied = config.updated(changed)
    model = load_model(varied.robot)
    controller, time = make_controller(varied, model), 0.0
    try:
        plant = make_plant("physics", varied, model)
        state = plant.state
        while True:
            command = controller.step(state, varied.dt)
            if controller.finished:
                return Cell(values, True, state.time)
            state = plant.step(command, varied.dt)
            time = state.time
            if getattr(plant, "fallen", False):
                return Cell(values, False, time, f"fell in {controller.phase.name}")
    except DqwalkError as error:
        return Cell(values, False, time, str(error))


def run(
    config: Config,
    combinations: Sequence[Mapping[str, float]],
    *,
    jobs: int = 1,
    progress: Callable[[int, Cell], None] | None = None,
) -> list[Cell]:
    """Walk every combination, `jobs` at a time in processes of their own, and return the cells in order.

    Parameters
    ----------
    config : Config
    combinations : sequence of mapping
    jobs : int
    progress : callable, optional
        Called with the number of cells done and the last one.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # for the processes that are about to start
    out: dict[int, Cell] = {}
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        asked = {pool.submit(walk, config, values): k for k, values in enumerate(combinations)}
        for future in as_completed(asked):
            out[asked[future]] = future.result()
            if progress is not None:
                progress(len(out), out[asked[future]])
    return [out[k] for k in sorted(out)]
