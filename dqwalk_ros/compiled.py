"""Compilation: readable functions, compiled by numba as they stand and kept on disk.

Numba keeps a compiled function until its own file changes, although it contains the functions it calls from other
files. So what is kept lies in a folder named after all files of this package that have compiled functions.
"""

from __future__ import annotations

import hashlib
import logging
import os
import pathlib
import tempfile
from collections.abc import Callable
from typing import Any

import numba
from numba.core import event

__all__ = ["jit"]


def _folder() -> pathlib.Path:
    package = pathlib.Path(__file__).parent
    sources = (file.read_bytes() for file in sorted(package.rglob("*.py")))
    digest = hashlib.sha256(b"".join(text for text in sources if b"jit" in text)).hexdigest()
    cache = pathlib.Path(os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache")
    if not os.access(next(folder for folder in (cache, *cache.parents) if folder.exists()), os.W_OK):
        cache = pathlib.Path(tempfile.gettempdir()) / f"user-{os.getuid()}"
    return cache / "dqwalk_ros" / digest[:16]


if "NUMBA_CACHE_DIR" not in os.environ:
    numba.config.CACHE_DIR = str(_folder())  # type: ignore[attr-defined]


class _Notice(event.Listener):
    """Says once that functions are being compiled; loading them from disk is not compiling."""

    _told = False

    def on_start(self, event: Any) -> None:
        """Announce the first compilation."""
        if not self._told:
            self._told = True
            logging.getLogger("dqwalk_ros").warning("compiling for this machine; this takes a while, once")

    def on_end(self, event: Any) -> None:
        """Do nothing."""


event.register("numba:compile", _Notice())  # type: ignore[no-untyped-call]


def jit(function: Callable[..., Any]) -> Any:
    """Return the function compiled, with IEEE arithmetic as written."""
    return numba.njit(cache=True, fastmath=False, error_model="numpy")(function)
