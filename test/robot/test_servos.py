"""Models of servo types and of sensor errors: the physics matches their parameters."""

from __future__ import annotations

import dataclasses
import math

import mujoco
import numpy as np
import pytest

import dqwalk_ros as dq
from dqwalk_ros import report as reporting
from dqwalk_ros.config import SensorsConfig, overlaid
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.state import Command
from dqwalk_ros.plants.base import upward
from dqwalk_ros.plants.mujoco import PhysicsPlant
from dqwalk_ros.plants.sensors import Reading, Sensors
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.report import bag
from dqwalk_ros.robot.servos import Drive, Servos, load_types
from dqwalk_ros.simulation import closed_loop, simulate
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.walks.table import make_controller

CONFIG = dq.load("poppy")
MODEL = dq.load_model(CONFIG.robot)
POPPY = ["*=MX-28", "?_hip_y=MX-64", "abs_[xy]=MX-64"]
TYPED = CONFIG.updated({"servo.types": POPPY})
KNEE, RIGHT, HIP = (MODEL.joint_names.index(name) for name in ("l_knee_y", "r_knee_y", "l_hip_y"))


def hanging(**changes: object) -> PhysicsPlant:
    """Return Poppy in the air without gravity, so that only the servos act."""
    config = TYPED.updated({name.replace("__", "."): value for name, value in changes.items()})
    plant = PhysicsPlant(config, MODEL, MODEL.posture(config.standing.posture))
    plant.mj.opt.gravity[:] = 0.0
    plant.data.qpos[2] += 1.0
    return plant


def torques(plant: PhysicsPlant) -> np.ndarray:
    """Return the present torques of the servos on the joints [N m]."""
    return plant.data.qfrc_actuator[plant._vadr] - plant._back_emf * plant.data.qvel[plant._vadr]


# ---------------------------------------------------------------------- the table


def test_stiffness_follows_from_p_register_and_stall_torque() -> None:
    """P/8 of 1023 per step of 1/4096 of a turn: an MX-28 has 51 N m/rad at most, and 6.4 at its default."""
    for p, expected in ((254, 50.6), (32, 6.4)):
        servos = Servos.of(TYPED.updated({"servo.p_gain": p}), MODEL)
        assert servos.stiffness[KNEE] == pytest.approx(expected, rel=0.01)
        assert servos.stiffness[KNEE] == pytest.approx(2.5 * p / 8.0 * 4096.0 / (2.0 * np.pi) / 1023.0, rel=1e-3)
        assert servos.stiffness[HIP] / servos.stiffness[KNEE] == pytest.approx(6.0 / 2.5)


def test_voltage_scales_torque_and_speed() -> None:
    """The back-EMF constant, torque per speed, does not depend on the voltage."""
    at12, at15 = (Servos.of(TYPED.updated({"servo.voltage": v}), MODEL) for v in (12.0, 15.0))
    np.testing.assert_allclose(at15.torque, 1.25 * at12.torque)
    np.testing.assert_allclose(at15.back_emf, at12.back_emf)
    np.testing.assert_allclose(at15.torque / at15.back_emf, 1.25 * at12.torque / at12.back_emf)


def test_every_poppy_motor_has_the_servo_type_of_the_plant() -> None:
    from dqwalk_ros.plants.poppy.motors import load_motors

    types = load_types("servos")
    motors = load_motors("poppy", types)
    named = Servos.of(TYPED, MODEL)
    for k, joint in enumerate(MODEL.joint_names):
        assert named.torque[k] == types[motors[joint].type].stall_torque


def test_a_custom_servo_type_is_used(tmp_path) -> None:
    table = tmp_path / "mine.yaml"
    table.write_text(
        "servos:\n  X: {stall_torque: 4.0, no_load_speed: 8.0, voltage: 12.0, duty: 10.0, p_register: false,\n"
        "      backlash: 0.0, resolution: 0.001, friction: 0.0, armature: 0.01}\n"
    )
    servos = Servos.of(CONFIG.updated({"servo.table": str(table), "servo.types": ["?_knee_y=X"]}), MODEL)
    assert servos.stiffness[KNEE] == 40.0
    assert servos.stiffness[HIP] == CONFIG.servo.stiffness


