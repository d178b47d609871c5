"""The page people look at: a walk in three dimensions, in the browser [viser].

A page shows moments. They come from a recorded walk (`Player`), from a walk in another process (`Feed`), or from ROS
(`dqwalk_ros.nodes.viewer`). The page is never in the loop of a walk: whoever walks only leaves the newest moment
behind.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dqwalk_ros.report.viewer.page import Page
    from dqwalk_ros.report.viewer.player import Player

__all__ = ["PORT", "Page", "Player"]

PORT = 8080
"""Where the page is, on 127.0.0.1, unless somebody is there already."""

_HOME = {"Page": "page", "Player": "player"}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
