"""The input of the inertial sensor, which joins its messages to the states of the joints, in the test's process."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Vector3
from sensor_msgs.msg import Imu, JointState

from dqwalk_ros.config import load
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.inertial_gate import InertialGate
from dqwalk_ros.nodes.inertial_sensor import InertialSensor
from dqwalk_ros.paper.state import State
from dqwalk_ros.support.errors import StateError

PAPER = load("paper")


def imu_at(stamp: int, *, frame: str = "", **fields: float) -> Imu:
    msg = Imu()
    msg.header.stamp, msg.header.frame_id = ros.time_msg(stamp), frame
    for name, value in fields.items():
        setattr(msg.orientation, name, value)
    return msg


def state_at(stamp: int) -> tuple[JointState, State]:
    msg = JointState()
    msg.header.stamp = ros.time_msg(stamp)
    return msg, State(1e-9 * stamp, np.zeros(1))


def test_in_lockstep_a_state_waits_for_the_imu_of_its_stamp(make: Any) -> None:
    one, again = make("integrator", PAPER.updated({"plant.lockstep": True})), []
    sensor = InertialSensor(one.node, "imu", InertialGate(3, lambda: 0.1), again.append)
    msg, state = state_at(5_000_000)
    one.send("imu", imu_at(0))
    assert sensor.join(msg, state) is None
    one.send("imu", imu_at(5_000_000, w=0.0, x=1.0))
    assert again == [msg]
    joined = sensor.join(msg, state)
    assert joined is not None
    assert joined.up == pytest.approx([0.0, 0.0, -1.0])  # upside down


def test_in_real_time_the_newest_imu_message_is_used_until_too_old(make: Any) -> None:
    one = make("integrator", PAPER)
    sensor = InertialSensor(one.node, "imu", InertialGate(3, lambda: 0.1), lambda _: None)
    assert sensor.join(*state_at(0)) is None
    one.clock.now += 0.2
    with pytest.raises(StateError, match="no message yet"):
        sensor.join(*state_at(0))  # by the time of receipt: the stamps may stand still
    one.send("imu", imu_at(1_000_000_000))
    joined = sensor.join(*state_at(1_050_000_000))
    assert joined is not None
    assert joined.up == pytest.approx([0.0, 0.0, 1.0])
    with pytest.raises(StateError, match=r"0\.200 s away"):
        sensor.join(*state_at(1_200_000_000))


def test_an_invalid_imu_message_is_refused(make: Any) -> None:
    one = make("integrator", PAPER.updated({"plant.lockstep": True}))
    sensor = InertialSensor(one.node, "imu", InertialGate(3, lambda: 0.1), lambda _: None)
    for bad, why in (
        (imu_at(0, frame="imu_link"), "it is in the frame 'imu_link', and robot.imu is 'imu'"),
        (imu_at(0, w=0.0), "unit quaternion"),
        (imu_at(0, x=float("nan")), "unit quaternion"),
        (Imu(angular_velocity=Vector3(x=float("inf"))), "angular velocity is not finite"),
        (Imu(orientation_covariance=[-1.0] + [0.0] * 8), "no orientation"),
        (Imu(angular_velocity_covariance=[-1.0] + [0.0] * 8), "no angular velocity"),
    ):
        one.send("imu", bad)
        with pytest.raises(StateError, match=why):
            sensor.join(*state_at(0))


def test_the_error_of_an_imu_message_names_what_is_wrong() -> None:
    """A sensor without a fusion publishes a quaternion of zeros."""
    with pytest.raises(StateError, match="its norm is 0: it estimates no orientation"):
        ros.inertial_of(imu_at(0, w=0.0))
    with pytest.raises(StateError, match=r"its norm is 1\.01$"):
        ros.inertial_of(imu_at(0, w=1.01))
    msg = imu_at(0)
    msg.angular_velocity.y = float("nan")
    with pytest.raises(StateError, match=r"^imu: its angular velocity is not finite: 0, nan, 0 rad/s$"):
        ros.inertial_of(msg)


@pytest.mark.parametrize("frame", ["", "imu", "/imu", "robot1/imu", "a/b/imu"])
def test_the_frame_of_the_imu_may_have_a_prefix(make: Any, frame: str) -> None:
    one = make("integrator", PAPER.updated({"plant.lockstep": True}))
    sensor = InertialSensor(one.node, "imu", InertialGate(3, lambda: 0.1), lambda _: None)
    one.send("imu", imu_at(0, frame=frame))
    assert sensor.join(*state_at(0)) is not None
    for other in ("robot1/imu_link", "imu/pelvis", "robot1imu"):
        one.send("imu", imu_at(1, frame=other))
        with pytest.raises(StateError, match=f"it is in the frame '{other}'"):
            sensor.join(*state_at(1))
