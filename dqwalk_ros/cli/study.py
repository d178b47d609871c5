"""``dqwalk study``: many walks with parameters varied."""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from typing import Any

from dqwalk_ros.cli.progress import Progress
from dqwalk_ros.config import Config
from dqwalk_ros.studies import Study, read
from dqwalk_ros.studies import run as run_study

__all__ = ["run"]


def run(args: argparse.Namespace) -> int:
    """Do it and return the exit code: 0 when all walks are there, however they ended."""
    study, out = read(args.study), Path(args.out or f"{Path(args.study).stem}_study")
    if args.dry_run:
        points = study.points()
        print(f"{study.name}: {len(points)} walks ({study.sample}); the first and the last:")
        print(f"  {points[0]}\n  {points[-1]}")
        return 0
    bar = Progress(quiet=args.quiet)

    def progress(done: int, total: int, rows: list[dict[str, Any]]) -> None:
        finished = sum(row["finished"] for row in rows)
        bar(done / total, f"{done} of {total} walks, {finished} finished")

    try:
        rows = run_study(study, out, jobs=args.jobs, scheduler=args.scheduler, progress=progress)
    finally:
        bar.close()
    figures = _draw(study, rows, out, args.format)
    if not args.quiet:
        print(_summary(study, rows))
        print(f"wrote {', '.join(map(str, [out / 'walks.parquet', *figures]))}")
    return 0


def _draw(study: Study, rows: list[dict[str, Any]], out: Path, formats: tuple[str, ...]) -> list[Path]:
    from dqwalk_ros.report.figures.study import study_figure

    units = {spec.name: spec.unit for spec in Config.specs()}
    units |= {name: "rad" for name in study.vary if name.startswith("start.")}
    units |= {"disturbance.velocity": "rad/s"}
    figure = study_figure(rows, list(study.vary), units)
    paths = [out / f"study.{kind}" for kind in formats]
    for path in paths:
        figure.savefig(path)
    return paths


def _summary(study: Study, rows: list[dict[str, Any]]) -> str:
    finished = [row for row in rows if row["finished"]]
    lines = [f"{study.name}: {len(finished)} of {len(rows)} walks finished"]
    if finished:
        best = max(finished, key=lambda row: row["margin/paper"])
        at = ", ".join(f"{name} = {best[name]}" for name in study.vary)
        lines.append(f"  largest least margin to the paper's planes: {1e3 * best['margin/paper']:.2f} mm at {at}")
    # the same failure at other numbers is the same failure
    ends = Counter(row["end"].partition(" at an error")[0].partition(":")[0] for row in rows if not row["finished"])
    lines += [f"  {count:4d} x {end}" for end, count in ends.most_common(6)]
    return "\n".join(lines)
