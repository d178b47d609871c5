"""Replay of the commands of a recorded exercise on a simulated robot, to validate identified servo parameters."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dqwalk_ros.config import Config, SensorsConfig
from dqwalk_ros.identification.exercise import NAME
from dqwalk_ros.paper.state import Command
from dqwalk_ros.plants.mujoco import PhysicsPlant
from dqwalk_ros.robot.model import parse_model
from dqwalk_ros.robot.servos import Servos
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import BagError
from dqwalk_ros.trace import Trace
from dqwalk_ros.walks.table import make_walk

_SHOWN = 100
"""Number of progress reports."""


def require_exercise(trace: Trace) -> None:
    """Raise BagError if a recording is not an exercise."""
    if trace.config.gait.walk != NAME:
        raise BagError(
            "this bag is not an exercise but a walk, in which ground reaction forces prevent the identification of "
            "servos; record an exercise with `dqwalk exercise`"
        )


def replay(trace: Trace, config: Config, progress: Callable[[float, str], None] | None = None) -> Array:
    """Simulate the commands of an exercise on a robot whose servos are those assumed in `config`.

    Parameters
    ----------
    trace : Trace
        An exercise of N states.
    config : Config
        Configuration of the exercise, with ``servo.assumed`` and the mass of the simulated robot.
    progress : callable, optional
        Called with the completed fraction and a line of text.

    Returns
    -------
    ndarray, shape (N, n)
        Joint angles of the simulated robot [rad].

    Raises
    ------
    BagError
        If the recording is not an exercise.
    """
    require_exercise(trace)
    model, u = parse_model(trace.model.urdf, config.robot), np.nan_to_num(trace.u)
    # here the whole delay acts on the commands, and a goal is written at the beginning of its period
    late = {"servo.latency": config.servo.assumed_latency + 0.5 * config.dt, "servo.rate": 0.0}
    made = config.updated(late | {f"sensors.{name}": value for name, value in vars(SensorsConfig()).items()})
    plant = PhysicsPlant(made, model, make_walk(made, model).posture, Servos.identified(made, model))
    out = np.empty_like(trace.q)
    out[0] = plant.state.q
    for k in range(len(trace) - 1):
        out[k + 1] = plant.step(Command(float(trace.time[k]), u[k]), float(trace.time[k + 1] - trace.time[k])).q
        if progress is not None and k % max(1, len(trace) // _SHOWN) == 0:
            progress(k / len(trace), f"{trace.time[k]:.0f} s")
    return out
