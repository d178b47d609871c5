"""Signals that end a loop between two of its steps, where nothing is lost."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any

__all__ = ["deferred_interrupts", "is_interrupt"]


@contextlib.contextmanager
def deferred_interrupts() -> Iterator[list[signal.Signals]]:
    """Collect the first SIGINT or SIGTERM in the list that is yielded, instead of ending the process.

    The loop inside the context reads the list after each step. A second signal acts at once, as outside of the context.
    Signals that are ignored or have a handler of the program are not affected, nor is any thread but the main one.
    """
    received: list[signal.Signals] = []
    before: dict[signal.Signals, Any] = {}

    def restore() -> None:
        while before:
            signal.signal(*before.popitem())

    def receive(number: int, _: FrameType | None) -> None:
        received.append(signal.Signals(number))
        restore()

    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            handler = signal.getsignal(number)
            if handler in (signal.default_int_handler, signal.SIG_DFL):
                before[number] = handler
                signal.signal(number, receive)
    try:
        yield received
    finally:
        restore()


def is_interrupt(error: BaseException | None) -> bool:
    """Return whether an error is a KeyboardInterrupt, or the SystemError that a function of numba turns it into."""
    return isinstance(error, KeyboardInterrupt) or (isinstance(error, SystemError) and is_interrupt(error.__cause__))
