"""The figure of a study: which walks finished, and with how much margin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dqwalk_ros.report.figures.style import BLUE, GREEN, GREY, RED, drawing, new_figure

__all__ = ["study_figure"]

_MARGIN = "margin/paper"


def study_figure(rows: Sequence[Mapping[str, Any]], names: Sequence[str], units: Mapping[str, str]) -> Any:
    """Draw the walks of a study; return a matplotlib figure.

    Parameters
    ----------
    rows : sequence of mapping
        As `study.run` returns them.
    names : sequence of str
        The parameters that were varied. The first number is across; a second one is upwards, and the margin then a
        colour; without a second one the margin is upwards. What is no number gets a panel per value.
    units : mapping of str to str
        Unit of each parameter, where it has one.
    """
    numbers = [name for name in names if all(_is_number(row[name]) for row in rows)]
    others = [name for name in names if name not in numbers]
    panels: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        panels.setdefault(", ".join(f"{name.split('.')[-1]}: {_text(row[name])}" for name in others), []).append(row)
    with drawing():
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
