"""A whole walk through ROS 2: start the nodes as processes, follow them, end them, say how it went.

Where ROS was installed from wheels there is no `ros2 launch`; this does its work, and returns an outcome. It needs no
ROS itself: the nodes report their progress as lines of JSON on their standard output.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import math
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from dqwalk_ros.config import Config, to_yaml
from dqwalk_ros.simulation import walk_type
from dqwalk_ros.standing.course import Course

__all__ = ["PLANTS", "Outcome", "Processes", "environment", "private_domain", "run_walk"]

PLANTS = {
    "integrator": "integrator",
    "physics": "physics",
    "poppy_as_built": "physics",
    "poppy": "poppy_driver",
}
"""The node that is each plant."""

_GRACE = {signal.SIGINT: 20.0, signal.SIGTERM: 3.0, signal.SIGKILL: 2.0}
"""How long a process may take to end after each signal [s]."""
_STARTUP = 180.0
"""Longest wait for the first tick [s]; on a fresh machine the kinematics is compiled first."""
_STALL = 60.0
"""Longest wait for the next sign of progress [s]."""


@dataclass(frozen=True)
class Outcome:
    """How a walk went.

    Attributes
    ----------
    finished : bool
        Every phase ended by its rule, and everything was recorded.
    reason : str
        Why not, where it did not.
    ticks : int
    walked : float
        Time of the walk [s].
    took : float
        Time of the clock, from the first tick to the last [s].
    bag, logs : Path
    pace : str
        In real time, what the plant reported of its own.
    """

    finished: bool
    reason: str
    ticks: int
    walked: float
    took: float
    bag: Path
    logs: Path
    pace: str = ""

    def __str__(self) -> str:
        pace = f"{self.ticks} ticks, {self.walked:.1f} s of walking in {self.took:.1f} s"
        if self.took > 0.0:
            pace += f" ({self.ticks / self.took:.0f} ticks/s)"
        if self.pace:
            pace += f"; plant: {self.pace}"
        return f"finished: {pace}" if self.finished else f"{self.reason} (after {pace}; logs in {self.logs})"


def run_walk(
    config: Config,
    bag: str | os.PathLike[str],
    *,
    plant: str = "integrator",
    course: Sequence[str] = (),
    lockstep: bool = True,
    progress: Callable[[float, str], None] | None = None,
    logs: str | os.PathLike[str] | None = None,
    domain: int | None = None,
) -> Outcome:
    """Walk with controller, plant, phase_monitor and recorder as processes of their own.

    Parameters
    ----------
    config : Config
    bag : path-like
        The folder that the recorder makes; it must not be there yet.
    plant : {"integrator", "physics", "poppy"}
        Other side of the command; what ``config/plants/NAME.yaml`` asks for is in `config` already.
    course : sequence of str
        Legs for the node pilot, as `standing.course.Course.parse` reads them; `config` has ``gait.steps: 0`` then.
    lockstep : bool
        Each state waits for its command; otherwise the walk goes by the clock.
    progress : callable, optional
        Called with the fraction done and some text, several times a second.
    logs : path-like, optional
        Where parameters and logs of the nodes go; `log` beside the bag by default.
    domain : int, optional
        ROS domain; by default ``ROS_DOMAIN_ID`` where it is set, else one that nobody else on this machine uses.

    Returns
    -------
    Outcome
    """
    bag = Path(bag)
    folder = Path(logs) if logs is not None else bag.parent / "log"
    folder.mkdir(parents=True, exist_ok=True)
    config = config.updated(
        {
            "plant.lockstep": lockstep,
            "node.autostart": True,
            "node.exit_when_done": True,
            "node.wait_for_recorder": True,
            "node.wait_for_monitor": True,
            "poppy.activate": plant == "poppy",
        }
    )
    params = folder / "params.yaml"
    params.write_text(to_yaml(config), encoding="utf-8")
    ros = ["--ros-args", "--params-file", str(params)]
    node = PLANTS[plant]
    with contextlib.ExitStack() as stack:
        if domain is None and "ROS_DOMAIN_ID" not in os.environ:
            domain = stack.enter_context(private_domain())
        processes = stack.enter_context(Processes(folder, domain))
        walk = _Walk(config, processes, node, Course.parse(course).duration, progress)
        interrupted = stack.enter_context(_interrupts())
        processes.start("recorder", ["--bag", str(bag), *ros])
        processes.start("phase_monitor", ros)
        processes.start(node, ros)
        processes.start("controller", ros)
        if course:
            processes.start("pilot", [*(f"--cmd-vel={leg}" for leg in course), *ros])
        reason = None
        while reason is None:
            processes.wait_for_news(0.2)
            walk.listen()
            reason = f"interrupted by {interrupted[0].name}" if interrupted else walk.ended()
            walk.show()
        processes.stop()
        reason = reason or _incomplete(processes, lockstep)
        paces = [line["text"] for line in processes.said(node) if line.get("event") == "pace"]
    return Outcome(
        finished=not reason,
        reason=reason,
        ticks=int(walk.last.get("ticks", 0)),
        walked=float(walk.last.get("time", 0.0)),
        took=walk.took,
        bag=bag,
        logs=folder,
        pace=paces[-1] if paces else "",
    )


class _Walk:
    """What the controller has reported so far: `last` of it, and the time `took` since it began [s]."""

    def __init__(
        self,
        config: Config,
        processes: Processes,
        plant: str,
        duration: float,
        progress: Callable[[float, str], None] | None,
    ) -> None:
        self._processes, self._plant, self._duration, self._progress = processes, plant, duration, progress
        self._phases = walk_type(config).phases(config) or math.inf
        self.last: dict[str, Any] = {}
        self.took = 0.0
        self._began = self._heard = time.monotonic()
        self._first: tuple[float, int] | None = None  # when, and ticks by then

    def listen(self) -> None:
        """Take in what the controller has reported."""
        now = time.monotonic()
        for line in self._processes.said("controller"):
            if line.get("event") != "walk":
                continue
            if line["ticks"] > self.last.get("ticks", -1):
                self._heard = now
            self._first = self._first or (now, line["ticks"])
            self.last, self.took = line, now - self._first[0]

    def ended(self) -> str | None:
        """Return None while the walk goes on, "" when it is over, else what went wrong."""
        processes = self._processes
        if (code := processes.exit_code("controller")) is not None:
            self.listen()
            if code == 0 and self.last.get("mode") == "finished":
                return ""
            return self.last.get("reason") or f"controller ended ({code}): {processes.last_error('controller')}"
        for name in (self._plant, "recorder"):
            if (code := processes.exit_code(name)) is not None:
                return f"{name} ended ({code}): {processes.last_error(name)}"
        silence = time.monotonic() - self._heard
        if silence > (_STALL if self._first else _STARTUP):
            return f"no progress for {silence:.0f} s: {processes.last_error('controller')}"
        return None

    def show(self) -> None:
        """Pass progress on."""
        if self._progress is None:
            return
        if self._first is None:
            self._progress(0.0, f"starting the nodes, {time.monotonic() - self._began:.0f} s")
            return
        line = self.last
        done = line["time"] / self._duration if self._duration else line["phase_index"] / self._phases
        rate = (line["ticks"] - self._first[1]) / self.took if self.took > 0.0 else 0.0
        of = "" if self._phases == math.inf else f"/{self._phases}"
        error = "" if line["error"] is None else f"error {line['error']:.4f}"
        text = f"phase {line['phase_index'] + 1}{of} {line['phase']}  {line['time']:7.2f} s  {error}"
        self._progress(min(1.0, max(0.0, done)), f"{text}  {rate:.0f} ticks/s")


def _incomplete(processes: Processes, lockstep: bool) -> str:
    """Return what is wrong with a recording that has ended; gaps are the clock's in real time, a loss in lockstep."""
    recorded = [line for line in processes.said("recorder") if line.get("event") == "recorded"]
    if not recorded:
        return f"the recorder did not finish the bag: {processes.last_error('recorder')}"
    missing = recorded[-1]["missing"]
    if lockstep and missing:
        return "the bag is incomplete: " + ", ".join(f"{n} of {name} are missing" for name, n in missing.items())
    return ""


