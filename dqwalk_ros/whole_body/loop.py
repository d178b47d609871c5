"""The closed loop of controller and plant, live or from what was recorded of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np

from dqwalk_ros.errors import DqwalkError
from dqwalk_ros.provenance import here
from dqwalk_ros.robot import Foot
from dqwalk_ros.whole_body.controller import WholeBodyController
from dqwalk_ros.whole_body.records import BodyCommand, BodyState, BodyTick, Wrench
from dqwalk_ros.whole_body.scenario import Scenario, Timed
from dqwalk_ros.whole_body.trace import FEET, BodyLog, Collector, Reaching, Reaction

__all__ = ["BodyPlant", "follow", "retrace"]

_LOW = 0.2
"""A robot whose CoM is lower than it should be by this fraction of its height has fallen."""
_LEANS = 1.0
"""So has one whose torso leans by this much [rad], even if it bends its legs so that the CoM stays where it is."""

Progress = Callable[[float, str], None]
"""Told the fraction done, and some text."""


class BodyPlant(Protocol):
    """A body that takes torques and pushes."""

    @property
    def state(self) -> BodyState:
        """The state now."""

    @property
    def wrenches(self) -> Mapping[Foot, Wrench]:
        """What the ground did to the feet; empty where that is not judged."""

    def step(self, command: BodyCommand, dt: float) -> BodyState:
        """Return the state one period later."""

    def push(self, impulse: tuple[float, float, float]) -> None:
        """Hit the robot [N s]."""


class _Targets:
    """Leads the hand, and notes how the preview reacts in the tick of a jump."""

    def __init__(self, controller: WholeBodyController, targets: tuple[Timed, ...], notes: list[Reaction]) -> None:
        self._controller, self._left, self._notes = controller, sorted(targets, key=lambda timed: timed[0]), notes
        self._before: tuple[float, ...] | None = None
        self._jumped = False

    def set(self, now: float) -> None:
        """Give the controller the target that is in force."""
        self._jumped = bool(self._left) and self._left[0][0] <= now + 1e-9
        if self._jumped:
            target = self._controller.target
            self._before = None if target is None else tuple(target)
        while self._left and self._left[0][0] <= now + 1e-9:
            self._controller.reach(self._left.pop(0)[1])

    def note(self, now: float, command: BodyCommand) -> None:
        """Compare the preview of this tick with that for the target before, if it has jumped."""
        if self._jumped and now > 0.0:
            moved = self._controller.last.footsteps - self._controller.footsteps_for(self._before)
            far = tuple(np.linalg.norm(moved, axis=1).tolist())
            self._notes.append(Reaction(now, len(command.stance) == 1, far, self._held()))

    def _held(self) -> bool:
        """Tell whether both coordinates of the next footstep are at a bound of its box."""
        problem, layout, answer = self._controller.hierarchy, self._controller.layout, self._controller.answer
        if problem is None or layout is None or answer is None:
            return False
        next_one = [layout.feet(axis).start for axis in (0, 1)]
        step, level1 = answer.x[next_one], problem.level1
        room = np.minimum(step - level1.lower[next_one], level1.upper[next_one] - step)
        return bool((room < 1e-6).all())


def follow(
    controller: WholeBodyController,
    plant: BodyPlant,
    scenario: Scenario,
    *,
    clock: Callable[[], float] = time.perf_counter,
    progress: Progress | None = None,
    watch: Callable[[WholeBodyController], None] | None = None,
) -> Reaching:
    """Close the loop of controller and plant over a scenario.

    A fall, or a controller or plant that gives up, ends it; what happened until then is returned. `watch` is called
    after each tick of the controller, outside the time that is measured.

    Raises
    ------
    DqwalkError
        If it ends before the first tick.
    """
    config, rows, note = controller.config, Collector(controller, scenario), ""
    targets, pushes = _Targets(controller, scenario.targets, rows.reactions), sorted(scenario.pushes)
    state, begin = plant.state, plant.state.time
    for _ in range(round(scenario.duration / config.dt)):
        now = state.time - begin
        targets.set(now)
        while pushes and pushes[0][0] <= now + 1e-9:
            plant.push(pushes.pop(0)[1])
            state = plant.state
        try:
            began = clock()
            command = controller.step(state, config.dt)
            spent = clock() - began
            if watch is not None:
                watch(controller)
            after = plant.step(command, config.dt)
        except DqwalkError as error:
            note = f"gave up at {now:.3f} s: {error}"
            break
        tick = rows.add(now, state, command, command.effort, plant.wrenches, spent)
        targets.note(now, command)
        if _fallen(controller, tick):
            note = f"fell at {now:.3f} s"
            break
        state = after
        if progress is not None:
            progress(now / scenario.duration, f"{scenario.name}  t = {now:.1f} s")
    if not len(rows):
        raise DqwalkError(f"{scenario.name} ended before it began: {note}")
    return rows.reaching(note, origin=here())


def retrace(
    log: BodyLog, *, clock: Callable[[], float] = time.perf_counter, progress: Progress | None = None
) -> tuple[Reaching, float]:
    """Ask the controller again what it thinks of each recorded state, and judge what was recorded.

    Forces and torques of the result are those of the log. The preview, the slack of (14) and the times are those of
    this controller now.

    Returns
    -------
    reaching : Reaching
    off : float
        Largest difference between a torque that was recorded and the one that this controller answers [N m].

    Raises
    ------
    DqwalkError
        If the controller cannot answer the first state.
    """
    controller = WholeBodyController(log.config, log.model, clock=clock)
    rows, note, off = Collector(controller, log.scenario), "", 0.0
    targets = _Targets(controller, log.scenario.targets, rows.reactions)
    for k, state in enumerate(log.states):
        targets.set(state.time)
        try:
            began = clock()
            command = controller.step(state, log.config.dt)
            spent = clock() - began
        except DqwalkError as error:
            note = f"gave up at {state.time:.3f} s: {error}"
            break
        wrenches = {
            foot: Wrench(row[:3], row[3:])
            for foot, row in zip(FEET, log.wrenches[k], strict=True)
            if np.isfinite(row).all()
        }
        tick = rows.add(state.time, state, command, log.effort[k], wrenches, spent)
        targets.note(state.time, command)
        off = max(off, float(np.abs(command.effort - log.effort[k]).max()))
        if _fallen(controller, tick):
            note = f"fell at {state.time:.3f} s"
            break
        if progress is not None:
            progress(k / len(log.states), f"solving again  t = {state.time:.1f} s")
    if not len(rows):
        raise DqwalkError(f"{log.scenario.name} ended before it began: {note}")
    return rows.reaching(note, again=True, origin=log.origin), off


def _fallen(controller: WholeBodyController, tick: BodyTick) -> bool:
    return abs(tick.height_error) > _LOW * controller.point_mass.height or tick.tilt > _LEANS
