"""A fall ends the walk, because motion of a robot on the floor can damage it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from inside import state
from std_srvs.srv import Trigger

from dqwalk_ros.config import load, overlaid
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.plants.base import Inertial, upward
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.simulation import make_plant, make_walk

CONFIG = overlaid(load("poppy"), "physics")
MODEL = load_model(CONFIG.robot)


def tilted(angle: float, axis: str) -> Inertial:
    """Return the IMU data of a pelvis tilted by an angle [rad] about an axis."""
    half = math.sin(0.5 * angle)
    quaternion = [math.cos(0.5 * angle), half * (axis == "x"), half * (axis == "y"), 0.0]
    return Inertial(np.array(quaternion), np.zeros(3), np.array([0.0, 0.0, 9.81]))


def send_state(node: Any, q: Any, stamp: float, imu: Inertial) -> None:
    node.send("imu", ros.imu(round(stamp * 1e9), MODEL.imu, imu))
    node.send("joint_states", state(MODEL.joint_names, q, stamp, velocity=np.zeros(MODEL.n)))


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_pelvis_tilted_too_far_ends_the_walk(make: Any, axis: str, side: float) -> None:
    """The other checks, of soles and gyroscope, are disabled by their limits."""
    node = make("controller", CONFIG.updated({"safety.sole_tilt": 1.5, "safety.contradiction": 3.0}))
    q = make_walk(CONFIG, MODEL).posture
    for k in range(20):
        send_state(node, q, 1.0 + 0.005 * k, tilted(side * 0.45, axis) if k > 10 else tilted(0.0, axis))
    assert any(node.got["joint_velocity_commands"][-1].velocity)
    send_state(node, q, 1.1, tilted(side * 0.55, axis))
    assert not any(node.got["joint_velocity_commands"][-1].velocity)
    assert node.got["phase"][-1].data == "fallen"
    status = node.got["diagnostics"][-1].status[0]
    assert status.level == b"\x02"
    assert "the robot has fallen: its pelvis leans by 32 deg" in status.message
    for service in ("start", "reset"):
        answer = node.call(service, Trigger.Request())
        assert not answer.success
    assert "put it on its feet first" in answer.message
    send_state(node, q, 1.105, tilted(0.0, axis))  # upright again, but not reset
    assert not any(node.got["joint_velocity_commands"][-1].velocity)
    assert node.call("reset", Trigger.Request()).success
    assert node.call("start", Trigger.Request()).success
    send_state(node, q, 1.2, tilted(0.0, axis))
    send_state(node, q, 1.205, tilted(0.0, axis))
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
    message = node.got["diagnostics"][-1].status[0].message
    assert "it fell because: the divergent component left the soles at " in message  # the push is not recorded
