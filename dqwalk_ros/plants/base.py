"""Plants: simulators and robots that execute commands; ground truth of simulators; measurement of the vertical."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from dqwalk_ros.config import Config
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.state import Command, State
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ConfigError, PlantError


class Plant(ABC):
    """A simulator or a robot."""

    physics: ClassVar[bool] = False
    """Whether it simulates soles, servos and an inertial sensor: `truth`, `inertial` and `push`."""
    parameters: ClassVar[str] = ""
    """Name of the file in ``config/plants/`` with what it requires of all nodes; empty without one."""

    @classmethod
    def of(cls, config: Config, model: RobotModel, q0: Array) -> Plant:
        """Return the plant with the joints at `q0` (n,) [rad]; by default the class is called with these arguments."""
        return cls(config, model, q0)  # type: ignore[call-arg]

    @property
    @abstractmethod
    def state(self) -> State:
        """The present measured state."""

    @abstractmethod
    def step(self, command: Command, dt: float) -> State:
        """Execute a command for one period `dt` [s] and return the state after it."""

    def hold(self, dt: float) -> State:
        """Execute no command for one period `dt` [s], so that the joints stay, and return the state after it."""
        return self.step(Command(self.state.time, np.zeros_like(self.state.q)), dt)

    @property
    def commanded(self) -> Array:
        """Angles to which commanded velocities are added, shape (n,) [rad]: goals of servos, else the measured."""
        return self.state.q

    @property
    def truth(self) -> Truth | None:
        """Ground truth of a simulator; None if it is not available."""
        return None

    @property
    def inertial(self) -> Inertial | None:
        """Measurements of the inertial sensor; None without such a sensor."""
        return None

    def push(self, force: ArrayLike, link: str = "") -> None:
        """Push a link of a simulated robot, by default the pelvis, with `force` (3,) [N] until the next call.

        The force is in world axes, and acts at the centre of mass of the link.
        """
        raise NotImplementedError

    @property
    def fallen(self) -> bool:
        """Whether the robot lies on the ground."""
        return False

    @property
    def warning(self) -> str:
        """Why the walk should end in a stance, before there is a fault that holds the joints in mid-step; or empty."""
        return ""

    @property
    def fault(self) -> str:
        """Why no command has an effect any more; empty if commands have."""
        return ""


@dataclass(slots=True, eq=False)
class Inertial:
    """Measurements of the inertial sensor."""

    orientation: Array
    """Unit quaternion (real part first) of the sensor's frame in the world, shape (4,)."""
    gyro: Array
    """Angular velocity in its frame, shape (3,) [rad/s]."""
    acceleration: Array
    """Specific force in its frame, shape (3,): 9.81 upwards at rest [m/s^2]."""


@dataclass(slots=True, eq=False)
class Truth:
    """Ground truth of a simulator, which no sensor of the robot measures."""

    pelvis: Array
    """Pose of the pelvis in the world, whose xy plane is the floor, shape (8,)."""
    soles: dict[Foot, Array]
    """Poses of the soles in the world, shape (8,)."""
    wrenches: dict[Foot, Array]
    """Force [N] and torque [N m] of the ground on each sole, about its origin, in its axes, shape (6,)."""
    com: Array
    """Centre of mass in the world, shape (3,) [m]."""
    q: Array
    """Joint angles, shape (n,) [rad]."""
    effort: Array
    """Torques of the servos on the joints, the mean of the last control period, shape (n,) [N m]."""

    @property
    def cop(self) -> Array:
        """Centre of pressure of both feet in the world, shape (3,) [m]; nan without ground contact."""
        return center_of_pressure(self.soles, self.wrenches)

    @property
    def tilt(self) -> float:
        """Inclination against the floor of the sole with the larger load [rad]."""
        support = max(self.wrenches, key=lambda foot: float(self.wrenches[foot][2]))
        return float(tilt(self.soles[support]))


def center_of_pressure(soles: Mapping[Foot, Array], wrenches: Mapping[Foot, Array]) -> Array:
    """Return the centre of pressure of both feet in the world, shape (..., 3) [m]; nan without ground contact.

    Parameters
    ----------
    soles : mapping of Foot to ndarray, shape (..., 8)
        Poses of the soles in the world.
    wrenches : mapping of Foot to ndarray, shape (..., 6)
        Force [N] and torque [N m] of the ground on each sole, about its origin, in its axes.
    """
    total, moment = np.zeros(1), np.zeros(3)
    for foot, wrench in wrenches.items():
        force = np.where(wrench[..., 2:3] > 1e-3, wrench[..., 2:3], 0.0)
        pressed = wrench[..., [4, 3, 5]] * [-1.0, 1.0, 0.0] / np.maximum(force, 1e-3)  # point of the sole
        total, moment = total + force, moment + force * DQ(soles[foot]).transform_point(pressed)
    return np.where(total > 1e-2, moment / np.maximum(total, 1e-2), np.nan)


def require_real_time(config: Config) -> None:
    """Check that the plant is not to wait for its commands.

    Raises
    ------
    ConfigError
        In lockstep.
    """
    if config.plant.lockstep:
        raise ConfigError("'plant.lockstep' must be false: a robot does not wait for its command")


def stands_still(config: Config) -> str:
    """Return why a plant in real time would never move, because it takes each command for the last one; or ""."""
    timeout, dt = config.plant.command_timeout, config.dt
    if config.plant.lockstep or timeout >= 2.0 * dt:
        return ""
    return (
        f"'plant.command_timeout' is {timeout:g} s, but commands come every {dt:g} s (dt): the robot would stand "
        f"still; set at least {2.0 * dt:g} s"
    )


def checked(values: ArrayLike, n: int, what: str) -> Array:
    """Return the values of a command, one per joint, as an array (n,); `what` is their name in the error message.

    Raises
    ------
    PlantError
        If their number is wrong, or one is not finite.
    """
    out = np.asarray(values, dtype=np.float64)
    if out.shape != (n,) or not are_finite(out):
        raise PlantError(f"the command must have {n} finite {what}, got {out}")
    return out


def are_finite(values: Array) -> bool:
    """Return whether all values (n,), and so their sum, are finite, of a few in less time than numpy takes."""
    return math.isfinite(sum(values.tolist()))


def pushed_periods(duration: float, dt: float) -> int:
    """Return the number of periods `dt` [s] of a push, whose force acts for whole periods: nearest to `duration` [s].

    The force for a given impulse is the impulse divided by this number and by `dt`.
    """
    return max(1, round(duration / dt))


def tilt(x: Array) -> Array:
    """Return the angle between the z axes of the poses `x` (..., 8) and that of the world [rad]."""
    out: Array = 2.0 * np.arcsin(np.clip(np.hypot(x[..., 1], x[..., 2]), 0.0, 1.0))
    return out


def upward(w: float, i: float, j: float, k: float) -> Array:
    """Return the unit vector against gravity (3,) in a frame with the orientation w + i + j + k, of any norm.

    The result does not depend on the yaw of the frame.
    """
    size = math.sqrt(w * w + i * i + j * j + k * k)
    w, i, j, k = w / size, i / size, j / size, k / size
    return np.array([2.0 * (i * k - w * j), 2.0 * (j * k + w * i), 1.0 - 2.0 * (i * i + j * j)])


def orientation_of(up: Array) -> Array:
    """Return a unit quaternion (4,), an orientation whose `upward` is the unit vector `up` (3,)."""
    return DQ.facing(up).conj().vec4()
