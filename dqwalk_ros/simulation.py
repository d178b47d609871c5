"""The closed loop without ROS."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from dqwalk_ros.controllers import Command, Controller
from dqwalk_ros.errors import DqwalkError
from dqwalk_ros.gait import phase_count
from dqwalk_ros.plants import Plant
from dqwalk_ros.trace import Recorder, Trace

__all__ = ["simulate"]

_REPORT_EVERY = 0.1


def simulate(
    controller: Controller,
    plant: Plant,
    *,
    progress: Callable[[float, str], None] | None = None,
    max_time: float | None = None,
    pilot: Callable[[float], None] | None = None,
) -> Trace:
    """Walk until the controller has finished.

    Parameters
    ----------
    controller : Controller
    plant : Plant
    progress : callable, optional
        Called about ten times a second with the fraction of phases done and a line of text.
    max_time : float, optional
        Stop after this time of walking [s].
    pilot : callable, optional
        Called before each step with the time of walking [s]; it may steer or stop the controller.

    Returns
    -------
    Trace
        Up to the end, to `max_time`, to Ctrl-C, or to an error of the controller, which is in its notes.
    """
    config, dt = controller.config, controller.config.dt
    body: Any = plant if hasattr(plant, "truth") and hasattr(plant, "inertial") else None
    falls: Any = plant if hasattr(plant, "fallen") else None
    recorder = Recorder(config, controller.model)
    state = plant.state
    begin = state.time
    end = None if max_time is None else state.time + max_time - 0.5 * config.dt
    total = phase_count(config) or math.inf
    due = 0.0
    try:
        while True:
            command: Command | None
            seen = None if body is None else (body.truth, body.inertial)
            try:
                if pilot is not None:
                    pilot(state.time - begin)
                command = controller.step(state, dt)
            except DqwalkError as error:
                recorder.note(str(error))
                command = None
            recorder.add(state, command, controller, seen)
            if command is None or controller.finished or (end is not None and state.time >= end):
                break
            if falls is not None and falls.fallen:
                recorder.note(f"the robot fell in {controller.phase.name} at {state.time:.2f} s")
                break
            if progress is not None and time.monotonic() >= due:
                due = time.monotonic() + _REPORT_EVERY
                progress(
                    controller.phase_index / total,
                    f"{controller.phase.name}  t = {state.time:.1f} s  error {controller.error:.4f}",
                )
            state = plant.step(command, dt)
    except KeyboardInterrupt:
        recorder.note(f"interrupted at {state.time:.3f} s")
    return recorder.trace()
