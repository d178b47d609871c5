"""Identification of servo parameters from an exercise of a robot that hangs; the fit does not know the true ones."""

from __future__ import annotations

import dataclasses
import math
import re

import numpy as np
import pytest

import dqwalk_ros as dq
from dqwalk_ros import cli
from dqwalk_ros.cli.identify import table, unexplained
from dqwalk_ros.config import Config, from_yaml, overlaid, with_files
from dqwalk_ros.identification import fit
from dqwalk_ros.identification.exercise import exercise_config, path_of
from dqwalk_ros.identification.replay import replay
from dqwalk_ros.plants.mujoco import PhysicsPlant
from dqwalk_ros.plants.sensors import Sensors
from dqwalk_ros.report.metrics import analyse
from dqwalk_ros.report.verdict import violations
from dqwalk_ros.robot.clearance import Clearance, limbs
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.servos import Drive, Servos
from dqwalk_ros.simulation import simulate
from dqwalk_ros.support.errors import BagError, ConfigError
from dqwalk_ros.trace import Trace
from dqwalk_ros.walks.table import make_controller, make_walk

pytestmark = pytest.mark.timeout(900)  # compilation is slow on a loaded machine
AS_BUILT = overlaid(dq.load("poppy"), "poppy_as_built")
REST = ["head_*", "*_shoulder_*", "*_arm_*", "*_elbow_*", "abs_*", "bust_*", "*_hip_x", "*_hip_z", "*_ankle_y"]
HIPS_AND_KNEES = exercise_config(AS_BUILT).updated({"robot.lock": REST})
LEGS = dq.load_model(HIPS_AND_KNEES.robot)


def exercised(config: Config, model: RobotModel, seed: int) -> tuple[Trace, np.ndarray, Servos]:
    """Simulate the exercise with random servos; return the trace, their true parameters (n, 5) and the servos.

    The trace contains the nominal configuration.
    """
    random, assumed = np.random.default_rng(seed), Servos.of(config, model)

    def factor(low: float, high: float) -> np.ndarray:
        return random.uniform(low, high, model.n)

    servos = dataclasses.replace(
        assumed,
        stiffness=assumed.stiffness * factor(0.6, 1.2),
        back_emf=assumed.back_emf * factor(0.8, 1.2),
        backlash=factor(0.002, 0.012),
        friction=assumed.friction * factor(0.5, 1.6),
        armature=assumed.armature * factor(0.95, 1.05),
    )
    latency, age = random.uniform(0.01, 0.06), random.uniform(0.0, 0.02)
    own = config.updated({"servo.latency": latency, "sensors.age": age, "sensors.seed": 1000 + seed})
    plant = PhysicsPlant(own, model, make_walk(config, model).posture, servos)
    trace = simulate(make_controller(config, model), plant)
    assert trace.finished
    # a reading is used at the next state
    delay = latency + math.ceil(age / config.dt - 1e-9) * config.dt
    columns = np.full(model.n, delay), servos.stiffness, servos.back_emf / servos.stiffness
    return trace, np.array([*columns, servos.backlash, servos.friction]).T, servos


def within(found: fit.Identified, true: np.ndarray) -> np.ndarray:
    """Return which values are identified: delay to 3 ms, stiffness to 10 %, backlash to 0.1 degrees, shape (n, 3)."""
    error = np.abs(found.value - true)
    return np.array([error[:, 0] < 0.003, error[:, 1] < 0.1 * true[:, 1], error[:, 3] < math.radians(0.1)]).T


def identified_config(found: fit.Identified, trace: Trace) -> Config:
    return from_yaml(fit.parameters(found, trace.config.dt, trace.model.mass), onto=trace.config)


def replay_error(trace: Trace, config: Config) -> np.ndarray:
    """Return the rms error of each joint angle of a replay [deg]."""
    return np.degrees(np.sqrt(np.mean((replay(trace, config) - trace.q) ** 2, axis=0)))


@pytest.fixture(scope="module")
def legs() -> tuple[Trace, np.ndarray, Servos]:
    return exercised(HIPS_AND_KNEES, LEGS, 0)


@pytest.fixture(scope="module")
def found(legs) -> fit.Identified:
    trace = legs[0]
    return fit.identify(trace, trace.physics.orientation)


# ---------------------------------------------------------------------- the exercise


