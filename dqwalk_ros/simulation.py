"""The closed loop of controller and plant without ROS, and the trace that it records."""

from __future__ import annotations

import contextlib
import importlib
import itertools
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.controller import VelocityController
from dqwalk_ros.estimation.base import BaseEstimator
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import Phase, PhaseKind
from dqwalk_ros.paper.state import Command, State
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.paper.walk import PaperWalk, Walk
from dqwalk_ros.plants.base import Inertial, Plant, Truth, orientation_of
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.plants.table import plant_type
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support import provenance
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ConfigError, DqwalkError
from dqwalk_ros.support.interrupts import deferred_interrupts, is_interrupt
from dqwalk_ros.walks.dynamic.recovery import RecoveringWalk
from dqwalk_ros.walks.dynamic.walk import DynamicWalk
from dqwalk_ros.walks.standing.walk import StandingWalk

__all__ = [
    "WALKS",
    "PhaseRecord",
    "PhysicsRecord",
    "Trace",
    "TraceRecorder",
    "closed_loop",
    "known_loads",
    "make_controller",
    "make_plant",
    "make_walk",
    "refuse_foreign_code",
    "simulate",
    "walk_type",
    "warm_up",
]


WALKS: Mapping[str, type[Walk]] = {"paper": PaperWalk, "standing": StandingWalk, "dynamic": DynamicWalk}
"""Class of the walk of each ``gait.style``."""


def walk_type(config: Config) -> type[Walk]:
    """Return the class of the walk that `config` describes: that of ``gait.walk`` if given, else of ``gait.style``.

    Raises
    ------
    ConfigError
        If ``gait.walk`` is not MODULE:CLASS, the class cannot be imported, or it is not a subclass of `Walk`.
    """
    own = config.gait.walk
    if not own:
        recovers = config.gait.style == "standing" and config.gait.recover
        return RecoveringWalk if recovers else WALKS[config.gait.style]
    module, _, name = own.partition(":")
    if not (module and name):
        raise ConfigError(f"gait.walk is '{own}'; it must be MODULE:CLASS")
    try:
        found = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(f"gait.walk is '{own}'; the class cannot be imported: {error}") from error
    if not (isinstance(found, type) and issubclass(found, Walk)):
        raise ConfigError(f"gait.walk is '{own}'; it must be a subclass of dqwalk_ros.paper.walk.Walk")
    return found


def refuse_foreign_code(config: Config, trusted: str = "") -> None:
    """Check a configuration that the user has not chosen, such as that of a recording or of a topic.

    A class is imported from a module, which executes it, so data may name no class but those of this package.

    Parameters
    ----------
    trusted : str
        The value of ``gait.walk`` that the user has given.

    Raises
    ------
    ConfigError
        If ``gait.walk`` names another class.
    """
    own = config.gait.walk
    if own not in ("", trusted) and own.partition(":")[0].partition(".")[0] != "dqwalk_ros":
        raise ConfigError(
            f"the walk is of the class {own!r:.100}, which is not imported because data name it; if you trust it, name "
            f"it yourself: --walk {own[:100]} (a node: -p gait.walk:={own[:100]})"
        )


def make_walk(config: Config, model: RobotModel) -> Walk:
    """Return a new walk as `config` describes it."""
    return walk_type(config)(config, model)


def make_controller(config: Config, model: RobotModel) -> VelocityController:
    """Return a new controller as `config` describes it.

    Raises
    ------
    ConfigError
        As `walk_type`, and if ``gait.recover`` is not the configuration of a dynamic walk.
    """
    return VelocityController(config, model, walk_type(config))


def make_plant(name: str, config: Config, model: RobotModel) -> Plant:
    """Return a simulator with the robot in the initial posture of its walk.

    Parameters
    ----------
    name : str
        A name of `plants.table.SIMULATORS`, or MODULE:CLASS; `config` contains its parameters.
    config : Config
    model : RobotModel

    Raises
    ------
    PlantError
        If there is no such simulator, or the physics engine is not installed.
    """
    return plant_type(name).of(config, model, make_walk(config, model).posture)