@pytest.mark.parametrize(
    ("key", "entry", "message"),
    [
        ("types", "*=MX-29", "servo.table has MX-28"),
        ("types", "knee=MX-28", "the joints are"),
        ("types", "*", "must be JOINT="),
        ("assumed", "*=stiff 3", "stiffness 49.2"),
        ("assumed", "*=stiffness -3", "stiffness 49.2"),
        ("assumed", "*=stiffness", "stiffness 49.2"),
    ],
)
def test_an_invalid_servo_entry_is_an_error(key: str, entry: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Drive.of(CONFIG.updated({f"servo.{key}": [entry]}), MODEL)


def test_the_controller_assumes_the_servo_type_unless_overridden() -> None:
    plain, typed = Drive.of(CONFIG, MODEL), Drive.of(TYPED, MODEL)
    assert (plain.stiffness == CONFIG.servo.assumed_stiffness).all()
    assert typed.stiffness[KNEE] == pytest.approx(50.6, rel=0.01)
    assert typed.damping[KNEE] == pytest.approx(2.5 / 5.76)
    overridden = Drive.of(TYPED.updated({"servo.assumed": ["l_knee_y=stiffness 40, damping 0.01"]}), MODEL)
    assert overridden.stiffness[KNEE] == 40.0
    assert overridden.damping[KNEE] == pytest.approx(0.4)
    assert overridden.stiffness[HIP] == typed.stiffness[HIP]
    effort = np.ones(MODEL.n)
    np.testing.assert_allclose(overridden.angles(effort) * overridden.stiffness, effort)


def test_the_lead_compensates_the_back_emf_only() -> None:
    late = TYPED.updated({"servo.assumed_latency": 0.06})
    plain, ahead = Drive.of(late, MODEL), Drive.of(late.updated({"servo.assumed_lead": 0.02}), MODEL)
    assert ahead.lead == pytest.approx(plain.damping)
    assert (ahead.damping == 0.0).all()  # delayed damping feedback excites the joint
    assert ahead.delay < plain.delay
    sooner = Drive.of(late.updated({"servo.assumed_latency": 0.02, "servo.assumed_lead": 0.02}), MODEL)
    assert (sooner.damping > 0.0).all()
    assert (sooner.damping < plain.damping).all()


@pytest.mark.parametrize("config", [CONFIG, TYPED], ids=["untyped", "typed"])
def test_the_lead_does_not_exceed_an_identified_lag(config: dq.Config) -> None:
    """A larger lead moves the joints ahead of their goals: fast walks tip on their toes."""
    leading = config.updated({"servo.assumed_lead": 0.02})
    told = leading.updated({"servo.assumed": ["?_knee_y=damping 0.004", "abs_x=stiffness 9"]})
    drive, before = Drive.of(told, MODEL), Drive.of(leading, MODEL)
    lead, usual = drive.lead / drive.stiffness, before.lead / before.stiffness
    assert lead[KNEE] == pytest.approx(0.004)
    np.testing.assert_allclose(np.delete(lead, [KNEE, RIGHT]), np.delete(usual, [KNEE, RIGHT]))


def test_the_delay_is_latency_plus_half_a_hold_plus_damping_lag() -> None:
    assumed = {"servo.assumed_latency": 0.04, "servo.assumed_rate": 50.0, "servo.assumed_damping": 0.02}
    assert Drive.of(CONFIG.updated(assumed), MODEL).delay == pytest.approx(0.07)


# ---------------------------------------------------------------------- in the engine


def test_servo_torque_is_proportional_to_the_error_up_to_the_stall_torque() -> None:
    plant = hanging()
    data, rest = plant.data, plant.data.qpos[plant._qadr].copy()
    for error in (0.02, 0.04, 0.3):
        plant._goals[:] = rest
        plant._goals[:, KNEE] = rest[KNEE] + error
        data.qvel[:] = 0.0
        mujoco.mj_forward(plant.mj, data)
        s = Servos.of(TYPED, MODEL)
        expected = np.clip(s.stiffness[KNEE] * max(error - 0.5 * s.backlash[KNEE], 0.0), 0.0, 2.5)
        assert torques(plant)[KNEE] == pytest.approx(expected, abs=1e-9)


def test_within_the_backlash_there_is_no_torque() -> None:
    plant = hanging()
    plant._goals[:] = plant.data.qpos[plant._qadr] + 0.0028  # less than half of 0.0058
    plant.data.qvel[:] = 0.0
    mujoco.mj_forward(plant.mj, plant.data)
    np.testing.assert_allclose(torques(plant), 0.0, atol=1e-12)


def test_servo_torque_decreases_to_zero_at_the_no_load_speed() -> None:
    """The torque-speed curve: at full voltage, the stall torque at rest and zero at the no-load speed."""
    plant = hanging()
    fast = 5.76
    plant._goals[:, KNEE] += 1.0
    for speed, torque in ((0.0, 2.5), (0.5 * fast, 1.25), (fast, 0.0)):
        plant.data.qvel[:] = 0.0
        plant.data.qvel[plant._vadr[KNEE]] = speed
        mujoco.mj_forward(plant.mj, plant.data)
        assert torques(plant)[KNEE] == pytest.approx(torque, abs=1e-9)


def test_recorded_torques_and_angles_give_the_work_of_the_servos() -> None:
    """Summed over every step of the engine; a torque of one moment of the period gives less than nothing."""
    config = overlaid(dq.load("poppy_dynamic"), "physics").updated({"gait.steps": 2})
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)
    assert isinstance(plant, PhysicsPlant)
    done = np.zeros(MODEL.n)

    def add_work(*_: object) -> None:
        done[:] += config.physics.timestep * torques(plant) * plant.data.qvel[plant._vadr]

    recorded, q = [], plant.truth.q
    mujoco.set_mjcb_control(add_work)
    try:
        for _ in closed_loop(controller, plant):
            truth = plant.truth
            recorded.append(truth.effort * (truth.q - q))
            q = truth.q
    finally:
        mujoco.set_mjcb_control(None)
    net, exact = float(np.sum(recorded)), float(done.sum())
    positive = float(np.maximum(recorded, 0.0).sum())
    assert exact > 0.0
    assert net == pytest.approx(exact, abs=0.02 * positive)
    assert net > 0.05 * positive


