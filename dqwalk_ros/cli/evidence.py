"""``dqwalk evidence``: simulates what the tables of results claim, in every engine."""

from __future__ import annotations

import fnmatch
import math
import statistics
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from dqwalk_ros.cli.options import Many, command, many_options
from dqwalk_ros.plants.table import PHYSICS
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.text_table import aligned
from dqwalk_ros.support.wording import counted, listed, without_numbers

if TYPE_CHECKING:
    from dqwalk_ros.studies.evidence import WalkOutcome


@command("""
a file of rows is a list such as
  rows:
    - name: dynamic, MX, noise
      config: poppy_dynamic           # as of --config
      plant: physics                  # or poppy_as_built
      set: {gait.steps: 20}
      params: [rough]                 # as of --params
      cmd_vel: ["0.1,0,0.25,8"]       # as of --cmd-vel
      hands: 2.0                      # each hand gets a random pose every 2 s; needs params: [arms]
      course: 20                      # another random course of 20 s for each seed, with a `push` during each velocity
      seeds: 20                       # walks with sensors.seed 1 to 20; first: 101 for 101 to 120
    - {name: pushes of 0.50 N s, config: poppy_dynamic, push: 0.5}   # 8 directions, 2 feet, 4 instants of a step
    - {name: punches, config: poppy_dynamic, push: 0.3, anywhere: true}   # per seed: random link, direction, instant

writes to the folder of --out:
  walks.jsonl             a line per finished walk; an interrupted run continues from here
  evidence.csv, .txt      all walks in order, and the printed table

examples:
  dqwalk evidence ground                                         110 walks on uneven ground in each engine
  dqwalk evidence ground --config adopted/dynamic.yaml           the same for another robot, in proportion to its legs
  dqwalk evidence obstacles                                      rubble, steps, stairs, obstacles
  dqwalk evidence arms                                           free arms, loads, and random poses of the hands
  dqwalk evidence as_built                                       the as-built Poppy with more seeds, pushes
  dqwalk evidence --sample 2                                     two walks of each row in each engine
  dqwalk evidence --engine physics --jobs 8                      without Drake
  dqwalk evidence --engine drake --row '5 m MX*'                 some rows only
  dqwalk evidence mine.yaml --scheduler tcp://127.0.0.1:8786
""")
@click.argument("path", metavar="[ROWS.yaml]", default="evidence")
@click.option(
    "--config",
    metavar="CONFIG",
    show_default="that of each row",
    help="Name or path of the configuration of another robot: without the parameter files and servo types of the rows, "
    "and with rubble and steps in proportion to its legs.",
)
@click.option(
    "--engine",
    "engines",
    type=click.Choice([name for name in PHYSICS if name != "poppy_as_built"]),
    multiple=True,
    default=("physics", "drake"),
    help="Physics engine; may be repeated.",
)
@click.option(
    "--row",
    "wanted",
    metavar="NAME",
    multiple=True,
    show_default="all",
    help="Rows of this name, in which '*' matches any text; may be repeated.",
)
@click.option(
    "--sample",
    metavar="N",
    type=click.IntRange(0),
    default=0,
    show_default="all",
    help="Walks of each row that are simulated.",
)
@many_options("evidence")
def evidence(
    path: str, config: str | None, engines: tuple[str, ...], wanted: tuple[str, ...], sample: int, many: Many
) -> int:
    """Reproduce the tables of results, in two physics engines.

    Prints for every row and engine, MuJoCo and Drake, how many walks stood and how many reports are OK, each with the
    success rate that this proves (95 % confidence), and the worst numbers. Needs: pip install mujoco drake
    """
    from dqwalk_ros.cli.progress import Progress
    from dqwalk_ros.cli.results import prepare_study, write_study
    from dqwalk_ros.studies import evidence as study

    rows = study.read(path)
    if config is not None:
        rows = study.of_robot(rows, config)
    for name in wanted:
        if not fnmatch.filter(rows, name):
            raise ConfigError(f"--row {name}: the rows are {listed(rows)}")
    if wanted:
        rows = {name: row for name, row in rows.items() if any(fnmatch.fnmatchcase(name, text) for text in wanted)}
    prepare_study(many, "walks.jsonl", "evidence.csv", "evidence.txt")
    with many.options("walks", lambda last: "stood" if last.stood else "fell") as options:
        done = study.collect(rows, engines, many.folder, sample=sample, **options)
    keys = ["row", "engine", "seed", "foot", "direction", "part"]
    head = [*keys, "stood", "ok", "reason", "tilt_rad", "landing_m", "inside", "speed_m_s", "touching"]
    lines = [
        [
            *(point.get(key) for key in keys),
            *(end.stood, end.ok, end.reason, end.tilt, end.landing, end.inside, end.speed, end.touching),
        ]
        for point, end in done
    ]
    with Progress(quiet=many.quiet) as bar:
        bar(0.0, "ceilings of the robots")
        tops = study.ceilings(rows)
    write_study(many, "evidence", head, lines, table(done, tops))
    return 0 if all(end.stood for _, end in done) else 1


_HEAD = ("row", "stood", "OK", "tilt\n[deg]", "landing\n[mm]", "inside\n[%]", "speed\n[m/s]", "ceiling", "touch")
_LEGEND = """\
worst of all walks, the speed is the median; in brackets the success rate proved with 95 % confidence;
ceiling: the speed that the servos allow in steady steps; of pushes, what a pendulum on the soles catches
in the weakest direction with the steps of the walk; a body that turns can bear more than a point mass
touch: states in which links of the robot touch each other, by their collision shapes in MuJoCo"""


def table(done: Sequence[tuple[Mapping[str, Any], WalkOutcome]], ceilings: Mapping[str, str]) -> str:
    """Return a table per engine, with a line per row and its ceiling, and why some did not stand or are not OK."""
    engines: dict[str, dict[str, list[WalkOutcome]]] = {}
    for point, end in done:
        engines.setdefault(point["engine"], {}).setdefault(point["row"], []).append(end)
    parts = []
    for engine, rows in engines.items():
        lines = [_line(row, ends, ceilings.get(row, "")) for row, ends in rows.items()]
        parts += [f"{engine}:", "", aligned(lines, _HEAD, right=range(3, 9)), ""]
    reasons = [f"{point['row']}, {point['engine']}: {without_numbers(end.reason)}" for point, end in done if end.reason]
    if reasons:
        reasons = ["", "what did not stand or is not OK:", *counted(reasons, 20)]
    return "\n".join([*parts, _LEGEND, *reasons])


def _line(row: str, ends: Sequence[WalkOutcome], ceiling: str) -> list[str]:
    """Return the cells of a row: its worst numbers, and the median of its speeds."""
    from dqwalk_ros.studies.evidence import bounds

    def share(passed: Sequence[bool]) -> str:
        return f"{sum(passed)}/{len(passed)} ({100.0 * bounds(sum(passed), len(passed))[0]:.0f} %)"

    def figure(values: Sequence[float | None], pick: Any, factor: float, digits: int) -> str:
        known = [value for value in values if value is not None]
        return f"{factor * pick(known):.{digits}f}" if known else ""

    return [
        row,
        share([one.stood for one in ends]),
        share([bool(one.ok) for one in ends]) if any(one.ok is not None for one in ends) else "",
        figure([one.tilt for one in ends], max, 180.0 / math.pi, 2),
        figure([one.landing for one in ends], max, 1e3, 2),
        figure([one.inside for one in ends], min, 100.0, 2),
        figure([one.speed for one in ends], statistics.median, 1.0, 3),
        ceiling,
        figure([one.touching for one in ends], max, 1.0, 0),
    ]
