"""The record of a walk: its states, commands and phases, and the ground truth of a physics engine."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.controller import VelocityController
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import Z
from dqwalk_ros.paper.phase import Phase, PhaseKind
from dqwalk_ros.paper.state import Command, State
from dqwalk_ros.plants.base import Inertial, Plant, Truth, center_of_pressure, orientation_of
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support import provenance
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.walks.table import make_walk

_NAN = np.full(8, math.nan)


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """What is recorded of every walk, also of one of the whole body: N states of a robot."""

    config: Config
    model: RobotModel
    time: Array
    """Times of the states, shape (N,) [s]."""
    q: Array
    """Measured joint angles, shape (N, n) [rad]."""
    notes: tuple[str, ...] = ()
    """Errors of the walk, and data that the recording lacks."""
    origin: Mapping[str, str] = field(default_factory=dict)
    """Software versions and machine (`dqwalk_ros.support.provenance`); empty if unknown."""

    def __len__(self) -> int:
        return int(self.time.shape[0])


@dataclass(frozen=True)
class PhaseRecord:
    """The data of a recorded phase from which it can be built again."""

    name: str
    kind: PhaseKind
    support: Foot
    base: Foot
    start: int
    """Index of its first state."""
    time: float
    """Time of that state [s]."""
    q_start: Array
    """Joint angles at that state, shape (n,) [rad]."""
    swing_target: Array | None
    """Pose at which the swing sole lands, in the base frame, shape (8,)."""
    x_odom_base: Array
    """Pose of its base sole in the base frame of the first phase, shape (8,)."""
    config: Config | None = None
    """Configuration of the phase, if parameters were changed during the walk."""
    decision: str = ""
    """Description of a change of the swing target during the phase, and its reason; empty without a change."""

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
    """Ground truth and inertial measurements of a physics engine at each state; nan where they were not recorded."""

    pelvis: Array
    """True pose in the world, shape (N, 8)."""
    wrenches: dict[Foot, Array]
    """Force [N] and torque [N m] of the ground on each sole, about its origin, in its axes, shape (N, 6)."""
    cop: Array
    """Centre of pressure in the world, shape (N, 3) [m]; nan also if no foot is on the ground."""
    orientation: Array
    """Orientation of the inertial sensor in the world, a unit quaternion, real part first, shape (N, 4)."""
    gyro: Array
    acceleration: Array
    """Angular velocity and specific force in the sensor's frame, shape (N, 3) [rad/s, m/s^2]."""
    q: Array
    """True joint angles, shape (N, n) [rad]."""
    effort: Array
    """Torques of the servos on the joints, the mean of the period before each state, shape (N, n) [N m]."""

    @cached_property
    def up(self) -> Array:
        """Unit vectors against gravity in the inertial sensor's frame, shape (N, 3); nan where not measured."""
        return DQ(self.orientation).conj().Ad(DQ(Z)).vec3()

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
        soles = {foot: np.array([truth.soles[foot] for truth, _ in samples]) for foot in Foot}
        wrenches = {foot: np.array([truth.wrenches[foot] for truth, _ in samples]) for foot in Foot}
        return cls(
            pelvis=np.array([truth.pelvis for truth, _ in samples]),
            wrenches=wrenches,
            cop=center_of_pressure(soles, wrenches),
            orientation=np.array([sensor.orientation for _, sensor in samples]),
            gyro=np.array([sensor.gyro for _, sensor in samples]),
            acceleration=np.array([sensor.acceleration for _, sensor in samples]),
            q=np.array([truth.q for truth, _ in samples]),
            effort=np.array([truth.effort for truth, _ in samples]),
        )


@dataclass(frozen=True, kw_only=True)
class Trace(Recorded):
    """A recorded walk of phases."""

    u: Array
    """Joint velocities commanded for each state, shape (N, n) [rad/s]; nan without a command."""
    phases: tuple[PhaseRecord, ...]
    solve_time: Array
    """Time taken by the solver, shape (N,) [s]; nan if unknown."""
    finished: bool
    """Whether the walk was finished."""
    physics: PhysicsRecord | None = None
    """Data of the physics engine, if the plant was one."""
    loads: Array | None = None
    """Estimated forces of the ground on the left and on the right sole [N], nan where unknown, shape (N, 2); None if
    all are."""
    epoch: int = 0
    """Stamp of time zero [ns]: that of the first state, if stamps are the time of day."""
    interrupted: bool = False
    """Whether Ctrl-C stopped the walk."""
    cut: bool = False
    """Whether the recording is damaged or cut off before the end of the walk, so that this end is not known."""

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
        command : Command or None
            None if the controller failed.
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
