"""A walk as a rosbag2, of phases or of the whole body: written, recorded, and read back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dqwalk_ros.report.bag.recording import is_body
from dqwalk_ros.report.bag.walk import read, write

if TYPE_CHECKING:
    from dqwalk_ros.report.bag.body import read_body, write_body

__all__ = ["is_body", "read", "read_body", "write", "write_body"]


def __getattr__(name: str) -> Any:
    """Return what needs Pinocchio, an extra that a walk of phases does without."""
    if name not in ("read_body", "write_body"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from dqwalk_ros.report.bag import body

    return getattr(body, name)
