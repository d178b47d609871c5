"""Poppy's driver against pypot's dummy motors: signs, limits, speeds, the slow start, a whole cycle."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dqwalk_ros.config import Config, find_share, load
from dqwalk_ros.controllers import Command, State, make_controller
from dqwalk_ros.errors import ConfigError, PlantError
from dqwalk_ros.model import RobotModel, load_model
from dqwalk_ros.plants.poppy import MIN_SPEED, Motor, PoppyPlant, load_motors, register_speed

MOTORS = load_motors("poppy")
WALK = {
    "dt": 0.02,
    "poppy.dummy": True,
    "gait.step_length": 0.02,
    "task.eta": 0.5,
    "ssp.threshold": 0.02,
}


class Servo:
    """A motor with pypot's user-side attributes that moves at once, and remembers what it was told."""

    def __init__(self, motor: Motor, angle: float = 0.0) -> None:
        self.name, self.present_position, self._goal = motor.name, angle, angle
        self.compliant, self.speeds = True, []
        self.present_temperature, self.present_voltage, self.present_load = 40.0, 12.0, 0.0

    @property
    def goal_position(self) -> float:
        return self._goal

    @goal_position.setter
    def goal_position(self, angle: float) -> None:
        self._goal = angle
        if not self.compliant:
            self.present_position = angle

    @property
    def moving_speed(self) -> float:
        return self.speeds[-1] if self.speeds else 0.0

    @moving_speed.setter
    def moving_speed(self, speed: float) -> None:
        self.speeds.append(speed)


def fake(**angles: float) -> Any:
    robot = SimpleNamespace(close=lambda: None)
    for motor in MOTORS.values():
        setattr(robot, motor.name, Servo(motor, angles.get(motor.name, 0.0)))
    return robot


@pytest.fixture(scope="module")
def model() -> RobotModel:
    return load_model(load("paper").robot)


@pytest.fixture(scope="module")
def config() -> Config:
    return load("paper").updated(WALK)


@pytest.fixture
def dummy(model: RobotModel, config: Config) -> Iterator[PoppyPlant]:
    plant = PoppyPlant(model, config.poppy)
    yield plant
    plant.close()


def settle(plant: PoppyPlant, dt: float = 0.02) -> None:
    plant.set_compliant(False)
    for _ in range(2000):
        plant.approach(dt)
        if plant.ready:
            return
    raise AssertionError("the first pose was not reached")


# ---------------------------------------------------------------------- the table


def test_the_table_has_the_25_motors_of_the_urdf() -> None:
    whole = load_model(Config().robot)
    assert set(MOTORS) == set(whole.joint_names)
    assert len(MOTORS) == 25


def test_limits_of_all_25_motors_are_those_of_the_urdf() -> None:
    whole = load_model(Config().robot)
    for name, low, high in zip(whole.joint_names, whole.q_min, whole.q_max, strict=True):
        np.testing.assert_allclose(MOTORS[name].limits, np.degrees([low, high]), atol=1e-6, err_msg=name)


@pytest.mark.parametrize("name", MOTORS)
def test_our_signs_are_pypots(dummy: PoppyPlant, name: str) -> None:
    """What pypot puts into the servo's register for a joint angle is what the table says."""
    motor, servo = MOTORS[name], getattr(dummy._robot, name)
    for angle in (-7.0, 0.0, 11.0):
        servo.goal_position = angle
        raw = servo.__dict__["goal_position"]
        assert raw == pytest.approx(motor.servo(angle))
        assert motor.user(raw) == pytest.approx(angle)


MIRRORED = ["hip_x", "hip_z", "hip_y", "knee_y", "ankle_y", "shoulder_y", "shoulder_x", "arm_z", "elbow_y"]


def test_a_mirrored_pose_is_mirrored_in_the_servos(model: RobotModel, config: Config) -> None:
    """_y turns alike on both sides, _x and _z oppositely; each servo then gets what its orientation and offset say.

    The expected raw angles are written out from the wiring, not computed by the code under test.
    """
    angle = 10.0
    raw = {  # left, right [deg] for left +10 and its mirror image
        "hip_x": (10.0, -10.0),
        "hip_z": (-10.0, 10.0),
        "hip_y": (12.0, -10.0),
        "knee_y": (10.0, -10.0),
        "ankle_y": (10.0, -10.0),
        "shoulder_y": (100.0, -100.0),
        "shoulder_x": (80.0, -80.0),
        "arm_z": (-10.0, 10.0),
        "elbow_y": (10.0, -10.0),
    }
    for joint in MIRRORED:
        other = angle if joint.endswith("_y") else -angle
        assert MOTORS[f"l_{joint}"].servo(angle) == pytest.approx(raw[joint][0]), joint
        assert MOTORS[f"r_{joint}"].servo(other) == pytest.approx(raw[joint][1]), joint


