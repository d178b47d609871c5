"""The path of the swing foot."""

from __future__ import annotations

import numpy as np
import pytest

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.walks.dynamic.swing import Swing, advanced


def test_a_swing_lands_at_a_changed_goal_and_time() -> None:
    start, goal = DQ.from_pose([-0.05, 0.08, 0.002]).vec8(), DQ.from_pose([0.05, 0.08, 0.0]).vec8()
    swing, dt, duration = Swing(start, goal, 0.02), 0.001, 0.4
    places = []
    for k in range(1, 450):
        t = k * dt
        if t > 0.2:
            swing.goal, duration = np.array([0.08, 0.08]), 0.44
        pose, velocity, _ = advanced(*swing.compiled, t, duration)
        places.append([*pose[:3], *velocity[:3]])
    path = np.array(places)
    slope = np.diff(path[:, :3], axis=0) / dt
    assert path[-1, :3] == pytest.approx([0.08, 0.08, 0.0], abs=1e-6)
    assert np.abs(path[-1, 3:]).max() < 1e-3
    assert np.abs(slope - 0.5 * (path[1:, 3:] + path[:-1, 3:]))[np.arange(448) != 199].max() < 0.02
    assert path[:, 2].max() == pytest.approx(0.02, abs=0.002)


def test_a_foot_that_lands_late_only_comes_down_at_the_end() -> None:
    start, goal, late = DQ.from_pose([-0.05, 0.08, 0.0]).vec8(), DQ.from_pose([0.05, 0.08, 0.0]).vec8(), 0.03
    swings = [(Swing(start, goal, 0.02), 0.4), (Swing(start, goal, 0.02, still=late / (0.4 + late)), 0.4 + late)]
    for t in np.linspace(0.3, 0.4, 20):
        (prompt, _, _), (other, _, _) = (advanced(*swing.compiled, float(t), duration) for swing, duration in swings)
        assert other[:2] == pytest.approx(prompt[:2], abs=5e-4)
        assert other[2] > prompt[2] + 5e-5
    assert other[:2] == pytest.approx([0.05, 0.08], abs=1e-9)


@pytest.mark.parametrize(("below", "goal"), [(0.0, 0.025), (-0.025, 0.025), (-0.025, 0.0), (0.0, -0.025)])
def test_a_swing_clears_the_edge_of_a_stair_that_is_10_mm_from_the_sole(below: float, goal: float) -> None:
    x = [-0.06, 0.12]
    swing = Swing(DQ.from_pose([x[0], 0.08, below]).vec8(), DQ.from_pose([x[1], 0.08, goal]).vec8(), 0.02, 0.0, below)
    path = np.array([np.concatenate(advanced(*swing.compiled, t, 0.4)[:2]) for t in np.arange(0.001, 0.401, 0.001)])
    edge = path[:, 0] > x[0] + 0.01 if goal > below else path[:, 0] < x[1] - 0.01
    assert path[edge, 2].min() > max(goal, below) - 1e-9
    assert path[-1, :3] == pytest.approx([x[1], 0.08, goal], abs=1e-6)
    assert np.abs(path[-1, 7:]).max() < 1e-3
    assert path[:, 2].max() < max(goal, below) + 0.021
    slope = np.diff(path[:, 2]) / 0.001
    assert np.abs(slope - 0.5 * (path[1:, 9] + path[:-1, 9])).max() < 0.02


@pytest.mark.parametrize("stopped", [0.15, 0.3])
@pytest.mark.parametrize("height", [None, 0.03])
def test_a_climbing_foot_that_is_stopped_goes_back_down_or_stays_on_top(stopped: float, height: float | None) -> None:
    start, goal = DQ.from_pose([-0.05, 0.08, -0.01]).vec8(), DQ.from_pose([0.07, 0.08, 0.02]).vec8()
    swing, dt = Swing(start, goal, 0.02, level=-0.01), 0.001
    poses = []
    for t in np.arange(dt, 0.401, dt):
        poses.append(advanced(*swing.compiled, float(t), 0.4)[0])
        if abs(t - stopped) < 1e-9:
            assert swing.is_over(poses[-1][:2]) is (stopped > 0.2)
            landing = swing.stop(poses[-1][:2], height)
    path, at = np.array(poses), round(stopped / dt) - 1
    assert path[-1, :2] == pytest.approx(landing, abs=1e-6)
    assert landing == pytest.approx([-0.05, 0.08] if height is None else path[at, :2], abs=1e-9)
    if height is None:  # to the ground before the stair, without a jump
        assert path[-1, 2] == pytest.approx(0.0, abs=1e-6)
        assert np.abs(np.diff(path[:, 2])).max() < 1e-3
    else:
        assert path[at + 1 :, 2] == pytest.approx(height, abs=1e-9)
