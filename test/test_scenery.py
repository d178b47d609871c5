"""Pictures show the robot's visual shapes, which do not affect the physics."""

from __future__ import annotations

import mujoco
import numpy as np

from dqwalk_ros.config import load
from dqwalk_ros.plants.camera import add_scenery
from dqwalk_ros.plants.mujoco import build
from dqwalk_ros.robot import load_model


def test_visual_shapes_do_not_affect_the_physics():
    config = load("poppy")
    model = load_model(config.robot)
    plain, seen = build(config, model), build(config, model, scenery=add_scenery)
    assert seen.ngeom > plain.ngeom + 20
    np.testing.assert_array_equal(seen.body_mass, plain.body_mass)
    np.testing.assert_array_equal(seen.body_inertia, plain.body_inertia)
    states = []
    for m in (plain, seen):
        data = mujoco.MjData(m)
        data.qpos[2] = 0.5
        data.qvel[:] = np.random.default_rng(0).normal(size=m.nv)
        for _ in range(300):
            mujoco.mj_step(m, data)
        assert data.ncon > 0
        states.append(data.qpos.copy())
    np.testing.assert_array_equal(*states)


def test_pictures_hide_collision_shapes():
    """Pictures omit group 0, so floor and soles, whose collision shapes are drawn, are in another group."""
    config = load("poppy")
    made = build(config, load_model(config.robot), scenery=add_scenery)
    for name in ("floor", "sole_left", "sole_right"):
        assert made.geom(name).group[0] == 2
    visual = made.geom_group == 1
    assert visual.sum() > 20
    assert not made.geom_contype[visual].any()
    assert not made.geom_conaffinity[visual].any()
