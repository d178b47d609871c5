"""``dqwalk report``: judge and draw a recorded walk."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dqwalk_ros.cli.results import write_results
from dqwalk_ros.errors import BagError
from dqwalk_ros.report import bag

if TYPE_CHECKING:
    from dqwalk_ros.report import Series

__all__ = ["run"]


def run(args: argparse.Namespace) -> int:
    """Do it and return the exit code."""
    path = Path(args.bag)
    out = Path(args.out) if args.out else path.with_name(path.resolve().name + "_report")
    if bag.is_body(path):
        from dqwalk_ros.cli import body

        return body.report(args, path, out, _name(path))
    series = _series(path, args.namespace)
    report = write_results(
        series.trace,
        out,
        formats=args.format,
        figures=not args.no_figures,
        quiet=args.quiet,
        as_json=args.json,
        series=series,
    )
    extra = []
    try:
        if args.html or args.compare:
            extra.append(_html(args, path, series, report, out))
        if args.csv:
            extra.append(_csv(series, out))
    except OSError as error:
        raise BagError(f"cannot write to '{out}': {error}") from error
    if extra and not (args.quiet or args.json):
        print("wrote " + ", ".join(str(file) for file in extra))
    return 0 if report["ok"] else 1


def _series(path: Path, namespace: str | None) -> Series:
    from dqwalk_ros import report as reporting

    return reporting.analyse(bag.read(path, namespace=namespace))


def _html(args: argparse.Namespace, path: Path, series: Series, report: dict[str, Any], out: Path) -> Path:
    """Write the page, of one walk or of two, and return its file."""
    from dqwalk_ros import report as reporting
    from dqwalk_ros.report import html
    from dqwalk_ros.report.bag.said import diagnostics_of

    subjects = [html.Subject(_name(path), series, report, diagnostics_of(path))]
    if args.compare:
        other = Path(args.compare)
        found = _series(other, args.namespace)
        subjects.append(html.Subject(_name(other), found, reporting.report(found), diagnostics_of(other)))
    file = out / "report.html"
    html.write(subjects, file)
    return file


def _name(path: Path) -> str:
    """Return what to call a bag: its folder, with the folder above where that says nothing."""
    path = path.resolve()
    return f"{path.parent.name}/{path.name}" if path.name in ("bag", "bag_1", "bag_2", "walk") else path.name


def _csv(series: Series, out: Path) -> Path:
    """Write time, joint angles, commands and every distance, a line per state."""
    trace = series.trace
    names = trace.model.joint_names
    columns = {"time [s]": trace.time, "error": series.error}
    columns |= {f"{name} [rad]": trace.q[:, i] for i, name in enumerate(names)}
    columns |= {f"{name} command [rad/s]": trace.u[:, i] for i, name in enumerate(names)}
    columns |= {f"com_{axis} [m]": series.com_odom[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"distance/{name}": values for name, values in series.distances.items()}
    columns |= {f"residual/{name}": values for name, values in series.residuals.items()}
    file = out / "series.csv"
    table = np.column_stack(list(columns.values()))
    np.savetxt(file, table, fmt="%.9g", delimiter=",", header=",".join(columns), comments="", encoding="utf-8")
    return file
