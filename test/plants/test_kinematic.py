"""The integrator: Euler's method to the last bit, within the limits; invalid velocities are rejected."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dqwalk_ros.config import load
from dqwalk_ros.paper.state import Command
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.errors import PlantError

DT = 0.005
MODEL = load_model(load("paper").robot)


def test_velocities_are_integrated_by_eulers_method_within_the_limits():
    plant = KinematicPlant(MODEL)
    u = np.linspace(-2.0, 2.0, MODEL.n) * MODEL.velocity_max
    for k in range(1, 1001):
        before, state = plant.state, plant.step(Command(0.0, u), DT)
        assert plant.state is state
        assert state.time == k * DT
        np.testing.assert_array_equal(state.dq, np.clip(u, -MODEL.velocity_max, MODEL.velocity_max))
        np.testing.assert_array_equal(state.q, before.q + DT * state.dq)
    assert (np.abs(u) > MODEL.velocity_max).any()


def test_a_step_does_not_change_earlier_states():
    plant, u = KinematicPlant(MODEL), np.full(MODEL.n, 0.1)
    first = plant.step(Command(0.0, u), DT)
    kept = first.q.copy(), first.dq.copy()
    u[:] = 0.3  # the command's own array, too
    plant.step(Command(0.0, u), DT)
    np.testing.assert_array_equal(first.q, kept[0])
    np.testing.assert_array_equal(first.dq, kept[1])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_invalid_velocities_are_refused_without_motion(bad):
    plant = KinematicPlant(MODEL)
    before, u = plant.state, np.zeros(MODEL.n)
    u[3] = bad
    for velocity in (u, np.zeros(MODEL.n - 1), np.zeros((MODEL.n, 1))):
        with pytest.raises(PlantError, match="finite velocities"):
            plant.step(Command(0.0, velocity), DT)
        assert plant.state is before


@pytest.mark.filterwarnings("error")
def test_velocities_of_any_size_are_clamped_without_a_warning():
    state = KinematicPlant(MODEL).step(Command(0.0, np.full(MODEL.n, 1e300)), DT)
    np.testing.assert_allclose(state.q, np.minimum(DT * MODEL.velocity_max, MODEL.q_max))


def test_an_invalid_start_posture_is_refused():
    for q in (np.zeros(MODEL.n + 1), np.full(MODEL.n, np.nan)):
        with pytest.raises(PlantError, match="finite angles"):
            KinematicPlant(MODEL, q)


def test_a_robot_without_velocity_limits_is_integrated():
    free = dataclasses.replace(MODEL, velocity_max=np.full(MODEL.n, np.inf))
    u = np.full(MODEL.n, 1e3)
    np.testing.assert_array_equal(KinematicPlant(free).step(Command(0.0, u), DT).q, DT * u)
