"""Which servo a biped needs: torques of a step, the torque-speed curve, and the command."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from dqwalk_ros import cli
from dqwalk_ros.config import Config, load
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.statics import GRAVITY, gravity_torques
from dqwalk_ros.robot.model import RobotModel, load_model
from dqwalk_ros.robot.servos import Servos, load_types
from dqwalk_ros.studies import servo_choice
from dqwalk_ros.studies.servo_choice import Gait, Step, choose, largest_loads, leg_pairs, own_servos, step
from dqwalk_ros.support.errors import ConfigError


@pytest.fixture(scope="module")
def poppy() -> tuple[Config, RobotModel]:
    config = load("poppy_dynamic")
    return config, load_model(config.robot)


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Try fewer steps."""
    for name, values in (
        ("_SPEEDS", [0.05, 0.15, 0.3]),
        ("_DURATIONS", [0.72, 1.0]),
        ("_LOWER", [0.0, 0.03]),
        ("_HEIGHTS", [0.02, 0.2]),
        ("_SLOPES", [0.0, 0.2]),
    ):
        monkeypatch.setattr(servo_choice, name, np.array(values))


def test_a_slow_step_needs_the_torques_of_gravity(poppy: tuple[Config, RobotModel]) -> None:
    config, model = poppy
    found = step(config, model, Gait(20.0, 1.0, 0.02, 0.01))
    assert found.off == 0.0
    for k in (10, 20, 30):
        statics = gravity_torques(Kinematics(model, found.q[k], Foot.LEFT), both=False)
        np.testing.assert_allclose(found.torque[k], statics, atol=2e-3 * np.abs(statics).max())


def test_the_soles_are_where_the_step_has_them(poppy: tuple[Config, RobotModel]) -> None:
    config, model = poppy
    found = step(config, model, Gait(0.4, 0.1, 0.05, 0.02))
    kins = [Kinematics(model, q, Foot.LEFT) for q in found.q]
    soles = np.array([kin.point(kin.swing) for kin in kins])
    assert soles[-1, 0] - soles[0, 0] == pytest.approx(0.1, abs=1e-3)
    assert np.ptp(soles[:, 2]) == pytest.approx(0.02, rel=0.05)
    com = np.array([kin.com for kin in kins])
    assert com[-1, 0] - com[0, 0] == pytest.approx(0.05, abs=2e-3)
    span = 0.2 * 0.4  # of which the velocity is the mean
    t = np.linspace(-0.25, 0.25, 41)
    ends = (np.array([np.interp(x, t, q) for q in found.q.T]) for x in (0.5 * span, -0.5 * span))
    np.testing.assert_allclose(found.velocity[20], (next(ends) - next(ends)) / span, atol=0.05)


def test_a_step_longer_than_the_legs_is_out_of_reach(poppy: tuple[Config, RobotModel]) -> None:
    config, model = poppy
    assert step(config, model, Gait(0.4, 0.1, 0.6, 0.02)).off > 0.01


def test_the_load_is_the_part_of_the_line() -> None:
    """Half of the stall torque at half of the no-load speed needs all of the voltage."""
    speed, zero = np.array([[0.0], [3.0], [-3.0]]), np.zeros((3, 1))
    motion = Step(zero, speed, zero, np.array([[1.0], [1.0], [1.0]]), (), 0.0)
    values = {field.name: np.zeros(1) for field in fields(Servos)}
    servos = Servos(**values | {"torque": np.array([2.0]), "back_emf": np.array([2.0 / 6.0])})
    assert largest_loads(servos, motion) == pytest.approx(1.0)
    assert largest_loads(replace(servos, friction=np.array([0.2])), motion) == pytest.approx(1.1)
    assert largest_loads(replace(servos, back_emf=np.zeros(1)), motion) == pytest.approx(0.5)
    rotor = replace(servos, armature=np.array([0.1]))
    assert largest_loads(rotor, replace(motion, acceleration=zero + 4.0)) == pytest.approx(1.2)


