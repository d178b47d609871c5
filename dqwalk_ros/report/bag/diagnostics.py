"""What the nodes of a recorded walk published of themselves on /diagnostics."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass

from dqwalk_ros.errors import BagError
from dqwalk_ros.report.bag.columns import LEVELS, NS, unpack
from dqwalk_ros.report.bag.storage import load

__all__ = ["Fault", "Status", "diagnostics_of", "faults"]

_KIND = "diagnostic_msgs/msg/DiagnosticArray"
_WORST = ("ERROR", "STALE", "WARN")


@dataclass(frozen=True)
class Status:
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

    def number(self, key: str) -> float:
        """Return a value as a number, nan where it is none."""
        try:
            return float(self.values.get(key, "nan"))
        except ValueError:
            return float("nan")


@dataclass(frozen=True)
class Fault:
    """The same complaint, however often it was made."""

    name: str
    level: str
    message: str
    first: float
    last: float
    count: int


def diagnostics_of(path: str | os.PathLike[str]) -> list[Status]:
    """Return every status in the order of time; messages that cannot be read are left out.

    Raises
    ------
    BagError
        If the bag cannot be read.
    """
    out = []
    for column in load(path, lambda topic, kind: kind == _KIND).columns.values():
        for time, raw in zip(column.times, column.raws, strict=True):
            try:
                array = unpack(raw, _KIND)
            except BagError:
                continue
            for status in array.status:
                values = {pair.key: pair.value for pair in status.values}
                level = LEVELS[min(int(status.level), len(LEVELS) - 1)]
                out.append(Status(time / NS, status.name, level, status.message, values))
    return sorted(out, key=lambda status: status.time)


def faults(said: list[Status]) -> list[Fault]:
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
