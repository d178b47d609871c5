"""All walks of a study: on the processes of one machine (joblib) or on a Dask cluster; resumable.

Every finished walk is a line of ``walks.jsonl`` at once, so a study that was killed goes on where it was. When all are
there they are written as one Parquet file, in the order of the study.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TextIO

from dqwalk_ros.errors import ConfigError
from dqwalk_ros.studies.plan import Study
from dqwalk_ros.studies.walks import walk

__all__ = ["run"]

Row = dict[str, Any]


def run(
    study: Study,
    out: Path,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Callable[[int, int, list[Row]], None] | None = None,
) -> list[Row]:
    """Walk what is missing and return all rows.

    Parameters
    ----------
    study : Study
    out : Path
        Folder of ``walks.jsonl`` and ``walks.parquet``.
    jobs : int
        Processes on this machine.
    scheduler : str, optional
        Address of a Dask scheduler, such as ``tcp://127.0.0.1:8786``, instead.
    progress : callable, optional
        Called after every walk with the walks done, all walks, and the rows so far.

    Raises
    ------
    ConfigError
        If another study is in the folder.
    """
    points = study.points()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"cannot make the folder '{out}': {error}") from error
    rows = _kept(study, out / "walks.jsonl")
    missing = [(index, point) for index, point in enumerate(points) if index not in rows]
    with _opened(study, out / "walks.jsonl", rows) as log:
        todo = [(study.config, point, index, study.seed) for index, point in missing]
        for row in _on_cluster(todo, scheduler) if scheduler else _here(todo, jobs):
            rows[row["walk"]] = row
            log.write(json.dumps(row) + "\n")
            log.flush()
            if progress is not None:
                progress(len(rows), len(points), list(rows.values()))
    found = [rows[index] for index in range(len(points))]
    _write_parquet(found, out / "walks.parquet")
    return found


def _kept(study: Study, path: Path) -> dict[int, Row]:
    """Return the walks that are there; a line that a kill cut off is none."""
    if not path.exists():
        return {}
    lines = path.read_text(encoding="utf-8").splitlines()
    head = _line(lines[0]) if lines else None
    if head is None or head.get("study") != study.digest():
        raise ConfigError(f"'{path}' belongs to another study; choose another folder with --out, or remove it")
    return {row["walk"]: row for row in map(_line, lines[1:]) if row is not None and "walk" in row}


def _line(text: str) -> Row | None:
    try:
        row = json.loads(text)
    except ValueError:
        return None
    return row if isinstance(row, dict) else None


def _opened(study: Study, path: Path, rows: dict[int, Row]) -> TextIO:
    """Write anew what is whole, in one move, and return the file to go on with."""
    new = path.with_suffix(".new")
    lines = [{"study": study.digest(), "name": study.name}, *rows.values()]
    new.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
    os.replace(new, path)
    return path.open("a", encoding="utf-8")


def _here(todo: list[tuple[Any, ...]], jobs: int) -> Iterator[Row]:
    if jobs == 1 or len(todo) < 2:
        yield from (walk(*arguments) for arguments in todo)
        return
    from joblib import Parallel, delayed

    parallel = Parallel(n_jobs=jobs, return_as="generator_unordered", pre_dispatch="3*n_jobs")
    yield from parallel(delayed(walk)(*arguments) for arguments in todo)


def _on_cluster(todo: list[tuple[Any, ...]], address: str | None) -> Iterator[Row]:
    from distributed import Client, as_completed

    try:
        client = Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        raise ConfigError(f"no Dask scheduler answers at {address}: {error}") from error
    with client:
        futures = client.map(walk, *zip(*todo, strict=True), pure=False) if todo else []
        for _, row in as_completed(futures, with_results=True):
            yield row


def _write_parquet(rows: list[Row], path: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    plain = [{k: json.dumps(v) if isinstance(v, list | tuple) else v for k, v in row.items()} for row in rows]
    new = path.with_suffix(".new")
    parquet.write_table(pa.Table.from_pylist(plain), new)
    os.replace(new, path)
