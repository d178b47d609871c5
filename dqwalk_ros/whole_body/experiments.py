"""The experiments of section VII [Sherikov2014]: Tests 1 and 2, the closed loop, and how hard a push may be."""

from __future__ import annotations

import math
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, TypeVar

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.errors import ConfigError, DqwalkError
from dqwalk_ros.provenance import here
from dqwalk_ros.robot import Foot, RobotModel, load_model
from dqwalk_ros.whole_body.controller import BodyCommand, BodyState, WholeBodyController, Wrench
from dqwalk_ros.whole_body.rigid_plant import RigidPlant
from dqwalk_ros.whole_body.trace import FEET, Array, BodyLog, Collector, Reaction, Scenario, Timed, WholeBodyTrace

__all__ = [
    "DIRECTIONS",
    "PAPER_TIMES",
    "PLANTS",
    "SCENARIOS",
    "BodyPlant",
    "PushLimit",
    "Walk",
    "each",
    "fitted",
    "follow",
    "make_body_plant",
    "push_limit",
    "retrace",
    "walk",
]

_TARGETS = ((0.0, (1.2, -0.8, 0.9)), (4.6, (2.0, -0.8, 0.9)), (6.25, (2.0, -0.2, 0.9)), (8.0, (1.8, -0.4, 0.9)))
_PUSHES = ((2.5, (0.0, 15.0, 0.0)), (7.0, (-15.0, 0.0, 0.0)))
SCENARIOS = {
    "1": Scenario("Test 1", 14.0, _TARGETS),
    "2": Scenario("Test 2", 14.0, _TARGETS, _PUSHES),
}
"""The paper's tests, with the times of the thesis, where the target jumps in mid-swing."""
PAPER_TIMES = ((0.0, (1.2, -0.8, 0.9)), (4.0, (2.0, -0.8, 0.9)), (8.0, (1.8, -0.4, 0.9)))
"""The targets at the times that the paper's text has."""
_HEIGHT, _MASS, _STEP = 0.73, 58.0, 0.8
"""CoM height and mass of the robot that the tests are for, and the duration of its steps [m, kg, s]."""
PLANTS = ("rigid", "physics")
"""What closes the loop: rigid bodies on rigid ground, or MuJoCo."""

_LOW = 0.2
"""A robot whose CoM is off its height by this fraction of it has fallen."""
_LEANS = 1.0
"""So has one whose torso leans by this much [rad], even if it bends its legs so that the CoM stays where it is."""

Progress = Callable[[float, str], None]
"""Called with the fraction done, and some text."""


def fitted(scenario: Scenario, controller: WholeBodyController) -> Scenario:
    """Return a test for a robot of any size: places scale with its CoM height h, impulses with m sqrt(h).

    Times scale with the duration of its steps.

    A robot within 2 % of the size and weight that the test is for, and as fast, gets the test as it is.
    """
    size = controller.point_mass.height / _HEIGHT
    impulse = controller.weight / (_MASS * controller.point_mass.gravity) * math.sqrt(size)
    slow = controller.stepping.period / _STEP
    if max(abs(size - 1.0), abs(impulse - 1.0), abs(slow - 1.0)) < 0.02:
        return scenario
    targets = tuple((slow * when, (size * x, size * y, size * z)) for when, (x, y, z) in scenario.targets)
    pushes = tuple((slow * when, (impulse * x, impulse * y, impulse * z)) for when, (x, y, z) in scenario.pushes)
    return replace(scenario, duration=slow * scenario.duration, targets=targets, pushes=pushes, size=size)


# ---------------------------------------------------------------------- the closed loop


