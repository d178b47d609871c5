"""How a node lives: started, spun, told to stop, ended in order.

Three habits of rclpy 7.1 (Jazzy) shape this file. Its own signal handling tears the context down before a node can
say a last word, so the handler here only sets a flag. `EventsExecutor`, the fastest one, runs nothing while it spins
without a deadline, so it is spun in slices. And `destroy_node` can hang inside the middleware, so the end is guarded.
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import gc
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from dqwalk_ros.errors import DqwalkError
from dqwalk_ros.nodes.wake import Wake

__all__ = ["LAST_WORDS", "STEADY", "Life", "Throttle", "Worker", "flush", "run", "say"]

STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""For every timer: rclpy's default clock makes timers stop when the system's clock is set back."""

_SLICE = 0.1
"""Longest time before a signal is seen [s]: Python runs its handlers only between two slices."""
LAST_WORDS = {True: 10.0, False: 0.25}
"""Longest wait for acknowledgements in lockstep, where nothing may be missing from the bag, and in real time [s].

A subscriber acknowledges when the middleware asks it, every 3 s. In real time that is too long to wait for: what was
published is on its way already, and where it was lost, the plant's watchdog does the same."""
_HANG = 5.0
"""Longest time the middleware may take to end [s]."""
_PATIENCE = 20
"""Calls of `spin_once` without any effect after which nothing more is waiting."""
_PR_SET_PDEATHSIG = 1


class Life:
    """Whether the node goes on, and how it ends.

    Attributes
    ----------
    over : bool
    exit_code : int
    """

    def __init__(self) -> None:
        self.over = False
        self.exit_code = 0

    def end(self, exit_code: int = 0) -> None:
        """Ask for the end; the loop stops after the current callback."""
        self.over, self.exit_code = True, exit_code

    def on_signal(self, number: int, frame: FrameType | None) -> None:
        """Handle SIGINT and SIGTERM."""
        self.over = True


class Worker:
    """What each node is: callbacks on a `node`, and a last word.

    Attributes
    ----------
    node : rclpy.node.Node
    rest : float
        Time to sleep between two looks at what has come [s]; who may wait leaves the processor to the loop.
    handled : int
        Messages handled so far, to be counted where `rest` is not zero.
    last_words : float
        Longest wait, at the end, for subscribers to acknowledge what was published [s].
    """

    node: Node
    rest = 0.0
    handled = 0
    last_words = LAST_WORDS[False]

    def drained(self) -> bool:
        """Tell, once the end is asked for, whether what is still under way may be left."""
        return True

    def close(self) -> None:
        """Say the last word; the node can still publish."""


class Throttle:
    """Let something pass at most once per period of the steady clock.

    Parameters
    ----------
    period : float [s]
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._next = -float("inf")

    def __call__(self) -> bool:
        """Tell whether it may pass now."""
        now = time.monotonic()
        if now < self._next:
            return False
        self._next = now + self._period
        return True


def run(name: str, make: Callable[[Node, Life], Worker], options: Any) -> int:
    """Run one node until it is told to stop; return the exit code.

    Parameters
    ----------
    name : str
        Default name of the node.
    make : callable
        Builds the worker; it raises a `DqwalkError` for parameters that cannot be used.
    options : argparse.Namespace
        From `entry.parse`; the ROS arguments of its ``argv`` apply.

    Returns
    -------
    int
        0 after a signal or a worker that is done, 1 after a failed walk, 2 for arguments that cannot be used.
    """
    life = Life()
    signal.signal(signal.SIGINT, life.on_signal)
    signal.signal(signal.SIGTERM, life.on_signal)
    if options.child:
        _end_with_parent()
    try:
        rclpy.init(args=options.argv, signal_handler_options=SignalHandlerOptions.NO)
        node = Node(name)
    except Exception as error:  # rclpy raises its own, undocumented types: bad ROS arguments, security without keys
        print(f"{name}: {_first_line(error)}", file=sys.stderr)
        rclpy.try_shutdown()
        return 2
    worker: Worker | None = None
    executor = EventsExecutor()
    wake = Wake(node, executor)
    try:
        worker = make(node, life)
        executor.add_node(node)
        gc.collect()
        gc.freeze()  # a full collection looks at all that is loaded for 30 ms, which is six periods at 200 Hz
        wake.start()
        while not life.over:
            executor.spin_once(timeout_sec=_SLICE)
            if worker.rest:
                _spin_until_idle(executor, worker)
                time.sleep(worker.rest)
        while not worker.drained():
            executor.spin_once(timeout_sec=_SLICE)
    except DqwalkError as error:
        print(f"{name}: {error}", file=sys.stderr)
        life.end(2)
    finally:
        wake.stop()
        _end(node, worker, life)
    return life.exit_code


def _end_with_parent() -> None:
    """Ask the kernel for SIGTERM when the parent dies: no robot may walk on unwatched."""
    with contextlib.suppress(OSError, AttributeError):  # not a Linux
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _spin_until_idle(executor: Any, worker: Worker) -> None:
    """Handle everything that has come.

    `spin_once` handles one event and does not tell whether there was any; an event whose message was overwritten by
    a newer one handles nothing. Hence some patience.
    """
    idle = 0
    while idle < _PATIENCE:
        before = worker.handled
        executor.spin_once(timeout_sec=0.0)
        idle = idle + 1 if worker.handled == before else 0


def _end(node: Node, worker: Worker | None, life: Life) -> None:
    # Everything is said by then: a middleware that hangs must not hold the process, nor change how it ends. The
    # thread cannot run if the middleware hangs with the interpreter's lock; faulthandler needs no lock.
    guard = threading.Timer(_HANG, os._exit, (life.exit_code,))
    guard.daemon = True
    try:
        if worker is not None:
            worker.close()
            flush(node, worker.last_words)
    finally:
        guard.start()
        faulthandler.dump_traceback_later(_HANG + 1.0, exit=True)
        node.destroy_node()
        rclpy.try_shutdown()
        faulthandler.cancel_dump_traceback_later()
        guard.cancel()


def flush(node: Node, timeout: float) -> None:
    """Wait until reliable subscribers have what was published [s]."""
    deadline = time.monotonic() + timeout
    for publisher in node.publishers:
        left = max(deadline - time.monotonic(), 0.0)
        publisher.wait_for_all_acked(Duration(seconds=left))


def _first_line(error: BaseException) -> str:
    return str(error).strip().splitlines()[0]


def say(event: str, **values: Any) -> None:
    """Print one line for the program that started this node (see `dqwalk_ros.runner`)."""
    print(json.dumps({"event": event, **values}), flush=True)
