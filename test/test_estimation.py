"""The estimate of the base against the truth of the physics, with all sensor faults and soles that slip."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

import dqwalk_ros as dq
from dqwalk_ros.config import find_share, from_yaml
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.estimation.base import BaseEstimator
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.robot import Foot
from dqwalk_ros.simulation import closed_loop, make_controller, make_plant
from dqwalk_ros.walk import PhaseKind

POPPY = dq.load("poppy")
MODEL = dq.load_model(POPPY.robot)


def errors(steps: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Walk as built, each foot slipping by 2 mm once a step; return errors (N, 9) and deviations (N, 9)."""
    text = find_share("config/plants", "poppy_as_built.yaml").read_text(encoding="utf-8")
    config = from_yaml(text, onto=POPPY).updated({"gait.steps": steps, "qp.solver": "daqp", "sensors.seed": seed})
    plant, controller = make_plant("physics", config, MODEL), make_controller(config, MODEL)
    estimator, random = BaseEstimator(config, MODEL), np.random.default_rng(seed)
    world, found, deviations, slipped = None, [], [], 0
    for state, _ in closed_loop(controller, plant):
        phase = controller.phase
        single = phase.kind is PhaseKind.SINGLE_SUPPORT
        standing = {phase.base} if single else set(Foot)
        felt = plant.inertial
        kin = Kinematics(MODEL, state.q, phase.base)
        estimate = estimator.update(state.time, kin, felt.gyro, felt.acceleration, standing)
        truth = plant.truth
        if world is None:  # the first base sole, level
            R = DQ(truth.soles[phase.base]).rotation_matrix()
            yaw = math.atan2(R[1, 0], R[0, 0])
            p = DQ(truth.soles[phase.base]).translation() * [1.0, 1.0, 0.0]
            world = DQ.from_pose(p, [math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)])
        if single and controller.phase_index > slipped:
            # the floor has no marks: to be carried along it is what a slip is
            slipped, way = controller.phase_index, random.uniform(-np.pi, np.pi)
            plant.data.qpos[:2] += 0.002 * np.array([math.cos(way), math.sin(way)])
        twist = np.empty(6)
        mujoco.mj_objectVelocity(plant.mj, plant.data, mujoco.mjtObj.mjOBJ_XBODY, plant._pelvis, twist, 0)
        x, y = world.conj() * DQ(truth.pelvis), DQ(estimate.pose)
        turned = (y * x.conj()).rotation()
        found.append(
            np.concatenate([
                2.0 * turned[1:] * np.sign(turned[0]),
                estimate.velocity - world.rotation_matrix().T @ twist[3:],
                y.translation() - x.translation(),
            ])
        )  # fmt: skip
        deviations.append(np.sqrt(np.diag(estimate.covariance)))
    assert controller.finished
    return np.array(found), np.array(deviations)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_base_is_known_within_what_the_estimate_says(seed: int) -> None:
    error, deviation = errors(4, seed)
    rms = np.sqrt((error**2).mean(axis=0))
    assert np.degrees(np.linalg.norm(rms[:3])) < 0.7
    assert np.linalg.norm(rms[3:6]) < 0.02
    assert np.linalg.norm(error[-1, 6:8]) < 0.02
    assert (np.abs(error) < 3.5 * deviation).mean() > 0.98
