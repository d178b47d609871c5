"""``dqwalk study``: simulates many walks with varied parameters."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dqwalk_ros.cli.options import Many, Place, command, format_option, many_options
from dqwalk_ros.support.wording import counted, without_numbers

if TYPE_CHECKING:
    from dqwalk_ros.studies import Study


@command("""
a study is a file such as
  config: paper                     # a name or a path, as of --config
  set: {gait.cycles: 1}             # parameters of every walk
  sample: grid                      # or latin_hypercube, sobol, with `count: 64` and `seed: 0`
  vary:
    gait.step_length: {from: 0.02, to: 0.12, steps: 6}
    dsp.flat_feet: [true, false]    # a list of values
    start.l_knee_y: [0.0, 0.2]      # initial angle of a joint [rad]
    mass.pelvis: [1.0, 1.5]         # factor on the mass of the body to which a link is attached
    disturbance.velocity: [0.0, 0.01]   # standard deviation, every joint, every tick [rad/s]

writes to the folder of --out:
  walks.jsonl      a line per finished walk; an interrupted study continues from here
  walks.parquet    all walks in order: parameters, finished, end, duration, error, margins (pandas.read_parquet)
  study.png        which walks finished, and their margins

needs: pip install distributed pyarrow

examples:
  dqwalk study studies/step_length.yaml --jobs 2
  dqwalk study mine.yaml --dry-run                         check it, print the number of walks
  dqwalk study mine.yaml --scheduler tcp://127.0.0.1:8786
""")
@click.argument("path", metavar="STUDY.yaml", type=Place())
@many_options(None, shown="STUDY_study")
@click.option("--dry-run", is_flag=True, help="Check the study and print the number of its walks.")
@format_option
def study(path: Path, many: Many, dry_run: bool, formats: tuple[str, ...]) -> int:
    """Simulate many walks with varied parameters.

    The exit code is 0 when all walks were simulated, whether or not they finished.
    """
    from dqwalk_ros import studies
    from dqwalk_ros.cli.results import prepare_study

    plan = studies.read(path)
    if dry_run:
        points = plan.points()
        studies.set_up(plan.config, points[0])
        print(f"{plan.name}: {len(points)} walks ({plan.sample}); the first and the last:")
        print(f"  {points[0]}\n  {points[-1]}")
        return 0
    many = dataclasses.replace(many, out=many.out or Path(f"{path.stem}_study"))
    folder = many.folder
    prepare_study(many, "walks.jsonl", "walks.parquet", *(f"study.{kind}" for kind in formats))
    with many.options("walks", lambda last: "finished" if last.finished else "failed") as options:
        rows = studies.walk_all(plan, folder, **options)
    from dqwalk_ros.report.figures.studies import study_figure
    from dqwalk_ros.report.figures.style import Drawn, save

    figures = save([Drawn("study", study_figure(rows, list(plan.vary), _units(plan)))], folder, formats, overwrite=True)
    if not many.quiet:
        print(_summary(plan, rows))
        print(f"wrote {', '.join(map(str, [folder / 'walks.parquet', *figures]))}")
    return 0


def _units(study: Study) -> dict[str, str]:
    """Return the units of the parameters that a study may vary."""
    from dqwalk_ros.config import Config

    own = {name: "rad" for name in study.vary if name.startswith("start.")} | {"disturbance.velocity": "rad/s"}
    return {spec.name: spec.unit for spec in Config.specs()} | own


def _summary(study: Study, rows: list[dict[str, Any]]) -> str:
    from dqwalk_ros.report.figures.studies import MARGINS, margins_of

    finished = [row for row in rows if row["finished"]]
    lines = [f"{study.name}: {len(finished)} of {len(rows)} walks finished"]
    if finished:
        margin = margins_of(rows)[0]
        best = max(finished, key=lambda row: row[margin])
        at = ", ".join(f"{name} = {best[name]}" for name in study.vary)
        lines.append(f"  best smallest margin {MARGINS[margin][1]}: {1e3 * best[margin]:.2f} mm at {at}")
    lines += counted((without_numbers(row["end"]) for row in rows if not row["finished"]), 6)
    return "\n".join(lines)
