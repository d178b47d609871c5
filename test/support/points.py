"""Functions of the points of a study, in a module that its worker processes can import."""

from __future__ import annotations

import fcntl
import signal
import time

import msgspec


class Number(msgspec.Struct):
    """The outcome of a point."""

    square: float


def hold_a_lock(index: int, point: dict[str, str]) -> Number:
    """Hold the lock of the point's file for as long as the process lives, and write to it whether it ignores Ctrl-C."""
    with open(point["file"], "w", encoding="utf-8") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        file.write(str(signal.getsignal(signal.SIGINT) is signal.SIG_IGN))
        file.flush()
        time.sleep(600.0)
    return Number(0.0)
