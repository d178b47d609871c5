"""The order of the phases, the footprints, and the rules that end a phase."""

from __future__ import annotations

import numpy as np
import pytest
from robots import legs
from walks import walk

from dqwalk_ros.config import load
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import EndRule, PhaseKind
from dqwalk_ros.paper.state import State
from dqwalk_ros.paper.walk import PaperWalk
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.support.errors import PhaseError, StateError
from dqwalk_ros.walks.table import make_controller

PAPER = load("paper")
FAST = {"task.eta": 0.5, "task.damping": 0.03, "gait.phase_timeout": 60.0}
"""Ten times as fast as the paper, so that failures occur early."""


@pytest.mark.parametrize(("first", "second"), [("left", "right"), ("right", "left")])
def test_the_four_phases_repeat(first, second):
    config = PAPER.updated({"gait.first_support": first, "gait.cycles": 3})
    sequence = []
    while (following := PaperWalk.phase_at(config, len(sequence))) is not None:
        sequence.append((following[0].value, following[1].value))
    double, single = "double_support", "single_support"
    assert sequence == 3 * [(double, first), (single, first), (double, second), (single, second)]


def test_footsteps_are_ahead_and_flat(foot):
    x = DQ(PaperWalk(PAPER, legs()).footstep(foot))
    at_zero = Kinematics(legs(), np.zeros(10), foot)
    np.testing.assert_allclose(x.translation(), at_zero.point(at_zero.swing) + np.array([0.05, 0.0, 0.0]), atol=1e-12)
    np.testing.assert_allclose(x.rotation(), [1.0, 0.0, 0.0, 0.0])
    config = PAPER.updated({"gait.step_width": 0.12, "gait.step_length": -0.02})
    wide = DQ(PaperWalk(config, legs()).footstep(foot))
    np.testing.assert_allclose(wide.translation(), [-0.02, -0.12 if foot is Foot.LEFT else 0.12, 0.0])


# ---------------------------------------------------------------------- end rules, with synthetic errors


def rule(kind, **changes):
    config = PAPER.updated({"dsp.stall_window": 0.05, "gait.phase_timeout": 10.0, **changes})
    return EndRule(config, f"{kind.value}/left", double=kind is PhaseKind.DOUBLE_SUPPORT)


def ticks_until_over(rule, errors, active=("sliding",)):
    for k, error in enumerate(errors):
        try:
            if rule.is_over(error.item, 0.005 * k):
                return k
        except PhaseError as failed:
            raise failed.held_by(active) from failed
    return None


def test_single_support_ends_below_the_threshold():
    errors = np.geomspace(0.1, 1e-4, 200)
    k = ticks_until_over(rule(PhaseKind.SINGLE_SUPPORT), errors)
    assert errors[k] < 1e-3 <= errors[k - 1]


def test_double_support_ends_when_its_error_stops_decreasing():
    t = 0.005 * np.arange(1000)
    errors = 0.04 + 0.03 * np.exp(-2.0 * t)
    k = ticks_until_over(rule(PhaseKind.DOUBLE_SUPPORT), errors)
    assert errors[k - 10] - errors[k] < 1e-4 <= errors[k - 11] - errors[k - 1]


def test_double_support_does_not_end_outside_the_cylinder():
    t = 0.005 * np.arange(1000)
    with pytest.raises(PhaseError, match=r"has stalled at an error of 0\.06") as caught:
        ticks_until_over(rule(PhaseKind.DOUBLE_SUPPORT), 0.06 + 0.01 * np.exp(-5.0 * t))
    assert caught.value.phase == "double_support/left"
    assert caught.value.error == pytest.approx(0.06, abs=1e-4)
    assert caught.value.active == ("sliding",)


def test_a_phase_has_a_time_limit():
    with pytest.raises(
        PhaseError, match=r"single_support/left is not over after 10 s at an error of .*; active: sliding"
    ):
        # it decreases fast enough not to stall, but starts too large
        ticks_until_over(rule(PhaseKind.SINGLE_SUPPORT), np.exp(-0.2 * 0.005 * np.arange(3000)))


