"""The closed loop of controller and plant in one process, without ROS."""

from __future__ import annotations

import contextlib
import itertools
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.controller import VelocityController
from dqwalk_ros.estimation.base import BaseEstimator
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.paper.state import Estimate
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.plants.base import Plant
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.errors import DqwalkError
from dqwalk_ros.support.interrupts import deferred_interrupts, is_interrupt
from dqwalk_ros.trace import Trace, TraceRecorder
from dqwalk_ros.walks.table import make_controller, make_walk, walk_type

_WARM_UP = 3.0
"""Longest time that a walk to compile its functions lasts [s]."""
_WARM_PHASES = 5
"""Index of the phase at which it ends: after a stance, both double supports and a single support."""
_REPORT_EVERY = 0.1
"""Period of the calls of `progress` [s]."""


def warm_up(config: Config, model: RobotModel) -> None:
    """Compile all functions used in a control period, so that no state is answered late.

    A walk with an inertial sensor takes its first steps on ideal joints, for at most `_WARM_UP`. In single support it
    measures an angular velocity, as after a push, so that it adjusts the step. A steered walk takes two steps. Of a
    walk without this sensor, which may last minutes, each phase is evaluated once, in the first posture.
    """
    with contextlib.suppress(DqwalkError):
        config = config.updated({"gait.steps": config.gait.steps or 2, "gait.footsteps": ()})
        controller, plant = make_controller(config, model), KinematicPlant(model, make_walk(config, model).posture)
        state, effort, gyro = plant.state, np.zeros(model.n), np.zeros(3)
        kin = Kinematics(model, state.q, Foot.LEFT)
        if not config.plant.imu:
            controller.step(replace(state, dq=np.zeros(model.n), effort=effort), config.dt)
            controller.reset()  # and prepares the walk
            walk, phase = controller.walk, None
            for _ in range(_WARM_PHASES):
                if (begins := walk.following(phase, kin)) is not None:
                    phase = walk.phase(begins.kind, begins.support, state.q, begins.swing_target)
                    kin = Kinematics(model, state.q, phase.base)
                    walk.observe(phase, kin, Estimate(state.time, state.q))
                    phase.evaluate(state.q, kin.up, 0.0, config.dt, model.velocity_max)
            return
        estimator = BaseEstimator(config, model)
        for k in range(2):
            estimator.update(k * config.dt, kin, np.zeros(3), np.array([0.0, 0.0, GRAVITY]), both=True)
        while controller.phase_index < _WARM_PHASES and plant.state.time < _WARM_UP:
            up = np.array([kin.direction(model.imu, axis)[2] for axis in np.eye(3)])  # of soles on level ground
            command = controller.step(replace(plant.state, up=up, gyro=gyro, effort=effort), config.dt)
            plant.step(command, config.dt)
            effort = effort if command.effort is None else command.effort
            gyro = np.full(3, 0.3 if controller.phase.kind is PhaseKind.SINGLE_SUPPORT else 0.0)
            kin = Kinematics(model, plant.state.q, controller.phase.base)


class _Controller(Protocol):
    config: Config

    @property
    def finished(self) -> bool: ...

    def step(self, state: Any, dt: float) -> Any: ...


class _Plant(Protocol):
    @property
    def state(self) -> Any: ...

    @property
    def fallen(self) -> bool: ...

    def step(self, command: Any, dt: float) -> Any: ...


def closed_loop(
    controller: _Controller,
    plant: _Plant,
    before_step: Callable[[float], None] | None = None,
    periods: int | None = None,
) -> Iterator[tuple[Any, Any]]:
    """Run the closed loop, and yield each state with its command, until the walk is finished or the robot has fallen.

    Parameters
    ----------
    controller : VelocityController or WholeBodyController
    plant : Plant or BodyPlant
    before_step : callable, optional
        Called before each step with the time since the start [s]; it may steer, stop or push.
    periods : int, optional
        Number of periods after which the loop ends.

    Raises
    ------
    DqwalkError
        Any error of controller and plant.
    KeyboardInterrupt
        On Ctrl-C, in the middle of a step; `simulate` completes the step.
    """
    dt = controller.config.dt
    begin = plant.state.time
    try:
        for _ in itertools.count() if periods is None else range(periods):
            if before_step is not None:
                before_step(plant.state.time - begin)
            state = plant.state
            command = controller.step(state, dt)
            yield state, command
            if controller.finished or plant.fallen:
                return
            plant.step(command, dt)
    except SystemError as error:
        if is_interrupt(error):
            raise KeyboardInterrupt from error
        raise


def simulate(
    controller: VelocityController,
    plant: Plant,
    *,
    progress: Callable[[float, str], None] | None = None,
    max_time: float | None = None,
    before_step: Callable[[float], None] | None = None,
    whole: bool = False,
) -> Trace:
    """Run the closed loop until the walk is finished, and record it.

    Parameters
    ----------
    progress : callable, optional
        Called about ten times a second with the fraction of phases done and a line of text.
    max_time : float, optional
        Simulated time after which the walk is stopped [s].
    before_step : callable, optional
        See `closed_loop`.
    whole : bool
        Ctrl-C is a KeyboardInterrupt, for walks that count only as a whole.

    Returns
    -------
    Trace
        The walk up to its end, `max_time`, a fall, Ctrl-C, or an error of the controller. The last three are described
        in its notes.
    """
    config = controller.config
    recorder = TraceRecorder(config, controller.model)
    warned = False

    def watch(elapsed: float) -> None:
        nonlocal warned
        if plant.warning and not warned:
            warned = True
            recorder.note(f"the plant has asked for the end of the walk: {plant.warning}")
            controller.stop()
        if before_step is not None:
            before_step(elapsed)

    end = math.inf if max_time is None else plant.state.time + max_time - 0.5 * config.dt
    total = walk_type(config).phases(config) or math.inf
    due = 0.0
    state = plant.state
    try:
        steps = closed_loop(controller, plant, watch)
        first = next(steps)  # it may compile for a minute, and Ctrl-C acts at once
        with deferred_interrupts() as interrupted:
            for state, command in itertools.chain([first], steps):
                recorder.add(state, command, controller, plant)
                if state.time >= end:
                    break
                if interrupted and whole:
                    raise KeyboardInterrupt
                if interrupted:
                    recorder.note(f"interrupted at {state.time:.3f} s")
                    recorder.interrupted = True
                    break
                if progress is not None and time.monotonic() >= due:
                    due = time.monotonic() + _REPORT_EVERY
                    progress(
                        controller.phase_index / total,
                        f"{controller.phase.name}  t = {state.time:.1f} s  error {controller.error:.4f}",
                    )
        if plant.fallen:
            recorder.note(f"the robot fell in {controller.phase.name} at {state.time:.2f} s")
        elif plant.fault:
            recorder.note(f"no command had an effect at the end: {plant.fault}")
    except DqwalkError as error:
        if controller.phase_index < 0:  # there is nothing to record
            raise
        recorder.note(str(error))
        recorder.add(plant.state, None, controller, plant)
    return recorder.trace()
