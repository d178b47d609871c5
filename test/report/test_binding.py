"""What binds a walk: the part of the torque-speed curves that it needs, and the limits that commands reach."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

import dqwalk_ros as dq
from dqwalk_ros.config import overlaid
from dqwalk_ros.estimation.predictor import Predictor
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.report import analyse
from dqwalk_ros.report.binding import acting, limits_at, limits_reached, most_loaded
from dqwalk_ros.robot.servos import Servos
from dqwalk_ros.simulation import simulate
from dqwalk_ros.trace import PhysicsRecord, Trace
from dqwalk_ros.walks.table import make_controller, make_walk

CONFIG = overlaid(dq.load("poppy_dynamic"), "physics").updated({"servo.types": ("*=MX-28", "?_hip_y=MX-64")})
MODEL = dq.load_model(CONFIG.robot)


def test_a_servo_gives_its_stall_torque_at_rest_and_none_at_its_no_load_speed() -> None:
    servos = Servos.of(CONFIG, MODEL)
    assert servos.load(-servos.torque, np.zeros(MODEL.n)) == pytest.approx(1.0)
    assert servos.load(np.zeros(MODEL.n), servos.torque / servos.back_emf) == pytest.approx(1.0)
    assert servos.load(0.25 * servos.torque, 0.5 * servos.torque / servos.back_emf) == pytest.approx(0.75)
    assert servos.load(-0.25 * servos.torque, 0.5 * servos.torque / servos.back_emf) == pytest.approx(0.25)  # brakes


def test_the_most_loaded_servo_is_that_closest_to_its_line() -> None:
    servos, n, joint = Servos.of(CONFIG, MODEL), MODEL.n, 3
    time, q, effort = 0.01 * np.arange(5), np.zeros((5, n)), np.zeros((5, n))
    q[3:, joint] = 0.02  # 2 rad/s in the period before the state of index 3
    effort[3, joint] = 0.5 * servos.torque[joint]
    effort[2, joint + 1] = 0.4 * servos.torque[joint + 1]
    nothing = np.full((5, 8), np.nan)
    physics = PhysicsRecord(
        pelvis=nothing, wrenches=dict.fromkeys(Foot, nothing[:, :6]), cop=nothing[:, :3], orientation=nothing[:, :4],
        gyro=nothing[:, :3], acceleration=nothing[:, :3], q=q, effort=effort,
    )  # fmt: skip
    trace = Trace(
        config=CONFIG, model=MODEL, time=time, q=q, u=q, phases=(), solve_time=time, finished=True, physics=physics
    )
    load = most_loaded(trace)
    assert load is not None
    assert (load.joint, load.time) == (MODEL.joint_names[joint], pytest.approx(0.03))
    assert load.part == pytest.approx(0.5 + 2.0 * servos.back_emf[joint] / servos.torque[joint])


def test_the_limits_found_in_a_record_are_those_of_the_quadratic_programs() -> None:
    """Of a controller that predicts the angles at which its commands act."""
    changes = {"gait.steps": 1, "joints.velocity": 1.0, "servo.assumed_latency": 0.02, "dynamic.trunk_weight": 0.0}
    config, found = CONFIG.updated({**changes, "joints.margin": 0.19}), Counter[str]()
    controller = make_controller(config, MODEL)
    fastest = np.minimum(MODEL.velocity_max, 1.0)

    class Watched(KinematicPlant):
        def step(self, command, dt):  # type: ignore[no-untyped-def]
            if controller.phase.kind is not PhaseKind.STANCE:
                problem = controller.problem
                assert problem is not None
                found.update(limits_at(command.velocity, problem.lower, problem.upper, fastest, MODEL))
            super().step(command, dt)

    trace = simulate(controller, Watched(MODEL, make_walk(config, MODEL).posture))
    assert trace.finished, trace.notes
    reached = limits_reached(analyse(trace), acting(trace)[0])
    assert reached == found
    assert {name.split("/")[0] for name in reached} == {"speed", "joint_min"}


def test_after_an_interruption_the_commands_before_it_are_compared_with_no_angle(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As the controller does, when the plant has held still."""
    calls = list[bool]()
    monkeypatch.setattr(Predictor, "interrupt", lambda predictor: calls.append(True))
    time, q = np.array([0.0, 0.005, 0.01, 0.5, 0.505]), np.zeros((5, MODEL.n))
    trace = Trace(config=CONFIG, model=MODEL, time=time, q=q, u=q + 1.0, phases=(), solve_time=time, finished=True)
    angles, _ = acting(trace)
    assert len(calls) == 1
    assert np.array_equal(angles[3], q[3])
