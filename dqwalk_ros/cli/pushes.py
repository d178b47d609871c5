"""``dqwalk pushes``: the largest impulse the robot survives in each direction, standing and walking."""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Sequence
from pathlib import Path

from dqwalk_ros.cli.progress import Progress
from dqwalk_ros.cli.settings import config_of
from dqwalk_ros.errors import ConfigError
from dqwalk_ros.model import load_model
from dqwalk_ros.report.figures.pushes import pushes_figure
from dqwalk_ros.report.figures.style import drawing
from dqwalk_ros.studies import pushes
from dqwalk_ros.studies.pushes import Limit

__all__ = ["run", "table"]


def run(args: argparse.Namespace) -> int:
    """Do it and return the exit code."""
    config = config_of(args)
    if config.gait.style != "standing":
        raise ConfigError(f"pushes are for a standing walk; gait.style of '{args.config}' is {config.gait.style}")
    bar = Progress(quiet=args.quiet)
    try:
        found = pushes.limits(
            config,
            pushes.MOMENTS if args.moment == "all" else (args.moment,),
            args.directions,
            duration=args.duration,
            tolerance=args.tolerance,
            jobs=args.jobs,
            progress=lambda count, total: bar(count / total, f"{count} of {total} directions"),
        )
    finally:
        bar.close()
    out = Path(args.out)
    out.mkdir(parents=True, exist_ok=True)
    with (out / "pushes.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["moment", "direction_deg", "survived_Ns", "failed_Ns", "reason"])
        writer.writerows(
            [one.moment, round(math.degrees(one.direction), 3), one.survived, one.failed, one.reason] for one in found
        )
    text = table(found, args.duration)
    (out / "pushes.txt").write_text(text + "\n", encoding="utf-8")
    with drawing():
        pushes_figure(found, load_model(config.robot).name).savefig(out / "pushes.png")
    print(text)
    return 0


def table(found: Sequence[Limit], duration: float) -> str:
    """Return the impulses survived, a line per direction and a column per moment."""
    moments = list(dict.fromkeys(one.moment for one in found))
    lines = [
        f"largest impulse survived [N s], a push of {duration:g} s on the pelvis",
        "",
        f"{'towards [deg, 0 ahead, 90 left]':32s}" + "".join(f"{moment:>10s}" for moment in moments),
    ]
    for direction in dict.fromkeys(one.direction for one in found):
        row = {one.moment: one for one in found if one.direction == direction}
        lines.append(f"{math.degrees(direction):32.0f}" + "".join(f"{row[m].survived:10.2f}" for m in moments))
    least = {m: min(one.survived for one in found if one.moment == m) for m in moments}
    lines.append(f"{'weakest':>32s}" + "".join(f"{least[m]:10.2f}" for m in moments))
    return "\n".join(lines)
