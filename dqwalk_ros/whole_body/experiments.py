"""The experiments of section VII [Sherikov2014]: the closed loop over a scenario, and the replay of a recorded walk."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.robot.model import RobotModel, load_model
from dqwalk_ros.simulation import closed_loop
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ConfigError, DqwalkError
from dqwalk_ros.whole_body.controller import BodyCommand, BodyState, WholeBodyController
from dqwalk_ros.whole_body.rigid_plant import BodyPlant, RigidPlant
from dqwalk_ros.whole_body.scenario import Scenario
from dqwalk_ros.whole_body.trace import BodyLog, BodyRecorder, Reaction, WholeBodyTrace

PLANTS = ("rigid", "physics")
"""Plants: rigid bodies on rigid ground, or MuJoCo."""

Progress = Callable[[float, str], None]
"""Callback with the fraction done and a line of text."""


def make_body_plant(name: str, config: Config, model: RobotModel, state: BodyState) -> BodyPlant:
    """Return a plant of `PLANTS` in a state.

    Raises
    ------
    ConfigError
        If there is no such plant.
    """
    torso = config.whole_body.torso
    if name == "physics":
        from dqwalk_ros.whole_body.torque_plant import TorquePlant

        return TorquePlant(model, state, pushed=torso)
    if name == "rigid":
        return RigidPlant(model, state, pushed=torso, damping=config.whole_body.contact_damping)
    raise ConfigError(f"there is no plant '{name}': {', '.join(PLANTS)}")


def follow(
    controller: WholeBodyController, plant: BodyPlant, scenario: Scenario, *, progress: Progress | None = None
) -> WholeBodyTrace:
    """Run the closed loop of controller and plant over a scenario and return its trace.

    A fall, or an error of controller or plant, ends the walk; the trace then contains the walk up to this time.

    Raises
    ------
    DqwalkError
        If the walk ends before the first control period.
    """
    dt, begin, rows, note = controller.config.dt, plant.state.time, BodyRecorder(controller, scenario), ""
    targets, pushes = sorted(scenario.targets), sorted(scenario.pushes)
    replaced: list[Array | None] = []  # targets that were replaced in this period

    def act(now: float) -> None:
        replaced.clear()
        while targets and targets[0][0] <= now + 1e-9:
            replaced.append(controller.target)
            controller.reach(targets.pop(0)[1])
        while pushes and pushes[0][0] <= now + 1e-9:
            plant.push(pushes.pop(0)[1])

    try:
        for state, _ in closed_loop(controller, plant, act, round(scenario.duration / dt)):
            now = state.time - begin
            rows.add(state, plant)
            if replaced and now > 0.0:
                rows.reactions.append(_reaction(now, controller, replaced[0]))
            if controller.finished:
                note = f"fell at {now:.3f} s"
            elif progress is not None:
                progress(now / scenario.duration, f"{scenario.name}  t = {now:.1f} s")
    except DqwalkError as error:
        note = f"gave up at {plant.state.time - begin:.3f} s: {error}"
    return rows.trace(plant, note)


def _reaction(now: float, controller: WholeBodyController, before: Array | None) -> Reaction:
    """Compare the preview of this period with that for the previous target."""
    tick, scene, h = controller.last, controller.last.scene, controller.last.problem
    moved = np.linalg.norm(tick.footsteps - controller.footsteps_for(before), axis=1)
    first = [scene.layout.y(axis).start + scene.preview.feet.start for axis in (0, 1)]
    x = tick.answer.x[first]
    held = bool((np.minimum(x - h.lower[first], h.upper[first] - x) < 1e-6).all())
    return Reaction(now, scene.swing is not None, tuple(moved.tolist()), held)


def walk(
    config: Config, scenario: Scenario, plant: str = "rigid", *, progress: Progress | None = None
) -> WholeBodyTrace:
    """Run a scenario on one of `PLANTS` and return the trace, whose `times` are CPU time of this process."""
    model = load_model(config.robot)
    controller = WholeBodyController(config, model, clock=time.process_time)
    body = make_body_plant(plant, config, model, controller.start)
    return follow(controller, body, scenario, progress=progress)


# ---------------------------------------------------------------------- recorded walks


def retrace(log: BodyLog, *, progress: Progress | None = None) -> tuple[WholeBodyTrace, float]:
    """Solve the problem of the controller again for each recorded state.

    Forces and torques of the returned trace are the recorded ones. The preview, the residual of (S14) and the times are
    those of the new solution.

    Returns
    -------
    trace : WholeBodyTrace
    off : float
        Largest difference between recorded and newly computed torques [N m].

    Raises
    ------
    DqwalkError
        If the problem of the first state cannot be solved.
    """
    plant = _RecordedPlant(log)
    controller = WholeBodyController(log.config, log.model)
    walked = follow(controller, plant, log.scenario, progress=progress)
    return replace(walked, again=True, origin=log.origin, notes=log.notes), plant.off


class _RecordedPlant(BodyPlant):
    """A plant that returns the recorded states and forces, regardless of the command."""

    def __init__(self, log: BodyLog) -> None:
        super().__init__(log.state(0))
        self._log, self.off = log, 0.0

    def _move(self, command: BodyCommand, time: float, dt: float) -> None:
        done = self._periods - 1
        self.effort = self._log.effort[done]
        self.off = max(self.off, float(np.abs(command.effort - self.effort).max()))
        rows = zip(Foot, self._log.wrenches[done], strict=True)
        self.wrenches = {foot: row for foot, row in rows if np.isfinite(row).all()}
        if self._periods < len(self._log):
            self.state = self._log.state(self._periods)
        else:
            self.state = replace(self.state, time=self.state.time + dt)

    def _hit(self, impulse: Array) -> None:
        """Do nothing: the recorded states contain the effect of the push."""
