"""Nodes as child processes: started, listened to, ended in order."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import queue
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

__all__ = ["Processes", "environment", "private_domain"]

_GRACE = (20.0, 3.0, 2.0)
"""How long a process may take to end after SIGINT, SIGTERM and SIGKILL [s]."""


@dataclass
class _Process:
    popen: subprocess.Popen[str]
    log: Path
    said: queue.SimpleQueue[dict[str, Any]] = field(default_factory=queue.SimpleQueue)
    reader: threading.Thread | None = None


class Processes:
    """Nodes as child processes, ended in order when the context is left.

    Parameters
    ----------
    logs : Path
        Folder for ``NAME.log``.
    domain : int, optional
        ROS domain; None leaves the environment's.
    extra : mapping of str to str
        Variables beside those of the environment.
    """

    def __init__(self, logs: Path, domain: int | None = None, extra: Mapping[str, str] | None = None) -> None:
        self._logs = logs
        self._environment = {**environment(domain), **(extra or {})}
        self._running: dict[str, _Process] = {}
        self._news = threading.Event()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the nodes that were started."""
        return tuple(self._running)

    def start(self, name: str, arguments: Sequence[str]) -> None:
        """Start the node `name` of `dqwalk_ros.nodes`; it ends when we do, however we do."""
        log = self._logs / f"{name}.log"
        with log.open("w", encoding="utf-8") as errors:
            popen = subprocess.Popen(
                [sys.executable, "-m", "dqwalk_ros.nodes", name, "--child", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                env=self._environment,
                start_new_session=True,  # Ctrl-C is for us: the nodes end in order
            )
        process = self._running[name] = _Process(popen, log)
        process.reader = threading.Thread(target=self._read, args=(process,), daemon=True)
        process.reader.start()

    def _read(self, process: _Process) -> None:
        assert process.popen.stdout is not None  # it is a pipe
        for text in process.popen.stdout:
            with contextlib.suppress(json.JSONDecodeError):
                process.said.put(json.loads(text))
            self._news.set()
        self._news.set()

    def wait_for_news(self, timeout: float) -> None:
        """Wait until a node says something or ends [s]."""
        self._news.wait(timeout)
        self._news.clear()

    def said(self, name: str) -> Iterator[dict[str, Any]]:
        """Yield what a node has said on its standard output since the last call."""
        with contextlib.suppress(queue.Empty):
            while True:
                yield self._running[name].said.get_nowait()

    def exit_code(self, name: str) -> int | None:
        """Return the exit code of a node, None while it runs; all it said can then be read."""
        process = self._running[name]
        code = process.popen.poll()
        if code is not None:
            _finish_reading(process)
        return code

    def signal(self, name: str, number: int) -> None:
        """Send a signal to one node."""
        self._running[name].popen.send_signal(number)

    def wait(self, name: str, timeout: float) -> int:
        """Wait for the end of a node; return its exit code.

        Raises
        ------
        subprocess.TimeoutExpired
        """
        return self._running[name].popen.wait(timeout)

    def log(self, name: str) -> str:
        """Return what a node has logged so far."""
        return self._running[name].log.read_text(encoding="utf-8", errors="replace")

    def last_words(self, name: str) -> str:
        """Return the last line a node logged, or its last error."""
        lines = [line for line in self.log(name).splitlines() if line.strip()]
        errors = [line for line in lines if "[ERROR]" in line or "[FATAL]" in line]
        return (errors or lines or ["it said nothing"])[-1]

    def stop(self) -> None:
        """End everything: SIGINT, then SIGTERM, then SIGKILL.

        What was started first ends last: a recorder goes on until the others have said their last words.
        """
        order = list(reversed(self._running.values()))
        for group in (order[:-1], order[-1:]):
            _end(group)
        for process in order:
            _finish_reading(process)


def _end(group: Sequence[_Process]) -> None:
    for number, grace in zip((signal.SIGINT, signal.SIGTERM, signal.SIGKILL), _GRACE, strict=True):
        alive = [process for process in group if process.popen.poll() is None]
        for process in alive:
            process.popen.send_signal(number)
        deadline = time.monotonic() + grace
        for process in alive:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.popen.wait(max(0.0, deadline - time.monotonic()))


def _finish_reading(process: _Process) -> None:
    if process.reader is not None:
        process.reader.join(1.0)


def environment(domain: int | None) -> Mapping[str, str]:
    """Return the environment of a node: this very package, and traffic that stays on this machine."""
    out = dict(os.environ)
    here = str(Path(__file__).resolve().parents[2])
    out["PYTHONPATH"] = os.pathsep.join([here, *filter(None, [out.get("PYTHONPATH")])])
    out.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    out["PYTHONUNBUFFERED"] = "1"
    if domain is not None:
        out["ROS_DOMAIN_ID"] = str(domain)
    return out


@contextlib.contextmanager
def private_domain() -> Iterator[int]:
    """Yield a ROS domain that no other walk on this machine uses; it is ours until the context is left."""
    candidates = list(range(1, 102))  # above 101 the ports run into those the kernel hands out
    random.shuffle(candidates)
    for number in candidates:
        path = Path(tempfile.gettempdir()) / f"dqwalk_ros.domain{number}.{os.getuid()}.lock"
        with path.open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue
            yield number
            return
    raise RuntimeError("all 101 ROS domains of this machine are taken by walks")
