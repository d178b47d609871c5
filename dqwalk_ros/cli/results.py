"""Writes the results of commands: reports, figures, tables."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dqwalk_ros import report as reporting
from dqwalk_ros.cli.options import Output, Report
from dqwalk_ros.support.errors import BagError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dqwalk_ros.report import Series
    from dqwalk_ros.report.figures.style import Drawn

__all__ = ["create", "prepare", "write_report", "write_results", "write_study"]


def prepare(folder: Path, *, force: bool) -> None:
    """Create the folder for a walk's results.

    Raises
    ------
    BagError
        As `create`, and if the folder contains an earlier walk and --force is not given.
    """
    bag = folder / "bag"
    if bag.exists() and not force:
        raise BagError(f"'{bag}' exists; choose another folder with --out, or replace it with --force")
    if bag.exists() and not any(bag.glob("*.mcap")) and not any(bag.glob("*.db3")):
        raise BagError(f"'{bag}' is not a bag and is not replaced; choose another folder with --out")
    if bag.exists():
        shutil.rmtree(bag)
    create(folder)


def create(folder: Path) -> None:
    """Create a folder of results unless it exists.

    Raises
    ------
    BagError
        If it cannot be created.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise BagError(f"'{folder}' is a file, not a folder") from None
    except OSError as error:
        raise BagError(f"cannot create the folder '{folder}': {error.strerror}") from error


def write_study(
    output: Output, name: str, head: Sequence[str], rows: Iterable[Sequence[Any]], text: str, figure: Figure
) -> None:
    """Write a study as ``NAME.csv``, a line per row, ``NAME.txt`` and ``NAME.png``, and print the text unless quiet."""
    from dqwalk_ros.report.figures.style import Drawn, save

    folder = output.folder
    with (folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([head, *rows])
    (folder / f"{name}.txt").write_text(text + "\n", encoding="utf-8")
    save([Drawn(name, figure)], folder)
    if not output.quiet:
        print(text)


def write_report(
    output: Report,
    found: Any,
    table: str,
    drawn: Iterable[Drawn],
    *,
    as_json: bool = False,
    more: Sequence[Path] = (),
) -> None:
    """Print a report, write it to ``report.json``, write its figures, and print the names of the files.

    Parameters
    ----------
    table : str
        The report as text; empty if it was printed before.
    as_json : bool
        Print only `found`, as JSON.
    more : sequence of Path
        Files that were written before.

    Raises
    ------
    BagError
        If the folder cannot be created.
    OSError
        If a file cannot be written.
    """
    from dqwalk_ros.cli.progress import Progress
    from dqwalk_ros.report.figures.style import save

    text, out = json.dumps(found, indent=2), output.folder
    if as_json:
        print(text)
    elif table and not output.quiet:
        print(table)
    create(out)
    (out / "report.json").write_text(text + "\n", encoding="utf-8")
    files = [*more, out / "report.json"]
    if not output.no_figures:
        with Progress(quiet=as_json or output.quiet) as bar:
            bar.stage(0.0, "drawing")
            files += save(drawn, out, output.formats)
    if not (as_json or output.quiet):
        print("wrote " + ", ".join(map(str, files)))


def write_results(series: Series, output: Report) -> dict[str, Any]:
    """Write and print the report of a walk of phases and its figures as `write_report`, and return the report."""
    from dqwalk_ros.report import figures

    found = reporting.report(series)
    write_report(output, found, reporting.render(found), figures.drawn(series))
    return found
