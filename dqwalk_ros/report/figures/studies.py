"""The figures of studies: which walks finished, which cells stood, and the hardest pushes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from dqwalk_ros.report.figures.style import BLUE, GREEN, GREY, INK, RED, drawing, new_figure

if TYPE_CHECKING:
    from dqwalk_ros.studies.pushes import Limit
    from dqwalk_ros.studies.robustness import Cell

__all__ = ["pushes_figure", "robustness_figure", "study_figure"]

# ---------------------------------------------------------------------- walks with parameters varied

_MARGIN = "margin/paper"


@drawing()
def study_figure(rows: Sequence[Mapping[str, Any]], names: Sequence[str], units: Mapping[str, str]) -> Any:
    """Draw the walks of a study; return a matplotlib figure.

    Parameters
    ----------
    rows : sequence of mapping
        As `studies.walk_all` returns them.
    names : sequence of str
        The varied parameters. The first numeric one is the x axis; a second one is the y axis, with the margin as
        colour; without a second one the y axis is the margin. Each value of a non-numeric parameter has its own panel.
    units : mapping of str to str
        Unit of each parameter that has one.
    """
    numbers = [name for name in names if all(_is_number(row[name]) for row in rows)]
    others = [name for name in names if name not in numbers]
    panels: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        panels.setdefault(", ".join(f"{name.split('.')[-1]}: {_text(row[name])}" for name in others), []).append(row)
    figure = new_figure(1.4 + 3.6 * len(panels), 3.6)
    axes = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    margins = [1e3 * row[_MARGIN] for row in rows if row["finished"]]
    most = max(map(abs, margins), default=1.0) or 1.0
    points = None
    for axis, (title, some) in zip(axes, panels.items(), strict=True):
        done = [row for row in some if row["finished"]]
        failed = [row for row in some if not row["finished"]]
        share = f"{len(done)} of {len(some)} finished"
        axis.set_title(f"{title}\n{share}" if title else share)
        if len(numbers) > 1:
            x, y = numbers[:2]
            colour = [1e3 * row[_MARGIN] for row in done]
            points = axis.scatter(
                [r[x] for r in done], [r[y] for r in done], c=colour, s=34, cmap="viridis", vmin=0, vmax=most
            )
            axis.scatter([r[x] for r in failed], [r[y] for r in failed], c=RED, marker="x", s=26, label="failed")
            axis.set_ylabel(_label(y, units))
        else:
            x = numbers[0] if numbers else "walk"
            for key, tone, label in (
                (_MARGIN, BLUE, "to the paper's planes and cylinder"),
                ("margin/true", GREEN, "to the edge of the soles"),
            ):
                axis.plot([r[x] for r in done], [1e3 * r[key] for r in done], "o-", color=tone, ms=4, label=label)
            low = min([0.0, *(1e3 * r[k] for r in done for k in (_MARGIN, "margin/true"))])
            axis.plot([r[x] for r in failed], [low] * len(failed), "x", color=RED, ms=7, label="did not finish")
            axis.axhline(0.0, color=GREY, lw=0.8)
            axis.set_ylabel("least margin of the CoM [mm]")
        axis.set_xlabel(_label(x, units))
        axis.locator_params(axis="x", nbins=5)
        axis.label_outer()
    handles: dict[str, Any] = {}
    for axis in axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if handles:
        figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=len(handles))
    if points is not None:
        figure.colorbar(points, ax=list(axes), label="least margin to the paper's planes [mm]")
    return figure


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def _text(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value)) or "none"
    return str(value)


def _label(name: str, units: Mapping[str, str]) -> str:
    unit = units.get(name, "")
    return f"{name} [{unit}]" if unit else name


# ---------------------------------------------------------------------- robots and floors that differ

_COLUMNS = ("physics.friction", "physics.mass_scale")
_PANEL = "servo.stiffness"
_WORD = {
    "physics.friction": ("friction", "{:g}", 1.0, 0.0),
    "physics.mass_scale": ("mass", "{:+.0f} %", 100.0, -100.0),
    "servo.stiffness": ("stiffness", "{:g} N m/rad", 1.0, 0.0),
    "servo.backlash": ("play", "{:.2f}°", 57.29578, 0.0),
    "servo.rate": ("output", "{:g} Hz", 1.0, 0.0),
    "servo.latency": ("latency", "{:.0f} ms", 1e3, 0.0),
}
_FELL = ("#7a0916", "#d1242f", "#f0a3a8")
"""Colours from an early to a late fall."""


@drawing()
def robustness_figure(done: Sequence[Cell], axes: Mapping[str, Sequence[float]], steps: int) -> Figure:
    """Draw a panel per stiffness, a row per servo, a column per floor and mass.

    Cells that fell show the number of their steps, of the `steps` of a whole walk.
    """
    panels = list(axes.get(_PANEL, (float("nan"),)))
    across = [name for name in axes if name in _COLUMNS]
    down = [name for name in axes if name not in (*_COLUMNS, _PANEL)][::-1]
    columns = list(itertools.product(*(axes[name] for name in across)))
    rows = list(itertools.product(*(axes[name] for name in down)))
    known = {frozenset(values.items()): end for values, end in done}
    shade = LinearSegmentedColormap.from_list("fell", _FELL)
    fig = new_figure(1.9 + len(panels) * (0.9 + 0.24 * len(columns)), 1.5 + 0.26 * len(rows))
    plots = fig.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for ax, panel in zip(plots, panels, strict=True):
        stood = walked = 0
        for (r, row), (c, column) in itertools.product(enumerate(rows), enumerate(columns)):
            values = dict(zip(down, row, strict=True)) | dict(zip(across, column, strict=True))
            if _PANEL in axes:
                values[_PANEL] = panel
            end = known.get(frozenset(values.items()))
            color: Any = "#eef1f4"
            if end is not None:
                walked += 1
                stood += end.stood
                color = GREEN if end.stood else shade(min(end.steps / max(steps, 1), 1.0))
            ax.add_patch(Rectangle((c, r), 1.0, 1.0, facecolor=color, edgecolor="white", linewidth=1.2))
            if end is not None and not end.stood:
                ax.text(c + 0.5, r + 0.52, str(end.steps), color="white", fontsize=6.5, ha="center", va="center")
        ax.set(xlim=(0, len(columns)), ylim=(len(rows), 0))
        ax.grid(visible=False)
        ax.spines[["left", "bottom"]].set_visible(False)
        ax.tick_params(length=0)
        ax.set_xticks(np.arange(len(columns)) + 0.5, [_joined(across, column) for column in columns], rotation=90)
        ax.set_yticks(np.arange(len(rows)) + 0.5, [_joined(down, row) for row in rows])
        ax.tick_params(labelsize=7.0)
        name = _described(_PANEL, panel) if _PANEL in axes else "all"
        ax.set_title(f"{name}: {stood} of {walked}", fontsize=9.5)
    fig.suptitle(
        f"{sum(end.stood for _, end in done)} of {len(done)} cells stood after {steps} steps",
        fontsize=12, fontweight="bold", color=INK,
    )  # fmt: skip
    fig.supxlabel(
        "green: stood; red: fell or stopped, with the number of steps; grey: not simulated", fontsize=8, color=GREY
    )
    return fig


def _described(name: str, value: float) -> str:
    word, form, scale, shift = _WORD.get(name, (name, "{:g}", 1.0, 0.0))
    return f"{word} {form.format(scale * value + shift)}"


def _joined(names: Sequence[str], values: Sequence[float]) -> str:
    return ", ".join(_described(name, value) for name, value in zip(names, values, strict=True))


# ---------------------------------------------------------------------- pushes


@drawing()
def pushes_figure(found: Mapping[str, Sequence[Limit]], title: str) -> Figure:
    """Draw the impulse survived in each direction, with ahead at the top and left on the left, a line per name."""
    fig = new_figure(5.4, 5.6)
    ax: Any = fig.subplots(subplot_kw={"projection": "polar"})
    ax.set_theta_zero_location("N")
    for (label, limits), color in zip(found.items(), (INK, BLUE, GREEN, RED), strict=False):
        angle = np.array([one.direction for one in limits])
        size = np.array([one.survived for one in limits])
        closed = np.append(np.arange(len(limits)), 0)
        ax.plot(angle[closed], size[closed], "o-", color=color, markersize=4, label=label)
        ax.fill(angle, size, color=color, alpha=0.08)
    ax.set_xticks(np.arange(0.0, 2.0 * math.pi, 0.25 * math.pi), ["ahead", "", "left", "", "back", "", "right", ""])
    ax.set_rlabel_position(22.5)
    ax.tick_params(labelsize=8.5)
    ax.set_ylim(0.0, None)
    fig.suptitle(title, fontsize=12, fontweight="bold")
    fig.legend(loc="outside lower center", ncols=1, fontsize=8.5)
    return fig
