"""Robots read from URDF: remaining joints, masses, soles, and rejected descriptions."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import yourdfpy
from robots import DATA, biped12, edited, legs, poppy

from dqwalk_ros.config import RobotConfig, find_share
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.robot.model import load_model, parse_model
from dqwalk_ros.support.errors import ModelError
from dqwalk_ros.walks.dynamic.pendulum import swing_inertia

POPPY = find_share("urdf", "poppy.urdf")


# ---------------------------------------------------------------------- joints, masses and limits


def test_the_papers_mechanism_has_ten_joints():
    model = legs()
    leg = ("hip_x", "hip_z", "hip_y", "knee_y", "ankle_y")
    assert model.n == 10
    assert set(model.joint_names) == {f"{side}_{joint}" for side in "lr" for joint in leg}
    assert 1.0 < model.mass < 1.2  # legs and pelvis


def test_a_model_can_be_pickled():
    model = poppy()
    again = pickle.loads(pickle.dumps(model))
    assert again.joint_names == model.joint_names
    assert again.q_min.tolist() == model.q_min.tolist()
    assert set(again.frames) == set(model.frames)
    assert again.root == model.root


def test_a_changed_file_is_another_robot(tmp_path):
    config = RobotConfig(urdf=str(edited(tmp_path, POPPY, (r'<robot name="\w+"', '<robot name="one"'))))
    first = load_model(config)
    assert load_model(config) is first
    edited(tmp_path, POPPY, (r'<robot name="\w+"', '<robot name="two"'))
    assert (first.name, load_model(config).name) == ("one", "two")


def test_the_whole_poppy_has_25_joints():
    model = poppy()
    assert model.n == 25
    assert set(legs().joint_names) < set(model.joint_names)
    assert model.mass > 2.0 * legs().mass


def test_another_biped_is_read():
    model = biped12()
    assert model.n == 12
    assert model.mass == pytest.approx(5.0)
    assert {sole.frame for sole in model.soles.values()} == {"left_sole", "right_sole"}


def test_bodies_agree_with_the_urdf(robot):
    """Masses, limits and joint origins, and parents before children."""
    urdf = yourdfpy.URDF.load(_file(robot), load_meshes=False, build_scene_graph=False).robot
    joints = {joint.name: joint for joint in urdf.joints}
    for name, lower, upper, velocity, effort in zip(
        robot.joint_names, robot.q_min, robot.q_max, robot.velocity_max, robot.effort_max, strict=True
    ):
        limit = joints[name].limit
        assert (limit.lower, limit.upper, limit.velocity, limit.effort) == (lower, upper, velocity, effort)
    left = {link.name for link in urdf.links if link.name in robot.frames}
    total = sum(link.inertial.mass for link in urdf.links if link.inertial is not None and link.name in left)
    assert robot.mass == pytest.approx(total, rel=1e-12)
    for index, body in enumerate(robot.bodies):
        assert body.parent < index
        assert index == 0 or np.linalg.norm(body.axis) == pytest.approx(1.0)


def _file(model):
    return str(DATA / "biped12.urdf") if model is biped12() else str(POPPY)


def test_soles_are_flat_and_side_by_side_at_zero_angles(robot, foot):
    """The pelvis and the CoM are above the soles."""
    kin = Kinematics(robot, np.zeros(robot.n), foot)
    x = kin.pose(kin.swing)
    np.testing.assert_allclose(x[:4], [1.0, 0.0, 0.0, 0.0], atol=1e-12)
    p = kin.point(kin.swing)
    assert p[2] == pytest.approx(0.0, abs=1e-12)
    assert p[0] == pytest.approx(0.0, abs=1e-12)
    assert p[1] < -0.05 if foot is Foot.LEFT else p[1] > 0.05
    assert kin.point(robot.pelvis)[2] > 0.3
    assert kin.com[2] > 0.15


def test_a_changed_file_is_read_again(tmp_path):
    """Although the model of its former content is remembered, in this process and on disk."""
    path = edited(tmp_path, POPPY)
    config = RobotConfig(urdf=str(path))
    before = load_model(config)
    assert load_model(config) is before
    path.write_text(path.read_text().replace('name="poppy_humanoid"', 'name="another"'))
    assert load_model(config).name == "another"


def test_the_encoding_that_a_published_text_declares_is_not_that_of_the_text():
    """It is that of the file; the text of a message has been decoded already."""
    text = POPPY.read_text(encoding="utf-8").partition("?>")[2].replace('"poppy_humanoid"', '"Poppy é"')
    model = parse_model(f'<?xml version="1.0" encoding="ISO-8859-1"?>{text}', RobotConfig())
    assert model.name == "Poppy é"


# ---------------------------------------------------------------------- subsets of joints


def test_wildcards_lock_whole_limbs():
    model = load_model(RobotConfig(lock=("r_*", "head_*")))
    assert not any(name.startswith(("r_", "head_")) for name in model.joint_names)
    assert "l_knee_y" in model.joint_names
    assert "r_sole" in model.frames


def test_dropping_a_joint_removes_all_bodies_beyond_it():
    whole, cut = poppy(), load_model(RobotConfig(drop=("abs_y",)))
    assert set(cut.joint_names) == set(legs().joint_names)
    assert "head" not in cut.frames
    assert cut.mass < whole.mass


def test_soles_without_a_joint_between_them_are_refused():
    with pytest.raises(ModelError, match="no joint moves the soles"):
        load_model(RobotConfig(lock=("*",)))


@pytest.mark.parametrize("lock", [("r_*", "head_*"), ("abs_*", "bust_*"), ("l_knee_y",), ("*_shoulder_*", "*_ankle_y")])
def test_locking_keeps_the_total_mass_and_the_centre_of_mass(lock, foot):
    whole, locked = poppy(), load_model(RobotConfig(lock=lock))
    assert locked.n < whole.n
    assert locked.mass == pytest.approx(whole.mass, rel=1e-14)
    rng = np.random.default_rng(0)
    for _ in range(5):
        q = rng.uniform(locked.q_min, locked.q_max)
        full = np.zeros(whole.n)
        for name, angle in zip(locked.joint_names, q, strict=True):
            full[whole.joint_names.index(name)] = angle
        a, b = Kinematics(locked, q, foot), Kinematics(whole, full, foot)
        np.testing.assert_allclose(a.com, b.com, atol=1e-14)
        for frame in ("l_sole", "r_sole", "pelvis", "head"):
            np.testing.assert_allclose(a.pose(frame), b.pose(frame), atol=1e-14)


def test_a_weighed_mass_scales_all_masses_and_inertias(foot):
    given, heavy = poppy(), load_model(RobotConfig(mass=3.2))
    assert heavy.mass == pytest.approx(3.2, rel=1e-14)
    q = np.random.default_rng(1).uniform(given.q_min, given.q_max)
    a, b = Kinematics(given, q, foot), Kinematics(heavy, q, foot)
    np.testing.assert_allclose(a.com, b.com, atol=1e-14)
    factor = 3.2 / given.mass
    np.testing.assert_allclose(swing_inertia(b), factor * swing_inertia(a), rtol=1e-12)
    again = parse_model(heavy.urdf, RobotConfig(mass=3.2))  # a published description has that mass already
    assert [body.mass for body in again.bodies] == pytest.approx([body.mass for body in heavy.bodies], rel=1e-14)


def test_joint_names_are_case_sensitive():
    with pytest.raises(ModelError, match="there is no such joint; it has"):
        load_model(RobotConfig(lock=("l_knee_Y",)))


# ---------------------------------------------------------------------- soles


def test_sole_dimensions_are_those_of_its_box():
    urdf = yourdfpy.URDF.load(str(POPPY), load_meshes=False, build_scene_graph=False).robot
    for foot, name in ((Foot.LEFT, "l_sole"), (Foot.RIGHT, "r_sole")):
        box = next(link for link in urdf.links if link.name == name).collisions[0]
        sole = poppy().soles[foot]
        assert (sole.length, sole.width) == tuple(box.geometry.box.size[:2])
        np.testing.assert_allclose(sole.center, 0.0, atol=1e-12)  # the link is at the centre of the sole
        np.testing.assert_allclose(sole.tip - sole.heel, [sole.length, 0.0, 0.0], atol=1e-15)
        np.testing.assert_allclose(sole.corners.mean(axis=0), sole.center, atol=1e-15)
        np.testing.assert_allclose(np.ptp(sole.corners, axis=0), [sole.length, sole.width, 0.0], atol=1e-15)


def test_sole_dimensions_can_be_configured(foot):
    sole = legs().soles[foot]
    assert (sole.length, sole.width) == (0.0934, 0.07)
    # p_basecom of section 5: below the foot's own centre of mass
    body = legs().frames[sole.frame].body
    kin = Kinematics(legs(), np.zeros(10), foot)
    x_sole_in_body = legs().frames[sole.frame].pose
    com = DQ(x_sole_in_body).conj().transform_point(legs().bodies[body].com)
    np.testing.assert_allclose(sole.center, [com[0], com[1], 0.0], atol=1e-15)
    np.testing.assert_allclose(kin.point(sole.frame, sole.center), sole.center, atol=1e-15)


def test_a_dimension_that_is_not_configured_is_that_of_the_box():
    sole = load_model(RobotConfig(sole_length=0.2)).soles[Foot.LEFT]
    assert (sole.length, sole.width) == (0.2, poppy().soles[Foot.LEFT].width)


# ---------------------------------------------------------------------- refused descriptions


@pytest.mark.parametrize("key", ["pelvis", "left_sole", "right_sole", "imu"])
def test_a_missing_link_is_named(key):
    with pytest.raises(ModelError, match=f"robot.{key} names the link 'nowhere', which is missing"):
        load_model(RobotConfig(**{key: "nowhere"}))


def test_a_dropped_sole_is_named():
    with pytest.raises(ModelError, match=r"robot\.left_sole names the link 'l_sole'"):
        load_model(RobotConfig(drop=("l_knee_y",)))


@pytest.mark.parametrize("key", ["drop", "lock"])
def test_a_missing_joint_is_named(key):
    with pytest.raises(
        ModelError, match=f"robot.{key} names 'tail_\\*', and there is no such joint; it has .*l_knee_y"
    ):
        load_model(RobotConfig(**{key: ("tail_*",)}))


def test_a_missing_file_is_named():
    with pytest.raises(ModelError, match=r"nowhere.urdf"):
        load_model(RobotConfig(urdf="nowhere.urdf"))
    with pytest.raises(ModelError, match=r"^no robot description '/nowhere/robot\.urdf' \(robot.urdf\)$"):
        load_model(RobotConfig(urdf="/nowhere/robot.urdf"))


def test_a_robot_without_mass_is_refused(tmp_path):
    path = edited(tmp_path, POPPY, (r"<inertial>.*?</inertial>", ""))
    with pytest.raises(ModelError, match="mass"):
        load_model(RobotConfig(urdf=str(path)))


def test_a_prismatic_joint_is_refused_unless_it_is_locked(tmp_path):
    path = edited(tmp_path, POPPY, (r'name="l_knee_y" type="revolute"', 'name="l_knee_y" type="prismatic"'))
    with pytest.raises(ModelError, match="joint 'l_knee_y'"):
        load_model(RobotConfig(urdf=str(path)))
    assert load_model(RobotConfig(urdf=str(path), lock=("l_knee_y",))).n == 24  # a locked joint is fixed


def test_a_sole_without_a_box_needs_configured_dimensions(tmp_path):
    path = edited(tmp_path, POPPY, (r"<collision>.*?</collision>", ""))
    with pytest.raises(ModelError, match=r"'[lr]_sole' has no collision box; give robot.sole_length and sole_width"):
        load_model(RobotConfig(urdf=str(path)))
    assert load_model(RobotConfig(urdf=str(path), sole_length=0.1, sole_width=0.05)).soles[Foot.LEFT].width == 0.05