def test_joints_of_a_limb_move_one_after_the_other_and_within_their_limits() -> None:
    path = path_of(LEGS, 1)
    assert (path > LEGS.q_min - 1e-9).all()
    assert (path < LEGS.q_max + 1e-9).all()
    assert not path[0].any()
    assert not path[-1].any()
    assert (np.ptp(path, axis=0) > 0.3).all()
    speed = np.abs(np.diff(path, axis=0)) / 0.005
    assert speed.max() < 2.5
    shaken = speed > 0.02
    assert sorted(joint for limb in limbs(LEGS) for joint in limb) == list(range(LEGS.n))
    for limb in limbs(LEGS):  # all joints of a limb move together only between postures
        assert shaken[:, limb].all(axis=1).mean() < 0.2
        assert shaken[:, limb].any(axis=1).mean() > 0.6


@pytest.mark.parametrize("lock", [REST, ["abs_y"], []])
def test_no_link_meets_another_one_during_the_exercise(lock: list[str]) -> None:
    """Shins and feet pressed on each other for 20 s, and where the legs end before the trunk on the way back."""
    from dqwalk_ros.plants.mujoco import own_contacts

    model = dq.load_model(exercise_config(dq.load("poppy")).updated({"robot.lock": lock}).robot)
    assert not own_contacts(model, path_of(model, 1)[::10])


def test_a_link_whose_shape_cannot_be_read_is_kept_clear_of_as_a_point() -> None:
    head, name, rest = LEGS.urdf.partition('<link name="l_foot">')
    broken = re.sub(r"<box [^>]*/>", '<mesh filename="nowhere.stl" />', rest.split("</link>")[0])
    robot = dataclasses.replace(LEGS, urdf=head + name + "</link>".join([broken, *rest.split("</link>")[1:]]))
    assert set(Clearance(robot)._links) == set(Clearance(LEGS)._links)


def test_a_held_robot_keeps_its_pelvis_pose_and_has_no_contacts(legs) -> None:
    physics = legs[0].physics
    np.testing.assert_allclose(physics.pelvis, np.tile(physics.pelvis[0], (len(legs[0]), 1)), atol=1e-12)
    assert not any(wrench.any() for wrench in physics.wrenches.values())
    assert not np.isfinite(physics.cop).any()


def test_soles_in_the_air_are_not_judged_as_soles_on_the_ground(legs) -> None:
    assert legs[0].finished
    assert not violations(analyse(legs[0]))


# ---------------------------------------------------------------------- the fit


def test_servo_parameters_are_identified_from_the_motion(legs, found) -> None:
    trace, true, servos = legs
    assert within(found, true).all(), table(found)
    assert (found.deviation > 0.0).all()
    nominal = Servos.of(trace.config, LEGS).stiffness
    assert np.abs(servos.stiffness / nominal - 1.0).max() > 0.1  # so the nominal values would be wrong


def test_goals_equal_those_sent_to_the_servos(legs) -> None:
    trace = legs[0]
    path = path_of(LEGS, 1)
    sent = np.array([np.interp(trace.time, 0.005 * np.arange(len(path)), column) for column in path.T]).T
    late = round(Drive.of(trace.config, LEGS).delay / trace.config.dt)  # the path is followed this much later
    assert np.abs(fit.goals_of(trace)[: -late - 1] - sent[late + 1 :]).max() < 0.03


def test_the_mounting_of_the_inertial_sensor_is_identified(legs, found) -> None:
    sensors = Sensors(dataclasses.replace(AS_BUILT.sensors, seed=1000))
    mounting = (sensors._leaning * sensors._mounting).rotation_matrix()
    model = dq.load_model(identified_config(found, legs[0]).robot)
    assert model.imu != model.imu_link
    identified = dq.DQ(model.frames[model.imu].pose).rotation_matrix()
    np.testing.assert_allclose(identified.T @ [0, 0, 1], mounting.T @ [0, 0, 1], atol=3e-4)


def test_replay_with_identified_parameters_matches_the_recording(legs, found) -> None:
    trace, true, _ = legs
    config = identified_config(found, trace)
    error = replay_error(trace, config).max()
    assert error < 0.2
    assert error < 0.3 * replay_error(trace, config.updated({"servo.assumed_latency": 0.0})).max()
    np.testing.assert_allclose(Servos.identified(config, LEGS).stiffness, found.value[:, 1], rtol=1e-3)
    drive = Drive.of(config, LEGS)
    np.testing.assert_allclose(drive.stiffness, found.value[:, 1], rtol=1e-3)
    assert drive.delay == pytest.approx(true[0, 0] - 0.5 * trace.config.dt + true[:, 2].mean(), abs=0.003)


def test_a_joint_that_did_not_move_is_reported_as_not_found(legs) -> None:
    trace = legs[0]
    q = trace.q.copy()
    q[:, 1] = 0.5  # its torque is off
    found = fit.identify(dataclasses.replace(trace, q=q))
    assert set(found.missing) == {LEGS.joint_names[1]}
    assert "is its torque on" in found.missing[LEGS.joint_names[1]]
    assert LEGS.joint_names[1] not in fit.parameters(found, 0.02, 1.0)
    assert f"NOT FOUND: {LEGS.joint_names[1]}" in table(found)
    with pytest.raises(BagError, match="no joint moved"):
        fit.identify(dataclasses.replace(trace, u=np.zeros_like(trace.u)))