class BodyPlant(Protocol):
    """A body that takes torques and pushes."""

    @property
    def state(self) -> BodyState:
        """The state now."""

    @property
    def effort(self) -> Array:
        """The joint torques of the last period, shape (n,) [N m]."""

    @property
    def wrenches(self) -> Mapping[Foot, Wrench]:
        """What the ground did to the feet in the last period; empty where that is not judged."""

    def step(self, command: BodyCommand, dt: float) -> BodyState:
        """Return the state one period later."""

    def push(self, impulse: tuple[float, float, float]) -> None:
        """Hit the robot [N s]."""


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
    controller: WholeBodyController,
    plant: BodyPlant,
    scenario: Scenario,
    *,
    clock: Callable[[], float] = time.perf_counter,
    progress: Progress | None = None,
    watch: Callable[[WholeBodyController], None] | None = None,
) -> WholeBodyTrace:
    """Close the loop of controller and plant over a scenario.

    A fall, or an error of controller or plant, ends it; what happened until then is returned. `watch` is called
    after each tick of the controller, outside the time that is measured.

    Raises
    ------
    DqwalkError
        If it ends before the first tick.
    """
    dt, note, rows = controller.config.dt, "", Collector(controller, scenario)
    targets, pushes = sorted(scenario.targets), sorted(scenario.pushes)
    state, begin = plant.state, plant.state.time
    for _ in range(round(scenario.duration / dt)):
        now, before, jumped = state.time - begin, controller.target, False
        while targets and targets[0][0] <= now + 1e-9:
            controller.reach(targets.pop(0)[1])
            jumped = now > 0.0
        while pushes and pushes[0][0] <= now + 1e-9:
            plant.push(pushes.pop(0)[1])
            state = plant.state
        try:
            began = clock()
            command = controller.step(state, dt)
            spent = clock() - began
            if watch is not None:
                watch(controller)
            after = plant.step(command, dt)
        except DqwalkError as error:
            note = f"gave up at {now:.3f} s: {error}"
            break
        rows.add(state, plant.effort, plant.wrenches, spent)
        if jumped:
            rows.reactions.append(_reaction(now, controller, before))
        if _fallen(controller):
            note = f"fell at {now:.3f} s"
            break
        state = after
        if progress is not None:
            progress(now / scenario.duration, f"{scenario.name}  t = {now:.1f} s")
    if not len(rows):
        raise DqwalkError(f"{scenario.name} ended before its first tick: {note}")
    recorded = plant if isinstance(plant, _RecordedPlant) else None
    return rows.trace(note, again=recorded is not None, origin=recorded.log.origin if recorded else here())


def retrace(
    log: BodyLog, *, clock: Callable[[], float] = time.perf_counter, progress: Progress | None = None
) -> tuple[WholeBodyTrace, float]:
    """Ask the controller again for its answer to each recorded state, and return what was recorded beside it.

    Forces and torques of the result are those of the log. The preview, the slack of (S14) and the times are those of
    this controller now.

    Returns
    -------
    trace : WholeBodyTrace
    off : float
        Largest difference between a torque that was recorded and the one that this controller answers [N m].

    Raises
    ------
    DqwalkError
        If the controller cannot answer the first state.
    """
    plant = _RecordedPlant(log)
    controller = WholeBodyController(log.config, log.model, clock=clock)
    return follow(controller, plant, log.scenario, clock=clock, progress=progress), plant.off


class _RecordedPlant:
    """A plant that does what it did when it was recorded, whatever the command."""

    def __init__(self, log: BodyLog) -> None:
        self.log, self._next = log, 0
        self.off = 0.0

    @property
    def state(self) -> BodyState:
        return self.log.states[min(self._next, len(self.log.states) - 1)]

    @property
    def effort(self) -> Array:
        effort: Array = self.log.effort[self._next - 1]
        return effort

    @property
    def wrenches(self) -> Mapping[Foot, Wrench]:
        rows = zip(FEET, self.log.wrenches[self._next - 1], strict=True)
        return {foot: Wrench(row[:3], row[3:]) for foot, row in rows if np.isfinite(row).all()}

    def step(self, command: BodyCommand, dt: float) -> BodyState:
        self._next += 1
        self.off = max(self.off, float(np.abs(command.effort - self.effort).max()))
        return self.state

    def push(self, impulse: tuple[float, float, float]) -> None:
        """Do nothing: the recorded states contain the push."""


def _reaction(now: float, controller: WholeBodyController, before: Array | None) -> Reaction:
    """Compare the preview of this tick with that for the target before."""
    tick, scene, h = controller.last, controller.scene, controller.hierarchy
    moved = np.linalg.norm(tick.footsteps - controller.footsteps_for(before), axis=1)
    first = [scene.layout.y(axis).start + scene.preview.feet.start for axis in (0, 1)]
    x = tick.answer.x[first]
    held = h is not None and bool((np.minimum(x - h.lower[first], h.upper[first] - x) < 1e-6).all())
    return Reaction(now, scene.swing is not None, tuple(moved.tolist()), held)


