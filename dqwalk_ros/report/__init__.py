"""Evaluation of recorded walks: time series, report, figures.

`analyse` recomputes every distance from the joint angles, `report` checks them against the rules, `save` draws them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqwalk_ros.support.lazy import lazy

if TYPE_CHECKING:
    from dqwalk_ros.report.figures import save
    from dqwalk_ros.report.metrics import Series, analyse
    from dqwalk_ros.report.table import render
    from dqwalk_ros.report.verdict import Violation, report

__all__ = ["Series", "Violation", "analyse", "render", "report", "save"]

__getattr__ = lazy(
    __name__,
    {
        "Series": "metrics",
        "Violation": "verdict",
        "analyse": "metrics",
        "render": "table",
        "report": "verdict",
        "save": "figures",
    },
)
