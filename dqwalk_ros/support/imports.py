"""Why another package's module was not imported, and how it is installed."""

from __future__ import annotations

import os
import traceback

from dqwalk_ros.support.wording import listed, printable

_ON_PYPI = {
    "daqp": "daqp",
    "distributed": "distributed",
    "dynamixel_sdk": "dynamixel-sdk",
    "mujoco": "mujoco",
    "pinocchio": "pin",
    "pyarrow": "pyarrow",
    "pydrake": "drake",
    "serial": "pyserial",
    "viser": "viser",
    "xacro": "xacro",
}
"""Name on PyPI of each Python module that may be missing."""
_OF_ROS = ("rclpy", "_interfaces", "_msgs", "_srvs")
"""Endings of the names of ROS modules."""


def how_to_install(module: str) -> str:
    """Return how a missing Python module, or the package of a submodule, is installed; empty if it is not known."""
    package = module.partition(".")[0]
    if package.endswith(_OF_ROS):
        return "source the setup file of a ROS 2 Jazzy, or pip install -e '.[ros]' in the folder of dqwalk_ros"
    return f"pip install {_ON_PYPI[package]}" if package in _ON_PYPI else ""


def not_imported(error: Exception) -> str:
    """Return why another package's module was not imported; empty for any other error.

    It is missing, or it failed as it was imported, as numba does where NUMBA_NUM_THREADS=0.
    """
    if isinstance(error, ModuleNotFoundError):
        if (error.name or "").partition(".")[0] == "dqwalk_ros":
            return ""
        how = how_to_install(error.name or "")
        return f"the Python module '{error.name}' is not installed{how and f': {how}'}"
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__) if frame.f_code.co_name == "<module>"]
    package = str(frames[-1].f_globals.get("__name__")).partition(".")[0] if frames else "dqwalk_ros"
    if package in ("dqwalk_ros", "__main__"):
        return ""
    names = [name for name in os.environ if name.startswith(f"{package.upper()}_")]
    doubt = f"; is {listed(names)} in the environment right?" if names else ""
    return f"{package} cannot be imported: {printable(str(error))}{doubt}"
