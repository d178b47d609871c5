"""Exceptions of the package; some have attributes that name the rows or the phase concerned."""

from __future__ import annotations

import os
import re
import traceback
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path


def listed(names: Collection[str]) -> str:
    """Return some names that came from outside, for a message that fits on a line and cannot act on a terminal."""
    some = [shown(name) for name in sorted(names)[:12]]
    return ", ".join([*some, f"and {len(names) - 12} more"] if len(names) > 12 else some)


_PARTICULAR = re.compile(r"'[^']*'|[-+.\d]+(?:e[-+]?\d+)?")
"""What distinguishes messages of the same kind: names and numbers."""


def kinds(messages: Sequence[str]) -> list[str]:
    """Return the first message of each kind, with the number of others that differ only by names and numbers."""
    found: dict[str, list[str]] = {}
    for message in messages:
        found.setdefault(_PARTICULAR.sub("", message), []).append(message)
    return [same[0] + (f" ({len(same) - 1} more like this)" if len(same) > 1 else "") for same in found.values()]


def printable(text: str) -> str:
    """Return a text in one line: control characters are escaped, as names from outside may contain them."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def shown(name: str) -> str:
    """Return a name that came from outside, as `listed` does."""
    return ascii(name)[1:-1][:60]


def missing(what: str, path: Path) -> str:
    """Return why there is no file at a path; a pipe, as of ``<(...)``, cannot be read twice."""
    if path.is_dir():
        return f"'{path}' is a folder; name the {what}"
    if path.exists():
        return f"'{path}' is a pipe or a device: write its content into a file"
    if path.is_symlink():
        return f"no {what} '{path}': it is a link that leads nowhere"
    why = unexpanded(str(path))
    return f"no {what} '{path}'{why and f': {why}'}"


def unexpanded(path: str) -> str:
    """Return that a path begins with what a shell replaces at the beginning of a word only; or ""."""
    begins = path.startswith(("~", "$"))
    return f"no shell has replaced the '{path[0]}'; write the whole path" if begins else ""


def one_line(text: str) -> str:
    """Return a text that came from outside in one line of printable characters, at most 300."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())[:300]


_ON_PYPI = {
    "daqp": "daqp",
    "distributed": "distributed",
    "dynamixel_sdk": "dynamixel-sdk",
    "mujoco": "mujoco",
    "pinocchio": "pin",
    "pyarrow": "pyarrow",
    "pydrake": "drake",
    "serial": "pyserial",
    "viser": "viser",
    "xacro": "xacro",
}
"""Name on PyPI of each Python module that may be missing."""
_OF_ROS = ("rclpy", "_interfaces", "_msgs", "_srvs")
"""Endings of the names of ROS modules."""


def how_to_install(module: str) -> str:
    """Return how a missing Python module, or the package of a submodule, is installed; empty if it is not known."""
    package = module.partition(".")[0]
    if package.endswith(_OF_ROS):
        return "source the setup file of a ROS 2 Jazzy, or pip install -e '.[ros]' in the folder of dqwalk_ros"
    return f"pip install {_ON_PYPI[package]}" if package in _ON_PYPI else ""


def not_imported(error: Exception) -> str:
    """Return why another package's module was not imported; empty for any other error.

    It is missing, or it failed as it was imported, as numba does where NUMBA_NUM_THREADS=0.
    """
    if isinstance(error, ModuleNotFoundError):
        if (error.name or "").partition(".")[0] == "dqwalk_ros":
            return ""
        how = how_to_install(error.name or "")
        return f"the Python module '{error.name}' is not installed{how and f': {how}'}"
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__) if frame.f_code.co_name == "<module>"]
    package = str(frames[-1].f_globals.get("__name__")).partition(".")[0] if frames else "dqwalk_ros"
    if package in ("dqwalk_ros", "__main__"):
        return ""
    names = [name for name in os.environ if name.startswith(f"{package.upper()}_")]
    doubt = f"; is {listed(names)} in the environment right?" if names else ""
    return f"{package} cannot be imported: {printable(str(error))}{doubt}"


class DqwalkError(Exception):
    """Base class of all exceptions that this package defines."""


class ConfigError(DqwalkError):
    """A configuration is not valid; the message names the key and the values allowed."""


class ModelError(DqwalkError):
    """A robot description is not valid; the message names the element."""


class StateError(DqwalkError):
    """A measured state or a commanded target is not valid; the message names the joints or the value."""


class PlantError(DqwalkError):
    """The plant (simulator or robot driver) failed, or a command does not fit it."""


class BagError(DqwalkError):
    """A bag does not contain a walk that can be read; the message names what is missing."""


class OutputError(DqwalkError):
    """A result is not written, because something exists in its place."""


class ViewerError(DqwalkError):
    """The viewer's web page cannot be served; the message says what to do."""


class StudyError(DqwalkError):
    """The results of a study cannot be read or written."""


class QPError(DqwalkError):
    """A quadratic program has no solution, or the solver found none that fulfils the optimality conditions.

    Attributes
    ----------
    status : str
        Status of the solver, or of the check of its solution.
    rows : tuple of str
        Names of the rows that conflict or are violated, most violated first; may be empty.
    short : dict of str to float
        Amount by which each of some rows must be relaxed for the problem to be feasible, in the row's own unit per
        second; may be empty.
    """

    def __init__(
        self, message: str, *, status: str, rows: Sequence[str] = (), short: Mapping[str, float] | None = None
    ) -> None:
        super().__init__(message)
        self.status = status
        self.rows = tuple(rows)
        self.short = dict(short or {})


class PhaseError(DqwalkError):
    """A phase does not reach the condition that ends it.

    Attributes
    ----------
    phase : str
        Name of the phase, such as ``"single_support/left"``.
    error : float
        Norm of the task error when the exception was raised.
    active : tuple of str
        Names of the inequalities that were active then.
    stalled : bool
        Whether the error no longer decreased.
    """

    def __init__(
        self, message: str, *, phase: str, error: float, active: Sequence[str] = (), stalled: bool = False
    ) -> None:
        super().__init__(message)
        self.phase = phase
        self.error = error
        self.active = tuple(active)
        self.stalled = stalled

    def held_by(self, rows: Sequence[str]) -> PhaseError:
        """Return a copy of the error that names `rows`, the inequalities that are active, in attribute and message."""
        minimum = ": a local minimum of the task" if self.stalled else ""
        text = f"active: {', '.join(rows)}" if rows else f"no constraint is active{minimum}"
        return PhaseError(f"{self}; {text}", phase=self.phase, error=self.error, active=rows, stalled=self.stalled)
