"""The figures of studies: which walks finished, which cells stood, and the hardest pushes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from dqwalk_ros.report.figures.style import BLUE, GREEN, GREY, INK, RED, drawing, new_figure

if TYPE_CHECKING:
    from dqwalk_ros.studies.pushes import Limit
    from dqwalk_ros.studies.robustness import Cell

# ---------------------------------------------------------------------- walks with parameters varied

MARGINS = {
    "margin/paper": (BLUE, "to the paper's planes and cylinder"),
    "margin/true": (GREEN, "to the edge of the soles"),
}
"""Colour and meaning of each margin of the CoM in a study."""


def margins_of(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return the margins that every finished walk has: only those of the paper's walk have its planes."""
    return [key for key in MARGINS if all(row[key] is not None for row in rows if row["finished"])]


@drawing()
def study_figure(rows: Sequence[Mapping[str, Any]], names: Sequence[str], units: Mapping[str, str]) -> Figure:
    """Draw the walks of a study.

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
    x, *more = numbers or ["walk"]
    panels: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        panels.setdefault(", ".join(f"{name.split('.')[-1]}: {_text(row[name])}" for name in others), []).append(row)
    figure = new_figure(1.4 + 3.6 * len(panels), 3.6)
    axes = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    margins = margins_of(rows)
    spread = [0.0, *_column([row for row in rows if row["finished"]], margins[0], 1e3)]
    for axis, (title, some) in zip(axes, panels.items(), strict=True):
        done = [row for row in some if row["finished"]]
        failed = [row for row in some if not row["finished"]]
        if more:
            _draw_map(axis, x, more[0], done, failed, margins[0], (min(spread), max(spread) or 1.0))
        else:
            _draw_margins(axis, x, done, failed, margins)
        axis.set(xlabel=_label(x, units), ylabel=_label(more[0], units) if more else "smallest margin of the CoM [mm]")
        share = f"{len(done)} of {len(some)} finished"
        axis.set_title(f"{title}\n{share}" if title else share)
        axis.locator_params(axis="x", nbins=5)
        axis.label_outer()
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3 if len(panels) > 1 else 1)
    if more:
        figure.colorbar(axes[0].collections[0], ax=list(axes), label=f"smallest margin {MARGINS[margins[0]][1]} [mm]")
    return figure


def _draw_map(
    axis: Axes,
    x: str,
    y: str,
    done: list[Mapping[str, Any]],
    failed: list[Mapping[str, Any]],
    margin: str,
    between: tuple[float, float],
) -> None:
    """Draw the walks as points over two parameters, with a margin as colour, `between` two values [mm]."""
    low, high = between
    margins = _column(done, margin, 1e3)
    axis.scatter(_column(done, x), _column(done, y), c=margins, s=34, cmap="viridis", vmin=low, vmax=high)
    axis.scatter(_column(failed, x), _column(failed, y), c=RED, marker="x", s=26, label="failed")


def _draw_margins(
    axis: Axes, x: str, done: list[Mapping[str, Any]], failed: list[Mapping[str, Any]], margins: Sequence[str]
) -> None:
    """Draw margins over one parameter."""
    low = 0.0
    for key in margins:
        tone, label = MARGINS[key]
        values = _column(done, key, 1e3)
        axis.plot(_column(done, x), values, "o-", color=tone, ms=4, label=label)
        low = min([low, *values])
    axis.plot(_column(failed, x), [low] * len(failed), "x", color=RED, ms=7, label="did not finish")
    axis.axhline(0.0, color=GREY, lw=0.8)


def _column(rows: Sequence[Mapping[str, Any]], key: str, scale: float = 1.0) -> list[float]:
    return [scale * row[key] for row in rows]


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
    "servo.backlash": ("play", "{:.2f}°", math.degrees(1.0), 0.0),
    "servo.rate": ("output", "{:g} Hz", 1.0, 0.0),
    "servo.latency": ("latency", "{:.0f} ms", 1e3, 0.0),
}
_FELL = ("#7a0916", RED, "#f0a3a8")
"""Colours from an early to a late fall."""


@drawing()
def robustness_figure(done: Sequence[Cell], axes: Mapping[str, Sequence[float]], steps: int) -> Figure:
    """Draw a panel per stiffness, a row per servo, a column per floor and mass; else one per value of the longest axis.

    Cells that fell show the number of their steps, of the `steps` of a whole walk.
    """
    varied = [name for name in axes if len(axes[name]) > 1]
    across = [name for name in varied if name in _COLUMNS]
    across = across or sorted(varied, key=lambda name: len(axes[name]))[-1:]
    groups = (
        [name for name in varied if name == _PANEL and name not in across],
        [name for name in varied if name not in (*across, _PANEL)][::-1],
        across,
    )
    panels, rows, columns = (list(itertools.product(*(axes[name] for name in names))) for names in groups)
    known = {frozenset((name, values[name]) for name in varied): end for values, end in done}
    shade = LinearSegmentedColormap.from_list("fell", _FELL)
    beside, below = (
        max(len(_described(names, one)) for one in every)
        for names, every in zip(groups[1:], (rows, columns), strict=True)
    )
    width = 0.6 + 0.06 * beside + len(panels) * (0.9 + 0.24 * len(columns))
    fig = new_figure(max(width, 4.6), 1.2 + 0.06 * below + 0.26 * len(rows))
    plots = fig.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for ax, panel in zip(plots, panels, strict=True):
        ends = []
        for (r, row), (c, column) in itertools.product(enumerate(rows), enumerate(columns)):
            values = zip(itertools.chain(*groups), (*panel, *row, *column), strict=True)
            end = known.get(frozenset(values))
            color: Any = "#eef1f4"
            if end is not None:
                ends.append(end)
                color = GREEN if end.stood else shade(min(end.steps / max(steps, 1), 1.0))
            ax.add_patch(Rectangle((c, r), 1.0, 1.0, facecolor=color, edgecolor="white", linewidth=1.2))
            if end is not None and not end.stood:
                ax.text(c + 0.5, r + 0.52, str(end.steps), color="white", fontsize=6.5, ha="center", va="center")
        ax.set(xlim=(0, len(columns)), ylim=(len(rows), 0))
        ax.grid(visible=False)
        ax.spines[["left", "bottom"]].set_visible(False)
        ax.tick_params(length=0, labelsize=7.0)
        ax.set_xticks(np.arange(len(columns)) + 0.5, [_described(groups[2], one) for one in columns], rotation=90)
        ax.set_yticks(np.arange(len(rows)) + 0.5, [_described(groups[1], one) for one in rows])
        title = _described(groups[0], panel) or "all"
        ax.set_title(f"{title}: {sum(end.stood for end in ends)} of {len(ends)}", fontsize=9.5)
    stood = sum(end.stood for _, end in done)
    title = f"{stood} of {len(done)} cells stood after {steps} steps"
    fig.suptitle(title, fontsize=12, fontweight="bold", color=INK)
    fig.supxlabel(
        "green: stood; red: fell or stopped, with the number of steps; grey: not simulated", fontsize=8, color=GREY
    )
    return fig


def _described(names: Sequence[str], values: Sequence[float]) -> str:
    words = []
    for name, value in zip(names, values, strict=True):
        word, form, scale, shift = _WORD.get(name, (name.rpartition(".")[2].replace("_", " "), "{:g}", 1.0, 0.0))
        words.append(f"{word} {form.format(scale * value + shift)}")
    return ", ".join(words)


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
