"""A navigation client like Nav2: velocities in, odometry out, using only what a real robot provides."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Twist
from inside import subscribed
from nav_msgs.msg import Odometry

from dqwalk_ros.config import load, overlaid
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.simulation import make_plant

SETTINGS = {"gait.steps": 0, "qp.solver": "daqp"}
CONFIG = overlaid(load("poppy"), "physics").updated(SETTINGS)
MODEL = load_model(CONFIG.robot)
NEAR, WITHIN = 0.02, 0.05
"""A goal counts as reached at the first distance by odometry; its true distance must be below the second [m]."""


def velocity(odom: Odometry, goal: np.ndarray) -> Twist:
    """Turn towards the goal, then walk there."""
    p, r = odom.pose.pose.position, odom.pose.pose.orientation
    ahead, heading = goal - [p.x, p.y], 2.0 * math.atan2(r.z, r.w)
    error = math.remainder(math.atan2(ahead[1], ahead[0]) - heading, 2.0 * math.pi)
    out = Twist()
    out.angular.z = 0.5 * error
    if abs(error) < 0.2:
        out.linear.x = 0.02 * min(1.0, float(np.linalg.norm(ahead)) / 0.1)
    return out


def drive(make: Any, goals: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the distance to each goal by odometry when it is reached, and the true distance [m]."""
    controller, plant = make("controller", CONFIG), make_plant("physics", CONFIG, MODEL)
    listener = subscribed(controller, "/odom", Odometry)
    begin = DQ(plant.truth.pelvis)
    left, out, tick, first = list(goals), [], 0, None
    try:
        while left:
            controller.exchange(plant, MODEL, 1.0 + tick * CONFIG.dt)
            controller.got["joint_velocity_commands"].clear()
            assert not plant.fallen, (tick * CONFIG.dt, out)
            tick += 1
            if not controller.got["odom"]:
                continue
            odom = controller.got["odom"].pop()
            place = np.array([odom.pose.pose.position.x, odom.pose.pose.position.y])
            first = place if first is None else first
            goal = first + left[0]
            if tick % 20 == 0:
                controller.send("cmd_vel", velocity(odom, goal))
            if np.linalg.norm(goal - place) < NEAR:
                true = (begin.conj() * DQ(plant.truth.pelvis)).translation()[:2]
                out.append((float(np.linalg.norm(goal - place)), float(np.linalg.norm(true - left.pop(0)))))
                print(f"{tick * CONFIG.dt:.0f} s: goal {len(out)}, {1e3 * out[-1][1]:.0f} mm true distance")
            assert tick * CONFIG.dt < 400.0 * len(goals), (place, left)
    finally:
        listener.destroy_node()
    return out


@pytest.mark.long
def test_a_goal_ahead_is_reached_by_odometry(make: Any) -> None:
    ((_, true),) = drive(make, [(0.06, 0.0)])
    assert true < WITHIN


@pytest.mark.long
@pytest.mark.timeout(3000)
def test_five_goals_on_a_square_of_one_metre_are_reached(make: Any) -> None:
    reached = drive(make, [(1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0), (1.0, 0.0)])
    assert len(reached) == 5
    assert max(true for _, true in reached) < WITHIN