def test_mirrored_limits_agree() -> None:
    for joint in MIRRORED:
        low, high = MOTORS[f"l_{joint}"].limits
        mirrored = (low, high) if joint.endswith("_y") else (-high, -low)
        np.testing.assert_allclose(
            MOTORS[f"r_{joint}"].limits, mirrored, atol=3.0, err_msg=joint
        )  # hip_y: built 1 to 3 off


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("motors: {}", "expected 'motors"),
        ("x: 1", "expected 'motors"),
        ("motors:\n  a: {id: 1}", "line 2: motor 'a' needs id, type"),
        (
            "motors:\n  a: {id: 1, type: MX-28, bus: lower, direct: true, offset: 0, raw: [1, 0]}",
            "raw: \\[lower, upper\\]",
        ),
        ("motors:\n  a: {id: 1, type: MX-28, bus: lower, direct: true, offset: .nan, raw: [0, 1]}", "in degrees"),
        ("motors:\n  a: {id: 1, type: X, bus: lower, direct: true, offset: 0, raw: [0, 1]}", "a type of MX-28"),
        ("motors:\n  a: {id: 1, type: MX-28, bus: lower, direct: 3, offset: 0, raw: [0, 1]}", "true or false"),
        ("motors:\n  a: {id: 999, type: MX-28, bus: lower, direct: true, offset: 0, raw: [0, 1]}", "an id of its own"),
    ],
)
def test_a_table_that_is_none_is_refused(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "motors.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=expected):
        load_motors(str(path))


# ---------------------------------------------------------------------- speeds


@pytest.mark.parametrize("speed", [0.0, 1e-9, -1e-9, 0.34, 0.36, -0.1, math.nan, math.inf, -math.inf, 1e6])
def test_no_speed_is_read_as_unlimited(speed: float) -> None:
    """pypot rounds to units of 0.684 deg/s, and 0 units are no limit at all."""
    written = register_speed(speed, 120.0)
    assert MIN_SPEED <= written <= 120.0
    assert round(written / 0.684) >= 1


def test_no_servo_ever_gets_an_unlimited_speed(model: RobotModel, config: Config) -> None:
    robot = fake(l_knee_y=40.0)
    plant = PoppyPlant(model, config.poppy, robot)
    settle(plant)
    for u in (0.0, 1e-9, 0.01, 5.0, 1e9):
        plant.step(Command(0.0, np.full(model.n, u)), 0.02)
    plant.close()
    speeds = np.array([s for name in MOTORS for s in getattr(robot, name).speeds])
    assert len(speeds) > 100
    assert (speeds >= MIN_SPEED).all()
    assert (speeds <= config.poppy.max_speed).all()


# ---------------------------------------------------------------------- start and stop


def test_nothing_moves_when_the_torque_comes_on(model: RobotModel, config: Config) -> None:
    robot = fake(l_knee_y=40.0, r_elbow_y=-70.0)
    plant = PoppyPlant(model, config.poppy, robot)
    before = plant.q
    plant.set_compliant(False)
    np.testing.assert_allclose(plant.q, before, atol=1e-12)
    np.testing.assert_allclose(plant.goal, before, atol=1e-12)


def test_the_way_to_the_first_pose_is_slow(model: RobotModel, config: Config) -> None:
    robot = fake(l_knee_y=40.0, r_knee_y=10.0, r_elbow_y=-70.0)
    plant = PoppyPlant(model, config.poppy, robot)
    plant.set_compliant(False)
    dt, steps = 0.02, 0
    while not plant.ready:
        before = plant.q
        plant.approach(dt)
        assert np.abs(plant.q - before).max() <= config.poppy.start_speed * dt + 1e-9
        steps += 1
        assert steps < 1000
    assert steps * dt >= math.radians(70.0) / config.poppy.start_speed - config.poppy.start_tolerance - dt
    plant.approach(dt)
    np.testing.assert_allclose(plant.q, 0.0, atol=config.poppy.start_tolerance)


def test_a_limp_robot_is_told_nothing(model: RobotModel, config: Config) -> None:
    robot = fake()
    plant = PoppyPlant(model, config.poppy, robot)
    settle(plant)
    plant.set_compliant(True)
    assert all(getattr(robot, name).compliant for name in MOTORS)
    goals = plant.goal.copy()
    plant.step(Command(0.0, np.ones(model.n)), 0.02)
    np.testing.assert_array_equal(plant.goal, goals)
    robot.l_knee_y.present_position = 30.0  # somebody bends its knee
    plant.set_compliant(False)
    assert not plant.ready  # the first pose comes first again
    assert plant.goal[plant.names.index("l_knee_y")] == pytest.approx(math.radians(30.0))


def test_goals_stay_inside_the_limits_and_near_the_joints(model: RobotModel, config: Config) -> None:
    plant = PoppyPlant(model, config.poppy, fake())
    settle(plant)
    rng = np.random.default_rng(1)
    for _ in range(300):
        plant.step(Command(0.0, rng.normal(0.0, 20.0, model.n)), 0.02)
        for name, goal in zip(plant.names, plant.goal, strict=True):
            low, high = MOTORS[name].limits
            assert math.radians(low) - 1e-9 <= goal <= math.radians(high) + 1e-9
    for servo in (getattr(plant._robot, name) for name in MOTORS):
        servo.__class__ = type("Stuck", (Servo,), {"goal_position": property(lambda s: s._goal, lambda s, a: None)})
    at = plant.q
    for _ in range(200):  # joints that do not move: their goals do not run away
        plant.step(Command(0.0, np.ones(model.n)), 0.02)
        assert np.abs(plant.goal - at).max() <= config.poppy.max_lead + 1e-9


def test_calibration_moves_the_zero_of_a_joint(model: RobotModel, config: Config) -> None:
    """ "-3 acts like 0" on a robot: pypot shows -3 where the joint is straight."""
    own = config.updated({"poppy.calibration": ["l_hip_y=-3"]})
    robot = fake(l_hip_y=-3.0)
    plant = PoppyPlant(model, own.poppy, robot)
    i = plant.names.index("l_hip_y")
    assert plant.q[i] == pytest.approx(0.0)
    settle(plant)
    assert robot.l_hip_y.goal_position == pytest.approx(-3.0)


@pytest.mark.parametrize("entry", ["l_hip_y", "l_hip_y=x", "nobody=1", "l_hip_y=90", "l_hip_y=nan"])
def test_a_calibration_that_is_none_is_refused(model: RobotModel, config: Config, entry: str) -> None:
    with pytest.raises(ConfigError, match=r"poppy\.calibration"):
        PoppyPlant(model, config.updated({"poppy.calibration": [entry]}).poppy, fake())


def test_an_angle_that_is_none_and_a_command_that_is_none(model: RobotModel, config: Config) -> None:
    robot = fake()
    plant = PoppyPlant(model, config.poppy, robot)
    settle(plant)
    with pytest.raises(PlantError, match="finite velocities"):
        plant.step(Command(0.0, np.full(model.n, np.nan)), 0.02)
    robot.l_knee_y.present_position = math.nan
    with pytest.raises(PlantError, match="no angle from l_knee_y"):
        plant.step(Command(0.0, np.zeros(model.n)), 0.02)


def test_a_bus_that_died_is_an_error(dummy: PoppyPlant) -> None:
    dummy.set_compliant(False)
    dummy.approach(0.02)
    dummy._robot.stop_sync()
    with pytest.raises(PlantError, match="has ended"):
        dummy.approach(0.02)


def test_motors_that_do_not_answer_are_an_error(model: RobotModel, config: Config) -> None:
    absent = config.updated({"poppy.dummy": False, "poppy.lower_port": "/dev/null", "poppy.upper_port": "/dev/null"})
    with pytest.raises(PlantError, match="do not answer"):
        PoppyPlant(model, absent.poppy)


def test_health(model: RobotModel, config: Config) -> None:
    robot = fake()
    robot.r_hip_y.present_temperature = 66.0
    health = PoppyPlant(model, config.poppy, robot).health
    assert health.hottest == ("r_hip_y", 66.0)
    assert set(health.voltage) == set(MOTORS)


# ---------------------------------------------------------------------- against the dummies


def test_dummies_follow_at_the_rate_of_the_bus(dummy: PoppyPlant, config: Config) -> None:
    """A slow sine of 5 degrees: a joint is behind by a period or two of pypot's loop and the ramp of its servo."""
    dummy.set_compliant(False)
    n, period = 10, 1.0 / config.poppy.rate
    began = last = time.monotonic()
    worst, ticks = 0.0, 0
    while (now := time.monotonic()) < began + 3.0:
        t = now - began
        u = np.full(n, math.radians(5.0) * 2.0 * math.pi * 0.25 * math.cos(2.0 * math.pi * 0.25 * t))
        goal = dummy.goal[:n].copy()
        state = dummy.step(Command(t, u), now - last)
        if t > 0.5:
            worst = max(worst, float(np.abs(state.q - goal).max()))
        last, ticks = now, ticks + 1
        time.sleep(max(period - (time.monotonic() - now), 0.0))
    assert ticks > 75  # 150 on an idle machine
    assert worst < math.radians(5.0)


def test_a_whole_cycle_on_a_robot_that_follows(model: RobotModel, config: Config) -> None:
    """Every phase ends by its rule, all limits kept, commanded and read-back angles one period apart."""
    plant = PoppyPlant(model, config.poppy, fake())
    settle(plant)
    controller = make_controller(config, model)
    worst, state = 0.0, State(0.0, plant.q[: model.n])
    for k in range(20_000):
        command = controller.step(state, config.dt)
        if controller.finished:
            break
        plant.step(command, config.dt)
        state = State((k + 1) * config.dt, plant.q[: model.n])
        worst = max(worst, float(np.abs(state.q - plant.goal[: model.n]).max()))
        assert (state.q <= model.q_max + 1e-9).all()
        assert (state.q >= model.q_min - 1e-9).all()
    assert controller.finished
    assert worst < 1e-9


def test_the_files_are_installed_where_they_are_looked_for() -> None:
    for plant in ("integrator", "poppy"):
        assert load(str(find_share("config/plants", f"{plant}.yaml")))
