"""The figures of a walk. Only this folder imports matplotlib, and only when a figure is drawn."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from dqwalk_ros.report.figures.from_above import on_the_ground, top_view
from dqwalk_ros.report.figures.paper import figure7, figure8, figure9
from dqwalk_ros.report.figures.style import drawing
from dqwalk_ros.report.metrics import Series

__all__ = ["FIGURES", "FORMATS", "figure7", "figure8", "figure9", "fits", "on_the_ground", "save", "top_view"]

FIGURES = {
    "figure7": figure7,
    "figure8": figure8,
    "figure9": figure9,
    "top_view": top_view,
    "on_the_ground": on_the_ground,
}
FORMATS = ("png", "pdf", "svg")


def fits(name: str, series: Series) -> bool:
    """Return whether a figure applies to a walk."""
    if name in ("figure7", "figure8"):
        return series.trace.config.gait.style == "paper"
    return name != "on_the_ground" or series.ground is not None


def save(series: Series, folder: str | os.PathLike[str], formats: Sequence[str] = ("png",)) -> list[Path]:
    """Draw every figure into a folder and return the files.

    Parameters
    ----------
    series : Series
    folder : path-like
        Created if it does not exist.
    formats : sequence of {"png", "pdf", "svg"}
    """
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    files = []
    for name, draw in FIGURES.items():
        if not fits(name, series):
            continue
        figure = draw(series)
        for kind in formats:
            files.append(out / f"{name}.{kind}")
            with drawing():  # resolution and fonts are read when the figure is saved
                figure.savefig(files[-1])
            figure.set_layout_engine("none")  # compute the layout only once
    return files