def test_a_servo_without_a_type_has_no_torque_at_the_velocity_limit(poppy: tuple[Config, RobotModel]) -> None:
    config, model = poppy
    servos = own_servos(config, model)
    np.testing.assert_allclose(servos.load(np.zeros(model.n), model.velocity_max), 1.0)
    typed = own_servos(config.updated({"servo.types": ["*=AX-12"]}), model)
    kind = load_types(config.servo.table)["AX-12"]
    np.testing.assert_allclose(typed.load(np.zeros(model.n), np.full(model.n, kind.no_load_speed)), 1.0)


def test_pairs_are_the_joints_of_both_legs(poppy: tuple[Config, RobotModel]) -> None:
    _, model = poppy
    names = [(model.joint_names[a], model.joint_names[b]) for a, b in leg_pairs(model)]
    assert [a.replace("l_", "r_", 1) for a, _ in names] == [b for _, b in names]
    assert names[0][0].startswith("l_hip")


@pytest.mark.usefixtures("few")
def test_stronger_and_faster_servos_allow_more(poppy: tuple[Config, RobotModel]) -> None:
    config, model = poppy
    types = load_types(config.servo.table)
    weak, twice = types["AX-12"], replace(types["AX-12"], stall_torque=3.0, no_load_speed=12.0)
    own, one, two = choose(config, model, {"weak": weak, "twice": twice})
    assert (own.name, one.voltage) == ("own", 12.0)
    assert one.speed.value <= min(most.value for most in one.joints.values())
    assert one.speed.joint in one.joints
    for a, b in ((one.speed, two.speed), (one.height, two.height), (one.slope, two.slope)):
        assert (a.value, a.sign) == (b.value, b.sign) or a.value < b.value
    assert one.speed.value < two.speed.value
    assert one.push < two.push
    assert one.warm == pytest.approx(2.0 * two.warm)


@pytest.mark.usefixtures("few")
def test_a_speed_is_that_of_one_step_whose_most_loaded_joint_is_least_loaded(poppy: tuple[Config, RobotModel]) -> None:
    """Not of several steps, each the best for another joint."""
    config, model = poppy[0].updated({"servo.types": ["*=AX-12"]}), poppy[1]
    gait, legs = Gait.of(config), [joint for pair in leg_pairs(model) for joint in pair]
    height = float(Kinematics(model, model.posture(config.standing.posture), Foot.LEFT).com[2])
    speeds = [float(part) * np.sqrt(GRAVITY * height) for part in servo_choice._SPEEDS]
    steps = [[step(config, model, one) for one in servo_choice._with_speed(gait, v, height)] for v in speeds]
    servos = own_servos(config, model)
    needed = [[largest_loads(servos, one)[legs].max() for one in ones if not one.off] for ones in steps]
    needed = [min(loads) for loads in needed if loads]
    over = next(k for k, load in enumerate(needed) if load > 1.0)  # before the legs reach no further
    expected = np.interp(1.0, needed[over - 1 : over + 1], speeds[over - 1 : over + 1])
    assert choose(config, model, {})[0].speed.value == pytest.approx(expected)


def test_only_steps_of_fixed_duration_are_considered() -> None:
    with pytest.raises(ConfigError, match=r"for a dynamic walk; gait\.style is standing"):
        Gait.of(load("poppy"))


@pytest.mark.usefixtures("few")
def test_the_command_prints_a_row_for_each_type(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["servos", "poppy_dynamic", "--type", "MX-28", "--quiet"]
    assert cli.main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("poppy_humanoid: 2.61 kg, steps of 0.5 s")
    assert lines[2].split()[:2] == ["servo", "V"]
    assert [line.split()[0] for line in lines[4:]] == ["own", "MX-28"]
    assert cli.main(["servos", "poppy_dynamic", "--type", "MX-1"]) == 2
    assert "the types are MX-28" in capsys.readouterr().err
