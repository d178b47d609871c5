"""Figures 7, 8 and 9 of the paper: the same panels, colours and thresholds, over any number of cycles."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dqwalk_ros.report.figures.style import (
    BLUE,
    DASHED,
    GREEN,
    MUTED,
    RED,
    drawing,
    joined,
    mark_phases,
    name_phases,
    new_figure,
    set_time_limits,
)
from dqwalk_ros.report.metrics import Series
from dqwalk_ros.report.spans import Span
from dqwalk_ros.support.arrays import Array

_TONES = 10
"""Number of tones of a colour for the cycles of a walk; the phases of more cycles share them."""


class _Panel(NamedTuple):
    """One panel: title, axis label, values, and a bound with its label and the place of the label."""

    title: str
    label: str
    values: Array
    bound: float | None = None
    bound_label: str = ""
    place: Literal["upper right", "center right", "lower right"] = "center right"


def _curves(series: Series, double: bool) -> list[tuple[Span, tuple[float, float, float], str]]:
    """Return the phases of one kind, their colours and legends."""
    spans = [span for span in series.spans if span.double is double and span.end > span.start]
    cycles = (len(spans) + 1) // 2
    tones = min(cycles, _TONES)
    out = []
    for i, span in enumerate(spans):
        foot = span.phase.support.value
        what = f"to the {foot} foot" if double else f"{span.phase.support.other.value} foot swings"
        cycle = f", cycle {i // 2 + 1}" if cycles > 1 else ""
        label = f"{_ordinal(i)} {'DSP' if double else 'SSP'}: {what}{cycle}"
        out.append((span, _tone((BLUE, GREEN)[i % 2], i // 2 * tones // cycles, tones), label))
    return out


def _tone(color: str, cycle: int, cycles: int) -> tuple[float, float, float]:
    """Return the colour of a cycle: full for the first one, lighter for later ones."""
    fade = 0.0 if cycles < 2 else 0.65 * cycle / (cycles - 1)
    r, g, b = (channel + (1.0 - channel) * fade for channel in to_rgb(color))
    return r, g, b


def _ordinal(i: int) -> str:
    if i < 6:
        return ("first", "second", "third", "fourth", "fifth", "sixth")[i]
    n = i + 1
    return f"{n}{'th' if n % 100 in (11, 12, 13) else {1: 'st', 2: 'nd', 3: 'rd'}.get(n % 10, 'th')}"


def _time_response(series: Series, panels: Sequence[_Panel], axes: Sequence[Axes], double: bool) -> None:
    """Draw panels over the time since the beginning of each phase; phases of the same colour are one line."""
    same: dict[tuple[float, float, float], list[Span]] = {}
    for span, color, _ in _curves(series, double):
        same.setdefault(color, []).append(span)
    lines = [(color, [span.ticks for span in spans]) for color, spans in same.items()]
    elapsed = series.time.copy()
    for span in series.spans:
        elapsed[span.ticks] -= series.time[span.start]
    for letter, panel, ax in zip("ABCDEFGH", panels, axes, strict=False):
        for color, parts in reversed(lines):  # so that the first phases are drawn on top
            ax.plot(joined(elapsed, parts), joined(panel.values, parts), color=color)
        if panel.bound is not None:
            bound = ax.axhline(panel.bound, color=RED, linestyle=DASHED, linewidth=1.3)
            ax.legend([bound], [panel.bound_label], loc=panel.place, labelcolor=RED, fontsize=8)
        ax.margins(y=0.08)
        ax.set_xlim(left=0.0)
        ax.set_title(f"{letter}   {panel.title}")
        ax.set_ylabel(panel.label)
    for ax in axes[-3:]:
        ax.set_xlabel(f"time since the {'double' if double else 'single'} support began [s]")


def _supports(series: Series, panels: Sequence[_Panel], height: float, title: str, *, double: bool) -> Figure:
    """Return a figure of panels, three in a row, over the time since the beginning of each phase of one kind."""
    fig = new_figure(11.0, height)
    _time_response(series, panels, list(fig.subplots(len(panels) // 3, 3).flat), double)
    fig.suptitle(title, fontsize=12, fontweight="bold")
    curves = _curves(series, double)
    if len(curves) > 6:
        curves = curves[:2] + curves[-2:]
    handles = [Line2D([], [], color=color, label=label) for _, color, label in curves]
    fig.legend(handles=handles, loc="outside lower center", ncols=2, fontsize=9)
    return fig


def _pelvis(series: Series) -> _Panel:
    height = series.pelvis[:, 2] - series.trace.config.pelvis.height
    return _Panel("Pelvis to its plane", "distance [mm]", 1e3 * height, 0.0, "pelvis plane")


@drawing()
def figure7(series: Series) -> Figure:
    """Draw Fig. 7: the double supports, A to F."""
    config = series.trace.config
    mm = 1e3
    panels = [
        _Panel(
            "CoM to the end foot's centre",
            "error norm [mm]",
            mm * series.error,
            mm * config.ssp.com_radius,
            "cylinder of the next SSP",
            "upper right",
        ),
        _Panel(
            "End-foot tip to the sliding axis",
            "distance [mm]",
            mm * series.slide,
            mm * config.dsp.sliding_radius,
            "sliding cylinder",
            "lower right",
        ),
        _Panel("End-foot tip to the ground", "height [mm]", mm * series.tip_height),
        _Panel("CoM to the tip plane", "distance [mm]", mm * series.distance("tip_plane"), 0.0, "tip plane"),
        _Panel("CoM to the back plane", "distance [mm]", mm * series.distance("back_plane"), 0.0, "back plane"),
        _pelvis(series),
    ]
    return _supports(series, panels, 6.2, "Double support: the CoM moves over the next support foot", double=True)


@drawing()
def figure8(series: Series) -> Figure:
    """Draw Fig. 8: the single supports."""
    config = series.trace.config
    mm = 1e3
    panels = [
        _Panel(
            "Pose error of the swing foot",
            r"$\|\mathrm{vec}_8(\underline{x} - \underline{x}_d)\|$",
            series.error,
            config.ssp.threshold,
            "end of the phase",
            "upper right",
        ),
        _Panel(
            "CoM to the axis of the cylinder",
            "distance [mm]",
            mm * series.com_to_axis,
            mm * config.ssp.com_radius,
            "boundary of the support",
        ),
        _pelvis(series),
    ]
    return _supports(series, panels, 3.7, "Single support: the swing foot moves to its target", double=False)


@drawing()
def figure9(series: Series) -> Figure:
    """Draw Fig. 9: the joint angles, with the limits and the changes of phase."""
    model = series.trace.model
    names = model.joint_names
    left = [i for i, name in enumerate(names) if name.startswith("l_")]
    right = [i for i, name in enumerate(names) if name.startswith("r_")]
    pairs = [i for pair in itertools.zip_longest(left, right) for i in pair if i is not None]
    order = [*pairs, *(i for i in range(model.n) if i not in pairs)]
    rows = (len(order) + 1) // 2
    fig = new_figure(11.0, 1.55 * rows + 1.3)
    grid = fig.subplots(rows, 2, sharex=True, squeeze=False)
    for ax, i in zip(grid.flat, order, strict=False):
        _joint(ax, series, i)
    for ax in list(grid.flat)[len(order) :]:
        ax.remove()
    for ax in list(grid.flat)[max(len(order) - 2, 0) : len(order)]:  # the last one of each column
        ax.set_xlabel("time [s]")
        ax.tick_params(labelbottom=True)
    for ax in grid[0]:
        low, high = ax.get_ylim()
        ax.set_ylim(low, high + 0.2 * (high - low))
        name_phases(ax, series)
    fig.suptitle("Joint angles over the walk, with their limits", fontsize=12, fontweight="bold")
    return fig


def _joint(ax: Axes, series: Series, i: int) -> None:
    model = series.trace.model
    q = np.degrees(series.trace.q[:, i])
    low, high = np.degrees([model.q_min[i], model.q_max[i]])
    mark_phases(ax, series)
    ax.plot(series.time, q, color=BLUE)
    for limit in (low, high):
        ax.axhline(limit, color=RED, linestyle=DASHED, linewidth=1.2)
    room = 0.1 * (high - low)
    ax.set_ylim(low - room, high + room)
    set_time_limits(ax, series)
    ax.set_ylabel("angle [°]")
    closest = float(np.degrees(series.joint_margin[:, i].min()))
    ax.set_title(_joint_title(model.joint_names[i]))
    ax.set_title(f"closest to a limit: {closest:.1f}°", loc="right", fontsize=8, fontweight="normal", color=MUTED)


def _joint_title(name: str) -> str:
    side = {"l": "left ", "r": "right "}.get(name.split("_")[0], "")
    return (side + name.split("_", 1)[1] if side else name).replace("_", " ")
