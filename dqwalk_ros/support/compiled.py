"""Compilation of numerical functions by numba, and the cache of their machine code on disk.

Numba recompiles a cached function only when its own file changes, although its machine code contains the functions
that it calls from other files. So the cache folder of a module is named after a `digest` of the module and of all that
it imports: a change recompiles the functions of its module and of those that depend on it.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import inspect
import logging
import os
import pathlib
import re
from collections.abc import Callable
from typing import Any

import numba
from numba import extending
from numba.core import event
from numba.np import arrayobj

from dqwalk_ros.support.cache import cache_folder

_ROOT = pathlib.Path(__file__).parents[2]
_IMPORT = re.compile(r"^ *from (dqwalk_ros[.\w]*) import", re.MULTILINE)


@functools.cache
def _read(module: str) -> tuple[str, tuple[str, ...]]:
    """Return the text of a module of this package, and the names of those that it imports."""
    place = _ROOT.joinpath(*module.split("."))
    text = (place / "__init__.py" if place.is_dir() else place.with_suffix(".py")).read_text(encoding="utf-8")
    return text, tuple(_IMPORT.findall(text))


@functools.cache
def digest(module: str) -> str:
    """Return a digest of the compiled functions of a module and of all modules that it imports, directly or not.

    A module of another package may call any function of this one, so that all count.
    """
    left, found = [module], set[str]()
    if module.partition(".")[0] != "dqwalk_ros":
        left = [".".join(file.relative_to(_ROOT).with_suffix("").parts) for file in _ROOT.glob("dqwalk_ros/**/*.py")]
    while left:
        if (name := left.pop()) not in found:
            found.add(name)
            left += _read(name)[1]
    texts = (_read(name)[0] for name in sorted(found))
    return hashlib.sha256("".join(text for text in texts if "jit" in text).encode()).hexdigest()[:16]


_CONFIG: Any = numba.config
if "NUMBA_OPT" not in os.environ:
    # LLVM's first level compiles in three quarters of the time of its third, and functions of arrays of this size run
    # as fast; all functions that numba compiles in this process have it
    _CONFIG.OPT = type(_CONFIG.OPT)(1)
_folder: pathlib.Path | None = None  # numba's own choice
_no_cache = ""
if "NUMBA_CACHE_DIR" not in os.environ:
    try:
        _folder = cache_folder()
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


event.register("numba:compile", _CompilationNotice())


def _wrong_shape(given: Any, wanted: Any) -> None:
    """Raise the error of an assignment to a part of an array, without the two shapes.

    numba itself writes them into the message. The machine code for that is ten times as long as the assignment, and
    was half of what is compiled once and loaded by every process.
    """
    raise NotImplementedError


@extending.overload(_wrong_shape)
def _wrong_shape_of(given: Any, wanted: Any) -> Any:
    def raises(given: Any, wanted: Any) -> None:
        raise ValueError("cannot assign an array of another shape to a part of an array")

    return raises


if len(inspect.signature(getattr(arrayobj, "raise_with_shape_context", print)).parameters) == 2:
    arrayobj.raise_with_shape_context = _wrong_shape  # else this numba does it in another way


def _saving(save: Callable[..., None]) -> Callable[..., None]:
    """Return what saves machine code where that is possible: on a full disk it is compiled again the next time."""

    def saves(*code: Any) -> None:
        with contextlib.suppress(OSError):
            save(*code)

    return saves


def jit(function: Callable[..., Any]) -> Any:
    """Return `function` compiled on its first call; floating-point operations are not reordered (no fast-math)."""
    compiled: Any = numba.njit(fastmath=False, error_model="numpy")(function)
    if not _no_cache and not _CONFIG.DISABLE_JIT:
        others = _CONFIG.CACHE_DIR
        if _folder is not None:
            _CONFIG.CACHE_DIR = str(_folder / digest(function.__module__))
        with contextlib.suppress(RuntimeError):  # a function of no file, such as one typed at a prompt
            compiled.enable_caching()
            cache = compiled._cache
            cache.save_overload = _saving(cache.save_overload)
        _CONFIG.CACHE_DIR = others
    return compiled
