"""Controllers: a state comes in, a command goes out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from dqwalk_ros.config import Config
    from dqwalk_ros.model import RobotModel
    from dqwalk_ros.phases import Phase

__all__ = ["Command", "Controller", "State", "Tick", "make_controller"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class State:
    """What is measured.

    Attributes
    ----------
    time : float
        [s]
    q : ndarray, shape (n,)
        Joint angles, in the order of the model [rad].
    dq : ndarray, shape (n,), or None
        Joint velocities [rad/s].
    """

    time: float
    q: Array
    dq: Array | None = None


@dataclass(frozen=True)
class Command:
    """What is asked of the joints until the next command.

    Attributes
    ----------
    time : float
        Time of the state it answers [s].
    velocity : ndarray, shape (n,)
        [rad/s]
    """

    time: float
    velocity: Array


@dataclass(frozen=True)
class Tick:
    """What a controller has to say about its last step.

    Attributes
    ----------
    error : float
        Norm of the phase's own task error.
    solve_time : float
        Time the solver took [s].
    iterations : int
    active : tuple of str
        Rows that held the command back, strongest first.
    """

    error: float
    solve_time: float
    iterations: int
    active: tuple[str, ...]


class Controller(Protocol):
    """What nodes and simulations need of a walking controller."""

    config: Config
    model: RobotModel

    @property
    def phase(self) -> Phase: ...
    @property
    def phase_index(self) -> int: ...
    @property
    def phase_time0(self) -> float: ...
    @property
    def finished(self) -> bool: ...
    @property
    def x_odom_base(self) -> Array: ...
    @property
    def error(self) -> float: ...
    @property
    def solve_time(self) -> float: ...
    @property
    def last(self) -> Tick: ...

    def step(self, state: State, dt: float) -> Command: ...
    def odometry(self) -> Array: ...
    def reset(self) -> None: ...


def make_controller(config: Config, model: RobotModel) -> Controller:
    """Return the controller that `config` describes."""
    from dqwalk_ros.controllers.velocity import VelocityController

    return VelocityController(config, model)
