"""Which cells of a robustness matrix stood, and how the rest ended."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from dqwalk_ros.report.figures.style import GREEN, GREY, INK, drawing, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dqwalk_ros.studies.robustness import Cell

__all__ = ["robustness_figure"]

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
"""From a fall at once to one at the end."""


def robustness_figure(done: Sequence[Cell], axes: Mapping[str, Sequence[float]], steps: int) -> Figure:
    """Draw a panel per stiffness, a row per servo, a column per floor and mass.

    Parameters
    ----------
    done : sequence of Cell
    axes : mapping of str to sequence of float
    steps : int
        Of a whole walk: a cell that fell says how many it made.
    """
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.patches import Rectangle

    panels = list(axes.get(_PANEL, (float("nan"),)))
    across = [name for name in axes if name in _COLUMNS]
    down = [name for name in axes if name not in (*_COLUMNS, _PANEL)][::-1]
    columns = list(itertools.product(*(axes[name] for name in across)))
    rows = list(itertools.product(*(axes[name] for name in down)))
    known = {tuple(sorted(cell.values.items())): cell for cell in done}
    shade = LinearSegmentedColormap.from_list("fell", _FELL)
    with drawing():
        fig = new_figure(1.9 + len(panels) * (0.9 + 0.24 * len(columns)), 1.5 + 0.26 * len(rows))
        plots = np.atleast_1d(fig.subplots(1, len(panels), sharey=True))
        for ax, panel in zip(plots, panels, strict=True):
            stood = walked = 0
            for (r, row), (c, column) in itertools.product(enumerate(rows), enumerate(columns)):
                values = dict(zip(down, row, strict=True)) | dict(zip(across, column, strict=True))
                if _PANEL in axes:
                    values[_PANEL] = panel
                cell = known.get(tuple(sorted(values.items())))
                color: str | tuple[float, float, float, float] = "#eef1f4"
                if cell is not None:
                    walked += 1
                    stood += cell.stood
                    color = GREEN if cell.stood else shade(min(cell.steps / max(steps, 1), 1.0))
                ax.add_patch(Rectangle((c, r), 1.0, 1.0, facecolor=color, edgecolor="white", linewidth=1.2))
                if cell is not None and not cell.stood:
                    ax.text(c + 0.5, r + 0.52, str(cell.steps), color="white", fontsize=6.5, ha="center", va="center")
            ax.set(xlim=(0, len(columns)), ylim=(len(rows), 0))
            ax.grid(visible=False)
            for side in ("left", "bottom"):
                ax.spines[side].set_visible(False)
            ax.tick_params(length=0)
            ax.set_xticks(np.arange(len(columns)) + 0.5, [_joined(across, column) for column in columns], rotation=90)
            ax.set_yticks(np.arange(len(rows)) + 0.5, [_joined(down, row) for row in rows])
            ax.tick_params(labelsize=7.0)
            name = _said(_PANEL, panel) if _PANEL in axes else "all"
            ax.set_title(f"{name}: {stood} of {walked}", fontsize=9.5)
        fig.suptitle(
            f"{sum(cell.stood for cell in done)} of {len(done)} cells stood after {steps} steps",
            fontsize=12, fontweight="bold", color=INK,
        )  # fmt: skip
        fig.supxlabel(
            "green: stood; red: fell or stopped, with the steps it made; grey: not walked", fontsize=8, color=GREY
        )
    return fig


def _said(name: str, value: float) -> str:
    word, form, scale, shift = _WORD.get(name, (name, "{:g}", 1.0, 0.0))
    return f"{word} {form.format(scale * value + shift)}"


def _joined(names: Sequence[str], values: Sequence[float]) -> str:
    return ", ".join(_said(name, value) for name, value in zip(names, values, strict=True))
