"""Common style of the figures: colours, fonts, time axis, marks of the phases."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure  # not pyplot: no global state, no display

from dqwalk_ros.report import colors
from dqwalk_ros.report.colors import hexed
from dqwalk_ros.report.metrics import Series
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.output import written

BLUE, GREEN, RED, ORANGE = map(hexed, (colors.BLUE, colors.GREEN, colors.RED, colors.ORANGE))
INK, GREY, MUTED = map(hexed, (colors.INK, colors.GREY, colors.MUTED))
FOOT = {foot: hexed(color) for foot, color in colors.FOOT.items()}
_STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.labelcolor": INK,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e8ec",
    "grid.linewidth": 0.7,
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "lines.linewidth": 1.7,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "path.simplify_threshold": 0.5,  # [pixels]
    "svg.fonttype": "none",
    "svg.hashsalt": "dqwalk",  # the same figure is the same file
    "pdf.fonttype": 42,
    "figure.dpi": 160,
    "savefig.dpi": "figure",
    "savefig.facecolor": "white",
}
_UNDATED: dict[str, dict[str, None]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
DASHED = (0, (5, 3))
_MANY = 50
"""Number of phases above which they are not marked over time."""

drawing = partial(mpl.rc_context, _STYLE)
"""Applies this style within a context or a function, without changing matplotlib's global settings."""


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a width and height [inch]."""
    return Figure(figsize=(width, height), layout="constrained")


class Drawn(NamedTuple):
    """A figure, its file name without suffix, and its caption in a report."""

    name: str
    figure: Figure
    caption: str = ""


def save(
    drawn: Iterable[Drawn],
    folder: str | os.PathLike[str],
    formats: Sequence[str] = ("png",),
    *,
    overwrite: bool = False,
) -> list[Path]:
    """Write figures as png, pdf or svg into a folder, which is created if necessary, and return the files.

    Raises
    ------
    OutputError
        If another file exists in the place of one, and `overwrite` is not set.
    """
    files = []
    for name, figure, _ in drawn:
        for kind in formats:
            files.append(Path(folder) / f"{name}.{kind}")
            with written(files[-1], overwrite=overwrite) as new:
                write_figure(figure, new, kind)
    return files


def write_figure(figure: Figure, file: Path | BinaryIO, kind: str) -> None:
    """Write a figure as png, pdf or svg."""
    with drawing():  # resolution and fonts are read when the figure is saved
        if kind != "png":  # else its layout would depend on the format that is written first
            figure.draw_without_rendering()
            figure.set_layout_engine("none")
        figure.savefig(file, format=kind, metadata=_UNDATED.get(kind))
    figure.set_layout_engine("none")  # compute the layout only once


def set_time_limits(ax: Axes, series: Series) -> None:
    """Show the whole walk, also if it has a single tick."""
    ax.set_xlim(series.time[0], max(series.time[-1], series.time[0] + series.trace.config.dt))


def joined(values: Array, parts: Iterable[slice]) -> Array:
    """Return some parts of a series (N, ...) one after the other, with nan between them, where a line ends."""
    gap = np.full((1, *values.shape[1:]), np.nan)
    return np.concatenate([piece for part in parts for piece in (gap, values[part])][1:])


def mark_phases(ax: Axes, series: Series) -> None:
    """Shade double support and put a dashed line at every change of phase, if they are not too many to be seen."""
    spans, time = series.spans, series.time
    if len(spans) > _MANY:
        return
    begin = [float(time[span.start]) for span in spans]
    shaded = [(a, float(time[span.end - 1]) - a) for a, span in zip(begin, spans, strict=True) if span.double]
    whole: dict[str, Any] = {"transform": ax.get_xaxis_transform()}  # from the bottom to the top, 0 to 1
    ax.broken_barh(shaded, (0.0, 1.0), color="#f1f4f7", zorder=0, linewidth=0, **whole)
    ax.vlines(begin[1:], 0.0, 1.0, color=GREY, linestyle=(0, (3, 3)), linewidth=0.9, zorder=2, **whole)


def name_phases(ax: Axes, series: Series) -> None:
    """Write the name of each phase at the top of the axes, abbreviated or omitted for short phases."""
    total = series.time[-1] - series.time[0]
    for span in series.spans:
        begin, end = series.time[span.start], series.time[span.end - 1]
        short = "DSP" if span.double else "SSP"
        long = f"{short} {'to' if span.double else 'on'} {span.phase.support.value}"
        if end - begin < 0.05 * total:
            continue
        ax.annotate(
            long if end - begin > 0.16 * total else short,
            (0.5 * (begin + end), 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, -3),
            textcoords="offset points",
            ha="center",
            va="top",
            fontsize=7.5,
            color=MUTED,
        )
