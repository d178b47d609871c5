"""How hard may the robot be pushed? The largest impulse that it survives, for each direction, by bisection."""

from __future__ import annotations

import math
import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.controller import VelocityController
from dqwalk_ros.errors import DqwalkError, PlantError
from dqwalk_ros.robot import Foot, load_model
from dqwalk_ros.simulation import make_controller, make_plant
from dqwalk_ros.walk import PhaseKind

__all__ = ["MOMENTS", "Limit", "Push", "limit", "limits", "pushed"]

MOMENTS = ("standing", "left", "right")
"""In a stance on both feet, or in the middle of a step on the left or on the right foot."""

_STANDS = 3.0
"""So long it must stand after a push in a stance [s]."""
_SOON = 5.0
"""A stance that is not there this long after its time does not come [s]."""


@dataclass(frozen=True)
class Push:
    """A force on the pelvis.

    Attributes
    ----------
    moment : str
        One of `MOMENTS`.
    direction : float
        Where it pushes to, 0 ahead, a right angle to the left [rad].
    impulse : float
        [N s]
    duration : float
        [s]
    """

    moment: str
    direction: float
    impulse: float
    duration: float = 0.1


@dataclass(frozen=True)
class Limit:
    """What was found in one direction.

    Attributes
    ----------
    moment : str
    direction : float
        [rad]
    survived, failed : float
        Largest impulse survived and least that was not, which are less than the tolerance apart [N s].
    reason : str
        What ended the walk at `failed`.
    """

    moment: str
    direction: float
    survived: float
    failed: float
    reason: str


def pushed(config: Config, push: Push) -> str:
    """Walk with one push; return why it did not survive, an empty text if it did.

    Raises
    ------
    PlantError
        If the walk ends, or falls, before it is pushed.
    """
    standing = push.moment == "standing"
    values: dict[str, object] = {"gait.steps": 0 if standing else 2}
    if not standing:  # the second step is on the foot that is asked for
        values["gait.first_support"] = Foot(push.moment).other.value
    varied = config.updated(values)
    model = load_model(varied.robot)
    controller, plant = make_controller(varied, model), make_plant("physics", varied, model)
    push_force = getattr(plant, "push", None)
    if push_force is None:
        raise PlantError("this plant cannot be pushed")
    force = push.impulse / push.duration * np.array([math.cos(push.direction), math.sin(push.direction), 0.0])
    state, began, why, s = plant.state, math.inf, "", varied.standing
    while True:
        try:
            command = controller.step(state, varied.dt)
        except DqwalkError as error:
            why = str(error)
        if controller.finished or why:
            break
        if began == math.inf and _due(controller, state.time, standing=standing):
            began = state.time
        push_force(force if began <= state.time < began + push.duration - 1e-9 else np.zeros(3))
        state = plant.step(command, varied.dt)
        if getattr(plant, "fallen", False):
            why = f"fell in {controller.phase.name}"
            break
        if standing and state.time > min(began, s.transfer_duration + _SOON) + _STANDS:
            break
    if began == math.inf:
        raise PlantError(f"the walk ended before it was pushed{': ' + why if why else ''}")
    return why


def _due(controller: VelocityController, time: float, *, standing: bool) -> bool:
    """Return whether the moment of the push has come."""
    since, s = time - controller.phase_time0, controller.config.standing
    if standing:
        return since >= s.transfer_duration
    second = controller.phase_index == 3 and controller.phase.kind is PhaseKind.SINGLE_SUPPORT
    return second and since >= 0.5 * s.swing_duration


def limit(
    config: Config, moment: str, direction: float, *, duration: float = 0.1, tolerance: float = 0.02, most: float = 4.0
) -> Limit:
    """Find the largest impulse that is survived, by bisection between zero and `most` [N s]."""
    low, high, reason = 0.0, most, ""
    step = 0.25
    while low < most:  # upwards first: the answer is seldom far from the ground
        tried = min(max(2.0 * low, step), most)
        reason = pushed(config, Push(moment, direction, tried, duration))
        if reason:
            high = tried
            break
        low = tried
    while reason and high - low > tolerance:
        tried = 0.5 * (low + high)
        why = pushed(config, Push(moment, direction, tried, duration))
        if why:
            high, reason = tried, why
        else:
            low = tried
    return Limit(moment, direction, low, high if reason else math.inf, reason)


def limits(
    config: Config,
    moments: Sequence[str] = MOMENTS,
    directions: int = 8,
    *,
    duration: float = 0.1,
    tolerance: float = 0.02,
    jobs: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> list[Limit]:
    """Find the limit of every moment and direction, `jobs` at a time in processes of their own.

    Parameters
    ----------
    config : Config
    moments : sequence of str
        Of `MOMENTS`.
    directions : int
        So many, evenly spread.
    duration : float
        Of each push [s].
    tolerance : float
        [N s]
    jobs : int
    progress : callable, optional
        Called with how many are done and how many there are.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # for the processes that are about to start
    asked = [(moment, 2.0 * math.pi * k / directions) for moment in moments for k in range(directions)]
    out: dict[int, Limit] = {}
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        futures = {
            pool.submit(limit, config, moment, direction, duration=duration, tolerance=tolerance): k
            for k, (moment, direction) in enumerate(asked)
        }
        for future in as_completed(futures):
            out[futures[future]] = future.result()
            if progress is not None:
                progress(len(out), len(asked))
    return [out[k] for k in range(len(asked))]
