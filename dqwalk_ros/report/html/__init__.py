"""The report of a walk as one self-contained HTML file: verdict, replay, figures, tables.

The file opens offline; `replay.js` draws the replay with WebGL from the joint angles and the shapes of the robot.
"""

from __future__ import annotations

from dqwalk_ros.report.html.page import Subject, write

__all__ = ["Subject", "write"]