def warm_up(config: Config, model: RobotModel) -> None:
    """Compile all functions used in a control period, so that no state is answered late.

    A walk with an inertial sensor takes its first steps on ideal joints, for at most `_WARM_UP`. In single support it
    measures an angular velocity, as after a push, so that it adjusts the step. A steered walk takes two steps.
    """
    with contextlib.suppress(DqwalkError):
        config = config.updated({"gait.steps": config.gait.steps or 2, "gait.footsteps": ()})
        controller, plant = make_controller(config, model), KinematicPlant(model, make_walk(config, model).posture)
        if not config.plant.imu:
            controller.step(plant.state, config.dt)
            return
        estimator, gyro, kin = BaseEstimator(config, model), np.zeros(3), Kinematics(model, plant.state.q, Foot.LEFT)
        for k in range(2):
            estimator.update(k * config.dt, kin, np.zeros(3), np.array([0.0, 0.0, GRAVITY]), both=True)
        while controller.phase_index < _WARM_PHASES and plant.state.time < _WARM_UP:
            up = np.array([kin.direction(model.imu, axis)[2] for axis in np.eye(3)])  # of soles on level ground
            plant.step(controller.step(replace(plant.state, up=up, gyro=gyro), config.dt), config.dt)
            gyro = np.full(3, 0.3 if controller.phase.kind is PhaseKind.SINGLE_SUPPORT else 0.0)
            kin = Kinematics(model, plant.state.q, controller.phase.base)


_WARM_UP = 3.0
"""Longest time that a walk to compile its functions lasts [s]."""
_WARM_PHASES = 5
"""Index of the phase at which it ends: after a stance, both double supports and a single support."""


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


_REPORT_EVERY = 0.1


def simulate(
    controller: VelocityController,
    plant: Plant,
    *,
    progress: Callable[[float, str], None] | None = None,
    max_time: float | None = None,
    before_step: Callable[[float], None] | None = None,
) -> Trace:
    """Run the closed loop until the walk is finished, and record it.

    Parameters
    ----------
    controller : VelocityController
    plant : Plant
    progress : callable, optional
        Called about ten times a second with the fraction of phases done and a line of text.
    max_time : float, optional
        Simulated time after which the walk is stopped [s].
    before_step : callable, optional
        See `closed_loop`.

    Returns
    -------
    Trace
        The walk up to its end, `max_time`, a fall, Ctrl-C, or an error of the controller. The last three are described
        in its notes.
    """
    config = controller.config
    recorder = TraceRecorder(config, controller.model)
    end = math.inf if max_time is None else plant.state.time + max_time - 0.5 * config.dt
    total = walk_type(config).phases(config) or math.inf
    due = 0.0
    state = plant.state
    try:
        steps = closed_loop(controller, plant, before_step)
        first = next(steps)  # it may compile for a minute, and Ctrl-C acts at once
        with deferred_interrupts() as interrupted:
            for state, command in itertools.chain([first], steps):
                recorder.add(state, command, controller, plant)
                if state.time >= end:
                    break
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
    except DqwalkError as error:
        if controller.phase_index < 0:  # there is nothing to record
            raise
        recorder.note(str(error))
        recorder.add(plant.state, None, controller, plant)
    return recorder.trace()


@dataclass(frozen=True)
class PhaseRecord:
    """The data of a recorded phase from which it can be built again.

    Attributes
    ----------
    name : str
    kind : PhaseKind
    support, base : Foot
    start : int
        Index of its first state.
    time : float
        Time of that state [s].
    q_start : ndarray, shape (n,)
        Joint angles at that state [rad].
    swing_target : ndarray, shape (8,), or None
        Pose at which the swing sole lands, in the base frame.
    x_odom_base : ndarray, shape (8,)
        Pose of its base sole in the base frame of the first phase.
    config : Config or None
        Configuration of the phase, if parameters were changed during the walk.
    decision : str
        Description of a change of the swing target during the phase, and its reason; empty without a change.
    """

    name: str
    kind: PhaseKind
    support: Foot
    base: Foot
    start: int
    time: float
    q_start: Array
    swing_target: Array | None
    x_odom_base: Array
    config: Config | None = None
    decision: str = ""

    @classmethod
    def of(cls, controller: VelocityController, start: int, time: float, config: Config | None = None) -> PhaseRecord:
        """Return the record of a controller's phase, which began at a time [s] with the state of index `start`."""
        now = controller.phase
        given = {name: getattr(now, name) for name in ("name", "kind", "support", "base", "q_start", "swing_target")}
        return cls(start=start, time=time, x_odom_base=controller.x_odom_base, config=config, **given)

    def phase(self, config: Config, model: RobotModel) -> Phase:
        """Return the phase, built from the recorded data."""
        return make_walk(self.config or config, model).phase(self.kind, self.support, self.q_start, self.swing_target)


