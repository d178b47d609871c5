"""``dqwalk robustness``: simulates the same walk in physics for different robots and floors."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from dqwalk_ros.cli.options import (
    Many,
    Setup,
    command,
    many_options,
    setup_options,
)
from dqwalk_ros.plants.table import PHYSICS
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.wording import counted, without_numbers

if TYPE_CHECKING:
    from dqwalk_ros.studies.robustness import Cell


@command("""
writes to the folder of --out:
  cells.jsonl             a line per finished cell; an interrupted run continues from here
  robustness.csv, .txt    all cells in order, and the printed table
  robustness.png          the matrix: which cells stood, and after how many steps the others fell

examples:
  dqwalk robustness --jobs 4 --set qp.solver=daqp          the same results in less time (pip install daqp)
  dqwalk robustness --sample 40
  dqwalk robustness --axis servo.stiffness=60 --axis servo.latency=0,0.06 --steps 4
  dqwalk robustness --axis latency_error=-0.02,0.02 --sample 72      the controller assumes a wrong latency
  dqwalk robustness --plant poppy_as_built --steps 20                40 walks: two P gains, 20 seeds of the sensors
""")
@setup_options("poppy", PHYSICS, "physics")
@click.option("--steps", metavar="N", type=int, default=10, help="Steps of each walk.")
@click.option("--axis", metavar="KEY=A,B", multiple=True, help="Vary a parameter over these values; may be repeated.")
@click.option(
    "--sample", metavar="N", type=click.IntRange(0), default=0, show_default="all", help="Walk N random combinations."
)
@click.option("--seed", metavar="N", type=int, default=0, help="Seed of --sample.")
@many_options("robustness")
def robustness(
    setup: Setup,
    steps: int,
    axis: tuple[str, ...],
    sample: int,
    seed: int,
    many: Many,
) -> int:
    """Walk in physics with different robots and floors.

    Walks every combination of friction, mass, servo stiffness, backlash, output rate and latency (432 of them) and
    prints the fraction that stood and why the others did not. Needs MuJoCo: pip install mujoco
    """
    from dqwalk_ros.cli.results import prepare_study, write_study
    from dqwalk_ros.report.figures.studies import robustness_figure
    from dqwalk_ros.studies import robustness as study
    from dqwalk_ros.walks.table import style_of

    made = setup.made({"gait.steps": steps})
    if style_of(made) == "paper":  # its number of steps is not --steps, and it falls at once
        raise ConfigError(f"robustness needs a standing or a dynamic walk; gait.style of '{setup.config}' is paper")
    axes = study.axes_of(made)
    for text in axis:
        name, _, values = text.partition("=")
        try:
            axes[name] = tuple(map(_number, values.split(",")))
        except ValueError:
            raise ConfigError(f"--axis needs KEY=NUMBER,NUMBER..., not {text!r}") from None
    for name, numbers in axes.items():  # invalid values are rejected before the first walk
        for number in numbers:
            varied = study.assumed(made, number) if name == study.LATENCY_ERROR else {name: number}
            made.updated(varied, source="--axis")
    prepare_study(many, "cells.jsonl", "robustness.csv", "robustness.txt", "robustness.png")
    combinations = study.cells(axes, sample, seed)
    with many.options("cells", lambda last: "stood" if last.stood else "did not stand") as options:
        done = study.walk_all(made, combinations, many.folder, **options)
    head = [*axes, "stood", "time", "steps", "reason", "tilt"]
    rows = [
        [*(values[name] for name in axes), int(end.stood), end.time, end.steps, end.reason, end.tilt]
        for values, end in done
    ]
    write_study(many, "robustness", head, rows, table(done, axes), robustness_figure(done, axes, steps))
    return 0 if all(end.stood for _, end in done) else 1


def _number(text: str) -> float:
    """Return a number, as an integer if it is one, because a seed must be an integer."""
    value = float(text)
    if not math.isfinite(value):
        raise ValueError
    return int(value) if value.is_integer() else value


def table(done: Sequence[Cell], axes: dict[str, tuple[float, ...]]) -> str:
    """Return the fraction that stood, in total and for each value, and the failures."""
    stood = sum(end.stood for _, end in done)
    total = math.prod(map(len, axes.values()))
    lines = [f"{stood} of {len(done)} cells stood ({len(done)} of the {total} combinations were walked)"]
    tilts = [math.degrees(end.tilt) for _, end in done if end.stood and end.tilt is not None]
    if tilts:
        middle, worst = statistics.median(tilts), max(tilts)
        lines.append(
            f"tilt of the loaded sole, the largest of each walk: median {middle:.2f}, worst {worst:.2f} degrees"
        )
    loads = [(end.load, end.joint) for _, end in done if end.stood and end.load is not None]
    if loads:
        most, joint = max(loads)
        lines.append(f"the servos need at most {100.0 * most:.0f} % of their torque-speed curves ({joint})")
    reached = Counter[str]()
    for _, end in done:
        reached.update(end.reached if end.stood else {})
    limits = ", ".join(f"{name} on {count} ticks" for name, count in reached.most_common(3))
    lines += [f"limits reached in all walks that stood: {limits or 'none'}", ""]
    for name, varied in axes.items():
        for value in varied:
            part = [end.stood for values, end in done if values[name] == value]
            if part:
                lines.append(f"  {name + ' = ' + format(value, 'g'):28s} {sum(part):3d} of {len(part):3d}")
    fallen = [(values, end) for values, end in done if not end.stood]
    if fallen:
        lines += ["", "why the others did not:", *counted(without_numbers(end.reason) for _, end in fallen), ""]
    for values, end in fallen:
        where = ", ".join(f"{name.partition('.')[2]} {value:g}" for name, value in values.items())
        lines.append(f"  failed at {end.time:5.1f} s, after {end.steps} steps: {where}: {end.reason}")
    return "\n".join(lines)
