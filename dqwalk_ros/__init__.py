"""Biped walking control with quadratic programming and vector-field inequalities, for ROS 2.

The public names below are imported on first use, so that importing the package is fast.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqwalk_ros.support.lazy import lazy

if TYPE_CHECKING:
    from dqwalk_ros.config import Config, load
    from dqwalk_ros.controller import VelocityController
    from dqwalk_ros.paper.dual_quaternions import DQ
    from dqwalk_ros.paper.foot import Foot
    from dqwalk_ros.paper.kinematics import Kinematics
    from dqwalk_ros.paper.phase import Phase
    from dqwalk_ros.plants.kinematic import KinematicPlant
    from dqwalk_ros.robot.model import RobotModel, load_model
    from dqwalk_ros.simulation import simulate
    from dqwalk_ros.trace import Trace
    from dqwalk_ros.walks.table import make_controller, make_walk

__version__ = "0.1.0"
__all__ = [
    "DQ", "Config", "Foot", "KinematicPlant", "Kinematics", "Phase", "RobotModel", "Trace", "VelocityController",
    "__version__", "load", "load_model", "make_controller", "make_walk", "simulate",
]  # fmt: skip

__getattr__ = lazy(__name__, {
    "DQ": "paper.dual_quaternions", "Config": "config", "Foot": "paper.foot", "KinematicPlant": "plants.kinematic",
    "Kinematics": "paper.kinematics", "Phase": "paper.phase", "RobotModel": "robot.model", "Trace": "trace",
    "VelocityController": "controller", "load": "config", "load_model": "robot.model",
    "make_controller": "walks.table", "make_walk": "walks.table", "simulate": "simulation",
})  # fmt: skip
