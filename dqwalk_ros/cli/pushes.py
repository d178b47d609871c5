"""``dqwalk pushes``: the largest impulse the robot survives in each direction, standing and walking."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dqwalk_ros.cli.options import command, config_of, config_option, jobs_option, quiet_option, set_option
from dqwalk_ros.errors import ConfigError

if TYPE_CHECKING:
    from dqwalk_ros.studies.pushes import Limit

__all__ = ["pushes", "table"]


@command("""
writes to the folder of --out:
  pushes.csv, .txt, .png

examples:
  dqwalk pushes --jobs 4 --set qp.solver=daqp
  dqwalk pushes --moment standing --directions 16 --set standing.balance=1.0
""")
@config_option("poppy")
@click.option(
    "--moment",
    type=click.Choice(["all", "standing", "left", "right"]),
    default="all",
    show_default=True,
    help="Standing, or in the middle of a step on this foot.",
)
@click.option(
    "--directions", metavar="N", type=click.IntRange(1, 360), default=8, show_default=True, help="Evenly spread."
)
@click.option("--duration", metavar="S", type=float, default=0.1, show_default=True, help="Of each push [s].")
@click.option("--tolerance", metavar="NS", type=float, default=0.02, show_default=True, help="Of each impulse [N s].")
@jobs_option
@click.option(
    "--out",
    metavar="DIR",
    type=click.Path(path_type=Path),
    default="pushes",
    show_default=True,
    help="Folder of the results.",
)
@quiet_option
@set_option
def pushes(
    config: str,
    moment: str,
    directions: int,
    duration: float,
    tolerance: float,
    jobs: int,
    out: Path,
    quiet: bool,
    changes: tuple[str, ...],
) -> int:
    """Find the largest push the robot survives.

    Pushes the pelvis of a walking robot in physics, in eight directions, standing on both feet and in the middle of a
    step on either foot, harder and harder until it falls, and prints the largest impulse survived.
    Needs dqwalk_ros[sim].
    """
    from dqwalk_ros.cli.progress import Progress
    from dqwalk_ros.report.figures.pushes import pushes_figure
    from dqwalk_ros.report.figures.style import drawing
    from dqwalk_ros.robot import load_model
    from dqwalk_ros.studies import pushes as study

    made = config_of(config, changes)
    if made.gait.style != "standing":
        raise ConfigError(f"pushes need a standing walk; gait.style of '{config}' is {made.gait.style}")
    with Progress(quiet=quiet) as bar:
        found = study.limits(
            made,
            study.MOMENTS if moment == "all" else (moment,),
            directions,
            duration=duration,
            tolerance=tolerance,
            jobs=jobs,
            progress=lambda count, total: bar(count / total, f"{count} of {total} directions"),
        )
    out.mkdir(parents=True, exist_ok=True)
    with (out / "pushes.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["moment", "direction_deg", "survived_Ns", "failed_Ns", "reason"])
        writer.writerows(
            [one.moment, round(math.degrees(one.direction), 3), one.survived, one.failed, one.reason] for one in found
        )
    text = table(found, duration)
    (out / "pushes.txt").write_text(text + "\n", encoding="utf-8")
    with drawing():
        pushes_figure(found, load_model(made.robot).name).savefig(out / "pushes.png")
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
