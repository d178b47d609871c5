"""Plants: what stands on the other side of the command."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from dqwalk_ros.controllers import Command, State
from dqwalk_ros.errors import PlantError

if TYPE_CHECKING:
    from dqwalk_ros.config import Config
    from dqwalk_ros.model import RobotModel

__all__ = ["Plant", "make_plant"]


class Plant(Protocol):
    """A simulator or a robot."""

    @property
    def state(self) -> State:
        """The state now."""

    def step(self, command: Command, dt: float) -> State:
        """Return the state one period `dt` [s] later."""


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
        from dqwalk_ros.plants.physics import PhysicsPlant
    except ModuleNotFoundError as error:
        if error.name != "mujoco":
            raise
        raise PlantError("the physics engine is not installed: pip install 'dqwalk_ros[sim]'") from error
    if config.gait.style != "standing":
        return PhysicsPlant(config, model)
    from dqwalk_ros.standing.phases import posture

    return PhysicsPlant(config, model, posture(config, model))
