"""Runs a whole walk through ROS 2: starts the nodes as processes, monitors and stops them, and returns the outcome.

It replaces `ros2 launch`, which is missing where ROS was installed from wheels. It does not import ROS itself: the
nodes report their progress as lines of JSON on their standard output.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Self

from dqwalk_ros.config import Config, to_yaml
from dqwalk_ros.plants.table import entry
from dqwalk_ros.support.compiled import COMPILING
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.interrupts import deferred_interrupts
from dqwalk_ros.support.output import write_text
from dqwalk_ros.support.own_folder import lock
from dqwalk_ros.walks.course import Course
from dqwalk_ros.walks.table import walk_type

_GRACE = {signal.SIGINT: 20.0, signal.SIGTERM: 3.0, signal.SIGKILL: 2.0}
"""Time that a process has to end after each signal [s]."""
_STARTUP = 180.0
"""Longest wait for the first control period [s]; on a new machine the kinematics is compiled first."""
_STALL = 60.0
"""Longest time without progress [s]."""


@dataclass(frozen=True)
class RunOutcome:
    """The outcome of a walk."""

    finished: bool
    """Whether all phases were finished and everything was recorded."""
    reason: str
    """Reason why the walk was not finished; empty if it was."""
    ticks: int
    """Number of control periods."""
    walked: float
    """Simulated or measured duration of the walk [s]."""
    took: float
    """Wall-clock time from the first to the last control period [s]."""
    bag: Path
    logs: Path
    """Folders of the recording and of the log files."""
    pace: str = ""
    """Statistics of the control period that the plant reported, in real time."""

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
    duration: float = 0.0,
    progress: Callable[[float, str], None] | None = None,
    domain: int | None = None,
) -> RunOutcome:
    """Run a walk with controller, plant, phase_monitor and recorder in separate processes.

    Parameters
    ----------
    bag : path-like
        Folder that the recorder creates; it must not exist. It is removed if the walk does not begin.
    plant : str
        A name of `plants.table.PLANTS`, or MODULE:CLASS; `config` must already contain its parameters.
    course : sequence of str
        Legs for the node pilot, see `walks.course.Course.parse`; they require ``gait.steps: 0``.
    lockstep : bool
        Whether each state waits for its command; otherwise the walk runs in real time.
    duration : float
        Of a walk whose phases do not show how much of it is done [s]; 0: they do, or the course does.
    progress : callable, optional
        Called several times a second with the fraction done and a line of text.
    domain : int, optional
        ROS domain; by default ``ROS_DOMAIN_ID`` if it is set, else one that no other walk on this machine uses.
    """
    bag, new = Path(bag), not os.path.lexists(bag)
    folder = bag.parent / "log"  # parameters and logs of the nodes
    config = config.updated(
        {
            "plant.lockstep": lockstep,
            "node.autostart": True,
            "node.exit_when_done": True,
            "node.wait_for_recorder": True,
            "node.wait_for_monitor": True,
            "plant.name": plant if entry(plant).type else "",
            "poppy.activate": plant == "poppy",
        }
    )
    params = folder / "params.yaml"
    write_text(params, to_yaml(config), overwrite=True)
    ros = ["--ros-args", "--params-file", str(params)]
    node = entry(plant).node
    with contextlib.ExitStack() as stack:
        if domain is None and "ROS_DOMAIN_ID" not in os.environ:
            domain = stack.enter_context(private_domain())
        processes = stack.enter_context(Processes(folder, domain))
        walk = _Progress(config, processes, node, Course.parse(course).duration or duration, progress)
        interrupted = stack.enter_context(deferred_interrupts())
        processes.start("recorder", ["--bag", str(bag), *ros])
        processes.start("phase_monitor", ros)
        processes.start(node, ros)
        processes.start("controller", ros)
        if course:
            processes.start("pilot", [*(f"--cmd-vel={leg}" for leg in course), *ros])
        reason = None
        while reason is None:
            processes.wait_for_report(0.2)
            walk.update()
            reason = f"interrupted by {interrupted[0].name}" if interrupted else walk.ended()
            walk.show()
        processes.stop()
        reason = reason or _recording_error(processes, lockstep, int(walk.last["ticks"]))
        pace = processes.reports[node].get("pace", "")
    if reason and new and not walk.last.get("ticks"):  # nothing of this walk is in it, and the next try needs its place
        shutil.rmtree(bag, ignore_errors=True)
    return RunOutcome(
        finished=not reason,
        reason=reason,
        ticks=int(walk.last.get("ticks", 0)),
        walked=float(walk.last.get("time", 0.0)),
        took=walk.took,
        bag=bag,
        logs=folder,
        pace=pace,
    )


class _Progress:
    """Progress of the controller: its `last` report, and the time `took` since its first one [s]."""

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
        self._last_progress = time.monotonic()
        self._first: tuple[float, int] | None = None  # time and ticks of the first report

    def update(self) -> None:
        """Read the last report of the controller."""
        line, now = self._processes.reports["controller"], time.monotonic()
        if line is self.last or not line:
            return
        if line["ticks"] > self.last.get("ticks", -1):
            self._last_progress = now
        self._first = self._first or (now, line["ticks"])
        self.last, self.took = line, now - self._first[0]

    def ended(self) -> str | None:
        """Return None during the walk, "" if it is finished, or the error that ended it."""
        processes = self._processes
        if (code := processes.exit_code("controller")) is not None:
            self.update()
            if code == 0 and self.last.get("mode") == "finished":
                return ""
            return self.last.get("reason") or processes.end_of("controller", code)
        for name in (self._plant, "recorder"):
            if (code := processes.exit_code(name)) is not None:
                return processes.end_of(name, code)
        passed = time.monotonic() - self._last_progress
        if passed > (_STALL if self._first else _STARTUP):
            return f"no progress for {passed:.0f} s: {processes.last_error('controller')}"
        return None

    def show(self) -> None:
        """Call the callback with the present progress."""
        if self._progress is None:
            return
        if self._first is None:
            compiling = COMPILING in self._processes.log("controller")
            self._progress(0.0, COMPILING if compiling else "starting the nodes")
            return
        line = self.last
        done = line["time"] / self._duration if self._duration else line["phase_index"] / self._phases
        rate = (line["ticks"] - self._first[1]) / self.took if self.took > 0.0 else 0.0
        of = "" if self._phases == math.inf else f"/{self._phases}"
        error = "" if line["error"] is None else f"error {line['error']:.4f}"
        number = min(line["phase_index"] + 1, self._phases)
        text = f"phase {number}{of} {line['phase']}  {line['time']:7.2f} s  {error}"
        self._progress(min(1.0, max(0.0, done)), f"{text}  {rate:.0f} ticks/s")


def _recording_error(processes: Processes, lockstep: bool, ticks: int) -> str:
    """Return the error of the finished recording, "" without one; missing messages are an error in lockstep only.

    The recorder sees a gap between two messages, but not that the last ones are missing; these are found by the number
    of `ticks`, of which each has a state and a command.
    """
    recorded = processes.reports["recorder"]
    if not recorded or processes.exit_code("recorder"):
        return f"the recorder did not finish the bag: {processes.last_error('recorder')}"
    counts = {name: recorded["counts"][name] for name in ("joint_states", "joint_velocity_commands")}
    missing = recorded["missing"] or {name: ticks - count for name, count in counts.items() if count < ticks}
    if lockstep and missing:
        return "the bag is incomplete: " + ", ".join(f"{n} of {name} are missing" for name, n in missing.items())
    return ""


class Processes:
    """Nodes as child processes; leaving the context ends them in order.

    Parameters
    ----------
    logs : Path
        Folder for the files ``NAME.log``.
    domain : int, optional
        ROS domain; None: that of the environment.

    Attributes
    ----------
    reports : dict of str to dict
        The last report of each node on its standard output, a line of JSON; empty before the first.
    """

    def __init__(self, logs: Path, domain: int | None = None) -> None:
        self._logs, self._environment = logs, environment(domain)
        self._running: dict[str, subprocess.Popen[str]] = {}
        self.reports: dict[str, dict[str, Any]] = {}
        self._readers: dict[str, threading.Thread] = {}
        self._reported = threading.Event()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self, name: str, arguments: Sequence[str]) -> None:
        """Start the node `name` of `dqwalk_ros.nodes`; it also ends if this process ends, for any reason."""
        log = self._logs / f"{name}.log"
        write_text(log, "", overwrite=True)  # not through a link
        with log.open("a", encoding="utf-8") as errors:
            process = subprocess.Popen(
                [sys.executable, "-m", "dqwalk_ros.nodes", name, "--child", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                env=self._environment,
                start_new_session=True,  # Ctrl-C reaches this process only, which then ends the nodes in order
            )
        self._running[name], self.reports[name] = process, {}
        self._readers[name] = threading.Thread(target=self._read, args=(name, process.stdout), daemon=True)
        self._readers[name].start()

    def _read(self, name: str, output: IO[str]) -> None:
        with output:
            for text in output:
                with contextlib.suppress(json.JSONDecodeError):
                    self.reports[name] = json.loads(text)
                self._reported.set()
        self._reported.set()

    def wait_for_report(self, timeout: float) -> None:
        """Wait until a node reports something or ends, at most for the timeout [s]."""
        self._reported.wait(timeout)
        self._reported.clear()

    def exit_code(self, name: str) -> int | None:
        """Return the exit code of a node, None while it runs; after its end, its last report is available."""
        code = self._running[name].poll()
        if code is not None:
            self._readers[name].join(1.0)
        return code

    def log(self, name: str) -> str:
        """Return the present content of a node's log file."""
        return (self._logs / f"{name}.log").read_text(encoding="utf-8", errors="replace")

    def last_error(self, name: str) -> str:
        """Return the last error in a node's log file, or its last line if there is no error."""
        lines = [line for line in self.log(name).splitlines() if line.strip()]
        errors = [line for line in lines if "[ERROR]" in line or "[FATAL]" in line]
        return (errors or lines or ["it logged nothing"])[-1]

    def end_of(self, name: str, code: int) -> str:
        """Return how a node ended, by its exit code; after a signal with its last line if it is a warning or worse."""
        if code >= 0:
            return f"{name} ended ({code}): {self.last_error(name)}"
        with contextlib.suppress(ValueError):  # a number without a name, such as that of a real-time signal
            last = self.last_error(name)
            bad = any(level in last for level in ("[WARN]", "[ERROR]", "[FATAL]"))
            return f"{name} was killed by {signal.Signals(-code).name}" + (f": {last}" if bad else "")
        return f"{name} was killed by signal {-code}"

    def stop(self) -> None:
        """End all nodes: by SIGINT, if necessary by SIGTERM, then by SIGKILL.

        The node that was started first ends last, so that a recorder receives the last messages of all others.
        """
        order = list(reversed(self._running.values()))
        for group in (order[:-1], order[-1:]):
            _end(group)
        for reader in self._readers.values():
            reader.join(1.0)


