"""Writes the results of `simulate`, `walk` and `report`: report, figures, tables."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dqwalk_ros import report as reporting
from dqwalk_ros.cli.options import Output
from dqwalk_ros.errors import BagError
from dqwalk_ros.simulation import Trace

if TYPE_CHECKING:
    from dqwalk_ros.report import Series

__all__ = ["prepare", "write_csv", "write_results"]


def prepare(output: Output) -> None:
    """Create the folder for a walk's results.

    Raises
    ------
    BagError
        If it cannot be created, or contains an earlier walk and --force is not given.
    """
    bag = output.folder / "bag"
    if bag.exists() and not output.force:
        raise BagError(f"'{bag}' exists; choose another folder with --out, or replace it with --force")
    if bag.exists() and not any(bag.glob("*.mcap")) and not any(bag.glob("*.db3")):
        raise BagError(f"'{bag}' is not a bag and is not replaced; choose another folder with --out")
    try:
        if bag.exists():
            shutil.rmtree(bag)
        output.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BagError(f"cannot create the folder '{output.folder}': {error}") from error


def write_csv(path: Path, head: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a table as CSV, a line per row."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(head)
        writer.writerows(rows)


def write_results(
    trace: Trace, out: Path, output: Output, *, as_json: bool = False, series: Series | None = None
) -> dict[str, Any]:
    """Analyse a walk, unless its `series` are given, write ``report.json`` and the figures, and print the tables.

    Returns
    -------
    dict
        The report.
    """
    series = series or reporting.analyse(trace)
    report = reporting.report(series)
    text = json.dumps(report, indent=2, allow_nan=False)
    try:
        out.mkdir(parents=True, exist_ok=True)
        (out / "report.json").write_text(text + "\n", encoding="utf-8")
        files = [out / "report.json"]
        if output.figures:
            files += reporting.save(series, out, output.formats)
    except OSError as error:
        raise BagError(f"cannot write to '{out}': {error}") from error
    if as_json:
        print(text)
    elif not output.quiet:
        print(reporting.render(report))
        print("wrote " + ", ".join(str(file) for file in files))
    return report
