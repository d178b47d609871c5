"""Writes the results of commands: reports, figures, tables."""

from __future__ import annotations

import csv
import json
import os
import shutil
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dqwalk_ros import report as reporting
from dqwalk_ros.cli.options import Output, Report
from dqwalk_ros.report.bag.storage import refuse_other
from dqwalk_ros.support.errors import OutputError
from dqwalk_ros.support.output import make_folder, refuse_existing, write_text, written

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dqwalk_ros.report.figures.style import Drawn
    from dqwalk_ros.trace import Trace


def prepare(folder: Path, *others: str, force: bool) -> None:
    """Create the folder for a walk's results, without a bag; `others` are the names of further results.

    Raises
    ------
    BagError
        If what is called bag is not a bag.
    OutputError
        If the folder contains earlier results and --force is not given, or it cannot be created.
    """
    bag = folder / "bag"
    if not force:
        no_walk = (folder / "log/params.yaml").is_file() and not os.path.lexists(bag)  # one that did not begin
        refuse_existing([bag, *(folder / name for name in others if name != "log" or not no_walk)])
    refuse_other(bag)
    if bag.is_symlink():
        bag.unlink()
    elif bag.exists():
        shutil.rmtree(bag)
    make_folder(folder)


def prepare_study(output: Output, store: str, *results: str) -> None:
    """Check the folder of a study; where its store exists, it continues, and the results beside it are its own.

    Raises
    ------
    OutputError
        If it is a file, or files called as its results exist, but not its store, and --force is not given.
    """
    if not output.force and not os.path.lexists(output.folder / store):
        refuse_existing(output.folder / name for name in results)
    if output.folder.exists() and not output.folder.is_dir():
        raise OutputError(f"'{output.folder}' is a file, not a folder")


def write_study(
    output: Output,
    name: str,
    head: Sequence[str],
    rows: Iterable[Sequence[Any]],
    text: str,
    figure: Figure | None = None,
) -> None:
    """Write a study as ``NAME.csv``, a line per row, ``NAME.txt`` and, with a figure, ``NAME.png``; print the text.

    Before the study, `prepare_study` has found that these files may be replaced.
    """
    from dqwalk_ros.report.figures.style import Drawn, save

    folder = output.folder
    with (
        written(folder / f"{name}.csv", overwrite=True) as new,
        new.open("w", newline="", encoding="utf-8") as file,
    ):
        csv.writer(file).writerows([head, *rows])
    write_text(folder / f"{name}.txt", text + "\n", overwrite=True)
    if figure is not None:
        save([Drawn(name, figure)], folder, overwrite=True)
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
    """Write a report to ``report.json`` and its figures; print it, even if that fails, and the names of the files.

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
    OutputError
        If a file exists already and --force is not given, or the folder cannot be created.
    OSError
        If a file cannot be written.
    """
    from dqwalk_ros.cli.progress import Progress
    from dqwalk_ros.report.figures.style import save

    text, out = json.dumps(found, indent=2), output.folder
    files = [*more, out / "report.json"]
    try:
        write_text(out / "report.json", text + "\n", overwrite=output.force)
        if not output.no_figures:
            with Progress(quiet=as_json or output.quiet) as bar:
                bar.stage(0.0, "drawing")
                files += save(drawn, out, output.formats, overwrite=output.force)
    finally:  # also on a full disk
        if as_json:
            print(text)
        elif table and not output.quiet:
            print(table, flush=True)
    if as_json:
        return
    if not output.quiet:
        print("wrote " + ", ".join(map(str, files)))
    elif wrong := _wrong(found):
        others = f" (and {len(wrong) - 1} more)" if len(wrong) > 1 else ""
        print(f"dqwalk: NOT OK: {wrong[0]}{others}", file=sys.stderr)  # why the exit code is not 0


def _wrong(found: Any) -> list[str]:
    """Return what is wrong according to the report of a walk."""
    if not isinstance(found, dict) or found.get("ok", True):
        return []
    missed = [f"{name} is not reached" for name, check in found.get("checks", {}).items() if not check["ok"]]
    return [violation["message"] for violation in found.get("violations", ())] + missed


def write_results(trace: Trace, output: Report) -> dict[str, Any]:
    """Write and print the report of a walk of phases and its figures as `write_report`, and return the report."""
    from dqwalk_ros.cli.progress import Progress
    from dqwalk_ros.report import figures

    with Progress(quiet=output.quiet) as bar:
        bar.stage(0.0, "computing")
        series = reporting.analyse(trace)
        found = reporting.report(series)
    write_report(output, found, reporting.render(found), figures.drawn(series))
    return found
