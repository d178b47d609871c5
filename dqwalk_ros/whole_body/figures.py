"""Figures 2 to 5 of the whole-body paper [Sherikov2014]."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import LogFormatter, MaxNLocator

from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.report.figures.style import BLUE, DASHED, FOOT, GREEN, GREY, INK, RED, Drawn, drawing, new_figure
from dqwalk_ros.whole_body.preview import Stepping
from dqwalk_ros.whole_body.trace import WholeBodyTrace


@drawing()
def solver(walked: WholeBodyTrace) -> Figure:
    """Draw Figure 2: solving time of the hierarchy, and number of changes of its active set."""
    fig = new_figure(9.0, 4.6)
    top, bottom = fig.subplots(2, 1, sharex=True)
    solve = 1e3 * walked.times[:, 2]
    top.plot(walked.time, solve, color=BLUE, linewidth=0.7)
    relaxed = np.array(["relaxed" in method for method in walked.method])
    if relaxed.any():
        top.plot(walked.time[relaxed], solve[relaxed], "o", color=RED, markersize=3.5, label="a level was relaxed")
    top.axhline(solve.mean(), color=INK, linestyle=DASHED, linewidth=1.1, label=f"mean {solve.mean():.2f} ms")
    top.axhline(0.92, color=GREY, linestyle=(0, (1, 2)), linewidth=1.4, label="the paper's mean, 0.92 ms (2012)")
    title = "Time to solve the hierarchy" + (" (recomputed from the recording)" if walked.again else "")
    top.set(ylabel="time [ms]", title=title, yscale="log")
    top.legend(fontsize=8, loc="upper right", ncols=3)
    top.set_ylim(0.5 * solve.min(), 4.0 * solve.max())
    top.yaxis.set_major_formatter("{x:g}")
    top.yaxis.set_minor_formatter(LogFormatter())
    bottom.plot(walked.time, walked.iterations, color=BLUE, linewidth=0.7)
    bottom.set(xlabel="time [s]", ylabel="iterations", title="Iterations of the active set (1: guess was correct)")
    bottom.yaxis.set_major_locator(MaxNLocator(integer=True))
    bottom.set_xlim(0.0, walked.time[-1])
    _mark_pushes((top, bottom), walked)
    fig.suptitle(f"{walked.scenario.name}: solving", fontweight="bold", x=0.01, ha="left")
    return fig


@drawing()
def walk_from_above(walks: Sequence[WholeBodyTrace]) -> Figure:
    """Draw Figure 3: footsteps, CoM, hand and target from above, one panel per walk."""
    places = np.vstack([np.vstack([w.hand[:, :2], w.target[:, :2], w.support]) for w in walks])
    low, high = np.nanmin(places, axis=0) - 0.18, np.nanmax(places, axis=0) + 0.18
    width = 10.5
    height = width * (high[1] - low[1]) / (high[0] - low[0])
    fig = new_figure(width, len(walks) * (height + 0.45) + 0.5)
    panels = np.atleast_1d(fig.subplots(len(walks), 1, sharex=True))
    for ax, walked in zip(panels, walks, strict=True):
        s = walked.config.whole_body
        stepping = Stepping.of(walked.config)
        half = np.array([0.5 * s.cop_length, 0.5 * s.cop_width])
        for index, (_, place) in enumerate(walked.footholds()):
            ax.add_patch(Rectangle(place - half, *(2.0 * half), **_looks(stepping.foot(index))))
        ax.plot(*walked.target.T[:2], color=RED, linestyle=(0, (1, 1.5)), linewidth=1.6, label="target")
        ax.plot(*walked.target[0, :2], "x", color=RED, markersize=6)
        ax.plot(*walked.hand.T[:2], color=BLUE, linestyle=DASHED, linewidth=1.3, label="hand")
        ax.plot(*walked.com.T[:2], color=INK, linewidth=1.5, label="CoM")
        for when, impulse in walked.scenario.pushes:
            at = walked.com[walked.at(when), :2]
            arrow = 0.012 * np.array(impulse[:2])
            ax.annotate("", at, at - arrow, arrowprops={"arrowstyle": "-|>", "color": RED, "linewidth": 1.8})
            text = f"{float(np.linalg.norm(impulse)):g} N s"
            side = "bottom" if arrow[1] < 0 else "top"
            ax.annotate(text, at - arrow, color=RED, fontsize=8, ha="center", va=side)
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), ylabel="y [m]", aspect="equal")
        steps = max(len(walked.footholds()) - 1, 0)
        ax.set_title(f"{walked.scenario.name}: {steps} step{'' if steps == 1 else 's'}")
    panels[-1].set_xlabel("x [m]")
    handles = panels[0].get_legend_handles_labels()[0]
    for foot in Foot:
        handles.append(Rectangle((0, 0), 1, 1, **_looks(foot), label=f"CoP area of the {foot.value} foot"))
    fig.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=8.5)
    return fig


def _looks(foot: Foot) -> dict[str, Any]:
    return {"facecolor": FOOT[foot] + "26", "edgecolor": FOOT[foot], "linewidth": 1.0}


@drawing()
def reactions(walked: WholeBodyTrace) -> Figure:
    """Draw Figures 4 and 5: target, hand, support and CoM velocity over time, along x and along y."""
    fig = new_figure(9.0, 7.0)
    panels = fig.subplots(2, 1, sharex=True)
    for axis, ax in enumerate(panels):
        dotted = (0, (1, 1.5))
        ax.plot(walked.time, walked.target[:, axis], color=RED, linestyle=dotted, linewidth=1.8, label="target [m]")
        ax.plot(walked.time, walked.hand[:, axis], color=BLUE, linestyle=DASHED, label="hand [m]")
        ax.plot(walked.time, walked.support[:, axis], color=GREEN, linewidth=1.4, label="support foot [m]")
        single = np.where(walked.single, walked.landing[:, axis], np.nan)
        ax.plot(walked.time, single, color=GREEN, linewidth=0.9, alpha=0.55, label="its next position [m]")
        velocity = walked.com_velocity[:, axis]
        ax.plot(walked.time, velocity, color=INK, linewidth=1.1, label="CoM velocity [m/s]")
        ax.set(ylabel="[m], [m/s]", title=f"({'ab'[axis]}) along {'xy'[axis]}")
        ax.set_xlim(0.0, walked.time[-1])
    panels[-1].set_xlabel("time [s]")
    for when, _ in walked.scenario.targets[1:]:
        for ax in panels:
            ax.axvline(when, color=GREY, linestyle=(0, (3, 3)), linewidth=0.9, label="new target")
    _mark_pushes(tuple(panels), walked)
    handles = {line.get_label(): line for line in panels[0].get_lines()}
    fig.legend(
        handles=[*handles.values()], loc="outside lower center", ncols=5 if len(handles) < 7 else 4, fontsize=8.5
    )
    what = " and pushes" if walked.scenario.pushes else ""
    title = f"{walked.scenario.name}: reactions to a target that moves{what}"
    fig.suptitle(title, fontweight="bold", x=0.01, ha="left")
    return fig


def drawn(walks: Sequence[WholeBodyTrace]) -> Iterator[Drawn]:
    """Draw the figures of some walks; a single walk with pushes has Figure 5 instead of Figure 4."""
    yield Drawn("figure2", solver(walks[0]), "Figure 2: solving time of the hierarchy, and changes of its active set.")
    yield Drawn("figure3", walk_from_above(walks), "Figure 3: from above.")
    caption = "Figures 4, 5: target, hand, support and the velocity of the centre of mass."
    for number, walked in enumerate(walks, 5 if len(walks) == 1 and walks[0].scenario.pushes else 4):
        yield Drawn(f"figure{number}", reactions(walked), caption)


def _mark_pushes(panels: Sequence[Axes], walked: WholeBodyTrace) -> None:
    for when, _ in walked.scenario.pushes:
        for ax in panels:
            ax.axvline(when, color=RED, linewidth=1.0, label="push")
