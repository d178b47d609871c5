"""The input of force sensors in the feet, in the test's process."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from inside import state

from dqwalk_ros.config import load
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.errors import ConfigError

CONFIG = load("paper").updated({"plant.foot_force": True})
MODEL = load_model(CONFIG.robot)
MS = 1_000_000


def wrench_at(stamp: int, x: float, y: float, z: float) -> WrenchStamped:
    msg = WrenchStamped()
    msg.header.stamp = ros.time_msg(stamp)
    msg.wrench.force.x, msg.wrench.force.y, msg.wrench.force.z = x, y, z
    return msg


def test_measured_forces_are_the_loads_of_the_walk(make: Any) -> None:
    """Whatever axes and sign the sensors have."""
    one = make("controller", CONFIG)
    one.send("left_foot_wrench", wrench_at(1000 * MS, 0.0, 0.0, -20.0))
    one.send("right_foot_wrench", wrench_at(1000 * MS, 3.0, 4.0, 0.0))
    one.send("joint_states", state(MODEL.joint_names, np.zeros(MODEL.n), 1.0))
    assert one.node._controller.loads == pytest.approx([20.0, 5.0])


def test_old_missing_and_impossible_forces_are_not_used(make: Any) -> None:
    one = make("controller", CONFIG)
    feet = one.node._feet
    assert feet.at(0) is None
    feet._on_wrench(0, wrench_at(1000 * MS, 0.0, 0.0, 20.0))
    assert feet.at(1000 * MS) is None  # only one foot
    unused = "the forces of the feet are not used: "
    arrived = "though it has just arrived: stamp both with the time of the measurement, by one clock (chrony)"
    assert one.node._condition()[:2] == ("WARN", f"{unused}right_foot_wrench: no message yet")
    feet._on_wrench(1, wrench_at(1000 * MS, 0.0, 0.0, 6.0))
    assert list(feet.at(1090 * MS)) == [20.0, 6.0]
    assert one.node._condition()[0] == "OK"
    assert feet.at(1110 * MS) is None
    assert feet.warning == f"{unused}left_foot_wrench: its stamp is 0.110 s before the state's, {arrived}"
    assert f"{unused}left_foot_wrench: no message yet" in one.log
    for wrong in (math.nan, math.inf):
        feet._on_wrench(0, wrench_at(1050 * MS, wrong, wrong, wrong))
    assert list(feet.at(1000 * MS)) == [20.0, 6.0]


def test_lockstep_is_refused(make: Any) -> None:
    with pytest.raises(ConfigError, match=r"plant.foot_force.*lockstep"):
        make("controller", CONFIG.updated({"plant.lockstep": True}))
