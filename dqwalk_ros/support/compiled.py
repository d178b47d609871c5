"""Compilation of numerical functions by numba, and the cache of their machine code on disk.

Numba recompiles a cached function only when its own file changes, although its machine code contains the functions
that it calls from other files. So the cache folder is named after a digest of all source files of this package in which
the word jit occurs: a change in any of them recompiles all.

Numba executes what it finds in the cache, so the cache is in a folder that no other user can have filled, or nowhere.
"""

from __future__ import annotations

import hashlib
import logging
import os
import pathlib
from collections.abc import Callable
from typing import Any

import numba
from numba.core import event

from dqwalk_ros.support.own_folder import own_folder, temporary

__all__ = ["COMPILING", "jit"]


def _cache_folder() -> pathlib.Path:
    """Return the folder of the cache: in the cache folder of the user, or if need be in the temporary one."""
    package = pathlib.Path(__file__).parent
    """Return the folder of the cache: in the user's cache folder, or in the temporary one where that is read-only."""
    package = pathlib.Path(__file__).parents[1]
    sources = (file.read_bytes() for file in sorted(package.rglob("*.py")))
    digest = hashlib.sha256(b"".join(text for text in sources if b"jit" in text)).hexdigest()
    caches = pathlib.Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    try:
        folder = own_folder(caches / "dqwalk_ros")
    except OSError:
        folder = own_folder(temporary())
    return folder / digest[:16]


_no_cache = ""
if "NUMBA_CACHE_DIR" not in os.environ:
    try:
        numba.config.CACHE_DIR = str(_cache_folder())  # type: ignore[attr-defined]
    except OSError as error:
        _no_cache = f"; in each process, because there is no cache ({error.strerror}: '{error.filename}')"


COMPILING = "compiling for this machine; this takes about a minute, once for each kind of walk"
"""Message of a process that finds no machine code in the cache."""


class _CompilationNotice(event.Listener):
    """Logs one warning at the first compilation of a process; loading a function from the cache is no compilation."""

    _logged = False

    def on_start(self, event: Any) -> None:
        """Log the warning, once."""
        if not self._logged:
            self._logged = True
            logging.getLogger("dqwalk_ros").warning(f"{COMPILING}{_no_cache}")

    def on_end(self, event: Any) -> None:
        """Do nothing."""


event.register("numba:compile", _CompilationNotice())  # type: ignore[no-untyped-call]


def jit(function: Callable[..., Any]) -> Any:
    """Return `function` compiled on its first call; floating-point operations are not reordered (no fast-math)."""
    return numba.njit(cache=not _no_cache, fastmath=False, error_model="numpy")(function)
