"""The walk seen from above: soles, cylinders, the way of the CoM, and how far inside its support it was."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.geometry import ConvexPolygon
from dqwalk_ros.report.figures.style import (
    BLUE,
    DASHED,
    GREEN,
    GREY,
    INK,
    RED,
    drawing,
    mark_phases,
    name_phases,
    new_figure,
    set_time_limits,
    thinned,
)
from dqwalk_ros.report.metrics import Series, Span, urdf_soles
from dqwalk_ros.robot import Foot, Sole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["top_view"]

Array = NDArray[np.float64]
_COLOR = {Foot.LEFT: BLUE, Foot.RIGHT: GREEN}
_ORANGE, _HULL, _HULL_EDGE = "#b35900", "#eef1f4", "#c9d1d9"
_LONG = 0.45
"""From this extent [m] on the walk is drawn above its margins, not beside them."""


def top_view(series: Series) -> Figure:
    """Draw the footsteps and the CoM in odom, and the margins of the CoM over time."""
    reach = float(np.ptp(series.com_odom[:, 0])) + 0.25
    steps = sum(not span.double for span in series.spans)
    with drawing():
        if reach < _LONG:
            fig = new_figure(11.5, 5.2)
            ground, margins = fig.subplots(1, 2, width_ratios=[1.0, 1.15])
        else:
            height = float(np.clip(11.0 * 0.26 / reach, 1.8, 5.0))
            fig = new_figure(11.5, height + 3.6)
            ground, margins = fig.subplots(2, 1, height_ratios=[height, 2.2])
        own = urdf_soles(series.trace)
        _draw_ground(ground, series, own)
        _draw_margins(margins, series)
        paper = series.trace.config.gait.style == "paper"
        fig.legend(handles=_legend(own is not None, paper), loc="outside lower center", ncols=7, fontsize=8.5)
        title = f"{series.trace.model.name}: {steps} step{'s' if steps != 1 else ''} from above"
        fig.suptitle(title, fontsize=12, fontweight="bold")
    return fig


def _legend(own: bool, paper: bool) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Patch(facecolor=BLUE + "26", edgecolor=BLUE, label="left sole"),
        Patch(facecolor=GREEN + "26", edgecolor=GREEN, label="right sole"),
        Patch(facecolor=_HULL, edgecolor=_HULL_EDGE, label="double-support polygon"),
        Line2D([], [], color=INK, linewidth=2.0, label="CoM"),
        Line2D([], [], color=GREY, linestyle=":", linewidth=1.2, label="start, swing"),
    ]
    if paper:
        handles.insert(3, Line2D([], [], color=RED, linestyle=DASHED, linewidth=1.2, label="cylinder (14)"))
    if own:
        handles.append(Line2D([], [], color=_ORANGE, linewidth=1.0, alpha=0.6, label="sole of the URDF"))
    return handles


def _in_odom(series: Series, span: Span, tick: int, foot: Foot, soles: Mapping[Foot, Sole]) -> Array:
    """Return the corners of a sole at a tick, shape (4, 2) [m]."""
    x = DQ(span.record.x_odom_base)
    if foot is not span.phase.base:
        x = x * DQ(series.end[tick])
    return x.transform_point(soles[foot].corners)[:, :2]


def _draw_ground(ax: Axes, series: Series, own: Mapping[Foot, Sole] | None) -> None:
    from matplotlib.patches import Polygon

    soles = series.trace.model.soles
    first = series.spans[0]
    for foot in Foot:  # where the feet stood at first
        corners = _in_odom(series, first, first.start, foot, soles)
        ax.add_patch(Polygon(corners, fill=False, edgecolor=GREY, linestyle=":", linewidth=1.2, zorder=2))
    for span in series.spans:
        if span.double:
            corners = np.concatenate([_in_odom(series, span, span.end - 1, foot, soles) for foot in Foot])
            hull = ConvexPolygon.hull(corners).vertices
            ax.add_patch(Polygon(hull, facecolor=_HULL, edgecolor=_HULL_EDGE, linewidth=0.8, zorder=1))
    singles = [span for span in series.spans if not span.double]
    for number, span in enumerate(singles, 1):
        _draw_step(ax, series, span, own, number, last=span is singles[-1])
    _draw_com(ax, series)
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.03)
    ax.autoscale_view()
    ax.set_xlabel("forward, x [m]")
    ax.set_ylabel("to the left, y [m]")
    ax.set_title("A   Footsteps and centre of mass")


def _draw_step(
    ax: Axes, series: Series, span: Span, own: Mapping[Foot, Sole] | None, number: int, *, last: bool
) -> None:
    """Draw the sole that carries, its cylinder, the way of the swing foot, and the last landing."""
    from matplotlib.patches import Circle, Polygon

    soles, base = series.trace.model.soles, span.phase.base
    x_base, color = DQ(span.record.x_odom_base), _COLOR[base]
    stance = _in_odom(series, span, span.start, base, soles)
    ax.add_patch(Polygon(stance, facecolor=color + "26", edgecolor=color, linewidth=1.4, zorder=3))
    if own is not None:
        real = _in_odom(series, span, span.start, base, own)
        ax.add_patch(Polygon(real, fill=False, edgecolor=_ORANGE, linewidth=1.0, alpha=0.6, zorder=3))
    center = x_base.transform_point(soles[base].center)
    paper = series.trace.config.gait.style == "paper"
    radius = series.trace.config.ssp.com_radius
    circle = Circle((float(center[0]), float(center[1])), radius, fill=False, edgecolor=RED, linestyle=DASHED)
    circle.set(linewidth=1.2, zorder=4)
    if paper:
        ax.add_patch(circle)
    swing = base.other
    way = (x_base * DQ(series.end[span.ticks])).transform_point(soles[swing].center)
    ax.plot(*_thinned_way(way), color=_COLOR[swing], linewidth=1.3, linestyle=":", zorder=5)
    ax.annotate(
        str(number),
        (float(way[-1, 0]), float(way[-1, 1])),
        color=_COLOR[swing],
        fontsize=10,
        fontweight="bold",
        zorder=8,
        ha="center",
        va="center",
    )
    if last:
        corners = _in_odom(series, span, span.end - 1, swing, soles)
        ax.add_patch(Polygon(corners, facecolor=_COLOR[swing] + "12", edgecolor=_COLOR[swing], linewidth=1.4, zorder=3))


def _draw_com(ax: Axes, series: Series) -> None:
    from matplotlib.patheffects import Normal, Stroke

    halo = [Stroke(linewidth=4.2, foreground="white"), Normal()]
    known = np.isfinite(series.com_odom).all(axis=1)
    way = series.com_odom[known]
    ax.plot(*_thinned_way(way), color=INK, linewidth=2.0, zorder=6, path_effects=halo)
    for tick, fill in ((0, "white"), (-1, INK)):
        ax.plot(*way[tick, :2], "o", color=fill, markeredgecolor=INK, markersize=6, zorder=7)


def _thinned_way(way: Array) -> tuple[Array, Array]:
    step = max(1, len(way) // 3000)
    at = np.unique(np.append(np.arange(0, len(way), step), len(way) - 1))
    return way[at, 0], way[at, 1]


def _draw_margins(ax: Axes, series: Series) -> None:
    mm = 1e3
    mark_phases(ax, series)
    curves = []
    if series.trace.config.gait.style == "paper":
        curves.append((series.paper_margin, INK, "support region of the paper: planes, cylinder"))
    curves.append((series.true_margin, GREEN, "convex hull of the soles as configured"))
    if series.urdf_margin is not None:
        curves.append((series.urdf_margin, _ORANGE, "convex hull of the soles of the URDF"))
    for values, color, label in curves:
        ax.plot(*thinned(series.time, mm * values), color=color, label=label)
    ax.axhline(0.0, color=RED, linestyle=DASHED, linewidth=1.3)
    low, high = ax.get_ylim()
    ax.set_ylim(low - 0.02 * (high - low), high + 0.36 * (high - low))
    set_time_limits(ax, series)
    ax.set_xlabel("time [s]")
    ax.set_ylabel("margin [mm]")
    ax.set_title("B   How far inside its support the CoM is (below zero: outside)")
    name_phases(ax, series)
    ax.legend(loc="upper left", bbox_to_anchor=(0.0, 0.95), fontsize=8.5)
