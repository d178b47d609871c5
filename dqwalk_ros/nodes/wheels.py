"""What rclpy 7.1 (Jazzy) lacks, above all as its wheels on PyPI are built. Nothing here is about walking.

1. Its signal handling ends the context before a node can publish a last message: ours only ends the spinning.
2. `EventsExecutor`, which has half the latency of the others, runs nothing while it spins without a deadline: it is
   spun in slices. Python also runs its signal handlers only between two slices.
3. A timer on the steady clock sleeps until a moment of the system's clock where rclpy is built for an old C library.
   Set that clock back by an hour and every timer sleeps an hour too long: a thread wakes the ones that are late.
4. `destroy_node` can hang inside the middleware (Fast-DDS issue 6513): the end has a deadline.
5. A Fast DDS publisher asks for acknowledgements every 3 s only, and sends again what was lost no sooner:
   config/fastdds.xml makes it 0.1 s.
"""

from __future__ import annotations

import contextlib
import faulthandler
import gc
import os
import signal
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from dqwalk_ros.config import find_share
from dqwalk_ros.errors import ConfigError

__all__ = ["STEADY", "TimerWaker", "first_line", "init", "shutdown", "spin"]

STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""For every timer and throttled log: those of rclpy's default clock stop when the system's clock is set back."""

_SLICE = 0.1
"""Longest time before a signal is seen [s]."""
_END = 5.0
"""Longest time that the middleware may take to end [s]."""


def init(argv: Sequence[str]) -> threading.Event:
    """Initialise rclpy; return an event that SIGINT and SIGTERM set, and SIGHUP where it is not ignored (nohup).

    Raises
    ------
    ConfigError
        For ROS arguments that cannot be used, or security without its keys.
    """
    stopped = threading.Event()
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(find_share("config", "fastdds.xml")))
    hangs_up = signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN
    for number in (signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hangs_up else [])):
        signal.signal(number, lambda *_: stopped.set())
    try:
        rclpy.init(args=list(argv), signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy raises its own, undocumented types
        raise ConfigError(first_line(error)) from error
    return stopped


def first_line(error: BaseException) -> str:
    """Return the first line of what rcl says; the rest is about its own source."""
    return str(error).strip().splitlines()[0]


def spin(node: Node, until: Callable[[], bool], *, pause: float = 0.0) -> None:
    """Spin a node.

    Parameters
    ----------
    node : rclpy.node.Node
    until : callable
        Asked after each event; true ends the spinning.
    pause : float
        Sleep so long [s], then handle all that has come. A node that is not in the loop of a walk leaves the
        processor to those which are, instead of waking up for each message.
    """
    executor: Any = EventsExecutor()
    executor.add_node(node)
    gc.collect()
    gc.freeze()  # a full collection looks at all that is loaded for 30 ms, which is six periods at 200 Hz
    waker = TimerWaker(node, executor)
    waker.start()
    try:
        while not until():
            executor.spin_once(timeout_sec=_SLICE)
            if pause:
                time.sleep(pause)
                waiting = executor.create_task(lambda: None)  # comes behind everything that waits now
                while not waiting.done():
                    executor.spin_once(timeout_sec=0.0)
    finally:
        waker.stop()


def shutdown(node: Node | None, exit_code: int) -> None:
    """Destroy a node and end rclpy; after `_END` seconds end the process with `exit_code` where that hangs."""
    guard = threading.Timer(_END, os._exit, (exit_code,))
    guard.daemon = True
    guard.start()
    # the thread cannot run if the middleware hangs with the interpreter's lock; faulthandler needs no lock
    faulthandler.dump_traceback_later(_END + 1.0, exit=True)
    if node is not None:
        node.destroy_node()
    rclpy.try_shutdown()
    faulthandler.cancel_dump_traceback_later()
    guard.cancel()


class TimerWaker(threading.Thread):
    """A thread that wakes timers of a node which are late.

    Parameters
    ----------
    node : rclpy.node.Node
    executor : rclpy.executors.Executor
        The loop that waits; it is woken at each look.
    """

    period = 0.1
    """Time between two looks [s]."""
    late = 0.1
    """A timer that is due for longer than this was not merely held up [s]."""

    def __init__(self, node: Node, executor: Any) -> None:
        super().__init__(name="timer_waker", daemon=True)
        self._node, self._executor = node, executor
        self._stopped = threading.Event()

    def run(self) -> None:
        """Look until `stop`."""
        while not self._stopped.wait(self.period):
            for timer in self._node.timers:
                left = timer.time_until_next_call()  # [ns]; None once it is cancelled
                if left is not None and left < -1e9 * self.late:
                    timer.reset()
            self._executor.wake()  # the wait of the loop may oversleep as well

    def stop(self) -> None:
        """End the thread, before the node ends."""
        self._stopped.set()
        with contextlib.suppress(RuntimeError):  # it never began
            self.join(1.0)
