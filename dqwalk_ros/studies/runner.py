"""Runs many walks in processes of one machine or on a Dask cluster; saves each outcome, resumes interrupted studies."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import itertools
import logging
import multiprocessing
import os
import random
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Generic, TypeVar

import msgspec

from dqwalk_ros.support.errors import ConfigError, StudyError
from dqwalk_ros.support.interrupts import as_ctrl_c, serve

Outcome = TypeVar("Outcome", bound=msgspec.Struct)
"""The outcome of a walk, a struct of plain types."""
Point = Mapping[str, Any]

_CONNECT_TIMEOUT = "10s"
"""Longest wait for a Dask scheduler."""


class Store(Generic[Outcome]):
    """The outcomes of a study in a file, a line of JSON each, from which an interrupted study continues.

    Parameters
    ----------
    digest : str
        Hash of everything that affects an outcome.
    points : sequence of mapping
        The varied parameters of each walk.
    kind : type
        Type of an outcome.
    force : bool
        Discard earlier outcomes.

    Attributes
    ----------
    name : str
        What the outcomes are, in the plural, by the name of the file.
    done : dict of int to outcome
        By the index of the point; walks whose line is damaged are repeated.

    Raises
    ------
    ConfigError
        If the file belongs to another study, or another process writes to it.
    StudyError
        If it cannot be read or written.
    """

    def __init__(
        self, path: Path, digest: str, points: Sequence[Point], kind: type[Outcome], *, force: bool = False
    ) -> None:
        self._path, self.name, self.points, self._kind = path, path.stem, points, kind
        self.done: dict[int, Outcome] = {}
        head = {"study": digest}
        with self._explained():
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.fdopen(_unlinked(path), "ab+")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._file.close()
            raise ConfigError(f"another process writes a study to '{path.parent}'; choose another folder") from None
        try:
            with self._explained():
                self._file.seek(0)
                text = b"" if force else self._file.read()
                lines = text.splitlines()
                if lines and self._decoded(lines[0]) != head:
                    raise ConfigError(
                        f"'{path}' belongs to another study; choose another folder with --out, or remove the file"
                    )
                self.done = dict(filter(None, map(self._outcome, lines[1:])))
                if not lines:
                    self._file.truncate(0)
                    self._write(head)
                elif not text.endswith(b"\n"):  # the last line of a study that was killed
                    self._file.write(b"\n")
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file and release its lock."""
        with self._explained():  # what could not be written before is written again
            self._file.close()

    def add(self, index: int, outcome: Outcome) -> None:
        """Save an outcome."""
        self.done[index] = outcome
        with self._explained():
            self._write({"walk": index, **self.points[index], **msgspec.to_builtins(outcome)})

    def _write(self, line: Mapping[str, Any]) -> None:
        self._file.write(msgspec.json.encode(line) + b"\n")
        self._file.flush()

    def _decoded(self, line: bytes) -> Any:
        try:
            return msgspec.json.decode(line)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return None

    def _outcome(self, line: bytes) -> tuple[int, Outcome] | None:
        row = self._decoded(line)
        index = row.get("walk") if isinstance(row, dict) else None
        if type(index) is not int or not 0 <= index < len(self.points):
            return None
        try:
            return index, msgspec.convert(row, self._kind)
        except msgspec.ValidationError:
            return None

    @contextlib.contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise StudyError(f"cannot read and write '{self._path}': {error.strerror}") from error


def run(
    task: Callable[[int, Point], Outcome],
    store: Store[Outcome],
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Callable[[int, int, Outcome], None] | None = None,
) -> list[tuple[Point, Outcome]]:
    """Run the walks that are missing in a store, close it, and return every point with its outcome, in order.

    The order of the walks is random, so that the outcomes of an interrupted study are a fair sample.

    Parameters
    ----------
    task : callable
        Runs walk number `index` at a point; its outcome must not depend on the process.
    jobs : int
        Processes on this machine.
    scheduler : str, optional
        Address of a Dask scheduler, such as ``tcp://127.0.0.1:8786``, instead.
    progress : callable, optional
        Called after every walk with the number of walks done, of all walks, and the outcome.

    Raises
    ------
    ConfigError
        If no scheduler answers.
    StudyError
        If an outcome cannot be saved, or after Ctrl-C, SIGTERM or SIGHUP; the outcomes until then remain in the store.
    """
    missing = [index for index in range(len(store.points)) if index not in store.done]
    random.Random(0).shuffle(missing)
    walks = [(task, index, store.points[index]) for index in missing]
    outcomes = _outcomes(walks, jobs, scheduler)
    with contextlib.closing(store), contextlib.suppress(KeyboardInterrupt), as_ctrl_c(), contextlib.closing(outcomes):
        for index, outcome in outcomes:
            store.add(index, outcome)
            if progress is not None:
                progress(len(store.done), len(store.points), outcome)
    if (count := len(store.done)) < (total := len(store.points)):
        raise StudyError(f"interrupted; {count} of {total} {store.name} are saved, the same command continues")
    return [(point, store.done[index]) for index, point in enumerate(store.points)]


def drawn(every: list[dict[str, Any]], sample: int, seed: int = 0) -> list[dict[str, Any]]:
    """Return `sample` of some points drawn at random, or all of them if `sample` is 0 or at least their number."""
    return random.Random(seed).sample(every, sample) if 0 < sample < len(every) else every


def _unlinked(path: Path) -> int:
    """Open a file for reading and appending, but not through a link."""
    if path.is_symlink():
        raise OSError(errno.ELOOP, "it is a link", str(path))
    return os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW, 0o666)


def _numbered(task: Callable[[int, Point], Outcome], index: int, point: Point) -> tuple[int, Outcome]:
    return index, task(index, point)


def _outcomes(walks: Sequence[Any], jobs: int, scheduler: str | None) -> Generator[tuple[int, Any], None, None]:
    """Yield index and outcome of each of some walks (task, index, point), as soon as it is done."""
    if scheduler is None and (why := _no_semaphore()):
        logging.getLogger("dqwalk_ros").warning(f"the walks run one after the other: {why}; is /dev/shm writable?")
        yield from itertools.starmap(_numbered, walks)
        return
    from joblib import Parallel, delayed

    with _backend(scheduler):
        parallel = Parallel(n_jobs=-1 if scheduler else jobs, return_as="generator_unordered", batch_size=1)
        yield from parallel(delayed(_numbered)(*walk) for walk in walks)


def _no_semaphore() -> str:
    """Return why processes cannot share a semaphore, which parallel ones need; empty if they can."""
    try:
        multiprocessing.get_context("spawn").Semaphore()
    except (ImportError, OSError) as error:
        return str(error)
    return ""


@contextlib.contextmanager
def _backend(scheduler: str | None) -> Iterator[None]:
    """Configure joblib for a Dask cluster, or for processes of this machine with one thread each."""
    from joblib import parallel_config

    if scheduler is None:
        with parallel_config("loky", inner_max_num_threads=1, initializer=serve, initargs=(os.getpid(),)):
            yield
        return
    from distributed import Client
    from distributed.client import FutureCancelledError

    try:
        client = Client(scheduler, timeout=_CONNECT_TIMEOUT)
    except (OSError, ValueError) as error:
        raise ConfigError(f"no Dask scheduler answers at {scheduler}: {error}") from error
    try:
        with client, parallel_config("dask"):
            yield
    except FutureCancelledError as error:
        raise StudyError(f"the Dask scheduler at {scheduler} is lost; started again, the command continues") from error
