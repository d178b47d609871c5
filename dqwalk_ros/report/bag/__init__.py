"""A walk as a rosbag2, of phases or of the whole body: written, recorded, and read back."""

from __future__ import annotations

from dqwalk_ros.report.bag.body import is_body, read_body, write_body
from dqwalk_ros.report.bag.walk import read, write

__all__ = ["is_body", "read", "read_body", "write", "write_body"]
