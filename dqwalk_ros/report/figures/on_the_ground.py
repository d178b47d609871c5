"""A walk in physics from above: true soles, CoM and centre of pressure, and over time how safely it stood."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.report.figures.style import (
    BLUE,
    DASHED,
    GREEN,
    GREY,
    INK,
    RED,
    drawing,
    mark_phases,
    new_figure,
    set_time_limits,
    thinned,
)
from dqwalk_ros.report.metrics import Ground, Series
from dqwalk_ros.report.verdict import TILT
from dqwalk_ros.robot import Foot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["on_the_ground"]

_COLOR = {Foot.LEFT: BLUE, Foot.RIGHT: GREEN}
_PRESSURE = "#b35900"
_MANY = 50
"""More phases than these are not marked over time."""


def on_the_ground(series: Series) -> Figure:
    """Draw where the soles, the CoM and the centre of pressure truly were, the CoP's margin and the soles' tilt."""
    of = series.ground
    if of is None:
        raise ValueError("the walk was not in physics")
    wide = np.ptp(of.stands[:, 0]) + 0.3 > 2.0 * (np.ptp(of.stands[:, 1]) + 0.3)
    with drawing():
        if wide:
            reach = (np.ptp(of.stands[:, 1]) + 0.3) / (np.ptp(of.stands[:, 0]) + 0.3)
            top = float(np.clip(11.0 * reach, 1.8, 5.0))
            fig = new_figure(11.5, top + 4.0)
            grid = fig.add_gridspec(3, 1, height_ratios=[top, 1.6, 1.1])
            axes = [fig.add_subplot(grid[k, 0]) for k in range(3)]
        else:
            fig = new_figure(11.5, 6.2)
            grid = fig.add_gridspec(2, 2, width_ratios=[1.15, 1.0], height_ratios=[1.4, 1.0])
            axes = [fig.add_subplot(grid[:, 0]), fig.add_subplot(grid[0, 1]), fig.add_subplot(grid[1, 1])]
        _draw_ground(axes[0], series, of)
        _draw_margin(axes[1], series, of)
        _draw_tilt(axes[2], series, of)
        fig.legend(handles=_legend(of), loc="outside lower center", ncols=6, fontsize=8.5)
        steps = sum(not span.double for span in series.spans)
        text = f"{series.trace.model.name} in physics: {steps} steps, {of.stands[-1, 2] * 180.0 / np.pi:+.0f} degrees"
        fig.suptitle(text if abs(of.stands[-1, 2]) > 0.1 else text.rpartition(",")[0], fontsize=12, fontweight="bold")
    return fig


def _legend(of: Ground) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Patch(facecolor=BLUE + "26", edgecolor=BLUE, label="left sole"),
        Patch(facecolor=GREEN + "26", edgecolor=GREEN, label="right sole"),
        Line2D([], [], color=INK, linewidth=1.6, label="CoM"),
        Line2D([], [], color=_PRESSURE, linewidth=1.0, label="centre of pressure"),
        Line2D([], [], color=GREY, marker="o", markersize=3, linestyle="", label="halfway between the feet"),
    ]
    if of.circle is not None:
        label = f"circle of {of.circle.radius:.3f} m"
        handles.append(Line2D([], [], color=RED, linestyle=DASHED, linewidth=1.2, label=label))
    return handles


def _draw_ground(ax: Axes, series: Series, of: Ground) -> None:
    from matplotlib.patches import Circle, Polygon

    soles, known = series.trace.model.soles, series.trace.physics
    assert known is not None  # there is a ground
    for index, span in enumerate(series.spans):
        if not span.double:
            continue
        feet = tuple(Foot) if index == 0 else (span.phase.base.other,)
        for foot in feet:
            corners = DQ(of.soles[foot][span.start]).transform_point(soles[foot].corners)[:, :2]
            face = _COLOR[foot] + "1c"
            ax.add_patch(Polygon(corners, facecolor=face, edgecolor=_COLOR[foot], linewidth=1.0, zorder=2))
    if of.circle is not None:
        x, y = map(float, of.circle.center)
        ring = Circle((x, y), of.circle.radius, fill=False, edgecolor=RED, linestyle=DASHED, linewidth=1.2, zorder=3)
        ax.add_patch(ring)
    step = max(1, len(series.time) // 6000)
    ax.plot(*known.cop[::step, :2].T, color=_PRESSURE, linewidth=0.8, alpha=0.85, zorder=4)
    ax.plot(*of.com[::step, :2].T, color=INK, linewidth=1.6, zorder=5)
    ax.plot(*of.stands[:, :2].T, "o", color=GREY, markersize=2.5, zorder=6)
    ax.set_aspect("equal")
    ax.margins(0.03)
    ax.autoscale_view()
    ax.set_xlabel("x [m]")
    ax.set_ylabel("y [m]")
    ax.set_title("A   From above, as it truly was")


def _draw_margin(ax: Axes, series: Series, of: Ground) -> None:
    if len(series.spans) <= _MANY:
        mark_phases(ax, series)
    ax.plot(*thinned(series.time, 1e3 * of.cop_margin), color=_PRESSURE, linewidth=1.1)
    ax.axhline(0.0, color=RED, linestyle=DASHED, linewidth=1.2)
    set_time_limits(ax, series)
    ax.set_ylabel("margin [mm]")
    ax.set_title(f"B   Centre of pressure inside its soles: {100.0 * of.inside:.2f} % of ticks")


def _draw_tilt(ax: Axes, series: Series, of: Ground) -> None:
    if len(series.spans) <= _MANY:
        mark_phases(ax, series)
    degrees = 180.0 / np.pi
    ax.plot(*thinned(series.time, degrees * of.tilt), color=INK, linewidth=1.1)
    most = degrees * float(np.nanmax(of.tilt))
    if most > 0.5 * degrees * TILT:
        ax.axhline(degrees * TILT, color=RED, linestyle=DASHED, linewidth=1.2)
    set_time_limits(ax, series)
    ax.set_ylim(bottom=0.0)
    ax.set_ylabel("tilt [degrees]")
    ax.set_xlabel("time [s]")
    ax.set_title(f"C   Tilt of the sole that carries more: at most {most:.2f} degrees")
