"""The largest impulses survived, as a rose."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dqwalk_ros.report.figures.style import BLUE, GREEN, INK, RED, drawing, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dqwalk_ros.studies.pushes import Limit

__all__ = ["pushes_figure"]


def pushes_figure(found: Mapping[str, Sequence[Limit]], title: str) -> Figure:
    """Draw the impulse survived in each direction, ahead up and left to the left, a line for each name."""
    with drawing():
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