def _fallen(controller: WholeBodyController) -> bool:
    tick = controller.last
    return abs(tick.height_error) > _LOW * controller.point_mass.height or tick.tilt > _LEANS


# ---------------------------------------------------------------------- many walks


@dataclass(frozen=True)
class Walk:
    """A walk to be made.

    Attributes
    ----------
    scenario : Scenario
    changes : mapping of str to value
        Of the configuration, such as ``{"whole_body.friction": 0.4}``.
    plant : str
    """

    scenario: Scenario
    changes: Mapping[str, Any] = field(default_factory=dict)
    plant: str = "rigid"


def walk(
    config: Config,
    wanted: Walk,
    progress: Progress | None = None,
    watch: Callable[[WholeBodyController], None] | None = None,
) -> WholeBodyTrace:
    """Make a walk; its times are CPU time of this process."""
    config = config.updated(dict(wanted.changes))
    model = load_model(config.robot)
    clock = time.process_time
    controller = WholeBodyController(config, model, clock=clock)
    plant = make_body_plant(wanted.plant, config, model, controller.start)
    return follow(controller, plant, wanted.scenario, clock=clock, progress=progress, watch=watch)


_Key = TypeVar("_Key")
_Result = TypeVar("_Result")


def each(
    task: Callable[..., _Result], asked: Mapping[_Key, tuple[Any, ...]], jobs: int
) -> Iterator[tuple[_Key, _Result]]:
    """Yield what `task` returns for each of the named arguments, as it comes, `jobs` processes at a time."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # for the processes that are about to start
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        futures = {pool.submit(task, *arguments): key for key, arguments in asked.items()}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            for future in futures:
                future.cancel()


# ---------------------------------------------------------------------- pushes

DIRECTIONS = {
    "ahead": 0.0,
    "ahead, left": 45.0,
    "left": 90.0,
    "back, left": 135.0,
    "back": 180.0,
    "back, right": 225.0,
    "right": 270.0,
    "ahead, right": 315.0,
}
"""Where the push sends the robot, as an angle from ahead to the left [deg]."""
_FIRST = 8.0
"""The first impulse that is tried [N s]."""
_MOST = 256.0
"""Harder is not tried [N s]."""


@dataclass(frozen=True)
class PushLimit:
    """The hardest push that was survived in one direction.

    Attributes
    ----------
    direction : float
        [deg]
    stood, fell : float
        The largest impulse that was survived, and the least one tried that was not [N s].
    tried : tuple of (float, bool)
        Every impulse, and whether the robot stood.
    """

    direction: float
    stood: float
    fell: float
    tried: tuple[tuple[float, bool], ...]


def push_limit(
    config: Config,
    direction: float,
    plant: str = "physics",
    when: float = 2.5,
    exact: float = 1.0,
    *,
    after: float = 4.0,
    targets: tuple[Timed, ...] = (),
) -> PushLimit:
    """Double an impulse until the robot falls, then bisect.

    Between the two impulses it is taken for granted that a robot which survives a push survives every lesser one.

    Parameters
    ----------
    config : Config
    direction : float
        [deg]
    plant : str
    when : float
        When the torso is hit [s].
    exact : float
        The two impulses are no further apart than this [N s].
    after : float
        How long the robot must stand after it is hit [s].
    targets : tuple
        Of the hand; without them the robot walks in place.
    """
    angle = math.radians(direction)
    tried: dict[float, bool] = {}

    def stands(impulse: float) -> bool:
        push = (when, (impulse * math.cos(angle), impulse * math.sin(angle), 0.0))
        scenario = Scenario(f"{impulse:g} N s", when + after, targets, (push,))
        tried[impulse] = walk(config, Walk(scenario, plant=plant)).stood
        return tried[impulse]

    stood, fell = 0.0, _FIRST
    while fell <= _MOST and stands(fell):
        stood, fell = fell, 2.0 * fell
    while fell - stood > exact:
        middle = 0.5 * (stood + fell)
        if stands(middle):
            stood = middle
        else:
            fell = middle
    return PushLimit(direction, stood, fell, tuple(sorted(tried.items())))
