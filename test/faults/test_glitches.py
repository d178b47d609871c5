"""Single impossible measurements, at many moments of a walk in physics: each is rejected, counted and named."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from inside import state, values
from sensor_msgs.msg import Imu, JointState
from std_srvs.srv import Trigger

from dqwalk_ros.config import Config, load, overlaid
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.state import Command
from dqwalk_ros.plants.base import Inertial
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.robot.model import load_model

SENSORS = {
    "sensors.attitude_noise": 0.004,
    "sensors.gyro_noise": 0.02,
    "sensors.encoder": 0.001534,
    "sensors.velocity_filter": 0.01,
}
DYNAMIC = overlaid(load("poppy_dynamic"), "physics").updated({**SENSORS, "qp.solver": "daqp"})
STANDING = overlaid(load("poppy"), "physics").updated({**SENSORS, "qp.solver": "daqp"})
MODEL = load_model(DYNAMIC.robot)
BEGIN = 0.6
"""When the first glitch occurs [s]."""


def turned(axis: int, degrees: float) -> Callable[[Inertial], Inertial]:
    half = 0.5 * math.radians(degrees)
    turn = DQ(np.array([math.cos(half), *(math.sin(half) * np.eye(3)[axis])]))
    return lambda felt: dataclasses.replace(felt, orientation=(DQ(felt.orientation) * turn).vec4())


IMU: dict[str, Callable[[Inertial], Inertial]] = {
    "20 degrees to the side": turned(0, 20.0),
    "20 degrees back": turned(1, -20.0),
    "gyro": lambda felt: dataclasses.replace(felt, gyro=np.array([0.0, 100.0, 0.0])),
    "no orientation": lambda felt: dataclasses.replace(felt, orientation=np.zeros(4)),
    "absurd": lambda felt: dataclasses.replace(felt, gyro=np.full(3, 1e300), acceleration=np.full(3, 1e30)),
    "not a number": lambda felt: dataclasses.replace(felt, gyro=np.full(3, np.nan)),
    "upside down": turned(0, 180.0),
    "gyro of 10 rad/s": lambda felt: dataclasses.replace(felt, gyro=felt.gyro + np.array([10.0, 0.0, 0.0])),
}


def test_a_clock_that_is_set_does_not_move_the_odometry(make: Any) -> None:
    """An estimate that integrates an acceleration for the step of the clock is 5 cm off after 0.3 s."""
    config = DYNAMIC.updated({"plant.lockstep": False})
    node, plant = make("controller", config), make_plant("physics", config, MODEL)
    places, velocities = [], []
    for k in range(90):
        node.exchange(plant, MODEL, 100.0 + k * config.dt + (0.3 if k >= 70 else 0.0))
        places.append(node.node._odometry._last.translation())
        velocities.append(node.node._odometry._velocity()[:3])
    assert "a clock was set" in node.log
    assert np.abs(np.diff(places, axis=0)).max() < 2e-3
    assert np.abs(velocities[20:]).max() < 0.3


def velocity(speed: float) -> Callable[[JointState], list[JointState]]:
    def glitch(msg: JointState) -> list[JointState]:
        msg.velocity[3] = speed
        return [msg]

    return glitch


def angle(off: float) -> Callable[[JointState], list[JointState]]:
    def glitch(msg: JointState) -> list[JointState]:
        msg.position[4] += off
        return [msg]

    return glitch


def doubled(msg: JointState) -> list[JointState]:
    """Return the state, and another one 2 us after it, one step of the encoder further."""
    moved = [x + 0.001534 for x in msg.position]
    again = state(msg.name, moved, 1e-9 * (ros.nanoseconds(msg.header.stamp) + 2000))
    return [msg, again]


JOINTS: dict[str, Callable[[JointState], list[JointState]]] = {
    "velocity of 100 rad/s": velocity(100.0),
    "velocity of 1e300 rad/s": velocity(1e300),
    "velocity of -15 rad/s": velocity(-15.0),
    "angle off by 1.5 rad": angle(1.5),
    "angle off by -0.2 rad": angle(-0.2),
    "angle of 1e300 rad": angle(1e300),
    "two states in 2 us": doubled,
}


class Walk:
    """A walk of which some messages are wrong.

    Attributes
    ----------
    rejected : int
        Number of wrong messages so far.
    largest, change : float
        Largest torque commanded, and its largest change in a period, in units of the joint's limit.
    """

    def __init__(self, make: Any, config: Config) -> None:
        self.node, self.plant, self.config = make("controller", config), make_plant("physics", config, MODEL), config
        self.sent = self.node.got["joint_velocity_commands"]
        self.glitches = 0
        self.largest = self.change = self.time = 0.0
        self._tau = np.zeros(MODEL.n)

    def walk(self, seconds: float, every: float, glitch: Callable[[Imu, JointState], list[JointState]]) -> None:
        """Walk, with a glitch of the messages at regular times."""
        dt, end, due = self.config.dt, self.time + seconds, max(self.time, BEGIN)
        while self.time < end - 1e-9 and self.node.node._mode.value == "walking":
            now = self.plant.state
            felt, states = ros.imu(self._stamp, MODEL.imu, self.plant.inertial), [self._state(now)]
            if self.time >= due - 1e-9:
                due, self.glitches = due + every, self.glitches + 1
                states = glitch(felt, states[0])
            self.node.clock.now += dt
            self.node.send("imu", felt)
            for msg in states:
                self.node.send("joint_states", msg)
            answer = self.sent[-1]
            command = Command(self.time, np.array(answer.velocity), np.array(answer.effort) if answer.effort else None)
            if command.effort is not None:
                self.largest = max(self.largest, float((np.abs(command.effort) / MODEL.effort_max).max()))
                change = float((np.abs(command.effort - self._tau) / MODEL.effort_max).max())
                self.change, self._tau = max(self.change, change), command.effort
            self.plant.step(command, dt)
            self.time += dt

    @property
    def _stamp(self) -> int:
        return round((1.0 + self.time) * 1e9)

    def _state(self, now: Any) -> JointState:
        return state(MODEL.joint_names, now.q, 1e-9 * self._stamp, velocity=now.dq)

    def check(self) -> None:
        """Check that the robot walks on, and its torques stay within their limits."""
        status = self.node.got["diagnostics"][-1].status[0]
        assert self.node.node._mode.value == "walking", (self.time, self.glitches, status.message)
        assert not self.plant.fallen
        assert 0.0 < self.largest <= 1.0 + 1e-12
        assert self.change <= 1.0 + 1e-12
        print(f"{self.glitches} of {self.glitches} walk on; torques at most {self.largest:.2f} of their limits")


def check_imu(make: Any, config: Config, seconds: float, every: float) -> None:
    """Walk with one glitch of the imu after the other; all are rejected."""
    walk, kinds = Walk(make, config), itertools.cycle(IMU.values())

    def glitch(msg: Imu, joints: JointState) -> list[JointState]:
        """Replace the imu message by a wrong one."""
        wrong = ros.imu(ros.nanoseconds(msg.header.stamp), MODEL.imu, next(kinds)(walk.plant.inertial))
        msg.orientation, msg.angular_velocity = wrong.orientation, wrong.angular_velocity
        msg.linear_acceleration = wrong.linear_acceleration
        return [joints]

    walk.walk(seconds, every, glitch)
    walk.check()
    assert walk.node.node._gate.inertial.rejected >= walk.glitches
    walk.node.node._diagnose()
    assert int(values(walk.node.got["diagnostics"][-1].status[0])["imu rejected"]) >= walk.glitches
    for named in (
        "vertical of the inertial sensor jumped by 20 degrees",
        "turns at 100 rad/s",
        "not a unit quaternion",
    ):
        assert named in walk.node.log
    assert "sole leans" not in walk.node.log


def check_joints(make: Any, config: Config, seconds: float, every: float) -> None:
    """Walk with one glitch of the joints after the other; all are rejected."""
    walk, kinds = Walk(make, config), itertools.cycle(JOINTS.values())
    walk.walk(seconds, every, lambda _, joints: next(kinds)(joints))
    walk.check()
    gate = walk.node.node._gate
    assert walk.node.node._rejected + gate.overtaken == walk.glitches
    for named in (
        f"{MODEL.joint_names[3]} 100 rad/s",
        "jump that the velocity limits do not allow",
        "outside the joint limits",
    ):
        assert named in walk.node.log


def test_single_wrong_messages_of_the_imu_do_not_end_a_dynamic_walk(make: Any) -> None:
    check_imu(make, DYNAMIC, BEGIN + 0.8, 0.1)


def test_single_wrong_states_of_the_joints_do_not_end_a_dynamic_walk(make: Any) -> None:
    check_joints(make, DYNAMIC, BEGIN + 0.7, 0.1)


@pytest.mark.long
@pytest.mark.parametrize("check", [check_imu, check_joints])
@pytest.mark.parametrize("seed", [1, 2])
def test_wrong_messages_in_each_of_200_moments_of_a_dynamic_walk(make: Any, check: Any, seed: int) -> None:
    """Their period is no part of that of the steps, so that each phase is hit at many times."""
    config = DYNAMIC.updated({"gait.steps": 64, "sensors.seed": seed})
    check(make, config, BEGIN + 200 * 0.155 - 0.01, 0.155)


@pytest.mark.long
@pytest.mark.parametrize("check", [check_imu, check_joints])
def test_wrong_messages_do_not_end_a_standing_walk(make: Any, check: Any) -> None:
    check(make, STANDING, 10.0, 0.135)


@pytest.mark.parametrize("dq", [True, False])
def test_torques_stay_within_their_limits_whatever_is_measured(make: Any, dq: bool) -> None:
    """Also where velocities are differences: one step of an encoder in 2 us would be 750 rad/s."""
    walk = Walk(make, DYNAMIC)

    def glitch(_: Imu, msg: JointState) -> list[JointState]:
        msg.velocity = [v + 0.99 * MODEL.velocity_max[0] for v in msg.velocity] if dq else []
        return [msg] if dq else doubled(msg)

    walk.walk(BEGIN + 0.2, 0.02, glitch)
    assert walk.glitches >= 10
    assert 0.0 < walk.largest <= 1.0 + 1e-12
    assert walk.change <= 1.0 + 1e-12


@pytest.mark.parametrize("kind", ["gyro", *(pytest.param(k, marks=pytest.mark.long) for k in IMU if k != "gyro")])
def test_three_wrong_messages_of_the_imu_in_a_row_end_the_walk_with_its_name(make: Any, kind: str) -> None:
    walk = Walk(make, STANDING)

    def glitch(msg: Imu, joints: JointState) -> list[JointState]:
        wrong = ros.imu(ros.nanoseconds(msg.header.stamp), MODEL.imu, IMU[kind](walk.plant.inertial))
        msg.orientation, msg.angular_velocity = wrong.orientation, wrong.angular_velocity
        return [joints]

    walk.walk(BEGIN + 0.1, STANDING.dt, glitch)
    assert walk.node.node._mode.value == "failed"
    assert walk.glitches == 3
    message = walk.node.got["diagnostics"][-1].status[0].message
    assert "inertial sensor" in message or "imu" in message
    assert "3 in a row" in message
    assert not any(walk.sent[-1].velocity)
    assert not walk.node.call("start", Trigger.Request()).success
    assert walk.node.call("reset", Trigger.Request()).success


def test_odometry_never_ends_a_walk(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """An accelerometer that contradicts the legs is named, and the legs say where the robot is."""
    walk = Walk(make, DYNAMIC)

    def glitch(msg: Imu, joints: JointState) -> list[JointState]:
        msg.linear_acceleration.y += 100.0
        return [joints]

    odometry = walk.node.node._odometry
    walk.walk(2.5, DYNAMIC.dt, glitch)
    walk.check()
    assert "odometry: the accelerometer contradicts the legs: is its acceleration in m/s^2" in walk.node.log
    assert "the pose is that of the legs alone" in walk.node.log
    assert abs(odometry._last.translation()[0]) < 0.4
    assert np.abs(odometry._last.translation()[1:]).max() < 0.5

    def fail(*_: Any, **__: Any) -> None:
        raise np.linalg.LinAlgError("singular")

    odometry.restart()
    monkeypatch.setattr(type(odometry._estimator), "update", fail)
    walk.walk(0.1, 1.0, lambda _, joints: [joints])
    walk.check()
