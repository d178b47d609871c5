"""Writes the results of whole-body walks, for `reach` and `report`: report, figures, page."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dqwalk_ros.cli.options import Output
from dqwalk_ros.cli.progress import Progress
from dqwalk_ros.errors import BagError, ConfigError
from dqwalk_ros.report import bag
from dqwalk_ros.report.figures.reaching import save_reaching
from dqwalk_ros.report.html.body import BodySubject, write
from dqwalk_ros.whole_body.demands import Demand, checks, render_checks, summary
from dqwalk_ros.whole_body.experiments import retrace
from dqwalk_ros.whole_body.trace import WholeBodyTrace

__all__ = ["report", "write_results"]


def write_results(
    output: Output,
    out: Path,
    found: Any,
    walks: Sequence[WholeBodyTrace],
    more: Sequence[Path] = (),
    *,
    quiet: bool = False,
) -> None:
    """Write ``report.json`` and the figures of some walks, and print the names of the files."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        (out / "report.json").write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
        files = [*more, out / "report.json"]
        if walks and output.figures:
            files += save_reaching(walks, out, output.formats)
    except OSError as error:
        raise BagError(f"cannot write to '{out}': {error}") from error
    if not (quiet or output.quiet):
        print("wrote " + ", ".join(str(file) for file in files))


def report(
    path: Path,
    out: Path,
    name: str,
    output: Output,
    *,
    namespace: str | None,
    html: bool,
    as_json: bool,
    series: bool,
) -> int:
    """Evaluate and draw a recorded whole-body walk under the title `name`; return the exit code."""
    if series:
        raise ConfigError("--compare and --csv are not available for whole-body walks")
    log = bag.read_body(path, namespace=namespace)
    with Progress(quiet=output.quiet or as_json) as bar:
        walked, off = retrace(log, progress=bar)
    found = checks(walked)
    result = summary(walked, found) | {"torques_differ_by": off, "notes": list(log.notes)}
    files = []
    if html:
        out.mkdir(parents=True, exist_ok=True)
        files.append(out / "report.html")
        write(BodySubject(name, walked, found, off, log.notes), files[0])
    if as_json:
        print(json.dumps(result, indent=2))
    elif not output.quiet:
        _print(walked, found, off, log.notes)
    write_results(output, out, result, [walked], files, quiet=as_json)
    return 0 if result["ok"] else 1


def _print(walked: WholeBodyTrace, found: Sequence[Demand], off: float, notes: Sequence[str]) -> None:
    for note in notes:
        print(f"note: {note}", file=sys.stderr)
    print(render_checks(walked, found))
    print(f"recorded and recomputed torques differ by at most {off:.2g} N m\n")
