"""``dqwalk robustness``: the same walk in physics on robots and floors that differ."""

from __future__ import annotations

import argparse
import csv
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from dqwalk_ros.cli.progress import Progress
from dqwalk_ros.cli.settings import config_of
from dqwalk_ros.errors import ConfigError
from dqwalk_ros.report.figures.robustness import robustness_figure
from dqwalk_ros.report.figures.style import drawing
from dqwalk_ros.studies import robustness
from dqwalk_ros.studies.robustness import AXES, Cell

__all__ = ["run", "table"]

_NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")


def run(args: argparse.Namespace) -> int:
    """Do it and return the exit code."""
    config = config_of(args).updated({"gait.steps": args.steps}, source="command line")
    axes = dict(AXES)
    for text in args.axis:
        name, _, values = text.partition("=")
        try:
            axes[name] = tuple(float(value) for value in values.split(","))
        except ValueError:
            raise ConfigError(f"--axis wants KEY=NUMBER,NUMBER..., not '{text}'") from None
    combinations = robustness.cells(axes, args.sample, args.seed)
    out = Path(args.out)
    out.mkdir(parents=True, exist_ok=True)
    kept = robustness.Kept(out / "cells.jsonl", config, force=args.force)
    bar, stood = Progress(quiet=args.quiet), sum(kept.stood(values) for values in combinations)

    def progress(count: int, cell: Cell) -> None:
        nonlocal stood
        stood += cell.stood
        bar(count / len(combinations), f"{count} of {len(combinations)} cells, {stood} of them stood")

    try:
        done = robustness.run(config, combinations, jobs=args.jobs, kept=kept, progress=progress)
    finally:
        bar.close()
    _write(out / "robustness.csv", done, list(axes))
    text = table(done, axes)
    (out / "robustness.txt").write_text(text + "\n", encoding="utf-8")
    with drawing():
        robustness_figure(done, axes, args.steps).savefig(out / "robustness.png")
    print(text)
    return 0 if len(done) == len(combinations) and all(cell.stood for cell in done) else 1


def table(done: Sequence[Cell], axes: dict[str, tuple[float, ...]]) -> str:
    """Return the fraction that stood, in all and for each value, and what failed."""
    stood = sum(cell.stood for cell in done)
    total = 1
    for values in axes.values():
        total *= len(values)
    lines = [f"{stood} of {len(done)} cells stood ({len(done)} of the {total} combinations were walked)", ""]
    for name, values in axes.items():
        for value in values:
            part = [cell for cell in done if cell.values[name] == value]
            if part:
                good = sum(cell.stood for cell in part)
                lines.append(f"  {name + ' = ' + format(value, 'g'):28s} {good:3d} of {len(part):3d}")
    reasons = Counter(_NUMBER.sub("#", cell.reason) for cell in done if not cell.stood)
    if reasons:
        lines += ["", "why the others did not:", *(f"  {count:3d} x {why}" for why, count in reasons.most_common()), ""]
    for cell in done:
        if not cell.stood:
            where = ", ".join(f"{name.partition('.')[2]} {value:g}" for name, value in cell.values.items())
            lines.append(f"  failed at {cell.time:5.1f} s, after {cell.steps} steps: {where}: {cell.reason}")
    return "\n".join(lines)


def _write(path: Path, done: Sequence[Cell], names: list[str]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([*names, "stood", "time", "steps", "reason"])
        for cell in done:
            writer.writerow(
                [*(cell.values[name] for name in names), int(cell.stood), cell.time, cell.steps, cell.reason]
            )
