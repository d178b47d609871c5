"""The figures of a walk; the only place that imports matplotlib, and only when one is drawn."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from dqwalk_ros.analysis.figures.paper import figure7, figure8, figure9
from dqwalk_ros.analysis.figures.style import drawing
from dqwalk_ros.analysis.figures.top_view import top_view
from dqwalk_ros.analysis.series import Series

__all__ = ["FIGURES", "FORMATS", "figure7", "figure8", "figure9", "save", "top_view"]

FIGURES = {"figure7": figure7, "figure8": figure8, "figure9": figure9, "top_view": top_view}
FORMATS = ("png", "pdf", "svg")


def save(series: Series, folder: str | os.PathLike[str], formats: Sequence[str] = ("png",)) -> list[Path]:
    """Draw every figure into a folder and return the files.

    Parameters
    ----------
    series : Series
    folder : path-like
        Made where it does not exist.
    formats : sequence of {"png", "pdf", "svg"}
    """
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    files = []
    paper_only = () if series.trace.config.gait.style == "paper" else ("figure7", "figure8")
    for name, draw in FIGURES.items():
        if name in paper_only:
            continue
        figure = draw(series)
        for kind in formats:
            files.append(out / f"{name}.{kind}")
            with drawing():  # resolution and fonts are settings of the moment of saving
                figure.savefig(files[-1])
            figure.set_layout_engine("none")  # the layout is found once
    return files
