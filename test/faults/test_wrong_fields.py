"""A walk during which one field of a message at a time is wrong, at random: the walk continues."""

from __future__ import annotations

import array
import copy
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Twist
from inside import state
from nav_msgs.msg import Path as NavPath
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from dqwalk_ros.config import load, overlaid, with_files
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.plants.table import make_plant

NUMBERS = (float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 5e-324, 0.0, 1e9, -1e9)
WHOLE = (0, 1, -1, 999_999_999, 2**31 - 1, -(2**31))
TEXTS = ("", "x" * 10_000, "odom\x00", "l_knee_y", "/odom", "robot1/odom", "\u00e9\u202e", "l_sole")


def fields(message: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the path of every field of a message, also within lists of messages."""
    if isinstance(message, list):
        inner = [(k, part) for k, part in enumerate(message) if hasattr(part, "get_fields_and_field_types")]
    else:
        inner = [(name, getattr(message, name)) for name in message.get_fields_and_field_types()]
    found = [] if isinstance(message, list) else [(*path, name) for name, _ in inner]
    for key, part in inner:
        if isinstance(part, list) or hasattr(part, "get_fields_and_field_types"):
            found += fields(part, (*path, key))
    return found


def wrong(rng: random.Random, value: Any) -> Any:
    """Return another value of the same type."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, float):
        return rng.choice(NUMBERS)
    if isinstance(value, int):
        return rng.choice(WHOLE)
    if isinstance(value, str):
        return rng.choice(TEXTS)
    if not isinstance(value, list | array.array) or not value:
        return value
    some = list(value)
    k = rng.randrange(len(some))
    changes = (
        [],
        some[:-1],
        [*some, some[0]],
        some[::-1],
        50 * some,
        [*some[:k], wrong(rng, some[k]), *some[k + 1 :]],
    )
    return type(value)(value.typecode, rng.choice(changes)) if isinstance(value, array.array) else rng.choice(changes)


def with_a_wrong_field(rng: random.Random, message: Any) -> Any:
    """Return a copy of a message with one other field, as received; the message itself if that is no message."""
    owner = out = copy.deepcopy(message)
    *way, name = rng.choice(fields(message))
    for key in way:
        owner = owner[key] if isinstance(key, int) else getattr(owner, key)
    try:
        setattr(owner, name, wrong(rng, getattr(owner, name)))
        return deserialize_message(serialize_message(out), type(out))
    except (AssertionError, OverflowError, SystemError, TypeError, ValueError):  # not a message
        return message


def commands() -> dict[str, Any]:
    """Return a valid message for each topic that commands the walk."""
    twist, pose = Twist(), PoseStamped()
    twist.linear.x = 0.05
    pose.pose.orientation.w, pose.pose.position.x, pose.pose.position.z = 1.0, 0.2, 0.4
    steps = NavPath(header=Header(frame_id="l_sole"), poses=[PoseStamped(pose=pose.pose)])
    arms = JointTrajectory(joint_names=["l_shoulder_x"], points=[JointTrajectoryPoint(positions=[0.3])])
    return {"cmd_vel": twist, "footsteps": steps, "arm_trajectory": arms}


@pytest.mark.long
@pytest.mark.parametrize("seed", range(1, 7))
def test_one_wrong_field_of_a_message_at_a_time_ends_no_walk(make: Any, seed: int) -> None:
    config = with_files(overlaid(load("poppy_dynamic"), "physics"), [Path("arms")]).updated({"gait.steps": 0})
    one, rng, dt = make("controller", config), random.Random(seed), config.dt
    model = one.node._model
    plant = make_plant("physics", one.node.config, model)
    asked, last = commands(), 0
    for k in range(round(7.0 / dt)):
        stamp = 1.0 + k * dt
        if not k % 50:
            one.send("cmd_vel", asked["cmd_vel"])
        if rng.random() < 0.05:
            topic = rng.choice(list(asked))
            one.send(topic, with_a_wrong_field(rng, asked[topic]))
        if k > last + 3 and rng.random() < 0.05:
            last, now = k, plant.state
            felt = ros.imu(round((stamp + rng.choice((-0.5, 1.0)) * dt) * 1e9), model.imu, plant.inertial)
            told = state(model.joint_names, now.q, stamp + rng.choice((0.0, 1.0)) * dt, velocity=now.dq)
            topic, message = rng.choice((("imu", felt), ("joint_states", told)))
            one.send(topic, with_a_wrong_field(rng, message))
        u = one.exchange(plant, model, stamp)
        assert (np.abs(u) <= 1.001 * model.velocity_max).all()
        assert one.node._mode.value == "walking", one.node._problem
    assert not plant.fallen
    assert all(text.isprintable() and len(text) < 2000 for _, text in one.log.lines)
