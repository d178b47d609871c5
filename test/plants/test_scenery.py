"""Pictures show the robot's visual shapes, which do not affect the physics."""

from __future__ import annotations

import mujoco
import numpy as np

from dqwalk_ros.config import load
from dqwalk_ros.plants.mujoco import build
from dqwalk_ros.report.movie import scenery_of
from dqwalk_ros.robot.model import load_model


def test_visual_shapes_do_not_affect_the_physics():
    config = load("poppy")
    model = load_model(config.robot)
    plain, seen = build(config, model), build(config, model, scenery=scenery_of(config, model))
    assert seen.ngeom > plain.ngeom + 20
    shapes = [seen.geom(k) for k in range(seen.ngeom) if seen.geom(k).name.startswith("shape")]
    assert len(shapes) == seen.ngeom - plain.ngeom
    assert not any(shape.contype[0] or shape.conaffinity[0] for shape in shapes)
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
