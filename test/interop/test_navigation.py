"""A navigation client like Nav2: velocities in, odometry out, using only what a real robot provides.

Its limits, its tolerance and its map are those of config/nav2/.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import networkx as nx
import numpy as np
import pytest
import yaml
from geometry_msgs.msg import Twist
from inside import subscribe
from nav_msgs.msg import Odometry

from dqwalk_ros.config import find_share, load, overlaid
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.walks.table import make_walk

NAV2 = yaml.safe_load(find_share("config/nav2", "nav2.yaml").read_text())
ROOM = yaml.safe_load(find_share("config/nav2", "room.yaml").read_text())


@dataclass(frozen=True)
class Client:
    """A walk, and how a client steers it."""

    name: str
    """Of the configuration."""
    speed: float
    turn: float
    """Largest velocities [m/s, rad/s]: the limits of Nav2's velocity_smoother."""
    near: float
    within: float
    """A goal counts as reached at the first distance by odometry; its true distance must be below the second [m], which
    contains the drift of all goals."""

    def velocity(self, heading: float, ahead: np.ndarray, left: float) -> Twist:
        """Turn towards a place `ahead`, then walk there; slower in the last 10 cm of what is `left` of the way."""
        error = math.remainder(math.atan2(ahead[1], ahead[0]) - heading, math.tau)
        out = Twist()
        out.angular.z = min(max(0.5 * error, -self.turn), self.turn)
        if abs(error) < 0.4:
            out.linear.x = self.speed * (1.0 - abs(error) / 0.4) * min(1.0, left / 0.1)
        return out


def parameters(node: str) -> Any:
    """Return the parameters of a node of Nav2."""
    return NAV2[node]["ros__parameters"]


_MOST, _NEAR = parameters("velocity_smoother")["max_velocity"], parameters("controller_server")["goal_checker"]
STANDING = Client("poppy", 0.02, 0.05, 0.02, 0.05)
DYNAMIC = Client("poppy_dynamic", _MOST[0], _MOST[2], _NEAR["xy_goal_tolerance"], 0.2)
ROBOT = NAV2["global_costmap"]["global_costmap"]["ros__parameters"]["robot_radius"]
"""Radius of the robot [m]."""
_CELL, _LOOK = 0.05, parameters("controller_server")["FollowPath"]["lookahead_dist"]
"""Grid of the plan, and distance along the path of the place that is walked towards [m]."""
OBSTACLE = 0.5 * math.sqrt(2.0) * ROOM["resolution"]
"""Largest distance of a point of an occupied cell of the map from its middle [m]."""


def occupied() -> np.ndarray:
    """Return the middles of the occupied cells of the map, shape (n, 2) [m]."""
    _, width, _, _, *values = find_share("config/nav2", ROOM["image"]).read_text().split()
    image = np.array(values, int).reshape(-1, int(width))[::-1]  # from the bottom
    rows, columns = np.nonzero(image < 128)
    return np.array(ROOM["origin"][:2]) + ROOM["resolution"] * (np.stack([columns, rows], axis=1) + 0.5)


def path(start: np.ndarray, goal: np.ndarray, obstacles: np.ndarray) -> np.ndarray:
    """Return the shortest path on a grid that keeps the robot away from all obstacles, shape (n, 2) [m]."""
    side = np.arange(-30, 31)
    cells = {(int(i), int(j)): _CELL * np.array([i, j], float) for i, j in itertools.product(side, side)}
    free = {
        cell
        for cell, place in cells.items()
        if not len(obstacles) or np.linalg.norm(obstacles - place, axis=1).min() > ROBOT + OBSTACLE + _CELL
    }
    graph = nx.Graph()
    for i, j in free:
        for di, dj in ((1, 0), (0, 1), (1, 1), (1, -1)):
            if (i + di, j + dj) in free:
                graph.add_edge((i, j), (i + di, j + dj), weight=math.hypot(di, dj))
    ends = [min(graph, key=lambda cell, place=place: np.linalg.norm(cells[cell] - place)) for place in (start, goal)]
    return np.array([*(cells[cell] for cell in nx.astar_path(graph, *ends, weight="weight")), goal])


def on_plane(x: DQ) -> DQ:
    """Return the position along the ground and the yaw of a pose, as a pose."""
    R, (px, py, _) = x.rotation_matrix(), x.translation()
    yaw = math.atan2(R[1, 0], R[0, 0])
    return DQ.from_pose([px, py, 0.0], [math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)])