@dataclass(frozen=True)
class PhysicsRecord:
    """Ground truth and inertial measurements of a physics engine at each state; nan where they were not recorded.

    Attributes
    ----------
    pelvis : ndarray, shape (N, 8)
        True pose in the world.
    wrenches : dict of Foot to ndarray, shape (N, 6)
        Force [N] and torque [N m] of the ground on each sole, about its origin, in its axes.
    cop : ndarray, shape (N, 3)
        Centre of pressure in the world [m]; nan also if no foot is on the ground.
    orientation : ndarray, shape (N, 4)
        Orientation of the inertial sensor in the world, a unit quaternion, real part first.
    gyro, acceleration : ndarray, shape (N, 3)
        Angular velocity and specific force in the sensor's frame [rad/s, m/s^2].
    q : ndarray, shape (N, n)
        True joint angles [rad].
    effort : ndarray, shape (N, n)
        Torques of the servos on the joints, the mean of the period before each state [N m].
    """

    pelvis: Array
    wrenches: dict[Foot, Array]
    cop: Array
    orientation: Array
    gyro: Array
    acceleration: Array
    q: Array
    effort: Array

    @cached_property
    def up(self) -> Array:
        """Unit vectors against gravity in the inertial sensor's frame, shape (N, 3); nan where not measured."""
        return DQ(self.orientation).conj().Ad(DQ(np.array([0.0, 0.0, 1.0]))).vec3()

    @classmethod
    def measured(cls, states: Sequence[State], up: Sequence[Array]) -> PhysicsRecord:
        """Return the record of a robot: the verticals `up` (3,) and, where known, the torques of its states."""
        truth = Truth(_NAN, dict.fromkeys(Foot, _NAN), dict.fromkeys(Foot, _NAN[:6]), _NAN[:3], _NAN, _NAN)
        samples = []
        for state, vertical in zip(states, up, strict=True):
            unknown = np.full(state.q.shape, math.nan)
            known = replace(truth, q=unknown, effort=unknown if state.effort is None else state.effort)
            samples.append((known, Inertial(orientation_of(vertical), _NAN[:3], _NAN[:3])))
        return cls.of(samples)

    @classmethod
    def of(cls, samples: list[tuple[Truth, Inertial]]) -> PhysicsRecord:
        """Return the record of one sample per state."""
        no_contact = np.full(3, math.nan)
        centers = [truth.cop for truth, _ in samples]
        return cls(
            pelvis=np.array([truth.pelvis for truth, _ in samples]),
            wrenches={foot: np.array([truth.wrenches[foot] for truth, _ in samples]) for foot in Foot},
            cop=np.array([no_contact if center is None else center for center in centers]),
            orientation=np.array([sensor.orientation for _, sensor in samples]),
            gyro=np.array([sensor.gyro for _, sensor in samples]),
            acceleration=np.array([sensor.acceleration for _, sensor in samples]),
            q=np.array([truth.q for truth, _ in samples]),
            effort=np.array([truth.effort for truth, _ in samples]),
        )


