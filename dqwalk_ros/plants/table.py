"""The plants that commands, launch files and nodes offer, one line each, and a user's own by MODULE:CLASS."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dqwalk_ros.support.errors import PlantError
from dqwalk_ros.support.imports import how_to_install
from dqwalk_ros.support.own_class import own_class

if TYPE_CHECKING:  # the help texts list the plants, and import no numpy
    from dqwalk_ros.config import Config
    from dqwalk_ros.plants.base import Plant
    from dqwalk_ros.robot.model import RobotModel


@dataclass(frozen=True)
class Entry:
    """One plant."""

    meaning: str
    node: str
    """The node that runs it."""
    type: str = ""
    """MODULE:CLASS of a simulator, a subclass of `Plant`; empty for a robot, which only its node can run."""
    parameters: str = ""
    """Name of the file in ``config/plants/`` with what the plant requires of all nodes; empty without one."""
    physics: bool = False
    """Whether it simulates soles, servos and an inertial sensor."""
    requires: str = ""
    """MODULE:FUNCTION of a configuration and a model that raises an error if the node of a robot would refuse them."""


_IDEAL = "dqwalk_ros.plants.kinematic:KinematicPlant"
_MUJOCO = "dqwalk_ros.plants.mujoco:PhysicsPlant"
_DRAKE = "dqwalk_ros.plants.drake:DrakePlant"
_OUTPUT = "dqwalk_ros.plants.robot_output:commanded_joints"
_MOTORS = "dqwalk_ros.plants.poppy.motors:require_usable"

PLANTS = {
    "integrator": Entry("ideal joints", "integrator", _IDEAL, "integrator"),
    "physics": Entry("MuJoCo", "physics", _MUJOCO, "physics", physics=True),
    "poppy_as_built": Entry(
        "MuJoCo with Poppy's servos, delays and sensors", "physics", _MUJOCO, "poppy_as_built", physics=True
    ),
    "drake": Entry("Drake, another physics engine", "physics", _DRAKE, "physics", physics=True),
    "ros2_control": Entry(
        "a robot whose controllers are running", "drive", parameters="ros2_control", requires=_OUTPUT
    ),
    "poppy": Entry("the real Poppy", "poppy_driver", parameters="poppy", requires=_MOTORS),
}


SIMULATORS = [name for name, each in PLANTS.items() if each.type]
PHYSICS = [name for name, each in PLANTS.items() if each.physics]
"""Names of the simulators, and of those with soles, servos and an inertial sensor."""


def entry(name: str) -> Entry:
    """Return the plant of a name; of ``MODULE:CLASS`` that of a user's own simulator.

    Raises
    ------
    PlantError
        If there is none of this name, or the class cannot be imported or is not a subclass of `Plant`.
    """
    if ":" in name:
        own = _imported(name)
        return Entry(own.__doc__ or name, "physics" if own.physics else "integrator", name, own.parameters, own.physics)
    if name not in PLANTS:
        raise PlantError(f"no plant is called '{name}': {', '.join(PLANTS)}, or MODULE:CLASS of your own")
    return PLANTS[name]


def require_accepted(name: str, config: Config, model: RobotModel) -> None:
    """Check that the node of a robot accepts a configuration, without the robot.

    Raises
    ------
    DqwalkError
        As the node does when it starts.
    """
    if requires := entry(name).requires:
        module, _, function = requires.partition(":")
        getattr(importlib.import_module(module), function)(config, model)


def defaults_of(node: str) -> Config:
    """Return the parameters of a node where none are given; the driver of a robot has those of its plant's file."""
    from dqwalk_ros.config import Config, overlaid

    files = [each.parameters for each in PLANTS.values() if each.node == node and not each.type]
    return overlaid(Config(), files[0]) if files else Config()


def plant_type(name: str) -> type[Plant]:
    """Return the class of a simulator.

    Raises
    ------
    PlantError
        As `entry`; if it is a robot, or a package it needs is not installed.
    """
    found = entry(name)
    if not found.type:
        raise PlantError(f"'{name}' is {found.meaning}; only its node {found.node} runs it")
    return _imported(found.type)


def make_plant(name: str, config: Config, model: RobotModel) -> Plant:
    """Return a simulator with the robot in the initial posture of its walk.

    Parameters
    ----------
    name : str
        A name of `SIMULATORS`, or MODULE:CLASS; `config` contains its parameters.

    Raises
    ------
    PlantError
        If there is no such simulator, or the physics engine is not installed.
    """
    from dqwalk_ros.walks.table import make_walk

    return plant_type(name).of(config, model, make_walk(config, model).posture)


def _imported(name: str) -> type[Plant]:
    from dqwalk_ros.plants.base import Plant

    try:
        return own_class(name, Plant)  # type: ignore[type-abstract]
    except ImportError as error:  # MuJoCo loads the library of MUJOCO_GL, and any module may fail
        if isinstance(cause := error.__cause__, ModuleNotFoundError) and cause.name in ("mujoco", "pydrake"):
            raise PlantError(f"the physics engine is not installed: {how_to_install(cause.name)}") from error
        raise PlantError(f"the plant is '{name}'; {error}") from error
