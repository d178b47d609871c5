"""Values of messages, by the names of joints."""

from __future__ import annotations

import numpy as np
import pytest

from dqwalk_ros.nodes.joint_order import JointOrder
from dqwalk_ros.support.errors import StateError


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


def test_joints_in_several_messages_are_named_as_such() -> None:
    """Such as those of a driver for each leg."""
    order = JointOrder(["a", "b"])
    for names, expected in ((["a"], "joints missing: b$"), (["b"], "joints missing: a; other messages have them, but")):
        with pytest.raises(StateError, match=expected):
            order(names, [1.0], "position")
