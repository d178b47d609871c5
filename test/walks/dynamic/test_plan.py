"""The plan of the dynamic walk: DCM over footprints."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from dynamic_poppy import OMEGA, supports

from dqwalk_ros.walks.dynamic.plan import Pressed, Rest, single_supports

MIRROR = np.array([1.0, -1.0])


@pytest.mark.parametrize(
    "reference",
    [
        Pressed(np.array([0.0, 0.04]), np.array([0.05, -0.04]), np.array([0.04, 0.01]), 0.1, OMEGA),
        Pressed(np.array([0.0, 0.04]), np.array([0.0, 0.04]), np.array([0.03, 0.01]), 0.4, OMEGA),
        Rest(np.array([0.0, 0.0]), np.array([0.01, 0.02]), 0.6, OMEGA),
    ],
    ids=["double", "single", "rest"],
)
def test_xi_diverges_from_z(reference: Pressed | Rest) -> None:
    h = 1e-6
    for t in np.linspace(0.05, 0.9, 7) * reference.duration:
        xi, z = reference.at(t)
        slope = (reference.at(t + h)[0] - reference.at(t - h)[0]) / (2.0 * h)
        assert slope == pytest.approx(OMEGA * (xi - z), abs=1e-7)
    again = pickle.loads(pickle.dumps(reference))  # in another process its function has another address
    assert "compiled" not in vars(again)
    np.testing.assert_array_equal(again.at(0.1), reference.at(0.1))


@pytest.mark.parametrize("roll", [0.0, 0.015])
def test_the_plan_is_continuous(roll: float) -> None:
    every = supports(roll=roll)
    every[3] = every[3]._replace(double=0.2, single=0.3)
    plan = single_supports(every, OMEGA, ends=False)
    assert len(plan) == len(every) - 1
    for k, (start, end) in enumerate(plan):
        a, b = every[k], every[k + 1]
        assert Pressed(a.first, a.last, end, a.single, OMEGA).at(0.0)[0] == pytest.approx(start)
        if k + 1 < len(plan):
            begins, _ = plan[k + 1]
            double = Pressed(a.last, b.first, begins, b.double, OMEGA)
            assert double.at(0.0)[0] == pytest.approx(end)
            assert double.at(b.double)[0] == pytest.approx(begins)


@pytest.mark.parametrize("ends", [False, True])
def test_plans_of_left_and_right_are_mirrored(ends: bool) -> None:
    left = single_supports(supports(roll=0.01), OMEGA, ends=ends)
    right = single_supports(supports(first=-1.0, roll=0.01), OMEGA, ends=ends)
    assert np.array(left) * MIRROR == pytest.approx(np.array(right))


def test_distant_steps_hardly_affect_the_plan() -> None:
    on, off = (single_supports(supports(), OMEGA, ends=ends)[0][0] for ends in (False, True))
    assert np.abs(on - off).max() < 1e-4


def test_stepping_in_place_is_periodic() -> None:
    plan = single_supports(supports(length=0.0), OMEGA, ends=False)
    assert plan[0][0] == pytest.approx(plan[2][0], abs=1e-4)
    assert plan[0][0] * MIRROR == pytest.approx(plan[1][0], abs=1e-3)
    assert plan[0][0][0] == pytest.approx(0.0, abs=1e-12)
