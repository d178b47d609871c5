"""Every decision of `nodes/safety.py` about states and commands, on a test clock."""

from __future__ import annotations

import numpy as np
import pytest
from stepped_time import SteppedTime

from dqwalk_ros.nodes.safety import (
    CommandGate,
    DuplicatePublishers,
    DuplicateStates,
    FaultCounter,
    FirstPublisher,
    JointOrder,
    Watchdog,
)
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.errors import StateError

DT = 0.005
MS = 1_000_000
PERIOD = 5 * MS


# ---------------------------------------------------------------------- names


def test_joints_are_matched_by_name_in_any_order() -> None:
    order = JointOrder(["a", "b"])
    np.testing.assert_array_equal(order(["b", "head", "a"], [2.0, 9.0, 1.0], "position"), [1.0, 2.0])
    np.testing.assert_array_equal(order(["b", "grip", "a", "grip"], [2.0, 9.0, 1.0, 8.0], "position"), [1.0, 2.0])
    np.testing.assert_array_equal(order(["a", "b"], [3.0, 4.0], "position"), [3.0, 4.0])


@pytest.mark.parametrize(
    ("names", "values", "expected"),
    [
        (["a"], [1.0], "joints missing: b"),
        (["a", "c"], [1.0, 2.0], "joints missing: b; it has c"),
        ([], [], "joints missing: a, b"),
        (["a", "b", "a"], [1.0, 2.0, 3.0], "named twice: a"),
        (["a", "b"], [1.0], "2 names, but 1 numbers"),
        (["a", "b"], [1.0, 2.0, 3.0], "2 names, but 3 numbers"),
        (["a", "b"], [1.0, float("nan")], "not a finite position: b = nan"),
        (["a", "b"], [float("-inf"), 1.0], "not a finite position: a = -inf"),
        (["b", "a"], [float("inf"), 1.0], "not a finite position: b = inf"),
    ],
)
def test_wrong_joint_names_and_values_are_rejected_by_name(
    names: list[str], values: list[float], expected: str
) -> None:
    order = JointOrder(["a", "b"])
    order(["a", "b"], [0.0, 0.0], "position")
    with pytest.raises(StateError, match=expected):
        order(names, values, "position")
    np.testing.assert_array_equal(order(["a", "b"], [5.0, 6.0], "position"), [5.0, 6.0])


# ---------------------------------------------------------------------- watchdog and latch


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


# ---------------------------------------------------------------------- commands


def commands_of(model: RobotModel, clock: SteppedTime) -> CommandGate:
    return CommandGate(model, lambda: 0.1, clock)


def test_the_plant_holds_before_the_first_and_after_the_last_command(model: RobotModel, clock: SteppedTime) -> None:
    gate, zero = commands_of(model, clock), np.zeros(model.n)
    assert gate.holding
    assert not gate.velocity(zero, DT).any()
    assert gate.accept(0, np.full(model.n, 0.01), 0)
    np.testing.assert_array_equal(gate.velocity(zero, DT), np.full(model.n, 0.01))
    clock.now += 0.099
    assert not gate.holding
    clock.now += 0.002
    assert gate.holding
    assert not gate.velocity(zero, DT).any()


def test_commands_for_a_wrong_state_are_ignored(model: RobotModel, clock: SteppedTime) -> None:
    gate, u = commands_of(model, clock), np.full(model.n, 0.01)
    now = 1000 * PERIOD
    assert gate.accept(now - PERIOD, u, now)
    assert not gate.accept(now - 2 * PERIOD, 2 * u, now)  # overtaken
    assert not gate.accept(now + 1, 2 * u, now)  # for a state that was never published: a clock fault
    assert gate.late == 2
    np.testing.assert_array_equal(gate.velocity(np.zeros(model.n), DT), u)


def test_commands_stamped_at_sending_are_accepted_until_too_old(model: RobotModel, clock: SteppedTime) -> None:
    gate, u, now = commands_of(model, clock), np.full(model.n, 0.01), 1000 * PERIOD
    sent = 5000 * PERIOD
    assert gate.accept(sent, u, now, clock=sent + 99 * MS)
    assert not gate.accept(sent + PERIOD, u, now, clock=sent + PERIOD + 101 * MS)


def test_commands_delayed_by_200_ms_cause_no_motion(model: RobotModel, clock: SteppedTime) -> None:
    gate, u = commands_of(model, clock), np.full(model.n, 0.01)
    for k in range(1, 200):
        gate.accept(k * PERIOD, u, k * PERIOD + 200 * MS)
        clock.now += DT
        assert gate.holding


def test_ignored_commands_do_not_feed_the_watchdog(model: RobotModel, clock: SteppedTime) -> None:
    gate, u = commands_of(model, clock), np.full(model.n, 0.01)
    gate.accept(100 * PERIOD, u, 100 * PERIOD)
    for _ in range(30):
        clock.now += DT
        gate.accept(50 * PERIOD, u, 100 * PERIOD)
    assert gate.late == 30
    assert gate.holding


def test_after_the_clock_is_set_back_the_plant_goes_on(model: RobotModel, clock: SteppedTime) -> None:
    gate, u = commands_of(model, clock), np.full(model.n, 0.01)
    ahead = 100_000_000_000
    assert gate.accept(ahead, u, ahead)
    clock.now += DT
    assert not gate.accept(ahead - PERIOD, u, ahead)  # an old command
    assert not gate.accept(ahead, u, 2 * PERIOD)  # its state is of the time before
    for k in range(2, 61):
        clock.now += DT
        assert gate.accept(k * PERIOD, u, k * PERIOD)
        assert not gate.accept((k - 1) * PERIOD, u, k * PERIOD)
    assert not gate.holding


