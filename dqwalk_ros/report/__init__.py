"""Evaluation of recorded walks: time series, report, figures.

`analyse` recomputes every distance from the joint angles, `report` checks them against the rules, `save` draws them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dqwalk_ros.report.figures import save
    from dqwalk_ros.report.metrics import Series, analyse
    from dqwalk_ros.report.table import render
    from dqwalk_ros.report.verdict import Violation, report

__all__ = ["Series", "Violation", "analyse", "render", "report", "save"]

_MODULES = {
    "Series": "metrics",
    "Violation": "verdict",
    "analyse": "metrics",
    "render": "table",
    "report": "verdict",
    "save": "figures",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
