"""Silence and repeated faults, on a test clock."""

from __future__ import annotations

from stepped_time import SteppedTime

from dqwalk_ros.nodes.watchdog import ClockSteps, FaultCounter, Watchdog


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


def test_three_advancing_stamps_at_another_time_tell_that_a_clock_was_set() -> None:
    steps, near = ClockSteps(), 10
    for stamp, counts in ((1, True), (90, False), (2, True), (90, False), (91, False), (92, True), (93, True)):
        follows = abs(stamp - near) <= 10
        assert steps.accepts(stamp, follows=follows) is counts
        near = stamp if counts else near
    for stamp, counts in ((30, False), (20, False), (25, False), (25, False), (26, False), (27, True)):
        assert steps.accepts(stamp, follows=False) is counts