def test_a_refusal_holds_despite_commands(model: RobotModel, clock: SteppedTime) -> None:
    gate = commands_of(model, clock)
    gate.refused = "two controllers: a, b"
    gate.accept(0, np.full(model.n, 0.01), 0)
    assert gate.holding
    assert not gate.velocity(np.zeros(model.n), DT).any()


def test_torques_end_with_the_motion(model: RobotModel, clock: SteppedTime) -> None:
    """A drive keeps its last torques by itself."""
    gate, tau = commands_of(model, clock), np.full(model.n, 0.5)
    assert gate.effort is None
    gate.accept(PERIOD, np.zeros(model.n), PERIOD, tau)
    assert gate.effort is tau
    clock.now += 0.11
    assert gate.holding
    assert gate.effort is None
    gate.accept(2 * PERIOD, np.zeros(model.n), 2 * PERIOD, tau)
    gate.refused = "two controllers"
    assert gate.effort is None


def test_hold_discards_the_command(model: RobotModel, clock: SteppedTime) -> None:
    gate = commands_of(model, clock)
    gate.accept(0, np.full(model.n, 0.01), 0)
    gate.hold()
    assert gate.holding


def test_two_publishers_are_reported_at_once_unless_one_may_be_stale(clock: SteppedTime) -> None:
    judge = DuplicatePublishers(clock).judge
    assert judge([]) == judge(["/a"]) == ""
    assert judge(["/b", "/a"]) == "/a, /b"
    unknown = "_NODE_NAMESPACE_UNKNOWN_/_NODE_NAME_UNKNOWN_"  # as rclpy names a node that is not discovered yet
    assert judge([unknown]) == ""
    assert judge([unknown, unknown]) == unknown
    assert judge(["/a", "/a"]) == ""
    clock.now += 24.9
    assert judge(["/a", "/a"]) == ""
    clock.now += 0.2
    assert judge(["/a", "/a"]) == "/a, 2 times"
    assert judge(["/a"]) == ""
    assert judge(["/a", "/a"]) == ""  # the time starts again


def test_joints_in_several_messages_are_named_as_such() -> None:
    """Such as those of a driver for each leg."""
    order = JointOrder(["a", "b"])
    for names, expected in ((["a"], "joints missing: b$"), (["b"], "joints missing: a; other messages have them, but")):
        with pytest.raises(StateError, match=expected):
            order(names, [1.0], "position")


def test_a_message_of_another_publisher_is_told_by_its_number(clock: SteppedTime) -> None:
    source = FirstPublisher(lambda: 0.1, clock)
    assert [source.is_another(number) for number in (50, 51, 1, 55, 2, 54)] == [False, False, True, False, True, True]
    clock.now += 0.2
    assert not source.is_another(3)  # the first one has ended
    assert not source.is_another(4)
    assert [source.is_another(FirstPublisher.unnumbered) for _ in range(3)] == [False] * 3


def test_a_second_plant_is_detected_by_its_messages() -> None:
    def verdict(messages: list[tuple[list[str], int]], publishers: list[str]) -> str:
        judge = DuplicateStates(DT)
        for look in range(1, DuplicateStates.looks + 1):
            for names, stamp in messages:
                judge.note(names, stamp)
            found = judge.judge(publishers)
            assert look == DuplicateStates.looks or found == ""  # one interval is not enough
        return found

    both, one = ["/a", "/b"], [(["x"], k * PERIOD) for k in range(50)]
    assert verdict(one, both) == ""  # the other one publishes other joints
    assert verdict(one, ["/a"]) == ""
    assert verdict(one[::3], both) == ""  # most are lost
    assert verdict([m for m in one for _ in range(2)], both) == "/a, /b"  # more messages than the stamps explain
    assert verdict([(["x"], k * PERIOD) for k in (0, 5, 1, 6, 2, 7, 3, 8)], both) == "/a, /b"  # back and forth
    assert verdict([*one, (["x", "y"], 50 * PERIOD)], both) == "/a, /b"  # another list of joints
    twice = [(["x"], stamp * PERIOD) for stamp in (0, 5, 4, 9, 8, 13)]
    assert verdict(twice, both) == ""  # two states out of order, which is normal


def test_the_rate_of_a_plant_is_measured_while_there_is_only_one() -> None:
    """A plant at twice the expected rate is not reported as two plants."""
    judge = DuplicateStates(2 * DT)
    for publishers in (["/a"], ["/a", "/b"], ["/a", "/b"]):
        for k in range(50):
            judge.note(["x"], k * PERIOD)
        found = judge.judge(publishers)
    assert found == ""


def test_the_plant_is_ready_until_commands_time_out(model: RobotModel, clock: SteppedTime) -> None:
    gate = commands_of(model, clock)
    assert gate.ready  # no command yet
    gate.accept(0, np.zeros(model.n), 0)
    clock.now += 0.099
    assert gate.ready
    clock.now += 0.002
    assert not gate.ready
    gate.accept(PERIOD, np.zeros(model.n), PERIOD)
    assert gate.ready
    gate.refused = "two controllers"
    assert not gate.ready


def test_different_commands_for_one_state_indicate_two_controllers(model: RobotModel, clock: SteppedTime) -> None:
    gate = commands_of(model, clock)
    for k in range(4):
        assert not gate.contradicted
        gate.accept(PERIOD, np.full(model.n, 0.01 * k), PERIOD)
    assert gate.contradicted
    assert gate.holding
    clock.now += 0.99
    assert gate.contradicted
    clock.now += 0.02
    assert not gate.contradicted