def drive(
    make: Any,
    client: Client,
    goals: Sequence[Sequence[float]],
    obstacles: np.ndarray | None = None,
) -> list[tuple[float, float]]:
    """Return the true distance to each goal when it is reached by odometry, and the least one to an obstacle [m]."""
    config = overlaid(load(client.name), "physics").updated({"gait.steps": 0, "qp.solver": "daqp"})
    sensors = replace(overlaid(config, "poppy_as_built").sensors, age=0.0)
    config = replace(config, sensors=sensors).updated({"servo.assumed_velocity_filter": sensors.velocity_filter})
    model, obstacles = load_model(config.robot), np.zeros((0, 2)) if obstacles is None else obstacles
    controller, plant = make("controller", config), make_plant("physics", config, model)
    subscribe(controller, "/odom", Odometry)
    begin, left, out = None, [np.array(goal) for goal in goals], []
    tick, least, way = 0, 9.9, None
    while left:
        controller.exchange(plant, model, 1.0 + tick * config.dt)
        controller.got["joint_velocity_commands"].clear()
        assert not plant.fallen, (tick * config.dt, out)
        tick += 1
        if not controller.got["odom"]:
            continue
        msg = controller.got["odom"].pop().pose.pose
        p, r = msg.position, msg.orientation
        here, truth = (
            on_plane(DQ.from_pose([p.x, p.y, 0.0], [r.w, r.x, r.y, r.z])),
            on_plane(DQ(plant.truth.pelvis)),
        )
        begin = truth * here.conj() if begin is None else begin  # where odom is
        at = (begin.conj() * truth).translation()[:2]
        place, R = here.translation()[:2], here.rotation_matrix()
        least = min([least, *(np.linalg.norm(obstacles - at, axis=1) - OBSTACLE)])
        way = path(place, left[0], obstacles) if way is None else way
        to_go = float(np.linalg.norm(left[0] - place))
        if tick % 20 == 0:
            nearest = int(np.argmin(np.linalg.norm(way - place, axis=1)))
            ahead = way[min(nearest + round(_LOOK / _CELL), len(way) - 1)] - place
            controller.send("cmd_vel", client.velocity(math.atan2(R[1, 0], R[0, 0]), ahead, to_go))
        if to_go < client.near:
            out.append((float(np.linalg.norm(at - left.pop(0))), float(least)))
            way, least = None, 9.9
            print(
                f"{tick * config.dt:.0f} s: goal {len(out)}, true distance {1e3 * out[-1][0]:.0f} mm, "
                f"obstacles at {out[-1][1]:.2f} m or more"
            )
        assert tick * config.dt < 400.0 * len(goals), (place, left)
    return out


@pytest.mark.long
def test_a_goal_ahead_is_reached_by_odometry(make: Any) -> None:
    ((true, _),) = drive(make, STANDING, [(0.06, 0.0)])
    assert true < STANDING.within


@pytest.mark.long
@pytest.mark.timeout(3000)
def test_five_goals_on_a_square_of_one_metre_are_reached(make: Any) -> None:
    reached = drive(make, STANDING, [(1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0), (1.0, 0.0)])
    assert len(reached) == 5
    assert max(true for true, _ in reached) < STANDING.within


@pytest.mark.long
@pytest.mark.timeout(3000)
def test_twenty_goals_among_obstacles_are_reached_by_the_dynamic_walk(make: Any) -> None:
    """Eight columns in a room, none of which the robot touches, by its odometry alone."""
    rng, obstacles = np.random.default_rng(1), occupied()
    goals: list[np.ndarray] = []
    while len(goals) < 20:
        goal = rng.uniform(-1.1, 1.1, 2)
        away = np.linalg.norm(goal - (goals[-1] if goals else 0.0)) > 0.5
        if away and np.linalg.norm(obstacles - goal, axis=1).min() > ROBOT + OBSTACLE + 2.0 * _CELL:
            goals.append(goal)
    reached = drive(make, DYNAMIC, goals, obstacles)
    assert len(reached) == 20
    assert max(true for true, _ in reached) < DYNAMIC.within
    assert min(free for _, free in reached) > ROBOT


def test_the_limits_for_nav2_are_walked_unchanged() -> None:
    """Also together: the walk scales larger velocities down, and Nav2 would not know."""
    smoother, follow = parameters("velocity_smoother"), parameters("controller_server")["FollowPath"]
    config = load(DYNAMIC.name).updated({"gait.steps": 0})
    walk = make_walk(config, load_model(config.robot))
    for x in (smoother["min_velocity"][0], 0.0, DYNAMIC.speed):
        for turn in (smoother["min_velocity"][2], 0.0, DYNAMIC.turn):
            assert walk.steer(x, 0.0, turn) == pytest.approx((x, 0.0, turn), rel=1e-9)
    assert 1.0 / smoother["smoothing_frequency"] < smoother["velocity_timeout"] < config.gait.cmd_vel_timeout
    assert (follow["desired_linear_vel"], follow["rotate_to_heading_angular_vel"]) == (DYNAMIC.speed, DYNAMIC.turn)
    assert follow["regulated_linear_scaling_min_radius"] >= DYNAMIC.speed / DYNAMIC.turn
