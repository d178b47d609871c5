"""A fall ends the walk, because motion of a robot on the floor can damage it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from inside import state
from rclpy.serialization import serialize_message
from std_srvs.srv import Trigger

from dqwalk_ros.config import load, overlaid
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.paper.state import State
from dqwalk_ros.plants.base import Inertial, orientation_of, upward
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.walks.table import make_walk

CONFIG = overlaid(load("poppy"), "physics")
MODEL = load_model(CONFIG.robot)


def tilted(angle: float, axis: str, rate: float = 0.0) -> Inertial:
    """Return the IMU data of a pelvis tilted by an angle [rad] about an axis, which turns about it [rad/s]."""
    half, along = math.sin(0.5 * angle), np.array([axis == "x", axis == "y", 0.0], float)
    return Inertial(np.array([math.cos(0.5 * angle), *half * along]), rate * along, np.array([0.0, 0.0, 9.81]))


def upright_of(now: State) -> Inertial:
    """Return the IMU data of a state; the yaw is not known."""
    return Inertial(orientation_of(now.up), now.gyro, np.zeros(3))


def send_state(node: Any, q: Any, stamp: float, imu: Inertial) -> None:
    node.send("imu", ros.imu(round(stamp * 1e9), MODEL.imu, imu))
    node.send("joint_states", state(MODEL.joint_names, q, stamp, velocity=np.zeros(MODEL.n)))


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_pelvis_tilted_too_far_ends_the_walk(make: Any, axis: str, side: float) -> None:
    """The other checks, of soles and gyroscope, are disabled by their limits."""
    node = make("controller", CONFIG.updated({"safety.sole_tilt": 1.5, "safety.contradiction": 3.0}))
    q = make_walk(CONFIG, MODEL).posture
    rate = 5.0
    for k in range(20):
        send_state(node, q, 1.0 + 0.005 * k, tilted(side * 0.005 * rate * k, axis, side * rate * (k > 0)))
    assert any(node.got["joint_velocity_commands"][-1].velocity)
    for k in (20, 21, 22):
        send_state(node, q, 1.0 + 0.005 * k, tilted(side * 0.005 * rate * k, axis, side * rate))
    assert not any(node.got["joint_velocity_commands"][-1].velocity)
    assert node.got["phase"][-1].data == "fallen"
    status = node.got["diagnostics"][-1].status[0]
    assert status.level == b"\x02"
    assert "the robot has fallen: its pelvis leans by 29 deg" in status.message
    for service in ("start", "reset"):
        answer = node.call(service, Trigger.Request())
        assert not answer.success
    assert "put it on its feet first" in answer.message
    node.clock.now += 0.2
    send_state(node, q, 1.3, tilted(0.0, axis))  # upright again, but not reset
    assert not any(node.got["joint_velocity_commands"][-1].velocity)
    assert node.call("reset", Trigger.Request()).success
    assert node.call("start", Trigger.Request()).success
    send_state(node, q, 1.305, tilted(0.0, axis))
    send_state(node, q, 1.310, tilted(0.0, axis))
    assert any(node.got["joint_velocity_commands"][-1].velocity)


def test_tipping_about_the_edge_of_the_sole_is_a_fall(make: Any) -> None:
    """The IMU rotates and the joints do not: a tilt of 12 degrees is detected."""
    node = make("controller", CONFIG)
    q, rate = make_walk(CONFIG, MODEL).posture, 0.8
    for k in range(200):
        imu = tilted(0.005 * rate * k, "x")
        send_state(node, q, 1.0 + 0.005 * k, Inertial(imu.orientation, np.array([rate, 0.0, 0.0]), imu.acceleration))
        if node.got["phase"][-1].data == "fallen":
            break
    assert 0.18 < 0.005 * rate * k < 0.24
    assert "sole leans by 1" in node.got["diagnostics"][-1].status[0].message
    assert not any(node.got["joint_velocity_commands"][-1].velocity)


@pytest.mark.parametrize(
    "direction", [0, *(pytest.param(k, marks=pytest.mark.long) for k in range(1, 20))], ids=lambda k: f"{18 * k} deg"
)
def test_commands_are_zero_after_a_push_that_fells_the_robot(make: Any, direction: int) -> None:
    """In physics: every command is zero from 0.3 to 1.3 s after a pelvis tilt of 40 degrees; -s prints the times."""
    node = make("controller", CONFIG)
    plant = make_plant("physics", CONFIG, MODEL)
    dt, tilted_at, last_command = CONFIG.dt, None, 0.0
    for k in range(1200):
        if tilted_at is not None and k * dt > tilted_at + 1.3:
            break
        u = node.exchange(plant, MODEL, 1.0 + k * dt)
        last_command = k * dt if u.any() else last_command
        if tilted_at is not None and k * dt > tilted_at + 0.3:
            assert not u.any()
        if k * dt >= 2.0:
            angle = math.radians(18.0 * direction)
            force = 30.0 * np.array([math.cos(angle), math.sin(angle), 0.0]) if k * dt < 2.2 else np.zeros(3)
            plant.push(force)
        if tilted_at is None and upward(*plant.inertial.orientation)[2] < math.cos(math.radians(40.0)):
            tilted_at = k * dt
    assert tilted_at is not None
    print(
        f"\n{18 * direction} deg: the last command {tilted_at - last_command:.2f} s before the pelvis tilts by 40 deg"
    )
    assert node.got["phase"][-1].data == "fallen"


def test_an_imu_in_ned_is_named(make: Any) -> None:
    node = make("controller", CONFIG)
    for k in range(3):
        send_state(node, make_walk(CONFIG, MODEL).posture, 1.0 + 0.005 * k, tilted(math.pi, "x"))
    message = node.got["diagnostics"][-1].status[0].message
    assert "leans by 180 deg: is the imu's frame NED (z down), or is its quaternion in the order w, x, y, z?" in message
    assert not any(node.got["joint_velocity_commands"][-1].velocity)


def test_the_monitor_names_the_cause_of_a_fall(make: Any) -> None:
    """Outside of the control loop, from the topics of the last seconds."""
    config = CONFIG.updated({"gait.recover": "", "standing.transfer_duration": 0.5})
    controller, monitor = make("controller", config), make("phase_monitor", config)
    plant, time = make_plant("physics", config, MODEL), 0.0
    sent: dict[str, int] = {}
    topics = ("walk_config", "robot_description", "phase_start", "com_target", "swing_target", "phase")

    def forward(*names: str) -> None:
        """Pass the new messages of the controller to the monitor."""
        for name in names:
            for msg in controller.got.get(name, [])[sent.get(name, 0) :]:
                monitor.send(name, msg)
            sent[name] = len(controller.got.get(name, []))

    foreign = state(["a_hand"], [0.0], 1.0)  # no command of this robot hides those after it
    for raw in {s.callback for s in monitor.node.subscriptions if s.topic_name == "/joint_velocity_commands"}:
        raw(serialize_message(foreign))
    while (controller.got["phase"][-1:] != [] and controller.node._mode.value == "walking") or not time:
        now = plant.state
        controller.exchange(plant, MODEL, 1.0 + time)
        for topic, msg in (
            ("imu", ros.imu(round((1.0 + time) * 1e9), MODEL.imu, upright_of(now))),
            ("joint_velocity_commands", controller.got["joint_velocity_commands"][-1]),
            ("joint_states", state(MODEL.joint_names, now.q, 1.0 + time)),
        ):
            for raw in {s.callback for s in monitor.node.subscriptions if s.topic_name == f"/{topic}"}:
                raw(serialize_message(msg))
        forward(*topics)
        time += config.dt
        assert time < 6.0
    assert controller.got["phase"][-1].data == "fallen"
    monitor.node._check_timeout()
    assert "it fell because" not in monitor.log  # the last messages are awaited
    monitor.clock.now += 5.0
    monitor.node._check_timeout()
    expected = "it fell because: the path of the CoM requires a centre of pressure beyond the soles"
    assert expected in monitor.log
    assert any(expected in msg.status[0].message for msg in monitor.got["diagnostics"])
    assert "because" not in controller.log
