"""What the nodes of a recorded walk said of themselves on /diagnostics."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from dqwalk_ros.report.bag import messages, storage

__all__ = ["Fault", "Said", "diagnostics_of", "faults"]

_KIND = "diagnostic_msgs/msg/DiagnosticArray"
LEVELS = ("OK", "WARN", "ERROR", "STALE")
_WORST = ("ERROR", "STALE", "WARN")


@dataclass(frozen=True)
class Said:
    """One status.

    Attributes
    ----------
    time : float
        When it was recorded [s].
    name, level, message : str
    values : mapping of str to str
    """

    time: float
    name: str
    level: str
    message: str
    values: Mapping[str, str]


@dataclass(frozen=True)
class Fault:
    """The same complaint, however often it was made."""

    name: str
    level: str
    message: str
    first: float
    last: float
    count: int


def diagnostics_of(path: str | os.PathLike[str]) -> list[Said]:
    """Return what was not OK, and everything the controller said.

    Raises
    ------
    BagError
        If the bag cannot be read.
    """
    content = storage.load(Path(path), lambda topic, kind: kind == _KIND)
    out = []
    for column in content.columns.values():
        for time, raw in zip(column.times, column.raws, strict=True):
            if _level(raw) == 0 and b"controller:" not in raw:
                continue
            for status in messages.unpack(raw, _KIND).status:
                values = {pair.key: pair.value for pair in status.values}
                level = status.level if isinstance(status.level, int) else status.level[0]
                out.append(Said(time / 1e9, status.name, LEVELS[min(level, 3)], status.message, values))
    return sorted(out, key=lambda said: said.time)


def _level(raw: bytes) -> int:
    """Return the level of the first status of a little-endian array, without unpacking it; -1 where in doubt."""
    if raw[1] != 1:
        return -1
    frame = int.from_bytes(raw[12:16], "little")
    at = 16 + frame
    at += -at % 4
    return raw[at + 4] if int.from_bytes(raw[at : at + 4], "little") == 1 and len(raw) > at + 4 else -1


def faults(said: list[Said]) -> list[Fault]:
    """Return every complaint once, the worst first; numbers in a message make no difference."""
    found: dict[tuple[str, str, str], Fault] = {}
    for status in said:
        if status.level == "OK":
            continue
        key = status.name, status.level, re.sub(r"[-+.\d]+(e[-+]?\d+)?", "#", status.message)
        before = found.get(key)
        first, count = (before.first, before.count) if before else (status.time, 0)
        message = before.message if before else status.message
        found[key] = Fault(status.name, status.level, message, first, status.time, count + 1)
    return sorted(found.values(), key=lambda fault: (_WORST.index(fault.level), fault.first))
