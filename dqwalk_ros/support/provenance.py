"""Provenance of a walk: the software versions and the machine that produced it, stored with its recording."""

from __future__ import annotations

import functools
import os
import platform
import time
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path

from dqwalk_ros import __version__

_PACKAGES = (
    "numpy",
    "numba",
    "scipy",
    "clarabel",
    "daqp",
    "yourdfpy",
    "rosbags",
    "mcap",
    "rclpy",
    "mujoco",
    "pin",
    "dynamixel_sdk",
)


def here() -> dict[str, str]:
    """Return the entries of `machine` and the present time in UTC, as texts by name."""
    return {"began": time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime()), **machine()}


@functools.cache
def machine() -> Mapping[str, str]:
    """Return versions of the installed packages, operating system, host and processor, as texts by name."""
    out = {"dqwalk_ros": __version__, "python": platform.python_version()}
    for package in _PACKAGES:
        try:
            out[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    if distribution := os.environ.get("ROS_DISTRO"):
        out["ros"] = distribution
    out["host"] = platform.node() or "unknown"
    out["system"] = f"{platform.system()} {platform.release()} {platform.machine()}"
    out["processor"] = f"{_processor()}, {os.cpu_count()} of them"
    return out


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def to_text(origin: Mapping[str, str]) -> str:
    """Return one line ``key: value`` per entry, which is also YAML."""
    return "".join(f"{key}: {' '.join(value.split())}\n" for key, value in origin.items())


def from_text(text: str) -> dict[str, str]:
    """Return the entries of a text written by `to_text`; lines of another form are ignored."""
    lines = (line.partition(": ") for line in text.splitlines())
    return {key.strip(): value.strip() for key, colon, value in lines if colon and key.strip()}
