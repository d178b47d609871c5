"""Progress bar, by tqdm."""

from __future__ import annotations

import sys
from typing import Any, Self

from tqdm import tqdm
from tqdm.contrib.logging import logging_redirect_tqdm

__all__ = ["Progress"]


class Progress:
    """Shows the fraction done, a line of text and the time left on a terminal, in a file nothing; a context manager."""

    def __init__(self, *, quiet: bool = False) -> None:
        self._bar = tqdm(
            total=1.0,
            disable=quiet or not sys.stderr.isatty(),
            leave=False,
            dynamic_ncols=True,
            bar_format="{percentage:3.0f} % |{bar:20}| {desc} {remaining} left",
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
        self._bar.set_description_str(text, refresh=False)
        self._bar.update(min(1.0, max(0.0, fraction)) - self._bar.n)

    def stage(self, fraction: float, text: str) -> None:
        """Show at once the fraction done and the name of a stage, during which the bar does not change."""
        self._bar.n = fraction
        self._bar.set_description_str(text)
