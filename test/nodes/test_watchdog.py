"""Silence and repeated faults, on a test clock."""

from __future__ import annotations

from stepped_time import SteppedTime

from dqwalk_ros.nodes.watchdog import FaultCounter, Watchdog


def test_the_watchdog_measures_silence_by_the_time_of_receipt(clock: SteppedTime) -> None:
    dog = Watchdog(lambda: 0.1, clock)
    assert dog.silent  # no message yet
    dog.feed()
    clock.now += 0.0999
    assert not dog.silent
    clock.now += 0.0002
    assert dog.silent
    dog.feed()
    assert not dog.silent
    dog.starve()
    assert dog.silent


def test_the_fault_counter_latches_after_consecutive_faults_until_reset() -> None:
    latch = FaultCounter(3)
    assert not latch.fault("x")
    assert not latch.fault("x")
    latch.good()
    assert not latch.fault("x")
    assert not latch.fault("x")
    assert latch.fault("third")
    latch.good()
    assert latch
    assert latch.reason == "third"
    latch.reset()
    assert not latch