@dataclass(frozen=True)
class Trace:
    """A recorded walk of N states.

    Attributes
    ----------
    config : Config
    model : RobotModel
    time : ndarray, shape (N,)
        Times of the states [s].
    q : ndarray, shape (N, n)
        Measured joint angles [rad].
    u : ndarray, shape (N, n)
        Joint velocities commanded for each state [rad/s]; nan without a command.
    phases : tuple of PhaseRecord
    solve_time : ndarray, shape (N,)
        Time taken by the solver [s]; nan if unknown.
    finished : bool
        Whether the walk was finished.
    notes : tuple of str
        Errors of the walk, and data that the recording lacks.
    origin : mapping of str to str
        Software versions and machine (`dqwalk_ros.support.provenance`); empty if unknown.
    physics : PhysicsRecord or None
        Data of the physics engine, if the plant was one.
    loads : ndarray, shape (N, 2), or None
        Estimated forces of the ground on the left and on the right sole [N], nan where unknown; None if all are.
    epoch : int
        Stamp of time zero [ns]: that of the first state, if stamps are the time of day.
    interrupted : bool
        Whether Ctrl-C stopped the walk.
    cut : bool
        Whether the recording is damaged or cut off before the end of the walk, so that this end is not known.
    """

    config: Config
    model: RobotModel
    time: Array
    q: Array
    u: Array
    phases: tuple[PhaseRecord, ...]
    solve_time: Array
    finished: bool
    notes: tuple[str, ...] = ()
    origin: Mapping[str, str] = field(default_factory=dict)
    physics: PhysicsRecord | None = None
    loads: Array | None = None
    epoch: int = 0
    interrupted: bool = False
    cut: bool = False

    def __len__(self) -> int:
        return int(self.time.shape[0])

    @property
    def spans(self) -> list[range]:
        """Indices of the states of each phase."""
        starts = [record.start for record in self.phases]
        return [range(*pair) for pair in itertools.pairwise([*starts, len(self)])]

    def up(self, tick: int) -> Array | None:
        """Return the unit vector against gravity (3,) in the inertial sensor's frame at a state; None if unknown."""
        up = None if self.physics is None else self.physics.up[tick]
        return up if up is not None and np.isfinite(up).all() else None


class TraceRecorder:
    """Collects a `Trace`, one state after the other."""

    def __init__(self, config: Config, model: RobotModel) -> None:
        self._config, self._model = config, model
        self._index = -1  # of the last phase
        self._time: list[float] = []
        self._q: list[Array] = []
        self._u: list[Array] = []
        self._solve_time: list[float] = []
        self._phases: list[PhaseRecord] = []
        self._finished = False
        self._notes: list[str] = []
        self._origin = provenance.here()
        self._physics: list[tuple[Truth, Inertial]] = []
        self._loads: list[Array] = []
        self.interrupted = False

    def add(
        self,
        state: State,
        command: Command | None,
        controller: VelocityController,
        plant: Plant,
    ) -> None:
        """Record a state and its command.

        Parameters
        ----------
        state : State
        command : Command or None
            None if the controller failed.
        controller : VelocityController
        plant : Plant
            The plant at that state, for its ground truth.
        """
        if (truth := plant.truth) is not None and (inertial := plant.inertial) is not None:
            self._physics.append((truth, inertial))
        self._finished = finished = controller.finished
        if controller.phase_index > self._index and not finished:
            self._index = controller.phase_index
            tuned = None if controller.config is self._config else controller.config
            self._phases.append(PhaseRecord.of(controller, len(self._time), state.time, tuned))
        elif not finished and controller.phase.decision != self._phases[-1].decision:
            now = controller.phase
            self._phases[-1] = replace(self._phases[-1], swing_target=now.swing_target, decision=now.decision)
        self._loads.append(_NAN[:2] if controller.loads is None else controller.loads)
        self._time.append(state.time)
        self._q.append(state.q)
        self._u.append(command.velocity if command is not None else np.full(state.q.shape, math.nan))
        self._solve_time.append(math.nan if finished or command is None else controller.solve_time)

    def note(self, text: str) -> None:
        """Add a text to the notes."""
        self._notes.append(text)

    def trace(self) -> Trace:
        """Return the trace of the states recorded so far."""
        n = self._model.n
        return Trace(
            config=self._config,
            model=self._model,
            time=np.array(self._time),
            q=np.array(self._q).reshape(-1, n),
            u=np.array(self._u).reshape(-1, n),
            phases=tuple(self._phases),
            solve_time=np.array(self._solve_time),
            finished=self._finished,
            notes=tuple(self._notes),
            origin=self._origin,
            physics=PhysicsRecord.of(self._physics) if self._physics else None,
            loads=known_loads(np.array(self._loads).reshape(-1, 2)),
            interrupted=self.interrupted,
        )


def known_loads(loads: Array) -> Array | None:
    """Return the loads (N, 2) of a `Trace`; None if all are unknown."""
    return loads if np.isfinite(loads).any() else None


_NAN = np.full(8, math.nan)
