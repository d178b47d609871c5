"""Progress bar, by tqdm."""

from __future__ import annotations

import math
import sys
import time
from typing import Any, Self

from tqdm import tqdm
from tqdm.contrib.logging import logging_redirect_tqdm

__all__ = ["Progress"]

_PAUSE = 10.0
"""Time between two lines where there is no terminal [s]."""


class Progress:
    """Shows the fraction done, times passed and left, and a line of text; a context manager.

    On a terminal this is a bar, in a file or pipe a line every ten seconds.
    """

    def __init__(self, *, quiet: bool = False) -> None:
        terminal = sys.stderr.isatty()
        self._due = math.inf if quiet or terminal else time.monotonic() + _PAUSE  # the next line in a file
        self._bar = tqdm(
            total=1.0,
            disable=quiet or not terminal,
            leave=False,
            dynamic_ncols=True,  # what is too long for a line is cut off at its end
            bar_format="{percentage:3.0f} % |{bar:20}| {elapsed}<{remaining} {desc}",
        )

    def __enter__(self) -> Self:
        self._above = logging_redirect_tqdm()  # log messages are printed above the bar
        self._above.__enter__()
        return self

    def __exit__(self, *_: Any) -> None:
        self._bar.close()
        self._above.__exit__(None, None, None)

    def print(self, text: str) -> None:
        """Print a line on standard output, above the bar."""
        self._bar.write(text)

    def __call__(self, fraction: float, text: str = "") -> None:
        """Show the fraction done and some text."""
        fraction = min(1.0, max(0.0, fraction))
        self._bar.set_description_str(text, refresh=False)
        self._bar.update(fraction - self._bar.n)
        self._line(fraction, text)

    def stage(self, fraction: float, text: str) -> None:
        """Show at once the fraction done and the name of a stage, during which the bar does not change."""
        self._bar.n = fraction
        self._bar.set_description_str(text)
        self._line(fraction, text)

    def _line(self, fraction: float, text: str) -> None:
        if (now := time.monotonic()) >= self._due:
            self._due = now + _PAUSE
            print(f"{100.0 * fraction:3.0f} % {text}", file=sys.stderr, flush=True)
