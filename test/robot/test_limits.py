"""Limits of the joints: reachable angles, clamped velocities and torques."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dqwalk_ros.config import load
from dqwalk_ros.robot.limits import clamp_effort, clamp_velocity, outside_limits, unreachable
from dqwalk_ros.robot.model import RobotModel, load_model

DT = 0.005


@pytest.fixture(scope="module")
def model() -> RobotModel:
    return load_model(load("paper").robot)


@pytest.mark.parametrize(
    ("q", "passed", "beyond"),
    [
        (0.121, 0.05, True), (0.119, 0.05, False), (-0.121, 0.05, True), (0.021, 0.0, True), (0.019, -1.0, False),
        (math.nan, 1.0, True), (math.inf, 1.0, True), (1e300, 1.0, True),
    ],
)  # fmt: skip
def test_an_angle_is_reachable_by_the_velocity_limit_and_the_time(q: float, passed: float, beyond: bool) -> None:
    found = unreachable(np.array([q, 0.0]), np.zeros(2), passed, np.full(2, 2.0), 0.02)
    assert found.tolist() == [beyond, False]


def test_every_joint_outside_its_limits_is_named(model: RobotModel) -> None:
    assert outside_limits(model.q_max + 0.2, model, 0.1).count(" by 0.2 rad") == model.n


speeds = st.floats(-1e6, 1e6, allow_nan=False)


@given(data=st.data())
def test_clamped_velocities_cross_no_limit(model: RobotModel, data: st.DataObject) -> None:
    u = np.array(data.draw(st.lists(speeds, min_size=model.n, max_size=model.n)))
    at = np.array(data.draw(st.lists(st.floats(0.0, 1.0), min_size=model.n, max_size=model.n)))
    dt = data.draw(st.floats(1e-4, 0.1))
    q = model.q_min + at * (model.q_max - model.q_min)
    v = clamp_velocity(u, q, model, dt)
    assert (np.abs(v) <= model.velocity_max).all()
    after = q + dt * v
    assert (after <= model.q_max + 1e-12).all()
    assert (after >= model.q_min - 1e-12).all()


@given(data=st.data())
def test_outside_its_limits_a_joint_moves_only_inward(model: RobotModel, data: st.DataObject) -> None:
    u = np.array(data.draw(st.lists(speeds, min_size=model.n, max_size=model.n)))
    out = np.array(data.draw(st.lists(st.floats(1e-9, 0.5), min_size=model.n, max_size=model.n)))
    v = clamp_velocity(u, model.q_max + out, model, DT)
    assert (v <= 0.0).all()
    v = clamp_velocity(u, model.q_min - out, model, DT)
    assert (v >= 0.0).all()


def test_outside_its_limits_a_joint_moves_only_if_commanded(model: RobotModel) -> None:
    for q in (model.q_max + 0.1, model.q_min - 0.1):
        assert not clamp_velocity(np.zeros(model.n), q, model, DT).any()
    np.testing.assert_array_equal(
        clamp_velocity(np.full(model.n, -0.2), model.q_max + 0.1, model, DT), np.full(model.n, -0.2)
    )


def test_a_command_beyond_the_limits_is_clamped_exactly_to_them(model: RobotModel) -> None:
    """To the velocity limit far from the joint limit, and to reach the joint limit within one period near it."""
    zero, fast = np.zeros(model.n), np.full(model.n, 1e3)
    far = np.minimum(model.q_max / 1e-4, model.velocity_max)
    np.testing.assert_allclose(clamp_velocity(fast, zero, model, 1e-4), far)
    np.testing.assert_allclose(
        clamp_velocity(-fast, zero, model, 1e-4), -np.minimum(-model.q_min / 1e-4, model.velocity_max)
    )
    np.testing.assert_allclose(0.1 * clamp_velocity(fast, model.q_max - 1e-3, model, 0.1), np.full(model.n, 1e-3))


def test_without_elapsed_time_the_clamped_velocity_is_zero(model: RobotModel) -> None:
    assert not clamp_velocity(np.ones(model.n), np.zeros(model.n), model, 0.0).any()
    assert not clamp_velocity(np.ones(model.n), np.zeros(model.n), model, -1.0).any()


def test_a_joint_without_a_velocity_limit_is_clamped_by_its_range(model: RobotModel) -> None:
    free = dataclasses.replace(model, velocity_max=np.full(model.n, np.inf))
    v = clamp_velocity(np.full(model.n, 1e9), np.zeros(model.n), free, DT)
    np.testing.assert_allclose(DT * v, free.q_max)


def test_torques_stay_within_the_limits(model: RobotModel) -> None:
    limited = dataclasses.replace(model, effort_max=np.arange(1.0, model.n + 1.0))
    requested = np.linspace(-30.0, 30.0, model.n)
    clamped = clamp_effort(requested, limited)
    assert (np.abs(clamped) <= limited.effort_max).all()
    np.testing.assert_array_equal(
        clamped[np.abs(requested) <= limited.effort_max], requested[np.abs(requested) <= limited.effort_max]
    )