def test_a_walk_is_refused_as_an_exercise(legs) -> None:
    walk = dataclasses.replace(legs[0], config=AS_BUILT)
    for use in (fit.identify, lambda trace: replay(trace, AS_BUILT)):
        with pytest.raises(BagError, match="dqwalk exercise"):
            use(walk)


def test_the_bag_is_not_replaced_by_its_result(tmp_path, capsys) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "bag_0.mcap").write_text("a recording")
    assert cli.main(["identify", str(bag), "--out", str(bag / "bag_0.mcap"), "--force"]) == 2
    assert "is in the bag, which is not changed" in capsys.readouterr().err
    assert (bag / "bag_0.mcap").read_text() == "a recording"


def test_a_joint_with_too_small_a_range_is_refused() -> None:
    narrow = dataclasses.replace(LEGS, q_min=LEGS.q_max - 0.2)
    with pytest.raises(ConfigError, match="lock it"):
        path_of(narrow, 1)


# ---------------------------------------------------------------------- the command line


@pytest.mark.long
def test_exercise_identify_and_replay_on_the_command_line(tmp_path, capsys) -> None:
    only = [*REST, "?_hip_y"]
    locked = "robot.lock=[" + ", ".join(f'"{name}"' for name in only) + "]"
    assert cli.main(["exercise", "--set", locked, "--set", "qp.solver=daqp", "--out", str(tmp_path), "--quiet"]) == 0
    assert cli.main(["identify", str(tmp_path / "bag"), "--mass", "2.9"]) == 0
    shown = capsys.readouterr().out
    assert "l_knee_y" in shown
    assert "±" in shown
    params = tmp_path / "identified.yaml"
    assert "l_knee_y=stiffness" in params.read_text()
    assert "mass: 2.9000" in params.read_text()
    assert dq.load_model(with_files(dq.load("poppy"), [params]).robot).mass == pytest.approx(2.9)
    assert cli.main(["replay", str(tmp_path / "bag")]) == 0
    assert str(params) in capsys.readouterr().out
    assert cli.main(["simulate", "--config", "poppy", "--params", str(tmp_path / "none.yaml")]) == 2
    assert "no parameter file" in capsys.readouterr().err


# ---------------------------------------------------------------------- all servos


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("seed", [11, 12, 13])
def test_five_minutes_identify_the_servos_of_a_random_poppy(seed: int) -> None:
    """`python -m pytest -m long -s test/identification/test_fit.py` prints the identified values and their errors."""
    config = exercise_config(AS_BUILT)
    model = dq.load_model(config.robot)
    trace, true, _ = exercised(config, model, seed)
    assert trace.time[-1] < 310.0
    found = fit.identify(trace)
    good = within(found, true)
    print(f"\nseed {seed}\n{table(found)}\n", flush=True)
    for name, value, truth, accurate in zip(model.joint_names, found.value, true, good, strict=True):
        missed = [what for what, ok in zip(("delay", "stiffness", "backlash"), accurate, strict=True) if not ok]
        late, stiff, play = value[0] - truth[0], value[1] / truth[1] - 1.0, value[3] - truth[3]
        print(
            f"{name:14s} delay {1e3 * late:+5.1f} ms  stiffness {100 * stiff:+6.1f} %  "
            f"backlash {math.degrees(play):+.3f} deg  {'MISSED: ' * bool(missed)}{', '.join(missed)}"
        )
    rms = replay_error(trace, identified_config(found, trace))
    mean = math.sqrt(float(np.mean(rms**2)))
    print(f"{good.all(axis=1).sum()} of {model.n}; replay {mean:.3f} degrees rms, {rms.max():.3f} at most", flush=True)
    assert good.all(axis=1).sum() >= 23
    assert rms.max() <= 1.5


def test_joints_that_do_not_move_like_servos_are_named() -> None:
    """Such as those of a robot that is not clamped: their parameters mean nothing, and a walk would use them."""
    n = len(joints := ("l_hip_y", "l_knee_y", "l_ankle_y"))
    rms = np.radians([0.09, 1.4, np.nan])
    found = fit.Identified(joints, np.ones((n, 5)), np.ones((n, 5)), rms, {"l_ankle_y": "it did not move"}, None)
    assert unexplained(found) == ["l_knee_y"]
    assert "NOT EXPLAINED: l_knee_y: no servo moves like that, within 0.5 degrees" in table(found)
