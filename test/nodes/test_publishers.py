"""Several publishers on a topic that must have one."""

from __future__ import annotations

from types import SimpleNamespace

from stepped_time import SteppedTime

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.publishers import UNKNOWN, DuplicatePublishers, DuplicateStates, FirstPublisher

DT = 0.005
MS = 1_000_000
PERIOD = 5 * MS


def test_two_publishers_are_reported_at_once_unless_one_may_be_stale(clock: SteppedTime) -> None:
    judge = DuplicatePublishers(clock).judge
    assert judge([]) == judge(["/a"]) == ""
    assert judge(["/b", "/a"]) == "/a, /b"
    assert judge([UNKNOWN]) == ""
    assert judge([UNKNOWN, UNKNOWN]) == UNKNOWN
    assert judge(["/a", "/a"]) == ""
    clock.now += 24.9
    assert judge(["/a", "/a"]) == ""
    clock.now += 0.2
    assert judge(["/a", "/a"]) == "/a, 2 times"
    assert judge(["/a"]) == ""
    assert judge(["/a", "/a"]) == ""  # the time starts again


def test_a_node_that_is_not_discovered_yet_has_a_name_that_can_be_read() -> None:
    """In "two controllers: ..." rclpy's own name reads as an error of this package."""
    ends = [("/", "a"), ("/robot", "b"), ("_NODE_NAMESPACE_UNKNOWN_", "_NODE_NAME_UNKNOWN_")]
    names = [ros.node_of(SimpleNamespace(node_namespace=where, node_name=name)) for where, name in ends]
    assert names == ["/a", "/robot/b", "a node that is being discovered"]


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
