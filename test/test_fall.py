"""A fall ends the walk, because commands to a robot that lies on the floor only do damage."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: source one, or pip install '.[ros]'")

from inside import inside, state
from std_srvs.srv import Trigger

from dqwalk_ros.cli.options import overlaid
from dqwalk_ros.config import load
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.plants import Inertial, upward
from dqwalk_ros.robot import load_model
from dqwalk_ros.simulation import make_plant, make_walk
from dqwalk_ros.standing.walk import StandingWalk
from dqwalk_ros.state import Command

CONFIG = overlaid(load("poppy"), "physics")
MODEL = load_model(CONFIG.robot)


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Any]:
    with inside(tmp_path) as made:
        yield made


def leaning(angle: float, axis: str) -> Inertial:
    """Return what the sensor of a pelvis says that leans by an angle [rad]."""
    half = math.sin(0.5 * angle)
    turned = [math.cos(0.5 * angle), half * (axis == "x"), half * (axis == "y"), 0.0]
    return Inertial(np.array(turned), np.zeros(3), np.array([0.0, 0.0, 9.81]))


def tell(node: Any, q: Any, stamp: float, said: Inertial) -> None:
    node.send("imu", ros.imu(round(stamp * 1e9), MODEL.imu, said))
    node.send("joint_states", state(MODEL.joint_names, q, stamp, velocity=np.zeros(MODEL.n)))


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_pelvis_that_leans_too_far_ends_the_walk(make: Any, axis: str, side: float) -> None:
    """Nothing else is looked at here, such as the soles and what the gyroscope says."""
    node = make("controller", CONFIG.updated({"safety.sole_tilt": 1.5, "safety.contradiction": 3.0}))
    q = make_walk(CONFIG, MODEL).posture
    for k in range(20):
        tell(node, q, 1.0 + 0.005 * k, leaning(side * 0.45, axis) if k > 10 else leaning(0.0, axis))
    assert any(node.got["joint_velocity_commands"][-1].velocity)
    tell(node, q, 1.1, leaning(side * 0.55, axis))
    assert not any(node.got["joint_velocity_commands"][-1].velocity)
    assert node.got["phase"][-1].data == "fallen"
    status = node.got["diagnostics"][-1].status[0]
    assert status.level == b"\x02"
    assert "the robot has fallen: its pelvis leans by 32 deg" in status.message
    for service in ("start", "reset"):
        answer = node.call(service, Trigger.Request())
        assert not answer.success
    assert "put it on its feet first" in answer.message
    tell(node, q, 1.105, leaning(0.0, axis))  # it lies no longer, and still nobody has said that it may walk
    assert not any(node.got["joint_velocity_commands"][-1].velocity)
    assert node.call("reset", Trigger.Request()).success
    assert node.call("start", Trigger.Request()).success
    tell(node, q, 1.2, leaning(0.0, axis))
    tell(node, q, 1.205, leaning(0.0, axis))
    assert any(node.got["joint_velocity_commands"][-1].velocity)


def test_a_robot_that_tips_about_the_edge_of_its_sole_falls(make: Any) -> None:
    """The inertial sensor turns and the joints do not: 12 degrees are noticed, long before the pelvis lies."""
    node = make("controller", CONFIG)
    q, rate = make_walk(CONFIG, MODEL).posture, 0.8
    for k in range(200):
        said = leaning(0.005 * rate * k, "x")
        tell(node, q, 1.0 + 0.005 * k, Inertial(said.orientation, np.array([rate, 0.0, 0.0]), said.acceleration))
        if node.got["phase"][-1].data == "fallen":
            break
    assert 0.18 < 0.005 * rate * k < 0.24
    assert "sole leans by 1" in node.got["diagnostics"][-1].status[0].message
    assert not any(node.got["joint_velocity_commands"][-1].velocity)


@pytest.mark.parametrize(
    "direction", [0, *(pytest.param(k, marks=pytest.mark.long) for k in range(1, 20))], ids=lambda k: f"{18 * k} deg"
)
def test_after_a_push_that_fells_the_robot_it_is_told_nothing_more(make: Any, direction: int) -> None:
    """In physics: from 0.3 s after the pelvis leans by 40 degrees on, every command is zero; -s prints when."""
    node = make("controller", CONFIG)
    plant = make_plant("physics", CONFIG, MODEL)
    dt, lying, moved = CONFIG.dt, None, 0.0
    for k in range(1200):
        tell(node, plant.state.q, 1.0 + k * dt, plant.inertial)
        u = np.array(node.got["joint_velocity_commands"][-1].velocity)
        moved = k * dt if u.any() else moved
        if lying is not None and k * dt > lying + 0.3:
            assert not u.any()
        if k * dt >= 2.0:
            angle = math.radians(18.0 * direction)
            force = 30.0 * np.array([math.cos(angle), math.sin(angle), 0.0]) if k * dt < 2.2 else np.zeros(3)
            plant.push(force)
        if lying is None and upward(*plant.inertial.orientation)[2] < math.cos(math.radians(40.0)):
            lying = k * dt
        plant.step(Command(k * dt, u), dt)
    assert lying is not None
    print(f"\n{18 * direction} deg: the last command {lying - moved:.2f} s before the pelvis leaned by 40 deg")
    assert node.got["phase"][-1].data == "fallen"
    said = node.got["diagnostics"][-1].status[0].message
    assert "it fell because: the divergent component left the soles at " in said  # the push is on no record


@pytest.mark.parametrize("value", [1e200, -1e308, 1.7e308])
def test_a_velocity_beyond_all_numbers_is_cut_off(value: float) -> None:
    walk = StandingWalk(CONFIG.updated({"gait.steps": 0}), MODEL)
    most = (walk.config.gait.most_length, walk.config.gait.most_side, walk.config.gait.most_turn)
    for asked in ((value, 0.0, 0.0), (value, value, value), (0.0, 0.0, value)):
        walked = walk.steer(*asked)
        assert np.isfinite(walked).all()
        assert all(abs(w) <= m for w, m in zip(walked, most, strict=True))
        assert any(walked)
