"""The load of each foot from the torques of the joints: the balance of a leg, and the physics engine's wrench."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import dqwalk_ros as dq
from dqwalk_ros.config import overlaid
from dqwalk_ros.estimation.load import FootLoads, share_of
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.paper.state import State
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.report import analyse, report
from dqwalk_ros.simulation import simulate
from dqwalk_ros.walks.table import make_controller

CONFIG = overlaid(dq.load("poppy_dynamic"), "physics")
MODEL = dq.load_model(CONFIG.robot)
FEET = tuple(Foot)
NOISE = {
    "servo.types": ["*=MX-28", "?_hip_y=MX-64", "abs_[xy]=MX-64"], "sensors.attitude_noise": 0.004,
    "sensors.gyro_noise": 0.02, "sensors.encoder": 0.001534, "sensors.velocity_filter": 0.01,
}  # fmt: skip


def posture(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return random joint angles and a random vertical of the inertial sensor."""
    random = np.random.default_rng(seed)
    q = MODEL.posture(CONFIG.standing.posture) + 0.15 * random.normal(size=MODEL.n)
    up = np.array([0.0, 0.0, 1.0]) + 0.1 * random.normal(size=3)
    return np.clip(q, MODEL.q_min, MODEL.q_max), up / np.linalg.norm(up)


def at_rest(q: np.ndarray, effort: np.ndarray) -> State:
    return State(0.0, q, np.zeros(MODEL.n), effort=effort)


@pytest.mark.parametrize("base", Foot)
def test_a_vertical_force_on_the_other_sole_is_found_exactly(base: Foot) -> None:
    q, up = posture(1)
    kin = Kinematics.measured(MODEL, q, base, up)
    sole, force = MODEL.soles[base.other], 11.0
    lifts = kin.up @ kin.point_jacobian(sole.frame, sole.center)
    effort = MODEL.mass * GRAVITY * (kin.up @ kin.com_jacobian) - force * lifts  # with the base sole at rest
    loads = FootLoads(CONFIG, MODEL).update(kin, at_rest(q, effort))
    assert loads is not None
    assert loads[FEET.index(base.other)] == pytest.approx(force, abs=1e-9)


def test_loads_do_not_depend_on_the_base_sole() -> None:
    q, up = posture(2)
    effort = np.random.default_rng(3).normal(size=MODEL.n)
    one, other = (
        FootLoads(CONFIG, MODEL).update(Kinematics.measured(MODEL, q, base, up), at_rest(q, effort)) for base in Foot
    )
    np.testing.assert_allclose(one, other, atol=1e-9)
    assert one is not None
    assert np.abs(one).max() > 0.1


def test_loads_need_torques() -> None:
    q, up = posture(4)
    kin, loads = Kinematics.measured(MODEL, q, Foot.LEFT, up), FootLoads(CONFIG, MODEL)
    assert loads.update(kin, State(0.0, q, np.zeros(MODEL.n))) is None
    assert loads.update(kin, at_rest(q, np.full(MODEL.n, np.nan))) is None
    assert loads.update(kin, at_rest(q, np.where(np.arange(MODEL.n) == 3, np.nan, 1.0))) is None


def test_in_the_air_each_foot_has_half_of_nothing() -> None:
    assert [share_of(foot, np.zeros(2)) for foot in Foot] == [0.5, 0.5]


@pytest.mark.parametrize(("passed", "part"), [(0.005, 1.0 / 3.0), (0.01, 0.5), (0.2, 1.0)])
def test_loads_follow_the_torques_within_the_time_since_the_last_state(passed: float, part: float) -> None:
    """With a time constant of 10 ms; after a gap they begin again."""
    q, up = posture(5)
    kin, efforts = Kinematics.measured(MODEL, q, Foot.LEFT, up), np.random.default_rng(6).normal(size=(2, MODEL.n))
    first, last = (FootLoads(CONFIG, MODEL).update(kin, at_rest(q, effort)) for effort in efforts)
    loads = FootLoads(CONFIG, MODEL)
    for time, effort in ((100.0, efforts[0]), (100.0 + passed, efforts[1])):
        found = loads.update(kin, replace(at_rest(q, effort), time=time))
    assert first is not None
    assert last is not None
    assert np.abs(last - first).max() > 0.1
    np.testing.assert_allclose(found, first + part * (last - first), atol=1e-6)


