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

__all__ = ["PhaseRecord", "Recorder", "Trace"]

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

    def add(self, state: State, command: Command | None, controller: Controller) -> None:
        """Record a state and its answer; `command` is None where the controller failed."""
        if controller.phase_index >= len(self._phases) and not controller.finished:
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
        self._finished = controller.finished
        self._time.append(state.time)
        self._q.append(state.q)
        self._u.append(command.velocity if command is not None else np.full(state.q.shape, math.nan))
        self._solve_time.append(math.nan if controller.finished or command is None else controller.solve_time)

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
        )
