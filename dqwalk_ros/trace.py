"""A walk as it was recorded: states, commands, and where each phase began."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros import origin
from dqwalk_ros.config import Config
from dqwalk_ros.controllers import Command, Controller, State
from dqwalk_ros.model import Foot, RobotModel
from dqwalk_ros.phases import PhaseKind
from dqwalk_ros.plants import Inertial, Truth

__all__ = ["PhaseRecord", "PhysicsRecord", "Recorder", "Trace"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PhaseRecord:
    """Where a phase began: enough to build it again.

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
        [rad]
    swing_target : ndarray, shape (8,), or None
    x_odom_base : ndarray, shape (8,)
        Pose of its base sole in the world of the first phase.
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


@dataclass(frozen=True)
class PhysicsRecord:
    """What a physics engine knew at each state; nan where it was not recorded.

    Attributes
    ----------
    pelvis : ndarray, shape (N, 8)
        True pose in the world.
    wrenches : dict of Foot to ndarray, shape (N, 6)
        Force [N] and torque [N m] of the ground on each sole, about its origin, in its axes.
    cop : ndarray, shape (N, 3)
        Centre of pressure in the world [m]; nan in the air, too.
    orientation : ndarray, shape (N, 4)
        Of the inertial sensor in the world, a unit quaternion, real part first.
    gyro, acceleration : ndarray, shape (N, 3)
        In the sensor's frame [rad/s, m/s^2].
    """

    pelvis: Array
    wrenches: dict[Foot, Array]
    cop: Array
    orientation: Array
    gyro: Array
    acceleration: Array

    @classmethod
    def of(cls, seen: list[tuple[Truth, Inertial]]) -> PhysicsRecord:
        """Gather what was seen at each state."""
        none = np.full(3, math.nan)
        centers = [truth.cop for truth, _ in seen]
        return cls(
            pelvis=np.array([truth.pelvis for truth, _ in seen]),
            wrenches={foot: np.array([truth.wrenches[foot] for truth, _ in seen]) for foot in Foot},
            cop=np.array([none if center is None else center for center in centers]),
            orientation=np.array([sensor.orientation for _, sensor in seen]),
            gyro=np.array([sensor.gyro for _, sensor in seen]),
            acceleration=np.array([sensor.acceleration for _, sensor in seen]),
        )


@dataclass(frozen=True)
class Trace:
    """A walk.

    Attributes
    ----------
    config : Config
    model : RobotModel
    time : ndarray, shape (N,)
        [s]
    q : ndarray, shape (N, n)
        Measured joint angles [rad].
    u : ndarray, shape (N, n)
        The command that answered each state [rad/s]; nan where none did.
    phases : tuple of PhaseRecord
    solve_time : ndarray, shape (N,)
        [s]; nan where unknown.
    finished : bool
        Whether the walk came to its end.
    notes : tuple of str
        What is missing or went wrong.
    origin : mapping of str to str
        Versions and machine that walked it (`dqwalk_ros.origin`); empty where nobody wrote that down.
    physics : PhysicsRecord or None
        Where the walk went through a physics engine.
    epoch : int
        Stamp of time zero [ns]: that of the first state where stamps are the time of day.
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
    epoch: int = 0

    def __len__(self) -> int:
        return int(self.time.shape[0])


class Recorder:
    """Collects a `Trace` tick by tick."""

    def __init__(self, config: Config, model: RobotModel) -> None:
        self._config, self._model = config, model
        self._time: list[float] = []
        self._q: list[Array] = []
        self._u: list[Array] = []
        self._solve_time: list[float] = []
        self._phases: list[PhaseRecord] = []
        self._finished = False
        self._notes: list[str] = []
        self._origin = origin.here()
        self._seen: list[tuple[Truth, Inertial]] = []

    def add(
        self,
        state: State,
        command: Command | None,
        controller: Controller,
        seen: tuple[Truth, Inertial] | None = None,
    ) -> None:
        """Record a state and its answer.

        Parameters
        ----------
        state : State
        command : Command or None
            None where the controller failed.
        controller : Controller
        seen : (Truth, Inertial), optional
            What the plant knew at that state; with every state or with none.
        """
        if seen is not None:
            self._seen.append(seen)
        self._finished = finished = controller.finished
        if controller.phase_index >= len(self._phases) and not finished:
            phase = controller.phase
            self._phases.append(
                PhaseRecord(
                    name=phase.name,
                    kind=phase.kind,
                    support=phase.support,
                    base=phase.base,
                    start=len(self._time),
                    time=state.time,
                    q_start=phase.q_start,
                    swing_target=phase.swing_target,
                    x_odom_base=controller.x_odom_base,
                )
            )
        self._time.append(state.time)
        self._q.append(state.q)
        self._u.append(command.velocity if command is not None else np.full(state.q.shape, math.nan))
        self._solve_time.append(math.nan if finished or command is None else controller.solve_time)

    def note(self, text: str) -> None:
        """Add to the notes."""
        self._notes.append(text)

    def trace(self) -> Trace:
        """Return what was recorded so far."""
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
            physics=PhysicsRecord.of(self._seen) if self._seen else None,
        )