def _end(group: Sequence[subprocess.Popen[str]]) -> None:
    """End processes by the signals of `_GRACE`, each sent to those that are still running."""
    for number, grace in _GRACE.items():
        alive = [process for process in group if process.poll() is None]
        for process in alive:
            process.send_signal(number)
        deadline = time.monotonic() + grace
        for process in alive:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(max(0.0, deadline - time.monotonic()))


def environment(domain: int | None) -> dict[str, str]:
    """Return the environment of a node: this copy of the package, and by default discovery on this machine only."""
    out = dict(os.environ)
    package_parent = str(Path(__file__).resolve().parents[2])
    out["PYTHONPATH"] = os.pathsep.join([package_parent, *filter(None, [out.get("PYTHONPATH")])])
    out.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    out["PYTHONUNBUFFERED"] = "1"
    if domain is not None:
        out["ROS_DOMAIN_ID"] = str(domain)
        out.pop("ROS_DISCOVERY_SERVER", None)  # it is for the nodes of other machines, and may not be there
    return out


@contextlib.contextmanager
def private_domain() -> Iterator[int]:
    """Yield a ROS domain that no other walk on this machine uses, and lock it until the context is left."""
    candidates = list(range(1, 102))  # the ports of domains above 101 overlap with the ephemeral ports of the kernel
    random.shuffle(candidates)
    for number in candidates:
        if (held := lock(f"domain{number}")) is not None:
            with held:
                yield number
            return
    raise ConfigError("all 101 ROS domains of this machine are taken by walks: wait, or set ROS_DOMAIN_ID")
