"""``dqwalk report``: evaluates and draws a recorded walk."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dqwalk_ros.cli.options import (
    Place,
    Report,
    bag_argument,
    beside,
    command,
    namespace_option,
    output_options,
    walk_option,
)
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.output import refuse_existing, refuse_inside, written

if TYPE_CHECKING:
    from dqwalk_ros.report import Series
    from dqwalk_ros.report.bag.storage import Content
    from dqwalk_ros.report.figures.style import Drawn
    from dqwalk_ros.report.html.page import Subject


@command("""
examples:
  dqwalk report walk/bag
  dqwalk report walk/bag --out paper --format pdf
  dqwalk report walk/bag --html                            report.html: opens offline, with a replay in 3D
  dqwalk report walk/bag --compare slower/bag              comparison.html: the two side by side
  dqwalk report walk/bag --json | jq .walk.margin
  dqwalk report rosbag2_2025_01_31/ --namespace poppy_1
""")
@bag_argument
@namespace_option
@walk_option
@click.option("--html", is_flag=True, help="Also write one offline page: replay, figures, tables.")
@click.option(
    "--compare",
    metavar="BAG",
    type=Place(),
    help="Another walk: write a page of both, side by side.",
)
@click.option("--csv", is_flag=True, help="Also write every series to series.csv, a line per state.")
@click.option("--json", "as_json", is_flag=True, help="Print the report as JSON instead of tables.")
@output_options(None, shown="BAG_report")
def report(
    bag: Path,
    namespace: str | None,
    walk: str,
    html: bool,
    compare: Path | None,
    csv: bool,
    as_json: bool,
    output: Report,
) -> int:
    """Evaluate and draw a recorded walk.

    BAG is the folder of a rosbag2, or one .mcap or .db3 file: split or compressed, recorded by `dqwalk` or by
    `ros2 bag record`, or truncated by a crash; the report then lists what is missing. All distances are recomputed
    from joint_states and the phases.
    """
    from dqwalk_ros import report as reporting
    from dqwalk_ros.cli.progress import Progress
    from dqwalk_ros.cli.results import write_report
    from dqwalk_ros.report import bag as bags
    from dqwalk_ros.report import figures
    from dqwalk_ros.report.bag.messages import diagnostics_of
    from dqwalk_ros.report.html import page

    quiet = output.quiet or as_json
    with Progress(quiet=quiet) as bar:
        bar.stage(0.0, "reading")
        content = bags.content_of(bag)
    output = replace(output, out=output.out or beside(bag, f"{bag.resolve().name}_report"))
    refuse_inside(bag, output.folder)
    sheet = output.folder / ("comparison.html" if compare else "report.html")
    if (html or compare) and not output.force:  # a page contains the time of its writing
        refuse_existing([sheet])
    if bags.is_body(content):
        if compare or csv:
            raise ConfigError("--compare and --csv are not available for whole-body walks")
        return _body(content, namespace, output, sheet if html else None, as_json=as_json)
    with Progress(quiet=quiet) as bar:
        bar.stage(0.0, "reading")
        trace = bags.read(content, namespace=namespace, walk=walk)
        statuses = diagnostics_of(content) if html or compare else []
        del content  # it is larger than all series
        bar.stage(0.3, "computing")
        series = reporting.analyse(trace)
        found = reporting.report(series)
        drawn: Iterable[Drawn] = figures.drawn(series)
        subjects = []
        if html or compare:
            own, *names = _names(bag, *filter(None, [compare]))
            others = [_other(compare, name, namespace, walk) for name in names if compare]
            bar.stage(0.7, "drawing")
            drawn = list(drawn)
            subjects = [page.Subject(own, series, found, statuses, drawn), *others]
    extra = []
    if subjects:
        extra.append(sheet)
        with Progress(quiet=quiet) as bar:
            bar.stage(0.0, "writing the page")
            page.write(subjects, sheet, overwrite=output.force)
    if csv:
        extra.append(_csv(series, output))
    write_report(output, found, reporting.render(found), drawn, as_json=as_json, more=extra)
    return 0 if found["ok"] else 1


def _body(bag: Content, namespace: str | None, output: Report, sheet: Path | None, *, as_json: bool) -> int:
    """Evaluate and draw a whole-body walk, also on one page if its file is given; return the exit code."""
    from dqwalk_ros.cli.progress import Progress
    from dqwalk_ros.cli.results import write_report
    from dqwalk_ros.whole_body import figures as reaching
    from dqwalk_ros.whole_body import page
    from dqwalk_ros.whole_body.bag import read_body
    from dqwalk_ros.whole_body.demands import checks, render_checks, summary
    from dqwalk_ros.whole_body.experiments import retrace

    quiet = output.quiet or as_json
    with Progress(quiet=quiet) as bar:
        bar.stage(0.0, "reading")
        log = read_body(bag, namespace=namespace)
        walked, off = retrace(log, progress=bar)
    demands = checks(walked)
    found = summary(walked, demands) | {"torques_differ_by": off, "notes": list(log.notes)}
    files = []
    if sheet is not None:
        files.append(sheet)
        differ = f"Recorded and recomputed torques differ by at most {off:.2g} N m."
        with Progress(quiet=quiet) as bar:
            bar.stage(0.0, "writing the page")
            page.write(sheet, _names(bag.path)[0], walked, demands, [differ, *log.notes], overwrite=output.force)
    for note in () if quiet else log.notes:
        print(f"note: {note}", file=sys.stderr)
    table = f"{render_checks(walked, demands)}\nrecorded and recomputed torques differ by at most {off:.2g} N m\n"
    write_report(output, found, table, reaching.drawn([walked]), as_json=as_json, more=files)
    return 0 if found["ok"] else 1


def _other(path: Path, name: str, namespace: str | None, walk: str) -> Subject:
    """Return the walk to be compared."""
    from dqwalk_ros import report as reporting
    from dqwalk_ros.report import bag, figures
    from dqwalk_ros.report.bag.messages import diagnostics_of
    from dqwalk_ros.report.html.page import Subject

    content = bag.content_of(path)
    if bag.is_body(content):
        raise ConfigError("--compare and --csv are not available for whole-body walks")
    series = reporting.analyse(bag.read(content, namespace=namespace, walk=walk))
    drawn = list(figures.drawn(series))
    return Subject(name, series, reporting.report(series), diagnostics_of(content), drawn)


def _names(*bags: Path) -> list[str]:
    """Return the titles of bags: the ends of their paths, longer for a default name, or where they are the same."""
    ends = [bag.resolve().parts[1:] for bag in bags]
    length = 2 if any(end[-1] in ("bag", "bag_1", "bag_2", "walk") for end in ends) else 1
    while len(set(ends)) > len({end[-length:] for end in ends}):
        length += 1
    return ["/".join(end[-length:]) for end in ends]


def _csv(series: Series, output: Report) -> Path:
    """Write time, joint angles, commands and every distance, a line per state."""
    import numpy as np

    trace = series.trace
    names = trace.model.joint_names
    columns = {"time [s]": trace.time, "error": series.error}
    columns |= {f"{name} [rad]": trace.q[:, i] for i, name in enumerate(names)}
    columns |= {f"{name} command [rad/s]": trace.u[:, i] for i, name in enumerate(names)}
    columns |= {f"com_{axis} [m]": series.com_odom[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"distance/{name}": values for name, values in series.distances.items()}
    columns |= {f"residual/{name}": values for name, values in series.residuals.items()}
    file = output.folder / "series.csv"
    table = np.column_stack(list(columns.values()))
    with written(file, overwrite=output.force) as new:
        np.savetxt(new, table, fmt="%.9g", delimiter=",", header=",".join(columns), comments="", encoding="utf-8")
    return file
