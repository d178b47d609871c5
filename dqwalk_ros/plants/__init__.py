"""Plants: what stands on the other side of the command, and what a simulated one knows besides the state."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqwalk_ros.controllers import Command, State
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import PlantError
from dqwalk_ros.model import Foot

if TYPE_CHECKING:
    from dqwalk_ros.config import Config
    from dqwalk_ros.model import RobotModel

__all__ = ["Inertial", "Plant", "Truth", "World", "make_plant", "upward"]

Array = NDArray[np.float64]


class Plant(Protocol):
    """A simulator or a robot."""

    @property
    def state(self) -> State:
        """The state now."""

    def step(self, command: Command, dt: float) -> State:
        """Return the state one period `dt` [s] later."""


class World(Plant, Protocol):
    """A simulator of the ground, too, so that the robot can fall."""

    @property
    def truth(self) -> Truth:
        """What no sensor measures."""

    @property
    def inertial(self) -> Inertial:
        """What the inertial sensor measures."""

    @property
    def fallen(self) -> bool:
        """Whether the robot lies on the ground."""

    def push(self, force: ArrayLike) -> None:
        """Push the pelvis with `force` (3,) [N] in world axes until the next call."""


@dataclass(frozen=True)
class Inertial:
    """What the inertial sensor measures.

    Attributes
    ----------
    orientation : ndarray, shape (4,)
        Unit quaternion (real part first) of the sensor's frame in the world.
    gyro : ndarray, shape (3,)
        Angular velocity in its frame [rad/s].
    acceleration : ndarray, shape (3,)
        Acceleration against free fall in its frame: 9.81 upwards at rest [m/s^2].
    """

    orientation: Array
    gyro: Array
    acceleration: Array


@dataclass(frozen=True)
class Truth:
    """What no sensor of the robot measures.

    Attributes
    ----------
    pelvis : ndarray, shape (8,)
        Its pose in the world, whose xy plane is the floor.
    soles : dict of Foot to ndarray, shape (8,)
        Poses of the soles in the world.
    wrenches : dict of Foot to ndarray, shape (6,)
        Force [N] and torque [N m] of the ground on each sole, about its origin, in its axes.
    com : ndarray, shape (3,)
        In the world [m].
    effort : ndarray, shape (n,)
        Torques of the servos on the joints [N m]; times the velocities they are the mechanical power [W].
    """

    pelvis: Array
    soles: dict[Foot, Array]
    wrenches: dict[Foot, Array]
    com: Array
    effort: Array

    @property
    def cop(self) -> Array | None:
        """Centre of pressure of both feet in the world, shape (3,) [m]; None in the air."""
        total, moment = 0.0, np.zeros(3)
        for foot, w in self.wrenches.items():
            if w[2] > 1e-3:
                total += w[2]
                moment += w[2] * DQ(self.soles[foot]).transform_point([-w[4] / w[2], w[3] / w[2], 0.0])
        return moment / total if total > 1e-2 else None


def upward(w: float, i: float, j: float, k: float) -> Array:
    """Return the unit vector against gravity in a frame whose orientation is the quaternion w + i + j + k, shape (3,).

    Its yaw makes no difference, nor does its norm.
    """
    size = math.sqrt(w * w + i * i + j * j + k * k)
    w, i, j, k = w / size, i / size, j / size, k / size
    return np.array([2.0 * (i * k - w * j), 2.0 * (j * k + w * i), 1.0 - 2.0 * (i * i + j * j)])


def make_plant(name: str, config: Config, model: RobotModel) -> Plant:
    """Return the plant ``"kinematic"`` or ``"physics"``, the robot in the posture in which its walk begins.

    Raises
    ------
    PlantError
        If it needs something that is not installed.
    """
    if name == "kinematic":
        from dqwalk_ros.plants.kinematic import KinematicPlant

        return KinematicPlant(model)
    try:
        from dqwalk_ros.plants.mujoco import PhysicsPlant
    except ModuleNotFoundError as error:
        if error.name != "mujoco":
            raise
        raise PlantError("the physics engine is not installed: pip install 'dqwalk_ros[sim]'") from error
    if config.gait.style != "standing":
        return PhysicsPlant(config, model)
    from dqwalk_ros.standing.phases import posture

    return PhysicsPlant(config, model, posture(config, model))