@pytest.mark.parametrize("dt", [0.005, 0.0025, 0.0045, 0.0125, 1.0 / 60.0])
def test_the_time_of_the_engine_is_that_of_the_state(dt: float) -> None:
    """The engine's step divides the period, also a period that is not the configured one."""
    plant = hanging(dt=dt, physics__settle=0.01)
    begin, still = plant.data.time, np.zeros(MODEL.n)
    for _ in range(20):
        state = plant.step(Command(plant.state.time, still), dt)
    for _ in range(5):
        state = plant.step(Command(state.time, still), 0.0072)
    assert state.time == pytest.approx(20 * dt + 0.036, abs=1e-9)
    assert plant.data.time - begin == pytest.approx(state.time, abs=2e-9)
    assert plant.mj.opt.timestep <= 0.001 + 1e-9


def test_goals_may_change_within_a_tick() -> None:
    """The engine makes several steps at once between two changes of the goals; the result equals single steps."""
    config = TYPED.updated({"servo.latency": 0.0023, "dt": 0.02})
    plant = PhysicsPlant(config, MODEL, MODEL.posture(config.standing.posture))
    once = mujoco.MjData(plant.mj)
    mujoco.mj_copyData(once, plant.mj, plant.data)
    goals = plant._goals.copy()
    plant.step(Command(0.0, np.full(MODEL.n, 0.2)), config.dt)
    for k in range(20):
        once.ctrl[:] = (goals if k < 3 else plant._goals).ravel()
        mujoco.mj_step(plant.mj, once)
    np.testing.assert_array_equal(once.qpos, plant.data.qpos)


# ---------------------------------------------------------------------- sensors


def reading(q: float, dq: float = 0.0) -> Reading:
    level, still = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
    return Reading(level, still, np.array([0, 0, 9.81]), np.full(3, q), np.full(3, dq), still)


def test_readings_are_delayed_and_held_between_bus_reads() -> None:
    sensors = Sensors(SensorsConfig(rate=50.0, age=0.01))
    seen = [sensors.measure(0.005 * k, reading(float(k))).q[0] for k in range(12)]
    assert seen == [0, 0, 0, 0, 0, 0, 4, 4, 4, 4, 8, 8]


def test_encoder_angles_are_quantized_and_velocities_follow_from_them() -> None:
    sensors = Sensors(SensorsConfig(encoder=0.01, velocity_filter=0.02))
    out = [sensors.measure(0.005 * k, reading(0.5 * 0.005 * k, dq=0.5)) for k in range(400)]
    assert all(abs(r.q[0] / 0.01 - round(r.q[0] / 0.01)) < 1e-9 for r in out)
    assert np.mean([r.dq[0] for r in out[100:]]) == pytest.approx(0.5, rel=0.01)
    assert np.std([r.dq[0] for r in out[100:]]) > 0.01


