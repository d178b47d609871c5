"""Signals that end a loop between two of its steps, where nothing is lost, and processes that end with their parent."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any


@contextlib.contextmanager
def deferred_interrupts() -> Iterator[list[signal.Signals]]:
    """Collect the first SIGINT, SIGTERM or SIGHUP in the list that is yielded, instead of ending the process.

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
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            handler = signal.getsignal(number)
            if handler in (signal.default_int_handler, signal.SIG_DFL):
                before[number] = handler
                signal.signal(number, receive)
    try:
        yield received
    finally:
        restore()


@contextlib.contextmanager
def postponed_interrupts() -> Iterator[None]:
    """Let a first SIGINT, SIGTERM or SIGHUP act at the end of the context, such as an import that would lose it."""
    received: list[signal.Signals] = []
    try:
        with deferred_interrupts() as received:
            yield
    finally:
        for number in received:
            signal.raise_signal(number)


@contextlib.contextmanager
def as_ctrl_c() -> Iterator[None]:
    """Have SIGTERM and SIGHUP raise KeyboardInterrupt, as Ctrl-C does, where they would end the process at once."""
    own = threading.current_thread() is threading.main_thread()
    numbers = [n for n in (signal.SIGTERM, signal.SIGHUP) if own and signal.getsignal(n) is signal.SIG_DFL]
    for number in numbers:
        signal.signal(number, signal.default_int_handler)
    try:
        yield
    finally:
        for number in numbers:
            signal.signal(number, signal.SIG_DFL)


def is_interrupt(error: BaseException | None) -> bool:
    """Return whether an error is a KeyboardInterrupt, or the SystemError that a function of numba turns it into."""
    return isinstance(error, KeyboardInterrupt) or (isinstance(error, SystemError) and is_interrupt(error.__cause__))


def end_with(parent: int, number: signal.Signals) -> None:
    """Have the kernel send this process a signal when its parent dies, so that no robot walks on unsupervised.

    Parameters
    ----------
    parent : int
        Process id of the parent; if it has died already, the signal is sent now.
    """
    with contextlib.suppress(OSError, AttributeError):  # not Linux
        ctypes.CDLL(None).prctl(1, number)  # PR_SET_PDEATHSIG
    if os.getppid() != parent:
        os.kill(os.getpid(), number)


def serve(parent: int) -> None:
    """Leave Ctrl-C and a closed terminal, which reach the workers of a study, too, to their parent; end with it."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    end_with(parent, signal.SIGKILL)
