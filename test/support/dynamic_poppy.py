"""Poppy and its dynamic walk, which the tests of its parts share."""

from __future__ import annotations

import math

import numpy as np

import dqwalk_ros as dq
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.paper.state import Estimate
from dqwalk_ros.walks.dynamic.plan import Support
from dqwalk_ros.walks.dynamic.walk import DynamicWalk
from dqwalk_ros.walks.following import FollowPose
from dqwalk_ros.walks.footprint import Footprint

CONFIG = dq.load("poppy_dynamic")
MODEL = dq.load_model(CONFIG.robot)
OMEGA = np.array([4.4, 3.7])


def random_posture(seed: int) -> np.ndarray:
    q = MODEL.posture(CONFIG.standing.posture) + 0.2 * np.random.default_rng(seed).normal(size=MODEL.n)
    return np.clip(q, MODEL.q_min, MODEL.q_max)


def prepared(config: dq.Config) -> DynamicWalk:
    walk = DynamicWalk(config, MODEL)
    walk.prepare()
    return walk


def supports(length: float = 0.05, width: float = 0.08, first: float = 1.0, roll: float = 0.0) -> list[Support]:
    """Return a support and six following ones, `length` apart [m]; the first is on the left."""
    aims = [np.array([k * length, first * 0.5 * width * (-1.0) ** k]) for k in range(7)]
    return [Support(aim, np.array([roll, 0.0]), 0.1, 0.4) for aim in aims]


def still(time: float, q: np.ndarray, up: np.ndarray, elapsed: float) -> Estimate:
    return Estimate(time, q, dq=np.zeros(MODEL.n), up=up, gyro=np.zeros(3), elapsed=elapsed)


def swing_target(config: dq.Config, q: np.ndarray, before: np.ndarray, up: np.ndarray, ticks: int) -> np.ndarray:
    """Return the target of the left foot after some states in support on the right one, position and quaternion.

    In the double support before it the vertical is `before` in axes of the left sole, then `up` in those of the right.
    """
    walk = prepared(config)
    both = walk.phase(PhaseKind.DOUBLE_SUPPORT, Foot.RIGHT, q)
    walk.observe(both, Kinematics(MODEL, q, Foot.LEFT, before), still(1.0, q, before, 0.0))
    stands = Footprint.of(Kinematics(MODEL, q, Foot.RIGHT).pose(MODEL.soles[Foot.LEFT].frame))
    phase = walk.phase(PhaseKind.SINGLE_SUPPORT, Foot.RIGHT, q, stands.pose)
    for k in range(ticks + 1):
        kin = Kinematics(MODEL, q, Foot.RIGHT, up)
        assert walk.observe(phase, kin, still(1.0 + config.dt * (k + 1), q, up, config.dt * k)) is None
    (target,) = (task.target for task in phase.tasks if isinstance(task, FollowPose))
    return target.numbers[:7]


def inclined(degrees: float) -> np.ndarray:
    """Return the vertical in axes of a sole that is inclined about its x axis."""
    return np.array([0.0, math.sin(math.radians(degrees)), math.cos(math.radians(degrees))])
