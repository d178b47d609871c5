"""Top views of a walk, by leg odometry and by the true motion in physics, and its margins over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch
from matplotlib.patheffects import Normal, Stroke

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import ConvexPolygon
from dqwalk_ros.report.figures.style import (
    DASHED,
    FOOT,
    GREEN,
    GREY,
    INK,
    ORANGE,
    RED,
    drawing,
    joined,
    mark_phases,
    name_phases,
    new_figure,
    set_time_limits,
)
from dqwalk_ros.report.ground import GroundTruth
from dqwalk_ros.report.metrics import Series, urdf_soles
from dqwalk_ros.report.spans import Span
from dqwalk_ros.report.verdict import TILT
from dqwalk_ros.robot.model import Sole
from dqwalk_ros.support.arrays import Array

_HULL, _HULL_EDGE = "#eef1f4", "#c9d1d9"
_LONG = 0.45
"""Length of a walk [m] above which it is drawn above its margins instead of beside them."""
_APART = 0.25
"""Least distance between the numbers of two steps [inch]."""


def _corners(x: Array, sole: Sole) -> Array:
    """Return the corners (4, 2) [m] of a sole at the pose `x` (8,)."""
    return DQ(x).transform_point(sole.corners)[:, :2]


def _draw_polygons(ax: Axes, polygons: Sequence[Array], edge: str, face: str = "none", **looks: Any) -> None:
    """Draw soles or other polygons (m, 2) of one kind."""
    ax.add_collection(PolyCollection(polygons, facecolor=face, edgecolor=edge, joinstyle="miter", **looks))


def _draw_rings(ax: Axes, centers: Sequence[Array], radius: float, zorder: int) -> None:
    looks: dict[str, Any] = {"facecolor": "none", "edgecolor": RED, "linestyle": DASHED, "linewidth": 1.2}
    rings = [Circle((float(center[0]), float(center[1])), radius) for center in centers]
    ax.add_collection(PatchCollection(rings, zorder=zorder, **looks))


def _soles_legend() -> list[Any]:
    return [Patch(facecolor=FOOT[f] + "26", edgecolor=FOOT[f], label=f"{f.value} sole") for f in Foot]


def _legend(fig: Figure, handles: list[Any]) -> None:
    fig.legend(handles=handles, loc="outside lower center", ncols=7, fontsize=8.5)


def _title(fig: Figure, series: Series, where: str, more: str = "") -> None:
    steps = sum(not span.double for span in series.spans)
    title = f"{series.trace.model.name} {where}: {steps} step{'s' if steps != 1 else ''}{more}"
    fig.suptitle(title, fontsize=12, fontweight="bold")


def _finish(ax: Axes, title: str) -> None:
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.03)
    ax.autoscale_view()
    ax.set(xlabel="forward, x [m]", ylabel="to the left, y [m]", title=title)


# ---------------------------------------------------------------------- by the odometry


@drawing()
def top_view(series: Series) -> Figure:
    """Draw the footsteps and the CoM in odom, and the margins of the CoM over time."""
    reach, broad = np.ptp(_known_com(series)[:, :2], axis=0) + 0.25
    width, height = 4.5, 3.9  # of the view from above [inch]
    if reach < _LONG:
        fig = new_figure(11.5, 5.2)
        ground, margins = fig.subplots(1, 2, width_ratios=[1.0, 1.15])
    else:
        width, height = 10.6, float(np.clip(11.0 * 0.26 / reach, 1.8, 5.0))
        fig = new_figure(11.5, height + 3.6)
        ground, margins = fig.subplots(2, 1, height_ratios=[height, 2.2])
    own = urdf_soles(series.trace)
    _draw_footsteps(ground, series, own, apart=_APART * max(reach / width, broad / height))
    _draw_margins(margins, series)
    handles = [*_soles_legend(), Patch(facecolor=_HULL, edgecolor=_HULL_EDGE, label="double-support polygon")]
    if series.style == "paper":
        handles.append(Line2D([], [], color=RED, linestyle=DASHED, linewidth=1.2, label="cylinder (U14)"))
    handles.append(Line2D([], [], color=INK, linewidth=2.0, label="CoM"))
    handles.append(Line2D([], [], color=GREY, linestyle=":", linewidth=1.2, label="start, swing"))
    if own is not None:
        handles.append(Line2D([], [], color=ORANGE, linewidth=1.0, alpha=0.6, label="sole of the URDF"))
    _legend(fig, handles)
    _title(fig, series, "from above")
    return fig


def _known_com(series: Series) -> Array:
    """Return the path (m, 3) of the CoM in odom [m], without the states of which it is not known."""
    return series.com_odom[np.isfinite(series.com_odom).all(axis=1)]


def _draw_footsteps(ax: Axes, series: Series, own: Mapping[Foot, Sole] | None, apart: float) -> None:
    """Draw soles and CoM, and the numbers of the last steps, and of those before that are `apart` [m] from them."""
    soles, places = series.trace.model.soles, series.soles
    initial = [_corners(places[foot][0], soles[foot]) for foot in Foot]
    _draw_polygons(ax, initial, GREY, linestyle=":", linewidth=1.2, zorder=2)
    hulls = []
    for span in series.spans:
        if span.double:
            corners = np.concatenate([_corners(places[foot][span.end - 1], soles[foot]) for foot in Foot])
            hulls.append(ConvexPolygon.hull(corners).vertices)
    _draw_polygons(ax, hulls, _HULL_EDGE, _HULL, linewidth=0.8, zorder=1)
    singles = [span for span in series.spans if not span.double]
    for foot in Foot:
        _draw_steps(ax, series, [span for span in singles if span.phase.base is foot], foot, own)
    halo = [Stroke(linewidth=4.2, foreground="white"), Normal()]
    text: dict[str, Any] = {
        "path_effects": halo,
        "fontsize": 10,
        "fontweight": "bold",
        "zorder": 8,
        "ha": "center",
        "va": "center",
    }
    numbered: dict[Foot, list[Array]] = {foot: [] for foot in Foot}
    for index, span in reversed([*enumerate(singles)]):
        swing = span.phase.base.other
        place = DQ(places[swing][span.end - 1]).transform_point(soles[swing].center)[:2]
        if any(np.linalg.norm(place - other) < apart for other in numbered[swing]):
            continue
        numbered[swing].append(place)
        beside = (0.0, 10.0 if swing is Foot.LEFT else -10.0)  # [points], outwards, where the CoM does not go
        ax.annotate(str(index + 1), (place[0], place[1]), beside, textcoords="offset points", color=FOOT[swing], **text)
    for span in singles[-1:]:  # the last landing
        swing = span.phase.base.other
        landed = _corners(places[swing][span.end - 1], soles[swing])
        _draw_polygons(ax, [landed], FOOT[swing], FOOT[swing] + "12", linewidth=1.4, zorder=3)
    com = _known_com(series)
    ax.plot(com[:, 0], com[:, 1], color=INK, linewidth=2.0, zorder=6, path_effects=halo)
    for tick, fill in ((0, "white"), (-1, INK)):
        ax.plot(*com[tick, :2], "o", color=fill, markeredgecolor=INK, markersize=6, zorder=7)
    _finish(ax, "A   Footsteps and centre of mass")


def _draw_steps(ax: Axes, series: Series, spans: Sequence[Span], base: Foot, own: Mapping[Foot, Sole] | None) -> None:
    """Draw the soles of the support foot `base`, their cylinders, and the paths of the swing foot."""
    if not spans:
        return
    soles, swing = series.trace.model.soles, base.other
    stances = [series.soles[base][span.start] for span in spans]
    stands = [_corners(stance, soles[base]) for stance in stances]
    _draw_polygons(ax, stands, FOOT[base], FOOT[base] + "26", linewidth=1.4, zorder=3)
    if own is not None:
        of_urdf = [_corners(stance, own[base]) for stance in stances]
        _draw_polygons(ax, of_urdf, ORANGE, linewidth=1.0, alpha=0.6, zorder=3)
    if series.style == "paper":
        centers = [DQ(stance).transform_point(soles[base].center) for stance in stances]
        _draw_rings(ax, centers, series.trace.config.ssp.com_radius, zorder=4)
    way = DQ(joined(series.soles[swing], [span.ticks for span in spans])).transform_point(soles[swing].center)
    ax.plot(way[:, 0], way[:, 1], color=FOOT[swing], linewidth=1.3, linestyle=":", zorder=5)


def _draw_margins(ax: Axes, series: Series) -> None:
    mark_phases(ax, series)
    curves = []
    if series.style == "paper":
        curves.append((series.paper_margin, INK, "support region of the paper: planes, cylinder"))
    curves.append((series.true_margin, GREEN, "convex hull of the soles as configured"))
    if series.urdf_margin is not None:
        curves.append((series.urdf_margin, ORANGE, "convex hull of the soles of the URDF"))
    for values, color, label in curves:
        ax.plot(series.time, 1e3 * values, color=color, label=label)
    ax.axhline(0.0, color=RED, linestyle=DASHED, linewidth=1.3)
    low, high = ax.get_ylim()
    ax.set_ylim(low - 0.02 * (high - low), high + 0.36 * (high - low))
    set_time_limits(ax, series)
    ax.set(xlabel="time [s]", ylabel="margin [mm]")
    ax.set_title("B   Margin of the CoM to the edge of its support (negative: outside)")
    name_phases(ax, series)
    ax.legend(
        loc="upper left", bbox_to_anchor=(0.0, 0.95), fontsize=8.5, frameon=True, framealpha=1.0, edgecolor="none"
    )


# ---------------------------------------------------------------------- in physics


@drawing()
def on_the_ground(series: Series) -> Figure:
    """Draw the real soles, CoM and centre of pressure, the margin of the CoP and the tilt of the soles."""
    of = series.ground
    if of is None:
        raise ValueError("the walk was not simulated in physics")
    long, broad = np.ptp(of.stands[:, :2], axis=0) + 0.3
    if long > 2.0 * broad:
        top = float(np.clip(11.0 * broad / long, 1.8, 5.0))
        fig = new_figure(11.5, top + 5.4)
        grid = fig.add_gridspec(4, 1, height_ratios=[top, 1.6, 1.1, 1.1])
        axes = [fig.add_subplot(grid[k, 0]) for k in range(4)]
    else:
        fig = new_figure(11.5, 6.2)
        grid = fig.add_gridspec(3, 2, width_ratios=[1.15, 1.0], height_ratios=[1.4, 1.0, 1.0])
        axes = [fig.add_subplot(grid[:, 0]), *(fig.add_subplot(grid[k, 1]) for k in range(3))]
    _draw_ground(axes[0], series, of)
    _draw_over_time(axes[1:], series, of)
    handles = [
        *_soles_legend(),
        Line2D([], [], color=INK, linewidth=1.6, label="CoM"),
        Line2D([], [], color=ORANGE, linewidth=1.0, label="centre of pressure"),
        Line2D([], [], color=GREY, marker="o", markersize=3, linestyle="", label="halfway between the feet"),
    ]
    if of.circle is not None:
        label = f"circle of {of.circle.radius:.3f} m"
        handles.append(Line2D([], [], color=RED, linestyle=DASHED, linewidth=1.2, label=label))
    _legend(fig, handles)
    turned = of.stands[-1, 2]
    _title(fig, series, "in physics", f", turned by {np.degrees(turned):+.0f} degrees" if abs(turned) > 0.1 else "")
    return fig


def _draw_ground(ax: Axes, series: Series, of: GroundTruth) -> None:
    soles = series.trace.model.soles
    doubles = [(index, span) for index, span in enumerate(series.spans) if span.double]
    for foot in Foot:
        landed = [span.start for index, span in doubles if index == 0 or span.phase.base is foot.other]
        stands = [_corners(of.soles[foot][tick], soles[foot]) for tick in landed]
        _draw_polygons(ax, stands, FOOT[foot], FOOT[foot] + "1c", linewidth=1.0, zorder=2)
    if of.circle is not None:
        _draw_rings(ax, [of.circle.center], of.circle.radius, zorder=3)
    ax.plot(of.physics.cop[:, 0], of.physics.cop[:, 1], color=ORANGE, linewidth=0.8, alpha=0.85, zorder=4)
    ax.plot(of.com[:, 0], of.com[:, 1], color=INK, linewidth=1.6, zorder=5)
    ax.plot(*of.stands[:, :2].T, "o", color=GREY, markersize=2.5, zorder=6)
    _finish(ax, "A   True motion from above")


def _draw_over_time(axes: list[Axes], series: Series, of: GroundTruth) -> None:
    """Draw the margin of the centre of pressure, the tilt, and which foot bears the weight."""
    tilt = np.degrees(of.tilt)
    most = float(np.nanmax(tilt))
    for ax, values, color in zip(axes[:2], (1e3 * of.cop_margin, tilt), (ORANGE, INK), strict=True):
        mark_phases(ax, series)
        ax.plot(series.time, values, color=color, linewidth=1.1)
        set_time_limits(ax, series)
    axes[0].axhline(0.0, color=RED, linestyle=DASHED, linewidth=1.2)
    axes[0].set_ylabel("margin [mm]")
    share = "not recorded" if of.inside is None else f"{100.0 * of.inside:.2f} % of ticks"
    axes[0].set_title(f"B   Centre of pressure inside its soles: {share}")
    if most > 0.5 * np.degrees(TILT):
        axes[1].axhline(np.degrees(TILT), color=RED, linestyle=DASHED, linewidth=1.2)
    axes[1].set_ylim(bottom=0.0)
    axes[1].set_ylabel("tilt [degrees]")
    axes[1].set_title(f"C   Tilt of the more loaded sole: at most {most:.2f} degrees")
    _draw_loads(axes[2], series, of)


def _draw_loads(ax: Axes, series: Series, of: GroundTruth) -> None:
    """Draw the fraction of the weight on each foot as a bar over time, and the estimate as a line."""
    true = np.stack([of.physics.wrenches[foot][:, 2] for foot in Foot], axis=1)
    part = true[:, 0] / np.maximum(true.sum(axis=1), 1e-3)
    ax.fill_between(series.time, 0.0, part, color=FOOT[Foot.LEFT], alpha=0.35, linewidth=0.0)
    ax.fill_between(series.time, part, 1.0, color=FOOT[Foot.RIGHT], alpha=0.35, linewidth=0.0)
    title = "D   Weight on each foot"
    if (loads := series.trace.loads) is not None:
        ax.plot(series.time, loads[:, 0] / np.maximum(loads.sum(axis=1), 1e-3), color=INK, linewidth=0.8)
        title += "; line: left, estimated from torques"
    set_time_limits(ax, series)
    ax.set(xlabel="time [s]", ylabel="fraction", ylim=(0.0, 1.0))
    ax.set_title(title)
