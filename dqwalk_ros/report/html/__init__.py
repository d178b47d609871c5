"""A walk as one HTML file that needs nothing else: verdict, replay, figures, tables.

The file opens offline; the replay is drawn by `replay.js` with WebGL, from joint angles and the robot's own shapes.
"""

from __future__ import annotations

from dqwalk_ros.report.html.page import Subject, write

__all__ = ["Subject", "write"]
