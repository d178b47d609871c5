"""A thread resets timers that are late, and only those; signals in quick succession end a node."""

from __future__ import annotations

import subprocess
import sys
import threading
from types import SimpleNamespace

from dqwalk_ros.nodes.wheels import TimerWaker


class Timer:
    """A timer due in `left` nanoseconds; after a reset, in one second."""

    def __init__(self, left: int | None) -> None:
        self.left, self.resets = left, 0

    def time_until_next_call(self) -> int | None:
        return self.left

    def reset(self) -> None:
        self.left, self.resets = 1_000_000_000, self.resets + 1


def test_only_late_timers_are_reset_and_the_executor_is_always_woken() -> None:
    timers = {"early": Timer(5_000_000), "slightly late": Timer(-20_000_000), "cancelled": Timer(None)}
    timers["late"] = Timer(-3_600_000_000_000)
    wakes = threading.Semaphore(0)
    wake = TimerWaker(SimpleNamespace(timers=timers.values()), SimpleNamespace(wake=wakes.release))  # type: ignore[arg-type]
    wake.start()
    for _ in range(3):
        assert wakes.acquire(timeout=30.0)
    wake.stop()
    assert not wake.is_alive()
    assert {name: timer.resets for name, timer in timers.items()} == {**dict.fromkeys(timers, 0), "late": 1}


def test_signals_in_quick_succession_do_not_block_the_handler() -> None:
    """A handler that takes a lock is interrupted by the next signal while it holds the lock."""
    code = (
        "import os, signal, subprocess, sys\n"
        "from dqwalk_ros.nodes import wheels\n"
        "stopped = wheels.init(['controller'])\n"
        "send = f'import os\\nfor _ in range(200_000): os.kill({os.getpid()}, 15); os.kill({os.getpid()}, 2)'\n"
        "sender = subprocess.Popen([sys.executable, '-c', send])\n"
        "while sender.poll() is None:\n"
        "    pass\n"
        "assert stopped\n"
        "wheels.shutdown(None, 0)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=40.0)
