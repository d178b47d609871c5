"""Ground truth of simulators: the centre of pressure of both feet."""

from __future__ import annotations

import numpy as np
import pytest

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.plants.base import center_of_pressure


@pytest.mark.parametrize("loaded", [(True, True), (True, False), (False, False)])
def test_the_centre_of_pressure_is_the_mean_of_the_points_at_which_the_ground_pushes(loaded: tuple[bool, bool]) -> None:
    """Four vertical forces on each sole, at ten times; without a load it is not known."""
    random, N = np.random.default_rng(0), 10
    soles, wrenches, points, forces = {}, {}, [], []
    for foot, stands in zip(Foot, loaded, strict=True):
        yaw = random.uniform(-3.0, 3.0, N)
        soles[foot] = DQ.from_pose(random.normal(size=(N, 3)), DQ.rotation_about(yaw, [0.0, 0.0, 1.0]).vec4()).vec8()
        corners = np.append(random.normal(size=(N, 4, 2)), np.zeros((N, 4, 1)), axis=-1)
        pushes = np.zeros((N, 4, 3))
        pushes[..., 2] = stands * random.uniform(1.0, 9.0, (N, 4))
        wrenches[foot] = np.concatenate([pushes.sum(axis=1), np.cross(corners, pushes).sum(axis=1)], axis=-1)
        points.append(DQ(soles[foot][:, None]).transform_point(corners))
        forces.append(pushes[..., 2:])
    weights, found = np.concatenate(forces, axis=1), center_of_pressure(soles, wrenches)
    total = weights.sum(axis=1)
    mean = (weights * np.concatenate(points, axis=1)).sum(axis=1) / np.where(total > 0.0, total, np.nan)
    np.testing.assert_allclose(found, mean, atol=1e-12)
    for k in range(N):
        one = ({foot: values[foot][k] for foot in Foot} for values in (soles, wrenches))
        np.testing.assert_array_equal(center_of_pressure(*one), found[k])
