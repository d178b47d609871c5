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
    with pytest.raises(StateError, match=r"stamp is 0\.200 s before the state's, though it has just arrived: .*chrony"):
        sensor.join(*state_at(1_200_000_000))
    with pytest.raises(StateError, match=r"0\.200 s after the state's"):
        sensor.join(*state_at(800_000_000))
    one.clock.now += 0.2
    with pytest.raises(StateError, match=r"no message for 0\.2 s: its driver has stopped, or sends too seldom"):
        sensor.join(*state_at(1_200_000_000))


def test_each_rejected_measurement_is_logged_with_its_reason(make: Any) -> None:
    """Also a single acceleration that is too strong, which is replaced."""
    one = make("integrator", PAPER)
    sensor = InertialSensor(one.node, "imu", InertialGate(3, lambda: 0.1), lambda _: None)
    for k in range(4):
        msg = imu_at(10_000_000 * k)
        msg.linear_acceleration.z = 981.0 if k else 9.81
        one.send("imu", msg)
        sensor.join(*state_at(10_000_000 * k))
    wrong = "imu: an acceleration of 981 m/s^2, where 157 m/s^2 is the most: check its unit"
    said = [text for level, text in one.log.lines if level == "error"]
    assert said == [
        f"imu rejected (1 so far): {wrong}; the last one is used instead",
        f"imu rejected (2 so far): {wrong}; the last one is used instead",
        f"imu rejected (3 so far): {wrong}; the odometry does without",
    ]


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
    with pytest.raises(StateError, match=r"its norm is 0: it estimates no orientation: .*imu_filter_madgwick"):
        ros.inertial_of(imu_at(0, w=0.0))
    with pytest.raises(StateError, match=r"its norm is 1\.01: its driver must normalize it$"):
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
        sensor = InertialSensor(one.node, "imu", InertialGate(3, lambda: 0.1), lambda _: None)
        one.send("imu", imu_at(1, frame=other))
        with pytest.raises(StateError, match=f"it is in the frame '{other}'"):
            sensor.join(*state_at(1))


@pytest.mark.parametrize("frame", ["", "camera"])
def test_messages_of_a_second_sensor_are_ignored(make: Any, frame: str) -> None:
    """They have another frame, or the numbers of a publisher that has begun later."""
    one = make("integrator", PAPER)
    sensor = InertialSensor(one.node, "imu", InertialGate(3, lambda: 0.1), lambda _: None)
    if frame:  # the other one may have begun first
        one.send("imu", imu_at(0, frame=frame, w=0.0, x=1.0), 900)
    for k in range(20):
        one.clock.now += 0.01
        one.send("imu", imu_at(10_000_000 * k, frame="imu"), 100 + k)
        one.send("imu", imu_at(10_000_000 * k, frame=frame, w=0.0, x=1.0), 900 + k if frame else 1 + k)
        joined = sensor.join(*state_at(10_000_000 * k))
        assert joined is not None
        assert joined.up == pytest.approx([0.0, 0.0, 1.0])
    assert "messages of a second sensor are ignored" in one.log
    one.clock.now += 0.2
    if not frame:  # the first one has ended
        one.send("imu", imu_at(400_000_000, w=0.0, x=1.0), 31)
        joined = sensor.join(*state_at(400_000_000))
        assert joined is not None
        assert joined.up == pytest.approx([0.0, 0.0, -1.0])


def test_a_sensor_that_has_begun_at_another_zero_is_named(make: Any) -> None:
    one = make("integrator", PAPER)
    sensor = InertialSensor(one.node, "imu", InertialGate(3, lambda: 0.1), lambda _: None)
    for k, (stamp, turned) in enumerate(((0, 0.0), (500, 0.02), (1000, 0.2))):
        one.send("imu", imu_at(stamp * 1_000_000, w=np.cos(turned), y=np.sin(turned)))
        sensor.join(*state_at(stamp * 1_000_000))
        assert ("its vertical turned by 21 degrees in 0.5 s without a measurement" in one.log) == (k == 2)
