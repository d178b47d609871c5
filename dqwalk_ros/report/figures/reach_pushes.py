"""The hardest push that is survived, all around."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.report.figures.style import BLUE, GREEN, INK, RED, drawing, new_figure
from dqwalk_ros.robot import Foot
from dqwalk_ros.whole_body.experiments import PushLimit

__all__ = ["save_pushes"]

Array = NDArray[np.float64]
_LINES = ((BLUE, "o"), (GREEN, "s"), (INK, "^"), (RED, "v"))


def save_pushes(
    limits: Mapping[str, Sequence[PushLimit]],
    standing: Foot | None,
    folder: str | os.PathLike[str],
    formats: Sequence[str] = ("png",),
) -> list[Path]:
    """Draw limits into a folder and return the files.

    Parameters
    ----------
    limits : mapping of str to sequence of PushLimit
        Several, such as those of two plants, by name.
    standing : Foot or None
        The foot that stands while the robot is hit; None is both.
    folder : path-like
    formats : sequence of str
    """
    with drawing():
        fig = new_figure(6.2, 6.4)
        ax: Any = fig.add_subplot(projection="polar")
        ax.set_theta_zero_location("N")  # ahead is up, left is left
        for (name, found), (color, marker) in zip(limits.items(), _LINES, strict=False):
            ordered = sorted(found, key=lambda one: one.direction)
            angle = np.radians([one.direction for one in (*ordered, ordered[0])])
            stood = np.array([one.stood for one in (*ordered, ordered[0])])
            ax.plot(angle, stood, color=color, marker=marker, markersize=4.5, linewidth=1.6, label=name)
            ax.fill(angle, stood, color=color, alpha=0.07)
        most = max(one.stood for found in limits.values() for one in found)
        ax.set_ylim(0.0, 1.12 * max(most, 1.0))
        ax.set_xticks(np.radians(np.arange(0, 360, 45)), ["ahead", "", "left", "", "back", "", "right", ""])
        ax.set_rlabel_position(22.5)
        ax.tick_params(axis="y", labelsize=7.5, labelcolor="#57606a")
        feet = "both feet stand" if standing is None else f"the {standing.value} foot stands, the other swings"
        title = f"Hardest push that is survived [N s]\n{feet}; where the push sends the torso"
        ax.set_title(title, loc="left", pad=18.0)
        fig.legend(loc="outside lower center", ncols=len(limits))
        files = [Path(folder) / f"pushes.{kind}" for kind in formats]
        for file in files:
            fig.savefig(file)
    return files
