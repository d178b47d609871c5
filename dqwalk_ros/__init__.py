"""Biped walking control with quadratic programming and vector-field inequalities, for ROS 2.

The public names below are imported on first use, so that importing the package is fast.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

_MODULE_OF = {
    "Config": "config",
    "load": "config",
    "DQ": "paper.dual_quaternions",
    "Foot": "paper.foot",
    "RobotModel": "robot.model",
    "load_model": "robot.model",
    "Kinematics": "paper.kinematics",
    "Phase": "paper.phase",
    "VelocityController": "controller",
    "make_controller": "walks.table",
    "make_walk": "walks.table",
    "KinematicPlant": "plants.kinematic",
    "simulate": "simulation",
    "Trace": "trace",
}

__all__ = ["__version__", *_MODULE_OF]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