def test_errors_of_the_inertial_sensor_are_as_configured() -> None:
    c = SensorsConfig(
        attitude_bias=0.01, attitude_noise=0.002, gyro_bias=0.02, gyro_noise=0.005, accelerometer_bias=0.1,
        accelerometer_noise=0.05, seed=3,
    )  # fmt: skip
    out = [Sensors.measure(s, 0.005 * k, reading(0.0)) for s in [Sensors(c)] for k in range(2000)]
    gyro, acceleration = (np.array([getattr(r, name) for r in out]) for name in ("gyro", "acceleration"))
    assert np.linalg.norm(gyro.mean(axis=0)) == pytest.approx(0.02, abs=5e-4)
    assert gyro.std(axis=0) == pytest.approx(np.full(3, 0.005), rel=0.05)
    assert np.linalg.norm(acceleration.mean(axis=0) - [0.0, 0.0, 9.81]) == pytest.approx(0.1, abs=5e-3)
    tilt = np.array([upward(*r.orientation) for r in out])[:, :2]
    assert np.linalg.norm(tilt.mean(axis=0)) == pytest.approx(0.01, abs=3e-4)
    assert tilt.std(axis=0) == pytest.approx(np.full(2, 0.002), rel=0.05)


def test_a_misaligned_sensor_rotates_all_its_measurements() -> None:
    sensors, true = Sensors(SensorsConfig(misalignment=0.1, seed=1)), reading(0.0)
    out = sensors.measure(0.0, true)
    up = upward(*out.orientation)
    assert np.arccos(up[2]) <= 0.1
    np.testing.assert_allclose(out.acceleration, 9.81 * up, atol=1e-9)


def test_exact_sensors_change_nothing() -> None:
    true = reading(0.3)
    assert Sensors(SensorsConfig(seed=5)).measure(0.0, true) is true


# ---------------------------------------------------------------------- the floor


def test_the_inertial_sensor_measures_a_slope() -> None:
    """The floor rises by 3 degrees forward and by 2 degrees to the left; the robot stands perpendicular to it."""
    a, b = math.radians(3.0), math.radians(2.0)
    config = CONFIG.updated({"physics.slope": a, "physics.slope_side": b})
    plant = PhysicsPlant(config, MODEL, MODEL.posture(config.standing.posture))
    up = plant.state.up
    assert up is not None
    assert up == pytest.approx([np.sin(a) * np.cos(b), np.sin(b), np.cos(a) * np.cos(b)], abs=0.03)
    assert np.dot(plant.mj.opt.gravity, [np.sin(a) * np.cos(b), np.sin(b), np.cos(a) * np.cos(b)]) < -9.8
    weight = sum(w[:3] for w in plant.truth.wrenches.values())
    assert np.linalg.norm(weight) == pytest.approx(MODEL.mass * 9.80665, rel=0.05)


def test_the_simulated_sensor_is_mounted_as_configured() -> None:
    """A controller that is told the mounting measures the same vertical of the base as with an aligned sensor."""
    rpy = (0.3, -0.2, 0.1)
    changes = {"physics.slope": 0.05, "physics.slope_side": 0.02}
    found = []
    for mounted in ((0.0, 0.0, 0.0), rpy):
        config = CONFIG.updated({**changes, "robot.imu_rpy": mounted})
        model = dq.load_model(config.robot)
        plant = PhysicsPlant(config, model, model.posture(config.standing.posture))
        plant.data.qvel[3:6] = 0.5, -0.3, 0.2
        state = plant.step(Command(0.0, np.zeros(model.n)), 0.005)
        x = DQ(model.frames[model.imu].pose)
        measured = (state.up, state.gyro, plant.inertial.acceleration)
        found.append([x.P().Ad(DQ([0.0, *a])).vec3() for a in measured])
        assert np.linalg.norm(state.gyro) > 0.1
    np.testing.assert_allclose(found[1], found[0], atol=1e-12)


def test_a_push_acts_on_the_pelvis_that_is_configured() -> None:
    config = CONFIG.updated({"robot.pelvis": "chest"})
    plant = PhysicsPlant(config, dq.load_model(config.robot), MODEL.posture(config.standing.posture))
    plant.push([1.0, 2.0, 3.0])
    pushed = np.flatnonzero(plant.data.xfrc_applied.any(axis=1))
    assert [plant.mj.body(k).name for k in pushed] == ["chest"]


