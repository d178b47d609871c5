"""Prediction of the state after the delay, and walks with delays that do not fall."""

from __future__ import annotations

import numpy as np
import pytest

import dqwalk_ros as dq
from dqwalk_ros.controller import VelocityController
from dqwalk_ros.estimation.delay import CommandHistory
from dqwalk_ros.paper.state import Estimate, State
from dqwalk_ros.studies import robustness
from dqwalk_ros.walks.table import make_controller, make_walk

CONFIG = dq.load("poppy")
MODEL = dq.load_model(CONFIG.robot)


def test_pending_motion_is_the_integral_of_commands_over_the_delay() -> None:
    """Compared with the integral of the commands over the delay, which is not a multiple of the period."""
    rng, dt, delay = np.random.default_rng(0), 0.005, 0.0228
    history, u = CommandHistory(delay, 3), rng.normal(size=(200, 3))
    times = dt * np.arange(201)
    integral = np.concatenate([np.zeros((1, 3)), np.cumsum(dt * u, axis=0)])
    for k in range(200):
        past = np.array([np.interp(times[k] - delay, times, column) for column in integral.T])
        assert history.pending(times[k]) == pytest.approx(integral[k] - past, abs=1e-12)
        history.add(times[k], u[k], dt)


def test_after_a_pause_all_of_a_new_command_is_pending() -> None:
    history = CommandHistory(0.04, 1)
    history.add(0.0, np.ones(1), 0.02)
    history.add(1.0, np.ones(1), 0.02)
    assert history.pending(1.02)[0] == pytest.approx(0.02)
    assert history.pending(1.05)[0] == pytest.approx(0.01)


def test_without_a_delay_nothing_is_pending() -> None:
    history = CommandHistory(0.0, 2)
    for k in range(10):
        assert np.abs(history.pending(0.005 * k)).max() < 1e-15
        history.add(0.005 * k, np.ones(2), 0.005)


@pytest.mark.parametrize("delay", [0.0, 0.05])
def test_the_command_history_is_bounded(delay: float) -> None:
    history = CommandHistory(delay, 2)
    for k in range(1000):
        history.add(0.005 * k, np.ones(2), 0.005)
    assert len(history._sums) <= delay / 0.005 + 3


def controller_with(**values: float) -> VelocityController:
    config = CONFIG.updated({f"servo.{key}": value for key, value in values.items()})
    return make_controller(config, MODEL)


def test_the_program_is_evaluated_at_the_state_after_the_delay() -> None:
    """The program equals that of a controller without delay at the state and time one delay later."""
    delayed, undelayed = controller_with(assumed_latency=0.02), controller_with()
    q = make_walk(CONFIG, MODEL).posture
    sent = []
    for k in range(30):
        now = q.copy()  # the robot has not moved yet: the commands of the last 20 ms are pending
        sent.append(delayed.step(State(0.005 * k, now + 0.005 * np.sum(sent[:-4], axis=0)), 0.005).velocity)
    ahead = q + 0.005 * np.sum(sent[:-1], axis=0)
    expected = delayed.phase.evaluate(
        ahead, np.array([0.0, 0.0, 1.0]), 29 * 0.005 + 0.02, 0.005, undelayed._limit
    ).problem
    found = delayed.problem
    assert found is not None
    for name in ("H", "c", "W", "w"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), abs=1e-9), name


def test_servo_damping_is_fed_forward() -> None:
    q, dq_, up = make_walk(CONFIG, MODEL).posture, 0.1 * np.random.default_rng(1).normal(size=MODEL.n), [0.0, 0.0, 1.0]
    state = State(0.0, q, dq_, np.array(up), np.zeros(3))
    controller = controller_with(assumed_damping=0.02)
    command = controller.step(state, 0.005)
    kin = controller._kinematics(state, controller.phase.base)
    seen = Estimate(0.0, q, dq_, np.array(up), np.zeros(3), elapsed=0.02)
    balance = controller.walk.effort(controller.phase, kin, seen, command.velocity)
    assert command.effort == pytest.approx(balance - 0.02 * 60.0 * (dq_ - command.velocity))


@pytest.mark.parametrize(
    "changes",
    [
        {"servo.stiffness": 25.0, "servo.latency": 0.04, "servo.rate": 50.0, "servo.backlash": 0.0058},
        pytest.param(
            {"servo.stiffness": 40.0, "servo.latency": 0.04, "physics.mass_scale": 1.1, "physics.friction": 0.4},
            marks=pytest.mark.long,
        ),
    ],
    ids=["25", "40"],
)
def test_walks_with_soft_delayed_servos(changes: dict[str, float]) -> None:
    found = robustness.walk(CONFIG.updated({"gait.steps": 2, "qp.solver": "daqp"}), 0, changes)
    assert found.stood, found.reason
