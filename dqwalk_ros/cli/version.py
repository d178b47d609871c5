"""``dqwalk version``: what is installed, for reports of faults."""

from __future__ import annotations

import argparse
import os
import platform
from importlib import metadata

from dqwalk_ros import __version__

__all__ = ["run"]

_PARTS = ("numpy", "numba", "clarabel", "yourdfpy", "rosbags", "mcap", "matplotlib", "rclpy")


def run(args: argparse.Namespace) -> int:
    """Do it and return the exit code."""
    print(f"dqwalk_ros {__version__}")
    print(f"Python     {platform.python_version()} on {platform.system()} {platform.machine()}")
    print(f"ROS        {os.environ.get('ROS_DISTRO', 'not sourced')}")
    for part in _PARTS:
        try:
            print(f"{part:<10} {metadata.version(part)}")
        except metadata.PackageNotFoundError:
            print(f"{part:<10} not installed")
    return 0
