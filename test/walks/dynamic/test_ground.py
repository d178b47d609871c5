"""How the ground inclines, and a sole that tips on it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from dynamic_poppy import CONFIG, MODEL, inclined, swing_target

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.walks.dynamic.ground import Ground, include
from dqwalk_ros.walks.footprint import Footprint


def random_vertical(random: np.random.Generator) -> np.ndarray:
    """Return the vertical in axes of a sole that is inclined by some degrees."""
    up = np.array([0.1, 0.1, 1.0]) * [*random.uniform(-1.0, 1.0, 2), 1.0]
    return up / np.linalg.norm(up)


@pytest.mark.parametrize("seed", range(5))
def test_a_sole_that_tips_leaves_the_swing_foot_at_its_height_above_the_ground(seed: int) -> None:
    """Up to the dead zone of 0.5 degrees."""
    random = np.random.default_rng(seed)
    flat, up = random_vertical(random), random_vertical(random)
    ground, unsure = Ground(flat), math.radians(0.5)
    # the vertical, as far as the sole is taken to have tipped
    seen = DQ(ground.tip(up, unsure)).Ad(DQ([0.0, *flat])).vec3()
    angle = math.acos(flat @ up)
    assert math.acos(flat @ seen) == pytest.approx(angle - math.radians(0.5))
    assert math.acos(seen @ up) == pytest.approx(math.radians(0.5))
    p, r = random.normal(size=3), random.normal(size=4)
    moved = ground.tipped(up, unsure, np.array([*p, *r / np.linalg.norm(r)]))
    assert seen @ moved[:3] == pytest.approx(flat @ p)
    before, after = DQ(r).P().normalized().conj().Ad(DQ([0.0, *flat])), DQ(moved[3:]).conj().Ad(DQ([0.0, *seen]))
    assert after.vec3() == pytest.approx(before.vec3())  # the vertical in axes of the swing sole
    assert Ground(flat).tip(flat, math.radians(0.5)) == pytest.approx(DQ(1.0).vec8())


def test_the_ground_is_inclined_as_the_soles_are_in_the_mean() -> None:
    random = np.random.default_rng(0)
    slope = random_vertical(random)
    ground = Ground(np.array([0.0, 0.0, 1.0]))
    turn = Footprint(0.1 + 0.2j, np.exp(0.3j))  # of the previous sole in the axes of the next
    for k in range(4000):
        if k % 100 == 99:
            ground.change_base(turn)
            slope = DQ(turn.pose).P().Ad(DQ([0.0, *slope])).vec3()
        include(ground.vertical, slope + 0.02 * random.normal(size=3), 0.005)
    assert ground.tip(slope, 1e-3) == pytest.approx(DQ(1.0).vec8(), abs=2e-3)


def test_the_pressure_is_aimed_further_inside_after_a_step_on_an_inclined_sole() -> None:
    """Until two steps have ended on soles that are level but for the noise of the sensor."""
    ground, found = Ground(np.array([0.0, 0.0, 1.0])), []
    for tilt in (0.4, 0.0, 0.6, 0.3, 0.4, 2.0):
        ground.end_step(math.radians(tilt))
        found.append(ground.inward > 0.0)
    assert found == [False, False, True, True, False, True]


@pytest.mark.parametrize("latency", [0.0, 0.04])
def test_the_swing_foot_leaves_a_tipped_sole_and_lands_on_the_ground(latency: float) -> None:
    """With a delay only if the sole tips by more than 60 degrees/s times it, here 2.25 degrees."""
    changes = {"servo.latency": latency, "servo.assumed_latency": latency, "dynamic.catch": False}
    config, q = CONFIG.updated(changes), MODEL.posture(CONFIG.standing.posture)
    stands, up = Kinematics(MODEL, q, Foot.RIGHT).point(MODEL.soles[Foot.LEFT].frame), inclined(2.0)
    begun, landed = (swing_target(config, q, inclined(0.0), up, ticks)[:3] for ticks in (0, 80))
    assert begun == pytest.approx(stands, abs=2e-4)
    assert up @ landed == pytest.approx(up @ stands if latency else 0.0, abs=1e-3)  # 3.3 mm above the ground


def test_the_ground_stays_as_it_is_when_the_base_changes_to_a_turned_foot() -> None:
    """On a slope the sole does not tip, although the vertical has other coordinates in its axes."""
    config, q = CONFIG.updated({"dynamic.catch": False}), MODEL.posture(CONFIG.standing.posture)
    q[MODEL.joint_names.index("l_hip_z")] = 0.4
    turn = Footprint.of(Kinematics(MODEL, q, Foot.RIGHT).pose(MODEL.soles[Foot.LEFT].frame))
    before = inclined(6.0)
    up = DQ(turn.pose).P().Ad(DQ([0.0, *before])).vec3()
    assert np.linalg.norm(up - before) > 0.03
    assert swing_target(config, q, before, up, 80)[2] == pytest.approx(0.0, abs=2e-4)
