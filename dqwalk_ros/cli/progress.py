"""A progress bar in forty lines."""

from __future__ import annotations

import shutil
import sys
import time
from typing import TextIO

__all__ = ["Progress"]


class Progress:
    """Show how far something is: a line that is redrawn on a terminal, a line now and then elsewhere.

    Parameters
    ----------
    stream : file
        Where to; standard error by default.
    quiet : bool
        Show nothing.
    """

    def __init__(self, stream: TextIO | None = None, *, quiet: bool = False) -> None:
        self._stream = stream or sys.stderr
        self._quiet = quiet
        self._live = self._stream.isatty()
        self._every = 0.1 if self._live else 5.0
        self._began = time.monotonic()
        self._shown = float("-inf")
        self._drawn = False

    def __call__(self, fraction: float, text: str = "") -> None:
        """Show the fraction done, some text, and the time left."""
        now = time.monotonic()
        if self._quiet or now - self._shown < self._every:
            return
        self._shown = now
        fraction = min(1.0, max(0.0, fraction))
        spent = now - self._began
        left = f"{_clock(spent / fraction - spent)} left" if fraction > 0.01 else ""
        if not self._live:
            print(f"{100 * fraction:3.0f} %  {text}  {left}".rstrip(), file=self._stream, flush=True)
            return
        width = shutil.get_terminal_size().columns
        bar = 20
        done = round(bar * fraction)
        line = f"[{'#' * done}{'.' * (bar - done)}] {100 * fraction:3.0f} %  {text}  {left}"
        print(f"\r{line[: width - 1]:<{width - 1}}", end="", file=self._stream, flush=True)
        self._drawn = True

    def close(self) -> None:
        """Wipe the line."""
        if self._drawn:
            print(
                "\r" + " " * (shutil.get_terminal_size().columns - 1) + "\r",
                end="",
                file=self._stream,
                flush=True,
            )
            self._drawn = False


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"
