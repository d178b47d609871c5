"""Wake timers that overslept.

Timers are measured on the steady clock, but where rclpy was built for an old C library (the wheels are) it sleeps until
a moment of the system's clock: set that back by an hour, and every timer sleeps an hour too long, and with it the
loop. Whoever looks from a thread of their own can tell, and wake them.
"""

from __future__ import annotations

import contextlib
import threading
from typing import Any

from rclpy.node import Node

__all__ = ["Wake"]

_LOOK = 0.1
"""Time between two looks [s]."""
_LATE = 0.1
"""A timer that is due for longer than this was not merely held up [s]."""


class Wake(threading.Thread):
    """A thread that looks after the timers of a node.

    Parameters
    ----------
    node : rclpy.node.Node
    executor : rclpy.executors.Executor
        The loop that waits; it is woken at each look.
    """

    def __init__(self, node: Node, executor: Any) -> None:
        super().__init__(name="wake", daemon=True)
        self._node, self._executor = node, executor
        self._over = threading.Event()

    def run(self) -> None:
        """Look until `stop`."""
        while not self._over.wait(_LOOK):
            for timer in self._node.timers:
                if self._is_late(timer):
                    timer.reset()
            self._executor.wake()  # a signal is seen between two waits of the loop, which may oversleep as well

    def stop(self) -> None:
        """End the thread, before the node ends."""
        self._over.set()
        with contextlib.suppress(RuntimeError):  # it never began
            self.join(1.0)

    @staticmethod
    def _is_late(timer: Any) -> bool:
        left = timer.time_until_next_call()  # [ns]; None once it is cancelled
        return left is not None and left < -1e9 * _LATE
