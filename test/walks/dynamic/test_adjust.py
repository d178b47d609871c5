"""Where and when a step ends, by the measured motion."""

from __future__ import annotations

import numpy as np
import pytest
from dynamic_poppy import CONFIG, OMEGA, supports

from dqwalk_ros.walks.dynamic.adjust import Step, adjusted, left_over, transfer_time
from dqwalk_ros.walks.dynamic.plan import Pressed, single_supports

DYNAMIC = CONFIG.dynamic


def a_step() -> Step:
    (here, _, _, _), (there, _, _, _), *_ = every = supports()
    (_, end), *_ = single_supports(every, OMEGA, ends=False)
    half = np.array([0.06, 0.015])
    return Step(
        z=here, landing=there, offset=end - there, duration=0.4, omega=OMEGA,
        low=here - half, high=here + half, reach=np.array([0.1, 0.0]),
    )  # fmt: skip


def at(step: Step, elapsed: float) -> np.ndarray:
    return Pressed(step.z, step.z, step.landing + step.offset, step.duration, OMEGA).at(elapsed)[0]


def test_small_errors_do_not_change_the_step() -> None:
    step = a_step()
    for elapsed in (0.05, 0.15, 0.25):
        for error in ([0.0, 0.0], [0.01, 0.0], [0.0, 0.003], [-0.008, -0.003]):  # within the range of the ankle
            xi = at(step, elapsed) + np.array(error)
            time, shift, over = adjusted(step, xi, elapsed, 0.4, np.zeros(2), DYNAMIC)
            assert time == pytest.approx(0.4, abs=0.006)
            assert np.abs(shift).max() < 0.002
            assert over == pytest.approx([0.0, 0.0], abs=1e-3)


def test_left_over_is_the_error_beyond_the_ankle_range() -> None:
    step, elapsed, left = a_step(), 0.1, 0.3
    xi = at(step, elapsed) + np.array([0.08, 0.02])
    over, _ = left_over(step, xi, elapsed, left)
    # with the zero-moment point in the corner of the sole, the error of xi at the end of the step
    reached = step.high + np.exp(OMEGA * left) * (xi - step.high)
    assert over == pytest.approx(reached - step.landing - step.offset)


def test_a_push_changes_position_and_time_of_the_step() -> None:
    step, xi = a_step(), at(a_step(), 0.15)
    time, shift = 0.4, np.zeros(2)
    for _ in range(20):
        time, shift, _ = adjusted(step, xi + np.array([0.06, 0.0]), 0.15, time, shift, DYNAMIC)
    assert shift[0] > 0.02
    for _ in range(20):  # towards the other foot: the step must end earlier
        time, shift, _ = adjusted(step, xi - np.array([0.0, 0.03]), 0.15, time, shift, DYNAMIC)
    assert time < 0.35
    assert shift[1] == 0.0  # there is no ankle roll


def test_a_double_support_lasts_until_xi_has_arrived() -> None:
    a, b = np.array([0.0, 0.0]), np.array([0.05, -0.08])
    reference = Pressed(a, b, np.array([0.06, -0.06]), 0.1, OMEGA)
    xi, z = reference.at(0.03)
    assert transfer_time(reference, z, xi, 0.0) == pytest.approx(0.07, abs=0.005)
    behind = xi + np.array([0.0, 0.006])
    longer = transfer_time(reference, z, behind, 0.07)
    assert longer > 0.08
    begin, _ = Pressed(z, b, reference.end, longer, OMEGA).at(0.0)  # of the longer double support
    assert begin[1] == pytest.approx(behind[1], abs=2e-3)
    assert transfer_time(reference, z, xi - np.array([0.0, 0.015]), 0.07) == pytest.approx(0.07)
    assert transfer_time(reference, z, behind, 0.45) == pytest.approx(0.45, abs=0.011)  # longer than what is tried
