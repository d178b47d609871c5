"""Walks as rosbag2: writing and reading; `whole_body.bag` does the same for walks of the whole body."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dqwalk_ros.report.bag.recording import is_body
    from dqwalk_ros.report.bag.storage import content_of
    from dqwalk_ros.report.bag.walk import read, read_orientations, write

__all__ = ["content_of", "is_body", "read", "read_orientations", "write"]

_FILES = {
    "content_of": "storage",
    "is_body": "recording",
    "read": "walk",
    "read_orientations": "walk",
    "write": "walk",
}


def __getattr__(name: str) -> Any:
    """Import on first use: the recorder needs no kinematics."""
    if name not in _FILES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_FILES[name]}"), name)
