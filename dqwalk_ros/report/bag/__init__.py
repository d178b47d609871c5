"""Walks as rosbag2: writing and reading; `whole_body.bag` does the same for walks of the whole body."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqwalk_ros.support.lazy import lazy

if TYPE_CHECKING:
    from dqwalk_ros.report.bag.recording import is_body
    from dqwalk_ros.report.bag.storage import content_of
    from dqwalk_ros.report.bag.walk import read, read_orientations, write

__all__ = ["content_of", "is_body", "read", "read_orientations", "write"]

# on first use: the recorder needs no kinematics
__getattr__ = lazy(
    __name__,
    {
        "content_of": "storage",
        "is_body": "recording",
        "read": "walk",
        "read_orientations": "walk",
        "write": "walk",
    },
)