@contextlib.contextmanager
def _interrupts() -> Iterator[list[signal.Signals]]:
    """Collect SIGINT and SIGTERM instead of dying of them."""
    seen: list[signal.Signals] = []
    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            before[number] = signal.signal(number, lambda n, _: seen.append(signal.Signals(n)))
    try:
        yield seen
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


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
        self._running: dict[str, subprocess.Popen[str]] = {}
        self._reports: dict[str, list[dict[str, Any]]] = {}
        self._readers: dict[str, threading.Thread] = {}
        self._news = threading.Event()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the nodes that were started."""
        return tuple(self._running)

    def start(self, name: str, arguments: Sequence[str]) -> None:
        """Start the node `name` of `dqwalk_ros.nodes`; it ends when we do, however we do."""
        with (self._logs / f"{name}.log").open("w", encoding="utf-8") as errors:
            process = subprocess.Popen(
                [sys.executable, "-m", "dqwalk_ros.nodes", name, "--child", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                env=self._environment,
                start_new_session=True,  # Ctrl-C is for us: the nodes end in order
            )
        self._running[name], self._reports[name] = process, []
        self._readers[name] = threading.Thread(target=self._read, args=(process, self._reports[name]), daemon=True)
        self._readers[name].start()

    def _read(self, process: subprocess.Popen[str], reports: list[dict[str, Any]]) -> None:
        assert process.stdout is not None  # it is a pipe
        for text in process.stdout:
            with contextlib.suppress(json.JSONDecodeError):
                reports.append(json.loads(text))
            self._news.set()
        self._news.set()

    def wait_for_news(self, timeout: float) -> None:
        """Wait until a node reports something or ends [s]."""
        self._news.wait(timeout)
        self._news.clear()

    def said(self, name: str) -> Iterator[dict[str, Any]]:
        """Yield what a node has reported on its standard output since the last call."""
        reports = self._reports[name]
        while reports:
            yield reports.pop(0)

    def exit_code(self, name: str) -> int | None:
        """Return the exit code of a node, None while it runs; all it reported can then be read."""
        code = self._running[name].poll()
        if code is not None:
            self._readers[name].join(1.0)
        return code

    def signal(self, name: str, number: int) -> None:
        """Send a signal to one node."""
        self._running[name].send_signal(number)

    def wait(self, name: str, timeout: float) -> int:
        """Wait for the end of a node; return its exit code.

        It raises `subprocess.TimeoutExpired` after the timeout [s].
        """
        return self._running[name].wait(timeout)

    def log(self, name: str) -> str:
        """Return what a node has logged so far."""
        return (self._logs / f"{name}.log").read_text(encoding="utf-8", errors="replace")

    def last_error(self, name: str) -> str:
        """Return the last error that a node logged, or else its last line."""
        lines = [line for line in self.log(name).splitlines() if line.strip()]
        errors = [line for line in lines if "[ERROR]" in line or "[FATAL]" in line]
        return (errors or lines or ["it logged nothing"])[-1]

    def stop(self) -> None:
        """End everything: SIGINT, then SIGTERM, then SIGKILL.

        What was started first ends last: a recorder goes on until the others have published all they had to.
        """
        order = list(reversed(self._running.values()))
        for group in (order[:-1], order[-1:]):
            _end(group)
        for reader in self._readers.values():
            reader.join(1.0)


def _end(group: Sequence[subprocess.Popen[str]]) -> None:
    for number, grace in _GRACE.items():
        alive = [process for process in group if process.poll() is None]
        for process in alive:
            process.send_signal(number)
        deadline = time.monotonic() + grace
        for process in alive:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(max(0.0, deadline - time.monotonic()))


def environment(domain: int | None) -> dict[str, str]:
    """Return the environment of a node: this very package, and traffic that stays on this machine."""
    out = dict(os.environ)
    here = str(Path(__file__).resolve().parents[1])
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
