"""The whole-body controller in closed loop with the physics engine, by joint torques."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dqwalk_ros.config import load
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.whole_body import SCENARIOS, Scenario, WholeBodyController, WholeBodyTrace, experiments, torque_plant
from dqwalk_ros.whole_body.dynamics import Multibody
from dqwalk_ros.whole_body.torque_plant import TorquePlant

CONFIG = load("whole_body")
MODEL = load_model(CONFIG.robot)


def walk(scenario: Scenario) -> WholeBodyTrace:
    return experiments.walk(CONFIG, scenario, "physics")


def test_the_robot_walks_on_compliant_ground() -> None:
    walked = walk(Scenario("soft", 1.15, ((0.0, (1.2, -0.8, 0.9)),)))
    assert walked.stood, walked.note
    assert walked.error[-1] < walked.error[0] - 0.3
    assert walked.footholds()[-1][1][0] > 0.1
    assert np.abs(walked.height_error).max() < 5e-3
    assert walked.tilt.max() < 0.05


def test_a_push_is_an_impulse() -> None:
    """Without contacts, the momentum equals the impulse plus that of gravity."""
    controller = WholeBodyController(CONFIG, MODEL)
    start = controller.start
    high = start.x_base.copy()
    high[4:] = 0.0
    high[7] = 2.0  # upright, 4 m up
    plant = TorquePlant(MODEL, replace(start, x_base=high), pushed="chest")
    still = replace(controller.step(start, CONFIG.dt), effort=np.zeros(MODEL.n))
    plant.push([0.0, 15.0, 0.0])
    for _ in range(12):
        state = plant.step(still, CONFIG.dt)
    body = Multibody(MODEL)
    d = body.at(state.x_base, state.q, state.v)
    assert body.mass * d.com_velocity == pytest.approx([0.0, 15.0, -body.mass * GRAVITY * 0.06], abs=0.01)


@pytest.mark.parametrize("dt", [0.005, 0.0025, 0.0045, 0.0125, 1.0 / 60.0])
def test_the_time_and_the_impulse_of_a_push_do_not_depend_on_the_period(dt: float) -> None:
    """The engine's step divides the period, and a push that ends within a step has its whole impulse."""
    controller = WholeBodyController(CONFIG, MODEL)
    plant = TorquePlant(MODEL, controller.start, pushed="chest")
    still = controller.step(controller.start, dt)
    plant.push([0.0, 15.0, 0.0])
    given, engine, data = 0.0, torque_plant.mujoco.mj_step, plant._data

    def spy(mj: object, d: object) -> None:
        nonlocal given
        given += data.xfrc_applied[:, 1].sum() * plant._mj.opt.timestep
        engine(mj, d)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(torque_plant.mujoco, "mj_step", spy)
        for _ in range(24):
            state = plant.step(still, dt)
    assert data.time == pytest.approx(state.time, abs=1e-9)
    assert plant._mj.opt.timestep <= 0.001 + 1e-9
    assert given == pytest.approx(15.0, rel=1e-6)


@pytest.mark.long
def test_scenario_1_completes() -> None:
    walked = walk(SCENARIOS["1"])
    assert walked.stood, walked.note
    assert walked.error[walked.at(4.0)] < 0.10