@pytest.mark.parametrize("wrong", [10.0, 1e6, 1e100, 1e300])
def test_one_wrong_torque_is_forgotten_soon(wrong: float) -> None:
    plant = make_plant("physics", CONFIG, MODEL)
    state, loads = plant.state, FootLoads(CONFIG, MODEL)
    kin = Kinematics.measured(MODEL, state.q, Foot.LEFT, state.up)
    assert state.effort is not None
    first = loads.update(kin, state)
    assert first is not None
    for k in range(1, 21):
        effort = np.where(np.arange(MODEL.n) == MODEL.joint_names.index("l_hip_y"), wrong, state.effort)
        later = replace(state, time=state.time + k * CONFIG.dt, effort=effort if k == 1 else state.effort)
        last = loads.update(kin, later)
    np.testing.assert_allclose(last, first, rtol=0.01)


@pytest.mark.parametrize("slope", [0.0, 0.09, -0.05])
def test_a_standing_robot_knows_which_foot_bears_what(slope: float) -> None:
    plant = make_plant("physics", CONFIG.updated({"physics.slope_side": slope}), MODEL)
    state, true = plant.state, plant.truth
    assert true is not None
    loads = FootLoads(CONFIG, MODEL).update(Kinematics.measured(MODEL, state.q, Foot.LEFT, state.up), state)
    assert loads is not None
    forces = np.array([true.wrenches[foot][2] for foot in Foot])
    assert share_of(Foot.LEFT, loads) == pytest.approx(forces[0] / forces.sum(), abs=0.1)
    assert share_of(Foot.LEFT, loads) + share_of(Foot.RIGHT, loads) == pytest.approx(1.0)


def test_measured_forces_are_the_loads() -> None:
    """They are filtered, and neither torques nor velocities are needed."""
    plant = make_plant("physics", CONFIG.updated({"plant.foot_force": True, "physics.slope_side": 0.09}), MODEL)
    state, true, loads = replace(plant.state, effort=None, dq=None), plant.truth, FootLoads(CONFIG, MODEL)
    assert true is not None
    kin = Kinematics.measured(MODEL, state.q, Foot.LEFT, state.up)
    forces = np.array([np.linalg.norm(true.wrenches[foot][:3]) for foot in Foot])
    assert loads.update(kin, state) == pytest.approx(forces)
    assert forces.sum() == pytest.approx(MODEL.mass * GRAVITY, rel=0.02)
    lifted = replace(state, time=state.time + CONFIG.dt, forces=np.array([0.0, 1e300]))
    left, right = np.asarray(loads.update(kin, lifted)) / forces
    assert 0.5 < left < 1.0 < right < 3.0


@pytest.mark.long
@pytest.mark.parametrize("slope", [0.0, 0.105])
def test_a_walking_robot_knows_which_foot_bears_what(slope: float) -> None:
    config = CONFIG.updated({"gait.steps": 14, "gait.step_length": 0.04, "physics.slope_side": slope, **NOISE})
    trace = simulate(make_controller(config, MODEL), make_plant("physics", config, MODEL))
    error = report(analyse(trace))["physics"]["load_error"]
    print(f"\nside slope of {slope} rad: the load of a foot is {error:.3f} of the weight off (median)")
    assert error < 0.1


@pytest.mark.long
@pytest.mark.parametrize(("noise", "most"), [({}, 0), (NOISE, 8)])
def test_a_touchdown_is_seen_in_the_loads_within_10_ms(noise: dict[str, object], most: int) -> None:
    """It is the first state in which the foot that swung bears a fifth of the weight; `most` may be later or missed."""
    config = CONFIG.updated({"gait.steps": 20, **noise})
    trace = simulate(make_controller(config, MODEL), make_plant("physics", config, MODEL))
    physics, loads, starts = trace.physics, trace.loads, [record.time for record in trace.phases]
    assert physics is not None
    assert loads is not None
    errors = list[float]()
    for record, until in zip(trace.phases, [*starts[2:], math.inf], strict=False):
        if record.kind is not PhaseKind.SINGLE_SUPPORT:
            continue
        began = record.time + 0.5 * config.standing.swing_duration
        window, swing = (began <= trace.time) & (trace.time < until), record.support.other
        estimated, true = loads[window, list(Foot).index(swing)], physics.wrenches[swing][window, 2]
        seen, bore = (np.argmax(load > 0.2 * MODEL.mass * GRAVITY) for load in (estimated, true))
        errors.append(float(trace.time[window][seen] - trace.time[window][bore]))
    late = int((np.abs(errors) > 0.0101).sum())
    print(f"\n{len(errors) - late} of {len(errors)} touchdowns are seen within 10 ms of the engine's")
    assert len(errors) == 21
    assert late <= most
