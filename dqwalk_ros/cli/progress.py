"""Progress bar, by tqdm."""

from __future__ import annotations

import sys
import threading
import time
from typing import Any, Self

from tqdm import tqdm
from tqdm.contrib.logging import logging_redirect_tqdm

_TICK, _PAUSE = 1.0, 10.0
"""Longest time between two states of the bar, and between two lines where there is no terminal [s]."""
_EARLY = 0.01
"""Fraction done before which no time left is shown: it would be hours, from the first steps and what preceded them."""


class _Bar(tqdm):  # type: ignore[misc]
    """tqdm's bar, which shows the time left once it can be known."""

    @property
    def format_dict(self) -> dict[str, Any]:
        """The fields of the format."""
        left = "<{remaining}" if self.n >= _EARLY else ""
        return {**super().format_dict, "bar_format": f"{{percentage:3.0f}} % |{{bar:20}}| {{elapsed}}{left} {{desc}}"}


class Progress:
    """Shows the fraction done, times passed and left, and a line of text; a context manager.

    On a terminal this is a bar, in a file or pipe a line every ten seconds; both also while no progress is reported.
    """

    def __init__(self, *, quiet: bool = False) -> None:
        self._terminal = sys.stderr.isatty()
        self._fraction, self._text, self._over = 0.0, "", threading.Event()
        self._thread = None if quiet else threading.Thread(target=self._keep_showing, daemon=True)
        self._bar = _Bar(
            total=1.0,
            disable=quiet or not self._terminal,
            leave=False,
            miniters=0,  # a new text is shown also without progress
            smoothing=0.0,  # a walk reports whole phases: the mean speed of all of them
            dynamic_ncols=True,  # what is too long for a line is cut off at its end
        )

    def __enter__(self) -> Self:
        self._above = logging_redirect_tqdm()  # log messages are printed above the bar
        self._above.__enter__()
        if self._thread is not None:
            self._thread.start()
        return self

    def __exit__(self, *_: Any) -> None:
        self._over.set()
        if self._thread is not None:
            self._thread.join()
        self._bar.close()
        self._above.__exit__(None, None, None)

    def _keep_showing(self) -> None:
        began = time.monotonic()
        while not self._over.wait(_TICK if self._terminal else _PAUSE):
            if self._terminal:
                self._bar.refresh()
            else:
                after = f"after {time.monotonic() - began:.0f} s: {self._text}"
                print(f"{100.0 * self._fraction:3.0f} % {after}", file=sys.stderr, flush=True)

    def print(self, text: str) -> None:
        """Print a line on standard output, above the bar."""
        self._bar.write(text)

    def __call__(self, fraction: float, text: str = "") -> None:
        """Show the fraction done and some text."""
        self._fraction, self._text = min(1.0, max(0.0, fraction)), text
        self._bar.set_description_str(text, refresh=False)
        self._bar.update(self._fraction - self._bar.n)

    def stage(self, fraction: float, text: str) -> None:
        """Show at once the fraction done and the name of a stage, during which the bar does not change."""
        self._fraction, self._text = fraction, text
        self._bar.n = fraction
        self._bar.set_description_str(text)
