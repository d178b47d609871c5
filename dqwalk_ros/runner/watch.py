"""Follow a walk from its first tick to its end."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable
from types import FrameType
from typing import Any, Self

from dqwalk_ros.config import Config
from dqwalk_ros.gait import phase_count
from dqwalk_ros.runner.processes import Processes

__all__ = ["Progress", "Signals", "Watch"]

_STARTUP = 180.0
"""Longest wait for the first tick [s]; on a fresh machine the kinematics is compiled first."""
_STALL = 60.0
"""Longest wait for the next sign of progress [s]."""

Progress = Callable[[float, str], None]


class Watch:
    """Follows a walk by what the controller says.

    Parameters
    ----------
    config : Config
    progress : callable or None
    plant : str
        Name of its node.
    duration : float
        Time that a steered walk takes [s]; 0 where the phases are counted.

    Attributes
    ----------
    last : dict
        What the controller said last.
    took : float
        Time from its first word to its last [s].
    """

    def __init__(
        self, config: Config, progress: Progress | None, *, plant: str = "integrator", duration: float = 0.0
    ) -> None:
        self._plant, self._duration = plant, duration
        self.last: dict[str, Any] = {}
        self.took = 0.0
        self._phases = phase_count(config) or math.inf
        self._threshold = config.ssp.threshold
        self._progress = progress
        self._first: tuple[float, int] | None = None
        self._error0 = (-1, 0.0)
        self._pace = 0.0

    def until_the_end(self, processes: Processes) -> str:
        """Return why the walk failed; an empty text where it did not."""
        began = heard = time.monotonic()
        with Signals() as signals:
            while True:
                processes.wait_for_news(0.2)
                if self._listen(processes):
                    heard = time.monotonic()
                if signals.seen:
                    return f"interrupted by {signal.Signals(signals.seen).name}"
                if (reason := self._ended(processes)) is not None:
                    return reason
                now = time.monotonic()
                self._show(now - began)
                if now - heard > (_STALL if self._first else _STARTUP):
                    return f"no progress for {now - heard:.0f} s: {processes.last_words('controller')}"

    def _ended(self, processes: Processes) -> str | None:
        """Return None while the walk goes on, "" when it is over, else what went wrong."""
        code = processes.exit_code("controller")
        if code is not None:
            self._listen(processes)
            if code == 0 and self.last.get("mode") == "finished":
                return ""
            return self.last.get("reason") or f"controller ended ({code}): {processes.last_words('controller')}"
        for name in (self._plant, "recorder"):
            if (code := processes.exit_code(name)) is not None:
                return f"{name} ended ({code}): {processes.last_words(name)}"
        return None

    def _listen(self, processes: Processes) -> bool:
        """Take in what the controller said; tell whether the walk went on."""
        ticks = self.last.get("ticks", -1)
        for line in processes.said("controller"):
            if line.get("event") == "walk":
                self._note(line)
        return bool(self.last.get("ticks", -1) > ticks)

    def _note(self, line: dict[str, Any]) -> None:
        now, ticks = time.monotonic(), int(line["ticks"])
        if self._first is None:
            self._first = (now, ticks)
        self.took = now - self._first[0]
        if self.took > 0.0:
            self._pace = (ticks - self._first[1]) / self.took
        if line["phase_index"] != self._error0[0] and line["error"]:
            self._error0 = (line["phase_index"], line["error"])
        self.last = line

    def _show(self, waited: float) -> None:
        if self._progress is None:
            return
        if not self.last:
            self._progress(0.0, f"starting the nodes, {waited:.0f} s")
            return
        line = self.last
        error = "" if line["error"] is None else f"error {line['error']:.4f}"
        of = "" if self._phases == math.inf else f"/{self._phases}"
        text = f"phase {line['phase_index'] + 1}{of} {line['phase']}  {line['time']:7.2f} s  {error}"
        self._progress(self._fraction(), f"{text}  {self._pace:.0f} ticks/s")

    def _fraction(self) -> float:
        """Return how much is done; within single support by the decay of its error, which is exponential."""
        if self._duration:
            return min(1.0, float(self.last["time"]) / self._duration)
        index, error = int(self.last["phase_index"]), float(self.last["error"] or 0.0)
        within = 0.0
        first = self._error0[1]
        if index % 2 and error and first > self._threshold:
            within = 1.0 - math.log(max(error, self._threshold) / self._threshold) / math.log(first / self._threshold)
        return min(1.0, max(0.0, (index + max(0.0, within)) / self._phases))


class Signals:
    """Notes SIGINT and SIGTERM instead of dying of them."""

    def __init__(self) -> None:
        self.seen = 0
        self._before: dict[int, Any] = {}

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.seen = number

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