def test_a_slow_phase_is_not_stalled():
    """The phase continues while the goal can be reached within the time limit at the present rate."""
    errors = 0.05 - 0.006 * 0.005 * np.arange(1960)  # 8.2 s from 0.05 to the threshold
    assert ticks_until_over(rule(PhaseKind.SINGLE_SUPPORT), errors) == 1634


def test_a_stall_without_active_constraints_is_a_local_minimum():
    with pytest.raises(PhaseError, match="no constraint is active: a local minimum of the task"):
        ticks_until_over(rule(PhaseKind.SINGLE_SUPPORT), np.full(3000, 0.02), active=())


def test_a_timeout_while_the_error_decreases_is_no_local_minimum():
    with pytest.raises(PhaseError, match=r"gait\.phase_timeout may be too short; no constraint is active$"):
        ticks_until_over(rule(PhaseKind.SINGLE_SUPPORT), np.exp(-0.2 * 0.005 * np.arange(3000)), active=())


# ---------------------------------------------------------------------- infeasible walks


def failure(**changes):
    """Walk until a phase fails; return the error."""
    config = PAPER.updated({**FAST, **changes})
    controller, plant = make_controller(config, legs()), KinematicPlant(legs())

    def run():
        while plant.state.time < 200.0 and not controller.finished:
            plant.step(controller.step(plant.state, config.dt), config.dt)

    with pytest.raises(PhaseError) as caught:
        run()
    kin = Kinematics(legs(), plant.state.q, controller.phase.base)
    for name, d in controller.phase.distances(kin.q).items():
        assert d > -1e-4, name  # no constraint is violated
    return caught.value


def test_a_step_that_is_too_long_fails():
    """20 cm: the swing stalls, and the error names the phase, the error and the active constraints."""
    error = failure(**{"gait.step_length": 0.2})
    assert error.phase == "single_support/left"
    assert error.error > 2e-3
    assert error.active
    assert set(error.active) <= {"com_cylinder", "pelvis"} | {
        f"joint_{end}/{name}" for end in ("min", "max") for name in legs().joint_names
    }
    assert error.phase in str(error)
    assert error.active[0] in str(error)


def test_an_unreachable_cylinder_fails():
    """The hip limits of Poppy keep the CoM more than 5 mm from the centre of the foot."""
    error = failure(**{"ssp.com_radius": 0.005})
    assert error.phase == "double_support/left"
    assert error.error > 0.005
    assert error.active
    assert "it ends below 0.005 m" in str(error)


def test_a_failed_simulation_notes_the_reason():
    trace = walk(PAPER.updated({**FAST, "gait.phase_timeout": 1.0}), legs())
    assert not trace.finished
    assert len(trace.notes) == 1
    assert trace.notes[0].startswith("double_support/left is not over after 1 s")
    assert np.isfinite(trace.q).all()
    assert np.isnan(trace.u[-1]).all()


# ---------------------------------------------------------------------- invalid states


@pytest.mark.parametrize(
    ("q", "message"),
    [
        (np.zeros(9), "the state has 9 joints, the model 10"),
        (np.array([0.0] * 4 + [np.nan] + [0.0] * 5), "the angle of l_ankle_y is not finite"),
        (np.full(10, np.inf), "the angle of l_hip_x, .* is not finite"),
    ],
)
def test_invalid_states_are_rejected(q, message):
    controller, plant = make_controller(PAPER, legs()), KinematicPlant(legs())
    with pytest.raises(StateError, match=message):
        controller.step(State(0.0, q), 0.005)
    for _ in range(3):  # also during the walk and after a pause; the walk continues with the next valid state
        plant.step(controller.step(plant.state, 0.005), 0.005)
    for time in (plant.state.time, plant.state.time + 10.0):
        with pytest.raises(StateError, match=message):
            controller.step(State(time, q), 0.005)
    again, same = make_controller(PAPER, legs()), KinematicPlant(legs())
    for _ in range(3):
        same.step(again.step(same.state, 0.005), 0.005)
    np.testing.assert_array_equal(controller.step(plant.state, 0.005).velocity, again.step(same.state, 0.005).velocity)
