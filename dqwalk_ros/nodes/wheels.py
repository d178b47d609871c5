"""Workarounds for rclpy 7.1 (Jazzy), most of all for its wheels on PyPI. Nothing here is specific to walking.

1. rclpy's signal handlers shut the context down before a node can publish a last message: ours only stop the spinning.
2. `EventsExecutor`, which has half the latency of the others, does not handle Python's signals while it spins without a
   deadline: it spins in slices, and signals are handled between two slices.
3. Where rclpy is built for an old C library, a timer on the steady clock waits for a time of the system clock. If that
   clock is set back by an hour, every timer is an hour late: a thread resets late timers.
4. `destroy_node` can hang inside the middleware (Fast-DDS issue 6513): shutdown has a deadline.
5. A Fast DDS publisher asks for acknowledgements, and repeats lost messages, only every 3 s: config/fastdds.xml sets
   this to 0.1 s.
6. Messages through the shared memory of Fast DDS get lost for good if their receiver is suspended for a second, in
   about one of a hundred cases: the profiles have UDP only. For the discovery range LOCALHOST, ROS 2 adds shared memory
   to any profile, so there the profile limits the discovery.
"""

from __future__ import annotations

import contextlib
import faulthandler
import gc
import inspect
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
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.own_folder import own_folder, temporary

STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""For every timer and throttled log: those of rclpy's default clock stop when the system's clock is set back."""

_FAST_DDS = "rmw_fastrtps_cpp"
_SLICE = 0.1
"""Longest time until a signal is handled [s]."""
_END = 5.0
"""Deadline for the shutdown of the middleware [s]."""


def init(argv: Sequence[str]) -> list[int]:
    """Initialise rclpy; return a list that fills with the signals received.

    These are SIGINT and SIGTERM, and SIGHUP where it is not ignored (nohup). A list has no lock: a second
    signal can interrupt the handler of the first, and would wait forever for the lock of a `threading.Event`.

    Raises
    ------
    ConfigError
        For invalid ROS arguments, or missing security keys.
    """
    received: list[int] = []
    if "FASTRTPS_DEFAULT_PROFILES_FILE" not in os.environ and rclpy.get_rmw_implementation_identifier() == _FAST_DDS:
        local = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE") == "LOCALHOST"
        profile = find_share("config", "fastdds_localhost.xml" if local else "fastdds.xml")
        os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(profile)
        if local:
            os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SYSTEM_DEFAULT"  # as in the profile
    hangs_up = signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN
    for number in (signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hangs_up else [])):
        signal.signal(number, lambda number, frame: received.append(number))
    initialize(args=list(argv), signal_handler_options=SignalHandlerOptions.NO)
    return received


def initialize(**options: Any) -> None:
    """Initialize rclpy, with the options of its `init`.

    Raises
    ------
    ConfigError
        If that fails.
    """
    find_log_folder()
    try:
        rclpy.init(**options)
    except Exception as error:  # rclpy raises its own, undocumented types
        secured = os.environ.get("ROS_SECURITY_ENABLE") == "true"
        keys = "; ROS_SECURITY_ENABLE is set, which needs the keys of this node in ROS_SECURITY_KEYSTORE"
        raise ConfigError(first_line(error) + (keys if secured else "")) from error


def find_log_folder() -> None:
    """Have ROS log into this user's temporary folder where there is no home to log into: it would not start."""
    given = {"ROS_HOME", "ROS_LOG_DIR"} & os.environ.keys()
    if not given and not os.access(os.environ.get("HOME", ""), os.W_OK):
        with contextlib.suppress(OSError):  # then ROS gives the reason
            os.environ["ROS_LOG_DIR"] = str(own_folder(temporary()) / "log")


def first_line(error: BaseException) -> str:
    """Return the first line of an error of rcl; the rest refers to its source code."""
    return str(error).strip().splitlines()[0]


def numbered(callback: Callable[[Any, int], None]) -> Callable[..., None]:
    """Return the callback of a subscription for one that gets each message and the number of its publisher for it.

    rclpy finds by its signature that a callback wants to know more of a message than its content. The EventsExecutor
    passes both as one tuple, other executors as two arguments.
    """

    def take(*given: Any) -> None:
        msg, info = given if len(given) == 2 else given[0]
        callback(msg, info["publication_sequence_number"])

    both = [inspect.Parameter(name, inspect.Parameter.POSITIONAL_ONLY) for name in ("msg", "info")]
    take.__signature__ = inspect.Signature(both)  # type: ignore[attr-defined]
    return take


def spin(node: Node, until: Callable[[], bool], *, pause: float = 0.0) -> None:
    """Spin a node.

    Parameters
    ----------
    until : callable
        Called after each event; true ends the spinning.
    pause : float
        Time to sleep [s] before all messages received until then are handled. A node outside the control loop thereby
        leaves the processor to those in the loop, instead of waking up for each message.
    """
    executor: Any = EventsExecutor()
    executor.add_node(node)
    gc.collect()
    gc.freeze()  # a full collection of all loaded modules takes 30 ms, which is six periods at 200 Hz
    waker = TimerWaker(node, executor)
    waker.start()
    try:
        while not until():
            executor.spin_once(timeout_sec=_SLICE)
            if pause:
                time.sleep(pause)
                waiting = executor.create_task(lambda: None)  # queued behind all waiting messages
                while not waiting.done():
                    executor.spin_once(timeout_sec=0.0)
    finally:
        waker.stop()


def shutdown(node: Node | None, exit_code: int) -> None:
    """Destroy a node and shut rclpy down; if that hangs for `_END` seconds, exit the process with `exit_code`."""
    guard = threading.Timer(_END, os._exit, (exit_code,))
    guard.daemon = True
    guard.start()
    # the thread cannot run if the middleware hangs while it holds the GIL; faulthandler does not need the GIL
    faulthandler.dump_traceback_later(_END + 1.0, exit=True)
    if node is not None:
        node.destroy_node()
    rclpy.try_shutdown()
    faulthandler.cancel_dump_traceback_later()
    guard.cancel()


class TimerWaker(threading.Thread):
    """A thread that resets late timers of a node.

    Parameters
    ----------
    executor : rclpy.executors.Executor
        Woken at each check.
    """

    period = 0.1
    """Period of the checks [s]."""
    late = 0.1
    """Delay above which a timer is considered late [s]."""

    def __init__(self, node: Node, executor: Any) -> None:
        super().__init__(name="timer_waker", daemon=True)
        self._node, self._executor = node, executor
        self._stopped = threading.Event()

    def run(self) -> None:
        """Check the timers until `stop`."""
        while not self._stopped.wait(self.period):
            for timer in self._node.timers:
                left = timer.time_until_next_call()  # [ns]; None once it is cancelled
                if left is not None and left < -1e9 * self.late:
                    timer.reset()
            self._executor.wake()  # the executor's own wait may be late as well

    def stop(self) -> None:
        """Stop the thread; to be called before the node is destroyed."""
        self._stopped.set()
        self.join(1.0)
