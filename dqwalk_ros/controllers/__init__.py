"""Controllers: a state comes in, a command goes out."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.errors import DqwalkError

if TYPE_CHECKING:
    from dqwalk_ros.config import Config
    from dqwalk_ros.model import RobotModel
    from dqwalk_ros.phases import Phase

__all__ = ["Command", "Controller", "State", "Tick", "make_controller", "warm_up"]

Array = NDArray[np.float64]


@dataclass(slots=True, eq=False)
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
    up : ndarray, shape (3,), or None
        Unit vector against gravity in the frame of the inertial sensor, where there is one.
    gyro : ndarray, shape (3,), or None
        Angular velocity of the inertial sensor in its frame [rad/s].
    """

    time: float
    q: Array
    dq: Array | None = None
    up: Array | None = None
    gyro: Array | None = None


@dataclass(slots=True, eq=False)
class Command:
    """What is asked of the joints until the next command.

    Attributes
    ----------
    time : float
        Time of the state it answers [s].
    velocity : ndarray, shape (n,)
        [rad/s]
    effort : ndarray, shape (n,), or None
        Torques that hold the robot against gravity, for a drive that can feed them forward [N m].
    """

    time: float
    velocity: Array
    effort: Array | None = None


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
    def phase(self) -> Phase:
        """The current phase; there is one after the first step."""

    @property
    def phase_index(self) -> int:
        """0, 1, ... from the beginning of the walk; -1 before the first step."""

    @property
    def phase_time0(self) -> float:
        """Time of the state at which the phase began [s]."""

    @property
    def finished(self) -> bool:
        """Whether the last phase is over."""

    @property
    def x_odom_base(self) -> Array:
        """Pose of the phase's base sole in the world of the first phase, shape (8,)."""

    @property
    def error(self) -> float:
        """Norm of the error of the phase's own task at the last state."""

    @property
    def solve_time(self) -> float:
        """Time the solver took for the last command [s]."""

    @property
    def last(self) -> Tick:
        """What there is to say about the last step."""

    def step(self, state: State, dt: float) -> Command:
        """Return what is asked of the joints for the next period `dt` [s]."""

    def steer(self, forward: float, left: float, turn: float) -> tuple[float, float, float]:
        """Set the velocity of a steered walk [m/s, m/s, rad/s]; return what it walks with."""

    def stop(self) -> None:
        """Put the feet together after the step under way, and end the walk."""

    def odometry(self) -> Array:
        """Pose of the pelvis in the world of the first phase, shape (8,)."""

    def reset(self) -> None:
        """Forget the walk; the next step begins a new one."""


def make_controller(config: Config, model: RobotModel) -> Controller:
    """Return the controller that `config` describes."""
    from dqwalk_ros.controllers.velocity import VelocityController

    return VelocityController(config, model)


def warm_up(config: Config, model: RobotModel) -> None:
    """Have everything compiled that a tick needs, before the first state waits for its answer."""
    from dqwalk_ros.standing.phases import posture

    sensed = {"up": np.array([0.0, 0.0, 1.0]), "gyro": np.zeros(3)} if config.plant.imu else {}
    with contextlib.suppress(DqwalkError):
        q = posture(config, model) if config.gait.style == "standing" else np.zeros(model.n)
        make_controller(config, model).step(State(0.0, q, np.zeros(model.n), **sensed), config.dt)
