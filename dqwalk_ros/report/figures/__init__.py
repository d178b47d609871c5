"""The figures of a walk. Only this folder imports matplotlib."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from dqwalk_ros.report.figures import style
from dqwalk_ros.report.figures.from_above import on_the_ground, top_view
from dqwalk_ros.report.figures.paper import figure7, figure8, figure9
from dqwalk_ros.report.figures.style import Drawn
from dqwalk_ros.report.metrics import Series

__all__ = ["FIGURES", "drawn", "figure7", "figure8", "figure9", "on_the_ground", "save", "top_view"]

FIGURES = {
    "figure7": (figure7, "Figure 7: the task error, and the distances of double support."),
    "figure8": (figure8, "Figure 8: the same for single support."),
    "figure9": (figure9, "Figure 9: joint angles, with their limits in red."),
    "top_view": (
        top_view,
        "From above: footsteps, the path of the centre of mass, and its margin to the edge of the support.",
    ),
    "on_the_ground": (on_the_ground, "True motion in physics: soles, centre of mass, centre of pressure, tilt."),
}
"""Function and caption of each figure."""


def drawn(series: Series) -> Iterator[Drawn]:
    """Draw every figure that applies to a walk."""
    paper = series.style == "paper"
    applies = {"figure7": paper, "figure8": paper, "on_the_ground": series.ground is not None}
    for name, (draw, caption) in FIGURES.items():
        if applies.get(name, True):
            yield Drawn(name, draw(series), caption)


def save(
    series: Series, folder: str | os.PathLike[str], formats: Sequence[str] = ("png",), *, overwrite: bool = False
) -> list[Path]:
    """Draw every figure of a walk into a folder and return the files; see `style.save`."""
    return style.save(drawn(series), folder, formats, overwrite=overwrite)
