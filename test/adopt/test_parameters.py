"""Servos: torques, rotors and damping of the parameters."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from robots import edited
from small_humanoid import SMALL, Z, anatomy_of, read, small_model

from dqwalk_ros.adopt import adopt
from dqwalk_ros.adopt.parameters import Numbers, servo_types
from dqwalk_ros.adopt.posture import Standing
from dqwalk_ros.config import Config, load
from dqwalk_ros.plants.mujoco import build
from dqwalk_ros.robot.servos import Servos
from dqwalk_ros.robot.urdf import Urdf
from dqwalk_ros.support.errors import ConfigError


def test_torques_are_limited_by_the_servos_only() -> None:
    model = small_model(Urdf.load(SMALL), sole_length=0.1, sole_width=0.08)
    mj = build(Config().updated({"servo.torque_scale": 3.0}), model)
    assert not mj.jnt_actfrclimited.any()
    k = model.joint_names.index("l_knee")
    assert mj.actuator_forcerange[k, 1] == pytest.approx(3.0 * model.effort_max[k])


def test_the_damping_of_light_legs_is_that_of_legs_with_rotors() -> None:
    urdf = Urdf.load(SMALL)
    model, anatomy = small_model(urdf), anatomy_of(urdf)
    standing = Standing(np.zeros(model.n), np.zeros(3), 0.3, error=0.0, knee=0.0, off=0.0, margin=0.05)
    numbers = Numbers(model, anatomy, standing, 0.0, "", {}, 0.0, ())
    for armature in (0.01, 1.0):
        swinging = numbers.inertia + armature
        ratio = 0.5 * numbers.damping(20.0, 0.5, armature) * math.sqrt(20.0 / swinging)
        assert ratio == pytest.approx(0.5, rel=0.03)


def test_weak_fast_servos_have_light_rotors(tmp_path: Path) -> None:
    light = 0.0025 * 9.81 * 0.05 * sum(link.inertial.mass for link in Urdf.load(SMALL).links.values())
    cases = ("0.4", "12", 0.3, 0.001), ("40", "12", 0.3, 0.01), ("0", "0", 0.3, 0.01), ("0", "0", 0.05, light)
    for effort, speed, height, armature in cases:  # 0: no limit
        urdf = read(tmp_path, (r'effort="[^"]*" velocity="[^"]*"', f'effort="{effort}" velocity="{speed}"'))
        standing = Standing(np.zeros(12), height * Z, 0.3, error=0.0, knee=0.0, off=0.0, margin=0.05)
        numbers = Numbers(small_model(urdf), anatomy_of(urdf), standing, 0.0, "", {}, 0.0, ())
        assert numbers.armature == pytest.approx(armature, rel=0.03)


def test_efforts_too_small_to_stand_are_replaced_and_named(tmp_path: Path) -> None:
    weak = r'(name="._ankle_roll".*?effort=)"[^"]*"', r'\1"0.1"'
    found = adopt(edited(tmp_path, SMALL, weak), tmp_path / "out")
    limits = dict(zip(found.model.joint_names, found.model.effort_max, strict=True))
    width, load = found.config.robot.sole_width, 9.80665 * found.model.mass
    assert limits["l_ankle_roll"] == limits["r_ankle_roll"] == pytest.approx(0.35 * width * load, rel=0.01)
    assert limits["l_knee"] == 4.1
    assert sum("'l_ankle_roll' has an effort limit of 0.1 N m, too little" in text for text in found.repairs) == 1
    assert found.config.servo.torque_scale == 1.0


def test_joints_with_the_limit_that_is_too_little_for_others_have_their_servos(tmp_path: Path) -> None:
    """0.35 N m in all hips: enough for the yaw joints, but it is not the limit of any of these servos."""
    hips = r'(name="._hip.*?effort=)"[^"]*"', r'\1"0.35"'
    found = adopt(edited(tmp_path, SMALL, hips), tmp_path / "out")
    limits = dict(zip(found.model.joint_names, found.model.effort_max, strict=True))
    assert limits["l_hip_yaw"] == limits["r_hip_pitch"] == limits["l_hip_roll"] > 1.0
    assert limits["l_knee"] == 4.1
    assert any("'l_hip_yaw' has an effort limit of 0.35 N m, too little" in text for text in found.repairs)


def test_the_yaw_joint_of_a_stance_leg_holds_the_body_while_the_other_leg_swings(tmp_path: Path) -> None:
    found = adopt(edited(tmp_path, SMALL, (r'(name="._hip_yaw".*?effort=)"[^"]*"', r'\1"0.01"')), tmp_path / "out")
    limits = dict(zip(found.model.joint_names, found.model.effort_max, strict=True))
    gait = load(tmp_path / "out" / "dynamic.yaml")
    leg = sum(body.mass for body in found.model.bodies) / 4.0  # at most
    ahead, time = 2.0 * gait.gait.step_length, gait.standing.swing_duration
    most = leg * 5.78 * ahead / time**2 * gait.gait.step_width
    assert 0.1 * most < limits["l_hip_yaw"] == limits["r_hip_yaw"] < 1.5 * most
    assert any("'l_hip_yaw' has an effort limit of 0.01 N m, too little" in text for text in found.repairs)


def test_servos_by_type_are_those_of_joints_with_a_part_of_the_name(tmp_path: Path) -> None:
    joints, table = ["l_knee", "r_knee", "l_hip_yaw"], ["MX-64", "MX-106"]
    assert servo_types(["knee=MX-64", "l_hip_yaw=MX-106"], joints, table) == ["*knee*=MX-64", "l_hip_yaw=MX-106"]
    for wrong, message in (("knee", "NAME=TYPE"), ("knee=MX-1", "MX-64, MX-106"), ("toe=MX-64", "l_knee, r_knee")):
        with pytest.raises(ConfigError, match=message):
            servo_types([wrong], joints, table)
    found = adopt(SMALL, tmp_path, servos=["knee=XM430-W350"])
    assert found.config.servo.types == ("*knee*=XM430-W350",)
    assert load(tmp_path / "dynamic.yaml").servo.types == found.config.servo.types
    servos = Servos.of(found.config, found.model)
    knees = [k for k, name in enumerate(found.model.joint_names) if "knee" in name]
    np.testing.assert_allclose(servos.torque[knees], 4.1)
    np.testing.assert_allclose(servos.stiffness[knees], 18.9, atol=0.1)
