"""A thread resets timers that are late, and only those."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: source one, or pip install '.[ros]'")

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


def test_stop_before_start_has_no_effect() -> None:
    TimerWaker(SimpleNamespace(timers=()), None).stop()  # type: ignore[arg-type]
