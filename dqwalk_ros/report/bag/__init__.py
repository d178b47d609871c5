"""A walk as a rosbag2: what `write` puts on disk and what the nodes' recorder does are interchangeable.

`topics` is the table both share, `messages` packs and unpacks whole columns of messages at once, `storage`
opens MCAP and SQLite files, whole, split, compressed or cut off by a crash. The names below are loaded on
first use, so that a node which only needs the table does not load the readers.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from dqwalk_ros.topics import BODY_TOPICS, FINISHED, ODOM, TOPICS, Topic

if TYPE_CHECKING:
    from dqwalk_ros.report.bag.body import read_body, write_body
    from dqwalk_ros.report.bag.reader import read
    from dqwalk_ros.report.bag.robot import is_body
    from dqwalk_ros.report.bag.writer import write

__all__ = [
    "BODY_TOPICS",
    "FINISHED",
    "ODOM",
    "TOPICS",
    "Topic",
    "is_body",
    "read",
    "read_body",
    "write",
    "write_body",
]

_HOME = {"is_body": "robot", "read": "reader", "read_body": "body", "write": "writer", "write_body": "body"}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