def test_the_wrenches_are_the_contact_forces_about_the_origin_of_each_sole() -> None:
    """Compared with the engine's force of every single contact, while one or both soles are on the ground."""
    config = overlaid(dq.load("poppy_dynamic"), "physics").updated({"gait.steps": 2, "physics.slope": 0.03})
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)
    assert isinstance(plant, PhysicsPlant)
    mj, d, fewest = plant.mj, plant.data, 2
    for tick, _ in enumerate(closed_loop(controller, plant)):
        if tick % 20:
            continue
        mujoco.mj_forward(mj, d)  # contacts, forces and sensors of the same moment
        truth = plant.truth
        fewest = min(fewest, sum(bool(w.any()) for w in truth.wrenches.values()))
        for foot in Foot:
            sole, expected = mj.body(MODEL.soles[foot].frame).id, np.zeros(6)
            for k, contact in enumerate(d.contact):
                bodies, felt = mj.geom_bodyid[contact.geom], np.empty(6)
                if sole in bodies:
                    mujoco.mj_contactForce(mj, d, k, felt)
                    felt *= 1.0 if bodies[1] == sole else -1.0  # it acts on the second body
                    force, torque = contact.frame.reshape(3, 3).T @ felt[:3], contact.frame.reshape(3, 3).T @ felt[3:]
                    expected += [*force, *torque + np.cross(contact.pos - d.xpos[sole], force)]
            R = d.xmat[sole].reshape(3, 3)
            np.testing.assert_allclose(truth.wrenches[foot], [*expected[:3] @ R, *expected[3:] @ R], atol=1e-9)
            x = DQ.from_pose(d.xpos[sole], d.xquat[sole]).vec8()
            np.testing.assert_allclose(truth.soles[foot], x, rtol=0, atol=1e-15)
    assert fewest == 1


def test_soft_servos_stand_on_a_slope_before_the_first_command() -> None:
    """The initial goals compensate gravity; otherwise the robot would stand on its heels when the walk begins."""
    config = CONFIG.updated({"physics.slope": 0.035, "servo.stiffness": 25.0, "servo.assumed_stiffness": 25.0})
    plant = PhysicsPlant(config, MODEL, MODEL.posture(config.standing.posture))
    assert plant.truth.tilt < math.radians(0.1)
    assert np.abs(plant._goals - plant.commanded).max() > 0.005


def test_rubble_leaves_the_initial_position_free() -> None:
    config = CONFIG.updated({"physics.rubble": 0.005})
    plant = PhysicsPlant(config, MODEL, MODEL.posture(config.standing.posture))
    boxes = plant.mj.geom_type == mujoco.mjtGeom.mjGEOM_BOX
    tops = 2.0 * plant.mj.geom_size[boxes, 2]
    assert boxes.sum() > 200
    assert np.sort(tops)[:-2].max() <= 0.005  # all but the two soles
    assert not plant.fallen


def test_the_report_uses_true_poses_not_measured_angles(tmp_path) -> None:
    """The soles' poses from a bag equal those of the engine, although measured angles are delayed and quantized."""
    config = overlaid(dq.load("poppy"), "poppy_as_built").updated({"gait.steps": 1})
    model = dq.load_model(config.robot)
    plant, true = make_plant("physics", config, model), []
    trace = simulate(
        make_controller(config, model), plant, max_time=2.0, before_step=lambda time: true.append(plant.truth.soles)
    )
    bag.write(trace, tmp_path / "bag")
    back = bag.read(tmp_path / "bag")
    assert np.abs(back.q - back.physics.q).max() > 1e-3  # the measured posture differs
    ground = reporting.analyse(back).ground
    count = min(len(true), len(trace))
    assert count >= 100
    for foot in Foot:
        expected = np.array([soles[foot] for soles in true[:count]])
        np.testing.assert_allclose(DQ(ground.soles[foot][:count]).translation(), DQ(expected).translation(), atol=1e-6)
        turned = np.abs((ground.soles[foot][:count, :4] * expected[:, :4]).sum(axis=1))
        np.testing.assert_allclose(turned, 1.0, atol=1e-9)
    without = dataclasses.replace(back.physics, q=np.full_like(back.q, np.nan))  # an older bag
    assert np.isfinite(reporting.analyse(dataclasses.replace(back, physics=without)).ground.tilt).all()
