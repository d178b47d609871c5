"""Functions of the points of a study, in a module that its worker processes can import."""

from __future__ import annotations

import signal

import msgspec


class Number(msgspec.Struct):
    """The outcome of a point."""

    square: float


def ignores_interrupts(index: int, point: dict[str, float]) -> Number:
    """Return 1 if the process ignores Ctrl-C."""
    return Number(float(signal.getsignal(signal.SIGINT) is signal.SIG_IGN))
