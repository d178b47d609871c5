"""Descriptions that are unusual or wrong in one respect, made of a robot that walks: adopted, or refused by name."""

from __future__ import annotations

import io
import math
import re
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from robots import edited

from dqwalk_ros import cli
from dqwalk_ros.adopt import adopt, posture
from dqwalk_ros.adopt.adoption import _mass_evidence
from dqwalk_ros.adopt.anatomy import Anatomy, distances, find_anatomy
from dqwalk_ros.adopt.check import check
from dqwalk_ros.adopt.description import description_in
from dqwalk_ros.adopt.doubts import assume_masses, list_massless, repair_degrees, repair_inertias, use_led_joints
from dqwalk_ros.adopt.lean import Lean
from dqwalk_ros.adopt.legs import axes_differ, bent, freedom, leg_of
from dqwalk_ros.adopt.parameters import Numbers, servo_types
from dqwalk_ros.adopt.picture import _bones
from dqwalk_ros.adopt.posture import Standing, stand
from dqwalk_ros.adopt.skeleton import Skeleton
from dqwalk_ros.adopt.trial import Trial, walk
from dqwalk_ros.config import Config, RobotConfig, load
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.plants.mujoco import build
from dqwalk_ros.report.binding import Load
from dqwalk_ros.robot.model import RobotModel, find_urdf, load_model, parse_model
from dqwalk_ros.robot.servos import Servos
from dqwalk_ros.robot.shapes import Shapes
from dqwalk_ros.robot.urdf import Urdf
from dqwalk_ros.support.errors import ConfigError, ModelError

SMALL = Path(__file__).parents[1] / "data" / "small_humanoid.urdf"
X, Y, Z = np.eye(3)


def anatomy_of(urdf: Urdf, near: Path = SMALL) -> Anatomy:
    return find_anatomy(urdf, Shapes(urdf, near))


def read(tmp_path: Path, *changes: tuple[str, str]) -> Urdf:
    return Urdf.load(edited(tmp_path, SMALL, *changes))


def small_model(urdf: Urdf, **sections: object) -> RobotModel:
    robot = {"pelvis": "trunk", "left_sole": "l_foot", "right_sole": "r_foot", **sections}
    return parse_model(urdf.text(), RobotConfig(**robot))  # type: ignore[arg-type]


def moved(urdf: Urdf, link: str, pose: np.ndarray) -> None:
    """Give a link another frame at `pose` (4, 4) in the present one; the robot is the same."""
    back = np.linalg.inv(pose)
    part = urdf.links[link].inertial
    part.origin, part.inertia = back @ part.origin, back[:3, :3] @ part.inertia @ back[:3, :3].T
    part.origin[:3, :3] = np.eye(3)
    for shape in (*urdf.links[link].visuals, *urdf.links[link].collisions):
        shape.origin = back @ shape.origin
    for joint in urdf.joints.values():
        if joint.parent == link:
            joint.origin = back @ joint.origin
        if joint.child == link:
            joint.origin = joint.origin @ pose
            joint.axis = None if joint.axis is None else back[:3, :3] @ joint.axis


def at(xyz: object, R: object = None) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3], pose[:3, :3] = xyz, np.eye(3) if R is None else R
    return pose


# ---------------------------------------------------------------------- legs


def test_hip_knee_and_ankle_are_those_of_the_axes_wherever_joints_have_their_origins() -> None:
    places = np.array([Z, Z, Z, 0.5 * Z, 0.0 * Z, 0.0 * Z])
    axes = np.array([Z, X, Y, Y, Y, X])
    leg = leg_of(places, axes)
    slid = leg_of(places + np.array([0.3, -0.1, 0.05, -0.2, 0.1, 0.4])[:, None] * axes, axes)
    for found in (leg, slid):
        assert found is not None
        assert found.knee == 3
        assert found.straight == pytest.approx(1.0)
        np.testing.assert_allclose([found.hip, found.ankle], [Z, 0.0 * Z], atol=1e-9)
    assert leg_of(places[:4], axes[:4]) is None  # without an ankle there is no knee


def test_skew_axes_of_a_hip_together_turn_it_as_three_axes_of_the_robot_do() -> None:
    skew = np.array([[0.8, 0.0, 0.6], [0.6, 0.0, -0.8], Y, Y, Y, X])
    turned = np.array([[0.6, 0.7, 0.4], [0.7, -0.6, 0.2], [0.4, 0.2, -0.9], Y, Y, X])
    for axes in (skew, turned / np.linalg.norm(turned, axis=1)[:, None]):
        angles = bent(axes, 3, Y)
        np.testing.assert_allclose(angles[:3] @ axes[:3], -0.3 * Y, atol=1e-9)
        assert angles[3] == pytest.approx(0.6)


def test_the_rank_of_the_axes_decides_what_legs_can_do() -> None:
    """Without ankle roll the pelvis stays between the feet; without hip yaw the feet do not turn."""
    bend = np.array([Z, Z, Z, 0.5 * Z + 0.2 * X, 0.0 * Z, 0.0 * Z])
    axes = np.array([Z, X, Y, Y, Y, X])

    def can(which: list[int], tilt: float = 0.0) -> tuple[bool, bool]:
        R = DQ.rotation_about(tilt, X + 0.3 * Z).rotation_matrix()
        hips = np.array([R @ a if k < 3 else a for k, a in enumerate(axes)])
        sides = [(bend[which] + y * Y, hips[which]) for y in (0.1, -0.1)]
        return freedom((sides[0], sides[1]), 1.0)

    assert can([0, 1, 2, 3, 4, 5]) == (True, True)
    assert can([0, 1, 2, 3, 4, 5], 0.5) == (True, True)  # skew axes
    assert can([0, 1, 2, 3, 4]) == (False, True)
    assert can([1, 2, 3, 4, 5]) == (True, False)
    assert can([2, 3, 4]) == (False, False)


def test_legs_are_alike_as_mirror_images_and_as_copies() -> None:
    p, a = np.array([Z, Z + 0.03 * X, 0.5 * Z, 0.02 * X]), np.array([Z, X, Y, Y])
    along = np.array([[0.0, 0.0, 0.1], [0.1, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.0, 0.0]])
    for q, b in ((p - 0.2 * Y, a), (p + along - 0.2 * Y, -a)):
        assert axes_differ(p, a, q, b, Y).max() < 1e-9
    tilted = a + 0.2 * np.array([[0, 1, 0], [0, 1, 0], [0, 0, 0], [0, 0, 0]])
    tilted /= np.linalg.norm(tilted, axis=1)[:, None]
    assert axes_differ(p, tilted, p - 0.2 * Y, tilted, Y).max() < 1e-9  # a copy
    assert axes_differ(p, tilted, p - 0.2 * Y, tilted * [-1, 1, -1], Y).max() < 1e-9  # a mirror image
    off = axes_differ(p, a, p - 0.2 * Y + np.outer([0.0, 0.0, 0.03, 0.0], X), a, Y)
    np.testing.assert_allclose(off, [0, 0, 0.03, 0], atol=1e-9)


@pytest.mark.parametrize("joints", ["r_hip_yaw", "r_knee", "r_hip_pitch r_knee r_ankle_pitch"])
def test_the_origin_of_a_joint_along_its_axis_is_arbitrary(joints: str) -> None:
    urdf, plain = Urdf.load(SMALL), anatomy_of(Urdf.load(SMALL))
    for joint in joints.split():
        moved(urdf, urdf.joints[joint].child, at(0.027 * urdf.joints[joint].axis))
    found = anatomy_of(urdf)
    assert found.legs == plain.legs
    assert found.soles[Foot.RIGHT].source == plain.soles[Foot.RIGHT].source
    assert (found.leg, found.apart) == pytest.approx((plain.leg, plain.apart), abs=1e-6)


def test_legs_that_differ_are_refused_with_joint_and_distance(tmp_path: Path) -> None:
    urdf = Urdf.load(SMALL)
    urdf.joints["r_knee"].origin[0, 3] += 0.02
    with pytest.raises(ModelError, match=r"'l_knee' is 20 mm from the mirror image of 'r_knee', more than 6 mm"):
        anatomy_of(urdf)


def test_legs_that_differ_less_are_taken_and_the_difference_is_doubted() -> None:
    """As where an edge was picked in one leg, and another one in the other."""
    urdf, plain = Urdf.load(SMALL), anatomy_of(Urdf.load(SMALL))
    urdf.joints["r_knee"].origin[0, 3] += 0.01
    found = anatomy_of(urdf)
    assert (found.legs, found.kinds) == (plain.legs, plain.kinds)
    (entry,) = [entry for entry in found.evidence if entry.what == "symmetry of the legs"]
    assert entry.value == "'l_knee' is 10 mm from the mirror image of 'r_knee', more than 6 mm"
    assert entry.confidence == "guess"


def test_an_ankle_beside_a_shin_that_touches_the_ground_is_no_toe() -> None:
    urdf, plain = Urdf.load(SMALL), anatomy_of(Urdf.load(SMALL))
    for side in "lr":
        joint = urdf.joints[f"{side}_ankle_roll"]
        joint.origin[0, 3] += 0.02
        for name, up in ((joint.child, 0.022), (joint.parent, -0.0132)):
            for shape in (*urdf.links[name].collisions, *urdf.links[name].visuals):
                shape.origin[2, 3] += up
    assert anatomy_of(urdf).legs == plain.legs


@pytest.mark.parametrize("round_", [True, False])
def test_wheels_under_the_feet_are_called_wheels(round_: bool, tmp_path: Path) -> None:
    shape = '<cylinder radius="0.03" length="0.02"/>' if round_ else '<box size="0.06 0.02 0.03"/>'
    wheel = (
        f'<link name="{{0}}_wheel"><collision><origin rpy="{1.5708 * round_} 0 0"/><geometry>{shape}</geometry>'
        '</collision></link><joint name="{0}_turn" type="continuous"><parent link="{0}_foot"/>'
        '<child link="{0}_wheel"/><origin xyz="0 0 -0.07"/><axis xyz="0 1 0"/></joint>'
    )
    urdf = read(tmp_path, ("</robot>", wheel.format("l") + wheel.format("r") + "</robot>"))
    if not round_:
        assert anatomy_of(urdf).sideways
        return
    with pytest.raises(ModelError, match="on wheels: 'l_turn', 'r_turn' turn them"):
        anatomy_of(urdf)


def test_an_axis_that_is_wrong_in_one_leg_is_named() -> None:
    urdf = Urdf.load(SMALL)
    urdf.joints["r_ankle_pitch"].axis = X
    urdf.joints["r_ankle_pitch"].origin[0, 3] += 0.02
    text = r"the axis of 'l_ankle_pitch' is 90 degrees from the mirror image of that of 'r_ankle_pitch'"
    with pytest.raises(ModelError, match=text):
        anatomy_of(urdf)


@pytest.mark.parametrize(
    ("ankle", "off", "message"),
    [
        (
            0.4,
            0.0,
            r"with \+y of its root link up it has legs that end with 'l_ankle_roll' and .*their soles lean by 23",
        ),
        (0.0, 0.01, r"the axis of '._ankle_pitch' is 90 degrees from the mirror image of that of '._ankle_pitch'"),
    ],
)
def test_legs_that_almost_stand_with_another_axis_up_are_said(ankle: float, off: float, message: str) -> None:
    urdf = Urdf.load(SMALL)
    for side in "lr":
        joint = urdf.joints[f"{side}_ankle_pitch"]
        joint.origin = joint.origin @ at(np.zeros(3), DQ.rotation_about(ankle, Y).rotation_matrix())
    urdf.joints["r_ankle_pitch"].origin[0, 3] += off
    urdf.joints["r_ankle_pitch"].axis = X if off else Y
    for link in urdf.links:
        moved(urdf, link, at(np.zeros(3), DQ.rotation_about(0.5 * math.pi, X).rotation_matrix()))
    with pytest.raises(ModelError, match=message):
        anatomy_of(urdf)


def test_legs_of_three_joints_do_not_show_what_is_up() -> None:
    """Those of a quadruped do not mean that its nose is up."""
    urdf = Urdf.load(SMALL)
    for side in "lr":
        for name in ("hip_yaw", "hip_roll", "ankle_roll"):
            urdf.weld({f"{side}_{name}": 0.0})
        joint = urdf.joints[f"{side}_ankle_pitch"]
        joint.origin = joint.origin @ at(np.zeros(3), DQ.rotation_about(0.4, Y).rotation_matrix())
    for link in urdf.links:
        moved(urdf, link, at(np.zeros(3), DQ.rotation_about(0.5 * math.pi, X).rotation_matrix()))
    with pytest.raises(ModelError, match="is carried by 2 joints at most"):
        anatomy_of(urdf)


def test_of_soles_that_overlap_the_visual_shapes_are_taken(tmp_path: Path) -> None:
    wide = r'(<collision>\s*<origin xyz="[^"]*"/>\s*<geometry>)<box size="0.1265 0.0825 0.0132"/>'
    found, plain = anatomy_of(read(tmp_path, (wide, r'\1<box size="0.6 0.4 0.0132"/>'))), anatomy_of(Urdf.load(SMALL))
    assert found.soles[Foot.LEFT].width == pytest.approx(plain.soles[Foot.LEFT].width)
    assert found.apart == plain.apart


def test_points_of_contact_span_a_sole(tmp_path: Path) -> None:
    def points(box: re.Match[str]) -> str:
        x, y, z = map(float, box[1].split())
        corners = [(x + a * 0.06325, y + b * 0.04125, z - 0.0066) for a in (-1, 1) for b in (-1, 1)]
        geometry = '<geometry><sphere radius="0.0"/></geometry>'
        return "".join(f'<collision><origin xyz="{a} {b} {c}"/>{geometry}</collision>' for a, b, c in corners)

    foot = rf'<collision>\s*<origin xyz="([^"]*)"/>\s*<geometry>{FOOT_BOX}</geometry>\s*</collision>'
    path = tmp_path / "points.urdf"
    path.write_text(re.sub(foot, points, SMALL.read_text()))
    found, plain = (anatomy_of(Urdf.load(file)).soles[Foot.LEFT] for file in (path, SMALL))
    assert (found.length, found.width) == pytest.approx((plain.length, plain.width), rel=0.01)
    np.testing.assert_allclose(found.pose.translation(), plain.pose.translation(), atol=1e-3)
    assert "collision" in found.source


def test_a_leg_that_ends_higher_than_the_other_is_refused_with_joint_and_distance(tmp_path: Path) -> None:
    urdf = Urdf.load(SMALL)
    urdf.joints["r_knee"].origin[:3, 3] += [0.1, 0.0, 0.05]
    with pytest.raises(ModelError, match=r"'l_knee' is 112 mm from the mirror image of 'r_knee', more than 6 mm"):
        anatomy_of(urdf)


def test_limits_that_do_not_mirror_each_other_are_doubted(tmp_path: Path) -> None:
    wrong = r'(name="r_knee".*?lower=)"-2.2" upper="2.2"', r'\1"-0.1" upper="2.2"'
    right = r'(name="l_knee".*?lower=)"-2.2" upper="2.2"', r'\1"-0.1" upper="2.2"'  # its axis is the opposite one
    found = {entry.what: entry for entry in anatomy_of(read(tmp_path, wrong, right)).evidence}
    assert "'l_knee' and 'r_knee' do not mirror each other: -0.10 to 2.20" in found["limits of the legs"].value
    assert "limits of the legs" not in {entry.what for entry in anatomy_of(Urdf.load(SMALL)).evidence}
    slow = r'(name="l_knee".*?velocity=)"[^"]*"', r'\1"0.001"'
    found = {entry.what: entry for entry in anatomy_of(read(tmp_path, slow)).evidence}
    assert "'l_knee' and 'r_knee' have the velocity limits 0.001 and " in found["limits of the legs"].value


CHEST = (
    '<link name="chest"><inertial><origin xyz="0 0 0.2"/><mass value="8"/><inertia ixx="0.1" iyy="0.1" izz="0.1"/>'
    '</inertial></link><joint name="waist" type="revolute"><parent link="trunk"/><child link="chest"/>'
    '<axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="4" velocity="6"/></joint></robot>'
)


def test_legs_without_ankle_roll_stand_as_far_apart_as_in_the_zero_posture(tmp_path: Path) -> None:
    rolls = r'(name="._ankle_roll" type=)"revolute"', r'\1"fixed"'
    arms = r'<parent link="trunk"/>(\s*<child link="._upper_arm"/>)', r'<parent link="chest"/>\1'
    urdf = read(tmp_path, rolls, arms, ("</robot>", CHEST))
    for side, sign in (("l", 1.0), ("r", -1.0)):
        urdf.joints[f"{side}_hip_pitch"].origin[1, 3] += sign * 0.06
    found = anatomy_of(urdf)
    assert not found.sideways
    assert found.turns
    plain = anatomy_of(Urdf.load(SMALL))
    assert found.apart > plain.apart + 0.1
    assert found.lean is None
    urdf.joints["waist"].axis = Z
    assert anatomy_of(urdf).lean is not None


NO_ROLL = r'(name="._ankle_roll" type=)"revolute"', r'\1"fixed"'


def test_a_trunk_leans_where_no_ankle_rolls_and_no_waist_moves_the_com(tmp_path: Path) -> None:
    """By the lever, the CoM moves sideways with the pelvis that rolls over both legs, which stay upright."""
    urdf = read(tmp_path, NO_ROLL)
    limits = [urdf.joints[f"{side}_hip_roll"].limit for side in "lr"]
    limits[0].lower, limits[1].upper = -0.3, 0.25
    found = anatomy_of(urdf)
    assert found.lean.most == 0.25
    posed = Skeleton(urdf, Shapes(urdf, SMALL)).turned(found.turn)
    total, legs = 0.0, {joint for leg in found.legs.values() for joint in leg}
    moved = np.zeros(3)
    for body in posed.bodies:
        total += posed.mass(body)
        if not legs & set(posed.way(body)):
            moved += posed.mass(body) * np.cross(-X, posed.com([body]) - posed.place("l_hip_roll"))
    assert found.lean.lever == pytest.approx(moved[1] / total, rel=1e-6)


def test_a_trunk_leans_less_in_quicker_steps_and_not_at_all_with_the_com_below_the_hips() -> None:
    angles = [Lean(0.1, 0.5).angle(0.2, 0.8, single) for single in (0.2, 0.4, 0.8)]
    assert angles == sorted(angles)
    assert angles[-1] < 1.0  # the CoM at most reaches the sole
    assert Lean(-0.1, 0.5).angle(0.2, 0.8, 0.4) == np.inf


def test_a_robot_whose_trunk_leans_does_the_dynamic_walk(tmp_path: Path) -> None:
    """With a pelvis that is kept level it waits in double support for a CoM that cannot move."""
    found = adopt(edited(tmp_path, SMALL, NO_ROLL), tmp_path / "out")
    assert "for a standing walk its trunk would have to lean by" in found.numbers.hindrance
    config = load(tmp_path / "out" / "dynamic.yaml").updated({"gait.steps": 6})
    done = walk(config, found.model, "integrator", lambda *_: None)
    assert (done.stood, done.note) == (True, "")


def test_a_head_that_is_not_there_is_left_out_and_a_leg_is_missed_by_name(tmp_path: Path) -> None:
    eye = '<joint name="eye_joint" type="fixed"><parent link="trunk"/><child link="eye"/></joint></robot>'
    found = adopt(edited(tmp_path, SMALL, ("</robot>", eye)), tmp_path / "out")
    assert any("'eye_joint' names 'eye', and there is no such link: left out" in repair for repair in found.repairs)
    with pytest.raises(ModelError, match=r"; line \d+: <joint> 'r_[a-z_]*' names 'r_thigh', and there is no such link"):
        adopt(edited(tmp_path, SMALL, (r'<link name="r_thigh">.*?</link>', "")), tmp_path / "other")


def test_two_robots_on_one_root_are_named(tmp_path: Path) -> None:
    """Both have a waist, so they look like one robot with four legs, or with two that are far apart."""
    inside = re.sub(r"^.*?<robot[^>]*>|</robot>", "", SMALL.read_text(), flags=re.S)
    parts = ['<robot name="two"><link name="world"/>']
    for who, y in (("a", 0.0), ("b", 1.0)):
        parts.append(re.sub(r'(<link name|<joint name|parent link|child link)="', rf'\1="{who}_', inside))
        parts.append(
            f'<joint name="{who}_base" type="fixed"><parent link="world"/>'
            f'<child link="{who}_trunk"/><origin xyz="0 {y} 0"/></joint>'
        )
    text = "".join(parts) + "</robot>"
    with pytest.raises(ModelError, match="'world_link' carries 2 robots, which begin with 'a_trunk', 'b_trunk'"):
        anatomy_of(Urdf(text, "two.urdf"))


def test_a_long_sole_may_be_narrow_but_not_one_like_a_point(tmp_path: Path) -> None:
    """As Unitree's H1, whose soles are 300 x 30 mm, and which does the dynamic walk."""
    box = '<box size="0.1265 0.0825 0.0132"/>'
    assert anatomy_of(read(tmp_path, (box, '<box size="0.1265 0.01 0.0132"/>'))).soles[Foot.LEFT].width < 0.011
    with pytest.raises(ModelError, match="points or edges: its left sole is 20 x 10 mm"):
        anatomy_of(read(tmp_path, (box, '<box size="0.02 0.01 0.0132"/>')))


def test_a_trunk_that_cannot_lean_as_far_as_a_walk_needs_is_an_error(tmp_path: Path) -> None:
    narrow = r'(name="._hip_roll".*?lower=)"[^"]*" upper="[^"]*"', r'\1"-0.02" upper="0.02"'
    with pytest.raises(ModelError, match=r"lean by \d+ degrees in each step .*; its hips roll by 1 degrees$"):
        adopt(edited(tmp_path, SMALL, NO_ROLL, narrow), tmp_path / "out")


def test_skew_hips_stand_on_level_soles(tmp_path: Path) -> None:
    urdf = Urdf.load(SMALL)
    for side in "lr":
        urdf.joints[f"{side}_hip_yaw"].axis = np.array([0.6, 0.0, 0.8])
        urdf.joints[f"{side}_hip_roll"].axis = np.array([0.8, 0.0, -0.6])
    found = anatomy_of(urdf)
    assert found.kinds == "SSPPPR"
    assert (found.sideways, found.turns) == (True, True)
    legs = {joint for names in found.legs.values() for joint in names}
    model = small_model(urdf, lock=tuple(set(small_model(urdf).joint_names) - legs))
    assert stand(model, found).error < 1e-3


# ---------------------------------------------------------------------- the root, and what is up


@pytest.mark.parametrize("root", ["r_foot", "l_shank"])
def test_the_root_may_be_in_a_leg(root: str) -> None:
    urdf, plain = Urdf.load(SMALL), anatomy_of(Urdf.load(SMALL))
    urdf.reroot(root)
    found = anatomy_of(urdf)
    assert found.legs == plain.legs
    assert (found.leg, found.apart) == pytest.approx((plain.leg, plain.apart), abs=1e-6)


def test_z_of_the_root_link_may_be_down() -> None:
    urdf, plain = Urdf.load(SMALL), anatomy_of(Urdf.load(SMALL))
    moved(urdf, urdf.root, at(np.zeros(3), np.diag([1.0, -1.0, -1.0])))
    found = anatomy_of(urdf)
    assert not urdf.repairs  # such as another root
    assert (found.legs, found.leg) == (plain.legs, pytest.approx(plain.leg))


def test_another_root_is_the_same_robot() -> None:
    urdf, q = Urdf.load(SMALL), np.random.default_rng(0).uniform(-0.4, 0.4, 20)
    kins = []
    for root in ("trunk", "r_foot", "l_lower_arm"):
        urdf.reroot(root)
        model = small_model(urdf)
        assert model.root == root
        assert len({*model.joints_to_soles(model.pelvis)}) == 1
        assert len({*model.joints_to_soles("l_shank")}) == 2
        angles = dict(zip(sorted(model.joint_names), q, strict=False))
        kins.append(Kinematics(model, np.array([angles[name] for name in model.joint_names]), Foot.LEFT))
    for kin in kins[1:]:
        np.testing.assert_allclose(kin.com, kins[0].com, atol=1e-12)
        np.testing.assert_allclose(kin.point("r_foot"), kins[0].point("r_foot"), atol=1e-12)


def test_pelvis_and_root_get_frames_with_z_up_between_the_hips(tmp_path: Path) -> None:
    """The trunk's frame is at the floor, and another of its axes is up."""
    urdf = Urdf.load(SMALL)
    moved(urdf, "trunk", at([0.02, 0.0, -0.4], DQ.rotation_about(0.5 * math.pi, X).rotation_matrix()))
    path = tmp_path / "turned.urdf"
    path.write_text(urdf.text())
    found = adopt(path, tmp_path / "out")
    assert (found.model.root, found.model.pelvis) == ("dqwalk_root", "dqwalk_pelvis")
    kin = Kinematics(found.model, found.model.posture(found.config.standing.posture), Foot.LEFT)
    for link in (found.model.root, found.model.pelvis):
        assert kin.direction(link, Z)[2] > 0.999
        assert kin.point(link)[2] == pytest.approx(found.anatomy.leg, rel=0.15)
    assert not found.findings


def test_a_part_of_the_robot_may_be_named_world(tmp_path: Path) -> None:
    urdf = read(tmp_path, (r'"trunk"', '"world"'))
    assert urdf.root == "world_link"
    assert "renamed 'world_link'" in urdf.repairs[-1]
    build(Config(), small_model(urdf, pelvis="world_link", sole_length=0.1, sole_width=0.08))


def test_torques_are_limited_by_the_servos_only() -> None:
    model = small_model(Urdf.load(SMALL), sole_length=0.1, sole_width=0.08)
    mj = build(Config().updated({"servo.torque_scale": 3.0}), model)
    assert not mj.jnt_actfrclimited.any()
    k = model.joint_names.index("l_knee")
    assert mj.actuator_forcerange[k, 1] == pytest.approx(3.0 * model.effort_max[k])


# ---------------------------------------------------------------------- shapes


def test_a_missing_mesh_of_a_foot_is_an_error_that_names_it(tmp_path: Path) -> None:
    box, mesh = r'<box size="0.1265 0.0825 0.0132"/>', '<mesh filename="package://missing/foot.stl"/>'
    small = r'(<link name="._ankle_link">.*?<box size=)"[^"]*"', r'\1"0.08 0.05 0.02"'
    with pytest.raises(ModelError, match=r"'._ankle_pitch' carry has a mesh .*'package://missing/foot.stl' not found"):
        anatomy_of(read(tmp_path, (box, mesh), small))


@pytest.mark.parametrize(
    "lost",
    [
        (r'(<link name="l_foot">.*?<collision>.*?<geometry>)<box [^>]*/>', r'\1<mesh filename="lost.stl"/>'),
        (r'(<link name="l_foot">.*?)<collision>.*?</collision>', r"\1"),
    ],
)
def test_soles_are_those_of_the_visual_shapes_of_both_feet_if_a_foot_lacks_a_collision_shape(
    lost: tuple[str, str], tmp_path: Path
) -> None:
    wide = r'(<link name="r_foot">.*?<collision>.*?<box size=)"[^"]*"', r'\1"0.16 0.1 0.0132"'
    soles = anatomy_of(read(tmp_path, lost, wide)).soles.values()
    assert ["visual shapes" in sole.source for sole in soles] == [True, True]
    assert {round(sole.length, 4) for sole in soles} == {0.1265}


def test_a_pointer_of_git_lfs_is_named(tmp_path: Path) -> None:
    (tmp_path / "foot.stl").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 84\n")
    path = edited(tmp_path, SMALL, (r'<box size="0.1265 0.0825 0.0132"/>', '<mesh filename="foot.stl"/>'))
    urdf = Urdf.load(path)
    with pytest.raises(ModelError, match="git lfs pull"):
        anatomy_of(urdf, path)


def test_all_meshes_that_are_declared_as_y_up_are_turned_or_none(tmp_path: Path) -> None:
    """The mesh of one foot, whose CoM is at its origin, does not show what is up; that of the other does."""
    for name, up in (("a", 0.05), ("b", 0.0)):
        box = trimesh.creation.box((0.12, 0.02, 0.08))
        box.apply_translation([0.0, up, 0.0])
        text = box.export(file_type="dae").replace(b"Z_UP", b"Y_UP")
        (tmp_path / f"{name}.dae").write_bytes(text)
    inertial = '<inertial><origin xyz="0 0 {}"/><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
    links = "".join(
        f'<link name="{name}">{inertial.format(z)}<visual><geometry><mesh filename="{name}.dae"/></geometry></visual>'
        "</link>"
        for name, z in (("a", 0.05), ("b", 0.0))
    )
    joint = '<joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint>'
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="r">{links}{joint}</robot>')
    shapes = Shapes(Urdf.load(path), path)
    sizes = [np.ptp(shapes.of(name, "visuals")[0].vertices, axis=0) for name in "ab"]
    np.testing.assert_allclose(sizes, [[0.12, 0.08, 0.02]] * 2, atol=1e-6)


def test_soles_that_are_not_alike_are_an_error(tmp_path: Path) -> None:
    tilted = r'(<link name="r_foot">.*?<collision>\s*<origin xyz="[^"]*")', r'\1 rpy="0 0.4 0"'
    with pytest.raises(ModelError, match=r"soles do not mirror each other: left .* turned by 23 degrees"):
        anatomy_of(read(tmp_path, tilted))


def test_soles_that_mirror_each_other_may_be_tilted_in_the_zero_posture(tmp_path: Path) -> None:
    tilts = [
        (rf'(<link name="{side}_foot">.*?<collision>\s*<origin xyz="[^"]*")', rf'\1 rpy="{angle} 0 0"')
        for side, angle in (("l", 0.4), ("r", -0.4))
    ]
    found = anatomy_of(read(tmp_path, *tilts))
    assert all("tilted by 22.9 degrees" in sole.source for sole in found.soles.values())


# ---------------------------------------------------------------------- units


def in_units(text: str, lengths: float) -> str:
    """Multiply the positions and sizes of a URDF."""

    def times(match: re.Match[str]) -> str:
        return f'{match[1]}"{" ".join(repr(lengths * float(word)) for word in match[2].split())}"'

    return re.sub(r'((?:<origin xyz|<box size|<sphere radius|length|radius)=)"([^"]*)"', times, text)


@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "millimetres"), (100.0, "centimetres"), (39.37, "inches")])
def test_another_unit_of_length_is_named(factor: float, unit: str) -> None:
    urdf = Urdf(in_units(SMALL.read_text(), factor), "robot.urdf")
    with pytest.raises(ModelError, match=rf"links of 'small_humanoid' weigh 4.059 kg .* are the lengths in {unit}\?"):
        anatomy_of(urdf)


@pytest.mark.parametrize(
    ("factor", "message"),
    [
        (1000.0, r"'foot.stl' of 'trunk' is 126 m large.*millimetres; write <mesh ... scale"),
        (0.0005, "joints in mill"),
    ],
)
def test_meshes_and_joints_in_different_units_are_named(factor: float, message: str, tmp_path: Path) -> None:
    trimesh.creation.box(factor * np.array([0.1265, 0.0825, 0.0132])).export(tmp_path / "foot.stl")
    every = r"<(box|cylinder|sphere) [^>]*/>", '<mesh filename="foot.stl"/>'
    path = edited(tmp_path, SMALL, every)
    with pytest.raises(ModelError, match=message):
        anatomy_of(Urdf.load(path), path)


def test_limits_in_degrees_are_converted_and_said() -> None:
    urdf = Urdf.load(SMALL)
    wanted = {name: joint.limit.lower for name, joint in urdf.joints.items() if joint.limit}
    for name in wanted:
        limit = urdf.joints[name].limit
        limit.lower, limit.upper = math.degrees(limit.lower), math.degrees(limit.upper)
    repair_degrees(urdf)
    assert {name: urdf.joints[name].limit.lower for name in wanted} == pytest.approx(wanted)
    assert "can only be degrees" in urdf.repairs[-1]
    repairs = list(urdf.repairs)
    repair_degrees(urdf)  # radians are left as they are
    assert urdf.repairs == repairs


def test_angles_of_origins_in_degrees_are_doubted(tmp_path: Path) -> None:
    urdf = read(tmp_path, (r'(<joint name="l_knee".*?<origin xyz="[^"]*")', r'\1 rpy="0 0 90"'))
    assert re.search(r"line \d+: <joint> 'l_knee' has rpy = .*90.* are they degrees", urdf.repairs[0])


def test_placeholder_inertias_are_replaced_and_named() -> None:
    urdf = Urdf.load(SMALL)
    true = urdf.links["l_shank"].inertial.inertia.copy()
    urdf.links["l_foot"].inertial.inertia = np.eye(3)
    repair_inertias(urdf, Shapes(urdf, SMALL), 0.29)
    assert np.linalg.eigvalsh(urdf.links["l_foot"].inertial.inertia).max() < 1e-3
    assert len(urdf.repairs) == 1
    assert "'l_foot' has the moment of inertia 1 kg m^2" in urdf.repairs[0]
    np.testing.assert_array_equal(urdf.links["l_shank"].inertial.inertia, true)


# ---------------------------------------------------------------------- joints


@pytest.mark.parametrize(("joints", "message"), [("", "17 of 17"), ("._(?!elbow)", "14 of 17")])
def test_a_robot_most_of_whose_joints_have_the_limits_0_and_0_moves_without_limits(
    joints: str, message: str, tmp_path: Path
) -> None:
    urdf = read(tmp_path, (rf'(<joint name="{joints}[^>]*>.*?)lower="[^"]*" upper="[^"]*"', r'\1lower="0" upper="0"'))
    assert len(anatomy_of(urdf).legs[Foot.LEFT]) == 6
    assert f"{message} revolute joints have the limits 0 and 0" in urdf.repairs[0]


def test_repairs_are_printed_for_a_refused_robot_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    legs = r'(name="._(?:hip|knee|ankle)[^>]*>.*?)lower="[^"]*" upper="[^"]*"', r'\1lower="0.1" upper="0.1"'
    path = edited(tmp_path, SMALL, legs)
    assert cli.main(["adopt", str(path), "--out", str(tmp_path / "out"), "--yes"]) == 2
    out, error = capsys.readouterr()
    assert "repaired: line" in out
    assert "'l_hip_yaw' has no range, lower and upper are 0.1: fixed there (11 more like this)" in out
    assert "joints have no range" in error


def test_a_crank_that_leads_an_ankle_follows_it(tmp_path: Path) -> None:
    """The description lets the ankle mimic a crank on the shank, with -0.5 q + 0.1."""
    crank = (
        '<link name="l_crank"><inertial><mass value="0.01"/><inertia ixx="1e-6" iyy="1e-6" izz="1e-6"/></inertial>'
        "</link>"
        '<joint name="l_crank_joint" type="revolute"><parent link="l_shank"/><child link="l_crank"/><axis xyz="0 1 0"/>'
        '<limit lower="-2" upper="2" effort="4" velocity="6"/></joint></robot>'
    )
    mimic = '<mimic joint="l_crank_joint" multiplier="-0.5" offset="0.1"/>'
    urdf = read(tmp_path, ("</robot>", crank), (r'(<joint name="l_ankle_pitch".*?<limit[^>]*>)', rf"\1{mimic}"))
    use_led_joints(urdf)
    assert anatomy_of(urdf).legs[Foot.LEFT][4] == "l_ankle_pitch"
    ankle, led = urdf.joints["l_ankle_pitch"], urdf.joints["l_crank_joint"].mimic
    assert (ankle.limit.lower, ankle.limit.upper) == pytest.approx((-0.9, 1.1))
    assert led.joint == "l_ankle_pitch"
    assert (led.multiplier, led.offset) == pytest.approx((-2.0, 0.2))
    assert "'l_crank_joint' follows" in urdf.repairs[-1]


@pytest.mark.parametrize("led", ["ankle_roll", "knee"])
def test_a_joint_that_follows_another_of_its_leg_is_named(led: str, tmp_path: Path) -> None:
    mimic = '<mimic joint="l_hip_pitch" multiplier="-1"/>'
    with pytest.raises(ModelError, match=f"'l_{led}' of a leg mimics 'l_hip_pitch'"):
        anatomy_of(
            read(
                tmp_path,
                (rf'(<joint name="l_{led}".*?<limit[^>]*>)', rf"\1{mimic}"),
                (rf'(<joint name="r_{led}".*?<limit[^>]*>)', rf"\1{mimic.replace('l_hip', 'r_hip')}"),
            )
        )


@pytest.mark.parametrize(("name", "sign"), [("l=knee", "="), ("neck[1]", r"\[")])
def test_a_joint_that_no_parameter_can_name_is_named(name: str, sign: str, tmp_path: Path) -> None:
    old = "l_knee" if "knee" in name else "neck"
    path = edited(tmp_path, SMALL, (f'<joint name="{old}"', f'<joint name="{name}"'))
    with pytest.raises(ModelError, match=rf"joint '{re.escape(name)}' cannot be named .* '{sign}' has a meaning"):
        adopt(path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def narrowed(tmp_path: Path, **limits: float) -> Path:
    """Write the robot with symmetric limits of some joints of both legs [rad]."""
    changes = [
        (rf'(name="._{name}".*?lower=)"[^"]*" upper="[^"]*"', rf'\1"-{most}" upper="{most}"')
        for name, most in limits.items()
    ]
    return edited(tmp_path, SMALL, *changes)


def test_steps_are_as_long_as_the_legs_reach_and_the_joints_in_the_way_are_named(tmp_path: Path) -> None:
    posture = {"hip_pitch": -0.24, "knee": 0.57, "ankle_pitch": -0.33}  # the axes of the right leg are opposite
    ranges = [
        (
            rf'(name="{side}_{name}".*?lower=)"[^"]*" upper="[^"]*"',
            rf'\1"{sign * angle - 0.06}" upper="{sign * angle + 0.06}"',
        )
        for name, angle in posture.items()
        for side, sign in (("l", 1.0), ("r", -1.0))
    ]
    found = adopt(edited(tmp_path, SMALL, *ranges), tmp_path / "out")
    reason = next(entry.source for entry in found.entries if entry.what == "gait.step_length")
    numbers: Numbers = found.numbers
    assert 0.002 < numbers.reach < 0.02
    assert found.config.gait.step_length < numbers.reach
    assert re.search("hip_pitch|knee|ankle_pitch", reason)
    assert not found.findings
    config = load(tmp_path / "out" / "robot.yaml").updated({"gait.step_length": 0.026})
    assert "the legs reach steps of" in str(check(config, load_model(config.robot))[0])


@pytest.mark.long
def test_soles_are_as_close_as_narrow_limits_of_the_ankles_require(tmp_path: Path) -> None:
    """Only with the feet closer than in the zero posture can the CoM be over one of them."""
    urdf = Urdf.load(narrowed(tmp_path, ankle_roll=0.26, hip_roll=0.26))
    for side, y in (("l", 0.03), ("r", -0.03)):
        urdf.joints[f"{side}_hip_yaw"].origin[1, 3] += y
    wide = anatomy_of(urdf)
    found = adopt(written(tmp_path, urdf), tmp_path / "out").anatomy
    assert found.apart == pytest.approx(0.87 * wide.apart, rel=1e-3)
    assert any(entry.what == "distance of the soles" and "limits" in entry.source for entry in found.evidence)


def rolls(tmp_path: Path, inwards: float, outwards: float, ankles: float) -> Urdf:
    """Return the robot with hips that roll so far inwards and outwards [rad], and ankles that roll so far."""
    urdf = Urdf.load(narrowed(tmp_path, ankle_roll=ankles, hip_roll=outwards))
    urdf.joints["l_hip_roll"].limit.lower, urdf.joints["r_hip_roll"].limit.upper = -inwards, inwards
    return urdf


def test_soles_are_as_wide_as_hips_that_roll_outwards_only_require(tmp_path: Path) -> None:
    urdf = rolls(tmp_path, -0.1, 0.3, 0.5)
    usual = anatomy_of(urdf).apart
    found = adopt(written(tmp_path, urdf), tmp_path / "out")
    assert not found.findings
    assert found.anatomy.apart == pytest.approx(1.15 * usual, rel=1e-3)
    assert any("wider than in the zero posture" in entry.source for entry in found.anatomy.evidence)


@pytest.mark.parametrize(
    ("inwards", "outwards", "ankles", "message"),
    [
        (0.15, 0.15, 0.15, r"is 1\d\.\d mm, and a standing walk lifts the other foot at 3\.6 mm; at their limits are"),
        (-0.1, 0.3, 0.5, r"with the CoM over one sole the legs reach steps of 0\.0 mm only: .*_hip_roll"),
    ],
)
def test_what_keeps_a_robot_from_a_standing_walk_only_is_said(
    inwards: float, outwards: float, ankles: float, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The CoM would be 10 mm from the middle, and the first phase of the walk would not end."""
    # wider it would walk
    monkeypatch.setattr("dqwalk_ros.adopt.stance.distances", lambda anatomy: distances(anatomy)[:3])
    found = adopt(written(tmp_path, rolls(tmp_path, inwards, outwards, ankles)), tmp_path / "out")
    assert re.search(message, found.findings[0].message)
    assert load(tmp_path / "out" / "dynamic.yaml").gait.step_length > 0.03


@pytest.mark.long
@pytest.mark.parametrize(("limit", "part"), [(0.36, 0.87), (0.4, 1.0)])
def test_the_com_reaches_the_middle_of_a_sole_where_a_distance_of_the_soles_allows_it(
    limit: float, part: float, tmp_path: Path
) -> None:
    """Near enough to be accepted are also wider distances, from which the phases of the walk would not end."""
    urdf = Urdf.load(narrowed(tmp_path, ankle_roll=limit, hip_roll=limit))
    for side, y in (("l", 0.03), ("r", -0.03)):
        urdf.joints[f"{side}_hip_yaw"].origin[1, 3] += y
    wide = anatomy_of(urdf)
    found = adopt(written(tmp_path, urdf), tmp_path / "out")
    assert found.anatomy.apart == pytest.approx(part * wide.apart, rel=1e-3)
    misses = [posture.over_one_foot(found.model, found.anatomy, found.numbers.standing, foot).error for foot in Foot]
    assert max(misses) < 0.1 * found.config.standing.com_threshold


def test_legs_that_touch_or_cannot_move_sideways_stand_no_closer() -> None:
    found = replace(anatomy_of(Urdf.load(SMALL)), apart=0.16)
    assert distances(found)[:5] == [0.16, 0.1392, 0.12, 0.0992, 0.184]  # 0.08 would be less than the width of a sole
    assert distances(replace(found, sideways=False)) == [0.16]


def test_the_damping_of_light_legs_is_that_of_legs_with_rotors() -> None:
    urdf = Urdf.load(SMALL)
    model, anatomy = small_model(urdf), anatomy_of(urdf)
    standing = Standing(np.zeros(model.n), np.zeros(3), 0.3, error=0.0, knee=0.0, off=0.0, margin=0.05)
    numbers = Numbers(model, anatomy, standing, 0.0, "", {}, 0.0, ())
    for armature in (0.01, 1.0):
        swinging = numbers.inertia + armature
        ratio = 0.5 * numbers.damping(20.0, 0.5, armature) * math.sqrt(20.0 / swinging)
        assert ratio == pytest.approx(0.5, rel=0.03)


def test_bodies_with_shapes_and_without_mass_are_listed() -> None:
    urdf = Urdf.load(SMALL)
    list_massless(urdf)
    assert urdf.repairs == []
    for name in (urdf.root, "l_foot"):
        urdf.links[name].inertial.mass = 0.0
    list_massless(urdf)
    assert [text.partition(",")[0] for text in urdf.repairs] == [f"'{urdf.root}'"]
    assert "'l_foot' have shapes and no mass" in urdf.repairs[0]


def test_a_robot_without_masses_has_those_of_the_volumes_of_its_links_and_can_be_weighed(tmp_path: Path) -> None:
    bare = edited(tmp_path, SMALL, (r"<inertial>.*?</inertial>", ""))
    found = adopt(bare, tmp_path / "out")
    (repair,) = [text for text in found.repairs if "no link has a mass" in text]
    assert {entry.confidence for entry in found.evidence if entry.what in ("mass", "m g h")} == {"guess"}
    assert f"{found.model.mass:.3g} kg in all; weigh the robot and give --set robot.mass=KG" in repair
    foot = Urdf.load(found.folder / "robot.urdf").links["l_ankle_link"].inertial
    assert foot.mass == pytest.approx(500.0 * 0.033 * 0.033 * 0.022)
    np.testing.assert_allclose(np.diag(foot.inertia)[2], foot.mass / 12.0 * 2.0 * 0.033**2)
    weighed = adopt(bare, tmp_path / "weighed", changes={"robot.mass": 2.0 * found.model.mass})
    assert weighed.numbers.mgh == pytest.approx(2.0 * found.numbers.mgh)
    assert weighed.model.mass == pytest.approx(2.0 * found.model.mass)


@pytest.mark.parametrize("mass", [1.0, 0.2, 1e-4])
def test_the_same_mass_in_all_links_is_that_of_a_template_where_no_robot_is_so_dense(mass: float) -> None:
    urdf = Urdf.load(SMALL)
    for link in urdf.links.values():
        link.inertial.mass = mass if link.inertial.mass else 0.0
    urdf.links[urdf.root].inertial.mass *= 2.0
    before = sum(link.inertial.mass for link in urdf.links.values())
    guessed, after = assume_masses(urdf, Shapes(urdf, SMALL)), sum(link.inertial.mass for link in urdf.links.values())
    assert guessed == (mass != 0.2)
    assert (after == before) == (not guessed)
    assert [text for text in urdf.repairs if f"have the mass {mass:g} kg, as in a template" in text] == urdf.repairs
    assert 0.2 < after < 10.0


@pytest.mark.parametrize("part", [0.03, 0.2])
def test_a_foot_that_weighs_a_fifth_of_the_robot_is_doubted(part: float) -> None:
    urdf = Urdf.load(SMALL)
    foot, total = urdf.links["l_foot"].inertial, sum(link.inertial.mass for link in urdf.links.values())
    foot.mass = part / (1.0 - part) * (total - foot.mass)
    model = small_model(urdf)
    standing = Standing(np.zeros(model.n), 0.3 * Z, 0.3, error=0.0, knee=0.0, off=0.0, margin=0.05)
    numbers = Numbers(model, anatomy_of(urdf), standing, 0.0, "", {}, 0.0, ())
    doubts = [entry.value for entry in _mass_evidence(numbers) if entry.confidence == "guess"]
    assert doubts == ([f"{foot.mass:.3g} kg, 20 % of the robot"] if part > 0.1 else [])


@pytest.mark.parametrize("scale", [1.0, 10.0])
def test_a_mass_that_no_robot_of_this_size_has_is_doubted(scale: float) -> None:
    urdf = Urdf.load(SMALL)
    for link in urdf.links.values():
        link.inertial.mass *= scale
    model = small_model(urdf)
    standing = Standing(np.zeros(model.n), 0.25 * Z, 0.25, error=0.0, knee=0.0, off=0.0, margin=0.05)
    rows = _mass_evidence(Numbers(model, anatomy_of(urdf), standing, 0.0, "", {}, 0.0, ()))
    mass = next(row for row in rows if row.what == "mass")
    assert (mass.confidence, "weigh the robot" in mass.source) == (("sure", False) if scale == 1.0 else ("guess", True))


@pytest.mark.parametrize("trunk", [1.4, 0.1])
def test_legs_that_are_most_of_the_robot_are_doubted(trunk: float, tmp_path: Path) -> None:
    urdf = Urdf.load(SMALL)
    for name, link in urdf.links.items():
        if not name.startswith(("l_", "r_")) or "arm" in name:
            link.inertial.mass *= trunk / 1.4
            link.inertial.inertia *= trunk / 1.4
    found = adopt(written(tmp_path, urdf), tmp_path / "out")
    (share,) = [entry.value for entry in found.evidence if entry.what == "mass of the legs"] or [""]
    assert share == ("" if trunk > 1.0 else f"{100 * found.numbers.legs:.0f} % of the robot")


def test_weak_fast_servos_have_light_rotors(tmp_path: Path) -> None:
    light = 0.0025 * 9.81 * 0.05 * sum(link.inertial.mass for link in Urdf.load(SMALL).links.values())
    cases = ("0.4", "12", 0.3, 0.001), ("40", "12", 0.3, 0.01), ("0", "0", 0.3, 0.01), ("0", "0", 0.05, light)
    for effort, speed, height, armature in cases:  # 0: no limit
        urdf = read(tmp_path, (r'effort="[^"]*" velocity="[^"]*"', f'effort="{effort}" velocity="{speed}"'))
        standing = Standing(np.zeros(12), height * Z, 0.3, error=0.0, knee=0.0, off=0.0, margin=0.05)
        numbers = Numbers(small_model(urdf), anatomy_of(urdf), standing, 0.0, "", {}, 0.0, ())
        assert numbers.armature == pytest.approx(armature, rel=0.03)


def test_the_knees_of_a_posture_are_bent_further_than_where_their_range_begins() -> None:
    urdf = Urdf.load(SMALL)
    for side, sign in (("l", 1.0), ("r", -1.0)):
        limit = urdf.joints[f"{side}_knee"].limit
        limit.lower, limit.upper = sorted((sign * 0.5, sign * 2.2))
    model = small_model(urdf)
    found = stand(model, anatomy_of(urdf))
    assert (np.abs(found.q[["knee" in name for name in model.joint_names]]) > 0.7).all()


def test_knees_behind_the_legs_are_bent_beyond_the_straight_leg() -> None:
    """A knee 40 mm behind the line from hip to ankle, as of MH5: at its angle of zero the leg is bent backward."""
    urdf = Urdf.load(SMALL)
    for side in "lr":
        moved(urdf, f"{side}_shank", at([-0.04, 0.0, 0.0]))
    model, anatomy = small_model(urdf), anatomy_of(urdf)
    assert stand(model, anatomy).knee > 0.0


def test_bent_legs_are_preferred_to_stretched_ones_with_smaller_angles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Knees in front of the line from hip to ankle are in front of stretched legs as well, where a search ends too."""
    model = small_model(Urdf.load(SMALL))
    ends = ((0.3, 0.0), (0.01, 0.036))
    one = Standing(np.zeros(model.n), np.zeros(3), 0.3, error=0.0, knee=0.02, off=0.0, margin=0.05)
    postures = [replace(one, q=np.full(model.n, q), off=off) for q, off in ends]
    monkeypatch.setattr(posture, "_solve", lambda *_: postures.pop(0))
    assert stand(model, anatomy_of(Urdf.load(SMALL))).q[0] == 0.3


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


def test_a_posture_that_is_not_found_names_the_joints_at_their_limits(tmp_path: Path) -> None:
    ahead = r'(<link name="trunk">\s*<inertial>\s*<origin xyz=)"0 0 0.077"', r'\1"0.3 0 0.077"'
    path = narrowed(tmp_path, ankle_pitch=0.1, hip_pitch=0.1, knee=0.1)
    path.write_text(re.sub(*ahead, path.read_text(), count=1, flags=re.DOTALL))
    with pytest.raises(ModelError, match=r"no posture was found.*at their limits are .*'[lr]_ankle_pitch' at -?0.10"):
        adopt(path, tmp_path / "out")


def test_hips_that_yaw_outwards_only_stand_at_their_limits(tmp_path: Path) -> None:
    ranges = [(rf'(name="{side}_hip_yaw".*?lower=)"[^"]*" upper="[^"]*"', rf'\1"{low}" upper="{high}"')
              for side, low, high in (("l", 0.0, 0.6), ("r", -0.6, 0.0))]  # fmt: skip
    found = adopt(edited(tmp_path, SMALL, *ranges), tmp_path / "out")
    angles = dict(zip(found.model.joint_names, found.numbers.standing.q, strict=True))
    assert [angles[f"{side}_hip_yaw"] for side in "lr"] == pytest.approx([0.0, 0.0], abs=1e-3)
    assert found.config.gait.step_length == pytest.approx(0.09 * found.anatomy.leg, abs=1e-3)
    (said,) = (entry.value for entry in found.evidence if entry.what == "at a limit in the posture")
    assert re.search("'l_hip_yaw' at -?0.00 of 0.00 to 0.60 rad", said)
    assert "'r_hip_yaw'" in said


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


def test_joints_of_the_legs_without_torque_limit_or_that_slide_are_said(tmp_path: Path) -> None:
    def said(what: str, *changes: tuple[str, str]) -> str:
        return next((e.value for e in anatomy_of(read(tmp_path, *changes)).evidence if e.what == what), "")

    assert said("without torque limit", (r'(name="l_knee".*?effort=)"[^"]*"', r'\1"0"')) == "l_knee"
    assert said("velocity of the legs", (r'velocity="[^"]*"', 'velocity="360"')) == "360 rad/s at least"
    assert not said("velocity of the legs", (r'velocity="[^"]*"', 'velocity="0"'))
    slide = '<link name="{0}_rail"/><joint name="{0}_slide" type="prismatic"><parent link="{0}_shank"/>'
    slide += '<child link="{0}_rail"/><limit lower="-0.1" upper="0.1"/></joint>'
    rails = ("</robot>", slide.format("l") + slide.format("r") + "</robot>")
    ankles = (r'(name="(.)_ankle_pitch".*?<parent link=)".*?"', r'\1"\2_rail"')
    assert said("locked in the legs", rails, ankles) == "l_slide, r_slide"


def test_a_servo_that_rides_on_the_limb_that_it_turns_follows_it(tmp_path: Path) -> None:
    """Its gear meshes with one of the link before: the limb mimics a joint that it carries."""
    gear = (
        '<link name="l_gear"><inertial><mass value="0.01"/><inertia ixx="1e-6" iyy="1e-6" izz="1e-6"/></inertial>'
        '</link><joint name="l_gear_joint" type="revolute"><parent link="{}"/><child link="l_gear"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="4" velocity="6"/></joint></robot>'
    )
    carried = Urdf.load(SMALL).joints["l_hip_yaw"].child
    mimic = '<mimic joint="l_gear_joint" multiplier="-2"/>'
    urdf = read(
        tmp_path, ("</robot>", gear.format(carried)), (r'(<joint name="l_hip_yaw".*?<limit[^>]*>)', rf"\1{mimic}")
    )
    use_led_joints(urdf)
    assert "l_hip_yaw" in anatomy_of(urdf).legs[Foot.LEFT]
    assert urdf.joints["l_hip_yaw"].limit.effort <= 2.0


# ---------------------------------------------------------------------- the way in, and what is said


def test_files_of_other_encodings_and_with_the_name_space_of_xacro_are_read(tmp_path: Path) -> None:
    """An exporter declares xacro's name space without need, and writes names in the encoding of Windows."""
    text = SMALL.read_text().replace(
        "<robot ", '<!-- Robot b\u00edpedo --><robot xmlns:xacro="http://www.ros.org/wiki/xacro" '
    )
    (tmp_path / "robot.urdf").write_bytes(text.encode("cp1252"))
    assert anatomy_of(Urdf.load(tmp_path / "robot.urdf")).kinds == "YRPPPR"


def test_macros_that_an_old_xacro_left_in_its_result_are_no_part_of_the_robot(tmp_path: Path) -> None:
    text = SMALL.read_text().replace(
        "<robot ", '<!-- autogenerated by xacro --><robot xmlns:xacro="http://www.ros.org/wiki/xacro" '
    )
    (tmp_path / "robot.urdf").write_text(text.replace("</robot>", '<xacro:gazebo_foot side="l"/></robot>'))
    assert Urdf.load(tmp_path / "robot.urdf").joints.keys() == Urdf.load(SMALL).joints.keys()


def test_a_robot_without_front_and_back_walks_along_an_axis_of_its_root_once_that_is_confirmed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    urdf = Urdf.load(SMALL)
    names = {name: f"j{k}" for k, name in enumerate(urdf.joints)} | {name: f"b{k}" for k, name in enumerate(urdf.links)}
    centred = (
        r'<origin xyz="[-\d.]+( [-\d.]+ [-\d.]+)"/>\s*(<geometry>\s*<box size="0.1265)',
        r'<origin xyz="0\1"/>\2',
    )
    path = edited(tmp_path, SMALL, *((rf'"{re.escape(old)}"', f'"{new}"') for old, new in names.items()), centred)
    urdf = Urdf.load(path)
    moved(urdf, urdf.root, at([0.0, 0.0, 0.0], DQ.rotation_about(0.5 * math.pi, Z).rotation_matrix()))
    ahead = next(entry for entry in anatomy_of(urdf).evidence if entry.what == "ahead")
    assert ahead.confidence == "guess"
    assert "give --forward" in ahead.source
    monkeypatch.setattr("sys.stdin", io.StringIO())  # of a script
    command = ["adopt", str(written(tmp_path, urdf)), "--out", str(tmp_path / "out"), "--no-walk", "--quiet"]
    assert cli.main(command) == 2
    assert "not confirmed: give --forward" in capsys.readouterr().err


def test_the_waist_of_poppy_moves_its_com_over_a_sole() -> None:
    """By 55 mm, where the ankle is 67 mm from the middle, and the sole begins before."""
    found = anatomy_of(Urdf.load(find_urdf("poppy.urdf")))
    assert not found.sideways
    assert "abs_x" in found.waist


def test_legs_of_a_robot_whose_com_is_below_its_hips_are_taken_for_arms_unless_they_are_named() -> None:
    urdf = Urdf.load(SMALL)
    urdf.links["trunk"].inertial.origin[2, 3] -= 0.5
    with pytest.raises(ModelError, match=r"like arms; if they are legs, .* name the feet with --left and --right$"):
        anatomy_of(urdf)
    assert find_anatomy(urdf, Shapes(urdf, SMALL), left="l_foot", right="r_foot").kinds == "YRPPPR"


def test_knees_that_bend_sideways_are_named() -> None:
    """The axes of the legs have x and y exchanged."""
    urdf = Urdf.load(SMALL)
    for joint in urdf.joints.values():
        if joint.axis is not None and joint.name.endswith(("roll", "pitch", "knee")):
            joint.axis = joint.axis[[1, 0, 2]]
    with pytest.raises(ModelError, match="the knees 'l_knee' and 'r_knee' bend sideways"):
        anatomy_of(urdf)


def test_a_round_foot_is_not_blamed_on_a_mesh_of_another_link(tmp_path: Path) -> None:
    lost = r'(<link name="trunk">.*?<geometry>\s*)<box [^>]*/>', r'\1<mesh filename="lost.stl"/>'
    with pytest.raises(ModelError, match=r"round below$"):
        anatomy_of(read(tmp_path, ("<box [^>]*0132[^>]*>", '<sphere radius="0.03"/>'), lost))


def test_xacro_finds_packages_and_takes_arguments(tmp_path: Path) -> None:
    (tmp_path / "src" / "parts").mkdir(parents=True)
    head = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    macro = '<xacro:macro name="part" params="name"><link name="${name}"/></xacro:macro></robot>'
    (tmp_path / "src" / "parts" / "parts.xacro").write_text(head + macro)
    path = tmp_path / "robot" / "my.urdf.xacro"
    path.parent.mkdir()
    include = '<xacro:include filename="$(find parts)/parts.xacro"/>'
    path.write_text(f'{head}<xacro:arg name="n" default="a"/>{include}<xacro:part name="$(arg n)"/></robot>')
    (tmp_path / "undefined.xacro").write_text(
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="$(arg name)"/></robot>'
    )
    with pytest.raises(ModelError, match=r"argument name; give it by --xacro NAME=VALUE"):
        Urdf.load(tmp_path / "undefined.xacro")
    (tmp_path / "condition.xacro").write_text(
        f'{head}<xacro:if value="$(arg DEBUG)"><link name="world"/></xacro:if><link name="a"/></robot>'
    )
    condition = Urdf.load(tmp_path / "condition.xacro")
    assert list(condition.links) == ["a"]
    assert condition.repairs == ["the argument 'DEBUG' has no value: false; or give it by --xacro DEBUG=true"]
    with pytest.raises(ModelError, match=r"needs the ROS package 'parts'.*--package-path"):
        Urdf.load(path)
    assert list(Urdf.load(path, [tmp_path / "src"], {"n": "b"}).links) == ["b"]
    assert list(Urdf.load(path, [tmp_path / "src" / "parts"]).links) == ["a"]


def test_xacro_finds_the_files_of_a_package_that_has_been_renamed(tmp_path: Path) -> None:
    urdf = tmp_path / "robot_description" / "urdf"
    urdf.mkdir(parents=True)
    (urdf.parent / "package.xml").write_text("<package><name>robot_description</name></package>")
    head = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    (urdf / "leg.xacro").write_text(f'{head}<link name="leg"/></robot>')
    path = urdf / "my.urdf.xacro"
    path.write_text(f'{head}<xacro:include filename="$(find old_description)/urdf/leg.xacro"/></robot>')
    assert list(Urdf.load(path).links) == ["leg"]
    (urdf / "leg.xacro").unlink()
    with pytest.raises(ModelError, match=r"needs the ROS package 'old_description', which is not installed"):
        Urdf.load(path)


def test_xacro_without_its_prefix_is_expanded_as_old_versions_did(tmp_path: Path) -> None:
    head = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    (tmp_path / "parts.xacro").write_text(
        f'{head}<property name="per-cent" value="0.01"/><property name="size" value="2"/>'
        '<macro name="part" params="name *origin"><link name="${name}"><visual><insert_block name="origin"/>'
        '<geometry><sphere radius="${2 * size}"/></geometry></visual></link></macro></robot>'
    )
    path = tmp_path / "my.xacro"
    sdf = '<gazebo><include/><plugin><macro name="m"/></plugin></gazebo>'
    path.write_text(f'{head}<include filename="parts.xacro"/>{sdf}<part name="a"><origin xyz="0 0 1"/></part></robot>')
    (link,) = Urdf.load(path).links.values()
    (visual,) = link.visuals
    assert (link.name, visual.geometry.sphere.radius, visual.origin[2, 3]) == ("a", 4.0, 1.0)


def test_files_that_xacro_includes_and_that_are_missing_are_left_out_where_no_link_needs_them(tmp_path: Path) -> None:
    """As those of colours and plugins beside an exported robot."""
    head = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    include = '<xacro:include filename="{}"/>'
    path = tmp_path / "my.urdf"
    path.write_text(head + include.format("$(find gone)/urdf/colours.xacro") + '<link name="a"/></robot>')
    urdf = Urdf.load(path)
    assert list(urdf.links) == ["a"]
    assert urdf.repairs == ["the file 'gone/urdf/colours.xacro' that it includes is not found: left out"]
    leg = '<link name="a"/><joint name="j" type="fixed"><parent link="a"/><child link="leg"/></joint></robot>'
    for missing, needed in (("legs.xacro", r"legs\.xacro', which is not there"), ("$(find gone)/l", "package 'gone'")):
        path.write_text(head + include.format(missing) + leg)
        with pytest.raises(ModelError, match=needed):
            Urdf.load(path)


def test_a_folder_an_archive_and_an_address_lead_to_the_description_or_say_what_to_do(tmp_path: Path) -> None:
    def said(path: Path) -> str:
        with pytest.raises(ModelError) as error:
            description_in(path)
        return str(error.value)

    assert "without a robot description" in said(tmp_path)
    (tmp_path / "my robot" / "urdf").mkdir(parents=True)
    one, two = (tmp_path / "my robot" / "urdf" / name for name in ("a.urdf", "b.urdf"))
    (tmp_path / "my robot" / "package.xml").write_text("<package/>")
    one.write_text("<robot/>")
    (tmp_path / "folder.urdf").mkdir()
    assert description_in(one) == description_in(tmp_path) == one
    two.write_text("<robot/>")
    assert f"2 robot descriptions; give one: {one}, {two}" in said(tmp_path)
    two.write_text('<robot><xacro:include filename="$(find my_robot)/urdf/a.urdf"/></robot>')
    assert description_in(tmp_path) == two  # the other is a part of it
    with zipfile.ZipFile(tmp_path / "robot.zip", "w") as archive:
        archive.write(one)
    assert "is an archive: unpack it" in said(tmp_path / "robot.zip")
    assert "is a web address: download" in said(Path("https://example.org/robot.urdf"))
    assert description_in(tmp_path / "none.urdf") == tmp_path / "none.urdf"  # what reads it says so


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            '<?xml version="1.0"?>\n<!-- a -->\n<sdf version="1.7"><model/></sdf>',
            "is an SDF, .* convert it to URDF or MJCF",
        ),
        ("#usda 1.0\n", "is a USD scene"),
        ("#VRML_SIM R2023b utf8\nPROTO Darwin [ ] { }", r"Webots exports a URDF"),
        ("format: ChoreonoidBody\n", "is a body of Choreonoid"),
        ("\n\n<!DOCTYPE html>\n<html><body>robot.urdf</body></html>", r"is a web page, .* download the file"),
    ],
)
def test_files_of_other_formats_are_named(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "robot"
    path.write_text(text)
    with pytest.raises(ModelError, match=message):
        description_in(path)


def test_a_trial_says_what_was_walked_and_what_its_report_finds() -> None:
    trials: list[tuple[Trial, Callable[[str], bool]]] = [
        (Trial("physics", True, 0.59, 0.6, ""), "physics: walked 0.590 m".__eq__),
        (Trial("physics", True, 0.2, 0.6, ""), "physics: walked 0.200 m instead of 0.600 m".__eq__),
        (Trial("physics", True, 0.6, 0.6, "a sole"), "physics: walked 0.600 m, but a sole".__eq__),
        (Trial("physics", True, 0.6, 0.6, "", touching="shins"), "physics: walked 0.600 m, but shins".__eq__),
        (Trial("physics", True, 0.6, 0.6, "", load=Load(1e-3, "l_knee", 1.0)), "physics: walked 0.600 m".__eq__),
        (
            Trial("physics", True, 0.6, 0.6, "", load=Load(0.731, "l_knee", 1.0)),
            "physics: walked 0.600 m, l_knee needs 73 % of its torque-speed curve at 1.00 s".__eq__,
        ),
    ]
    for trial, expected in trials:
        assert expected(str(trial))


def test_the_picture_has_the_bones_of_a_robot_without_meshes() -> None:
    model = small_model(Urdf.load(SMALL))
    kin = Kinematics(model, np.zeros(model.n), Foot.LEFT)
    bones = _bones(model, kin)
    assert len(bones) == model.n + 2  # to each joint, and to both soles
    thigh = next(bone for bone in bones if np.allclose(bone[1], kin.point("l_shank")))
    assert np.linalg.norm(thigh[0] - thigh[1]) > 0.1


# ---------------------------------------------------------------------- ten things that people do to a robot


def written(tmp_path: Path, urdf: Urdf) -> Path:
    path = tmp_path / "perturbed.urdf"
    path.write_text(urdf.text())
    return path


def millimetres(tmp_path: Path) -> Path:
    path = tmp_path / "perturbed.urdf"
    path.write_text(in_units(SMALL.read_text(), 1000.0))
    return path


def degrees(tmp_path: Path) -> Path:
    urdf = Urdf.load(SMALL)
    for joint in urdf.joints.values():
        if joint.limit:
            joint.limit.lower, joint.limit.upper = math.degrees(joint.limit.lower), math.degrees(joint.limit.upper)
    return written(tmp_path, urdf)


def centimetres_and_grams(tmp_path: Path) -> Path:
    urdf = Urdf(in_units(SMALL.read_text(), 100.0), "perturbed")
    urdf.scale_mass(1000.0)
    return written(tmp_path, urdf)


def knees_that_bend_together(tmp_path: Path) -> Path:
    return edited(tmp_path, SMALL, ('(<joint name="l_knee".*?)(</joint>)', r'\1<mimic joint="r_knee"/>\2'))


def root_at_the_foot(tmp_path: Path) -> Path:
    urdf = Urdf.load(SMALL)
    urdf.reroot("r_foot")
    return written(tmp_path, urdf)


def y_up(tmp_path: Path) -> Path:
    urdf = Urdf.load(SMALL)
    moved(urdf, urdf.root, at([0.0, 0.0, 0.0], DQ.rotation_about(0.5 * math.pi, X).rotation_matrix()))
    return written(tmp_path, urdf)


def tilted(tmp_path: Path, turn: np.ndarray) -> Path:
    """Return a description whose root link is turned by a rotation vector against the robot."""
    urdf = Urdf.load(SMALL)
    angle = float(np.linalg.norm(turn))
    moved(urdf, urdf.root, at(np.zeros(3), DQ.rotation_about(angle, turn / angle).rotation_matrix()))
    return written(tmp_path, urdf)


def rolled(tmp_path: Path) -> Path:
    return tilted(tmp_path, 0.3 * X)


def pitched(tmp_path: Path) -> Path:
    return tilted(tmp_path, 0.3 * Y)


def tilted_on_its_face(tmp_path: Path) -> Path:
    return tilted(tmp_path, 1.27 * Y - 0.3 * X + 0.4 * Z)


def tilted_trunk_on_a_tilted_foot(tmp_path: Path) -> Path:
    urdf = Urdf.load(tilted(tmp_path, 0.3 * X - 0.3 * Y))
    urdf.reroot("r_foot")
    moved(urdf, "r_foot", at(np.zeros(3), DQ.rotation_about(-0.3, X).rotation_matrix()))
    return written(tmp_path, urdf)


def axes_negated(tmp_path: Path) -> Path:
    urdf = Urdf.load(SMALL)
    for joint in urdf.joints.values():
        if joint.limit:
            joint.axis = -joint.axis
            joint.limit.lower, joint.limit.upper = -joint.limit.upper, -joint.limit.lower
    return written(tmp_path, urdf)


def narrow_limits(tmp_path: Path) -> Path:
    return narrowed(tmp_path, hip_roll=0.1, ankle_roll=0.1)


def one_leg_longer(tmp_path: Path) -> Path:
    urdf = Urdf.load(SMALL)
    urdf.joints["r_ankle_pitch"].origin[2, 3] *= 1.02
    return written(tmp_path, urdf)


FOOT_BOX = r'<box size="0.1265 0.0825 0.0132"/>'


def missing_meshes(tmp_path: Path) -> Path:
    return edited(tmp_path, SMALL, (FOOT_BOX, '<mesh filename="package://robot/foot.stl"/>'))


def lfs_pointers(tmp_path: Path) -> Path:
    (tmp_path / "foot.stl").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 84\n")
    return edited(tmp_path, SMALL, (FOOT_BOX, '<mesh filename="foot.stl"/>'))


def placeholder_inertias(tmp_path: Path) -> Path:
    return edited(
        tmp_path, SMALL, (r'<inertia ixx="[^"]*" iyy="[^"]*" izz="[^"]*"', '<inertia ixx="1" iyy="1" izz="1"')
    )


PERTURBED: list[tuple[Callable[[Path], Path], str, str]] = [  # what is done, the refusal, and the repair that is said
    (millimetres, "are the lengths in millimetres", ""),
    (centimetres_and_grams, "lengths in centimetres and the masses in grams", ""),
    (knees_that_bend_together, "'l_knee' of a leg mimics 'r_knee' of the other leg", ""),
    (degrees, "", "can only be degrees"),
    (root_at_the_foot, "", "is in a leg"),
    (y_up, "", ""),
    (rolled, "", ""),
    (pitched, "", ""),
    (tilted_on_its_face, "", ""),
    (tilted_trunk_on_a_tilted_foot, "", "is in a leg"),
    (axes_negated, "", ""),
    (narrow_limits, "", ""),
    (one_leg_longer, "", ""),
    (missing_meshes, "'package://robot/foot.stl' not found", ""),
    (lfs_pointers, "git lfs pull", ""),
    (placeholder_inertias, "", "moment of inertia 1 kg m"),
]


@pytest.mark.parametrize(("perturb", "refusal", "repair"), PERTURBED, ids=lambda one: getattr(one, "__name__", ""))
def test_what_people_do_to_a_robot_is_undone_or_named(
    perturb: Callable[[Path], Path], refusal: str, repair: str, tmp_path: Path
) -> None:
    path = perturb(tmp_path)
    if refusal:
        with pytest.raises(ModelError, match=refusal):
            adopt(path, tmp_path / "out")
        return
    urdf = Urdf.load(path)
    repair_degrees(urdf)
    found = find_anatomy(urdf, Shapes(urdf, path))
    repair_inertias(urdf, Shapes(urdf, path), found.leg)
    plain = anatomy_of(Urdf.load(SMALL))
    assert found.legs == plain.legs
    assert (found.kinds, found.sideways, found.turns) == (plain.kinds, True, True)
    assert found.leg == pytest.approx(plain.leg, rel=0.02)
    assert found.apart == pytest.approx(plain.apart, rel=0.02)
    assert any(repair in text for text in [*urdf.repairs, ""])


def test_hips_that_yaw_together_are_locked(tmp_path: Path) -> None:
    """As NAO's, which have one motor for both: the legs walk without this joint."""
    yaw = r'(<joint name="r_hip_yaw".*?)(</joint>)'
    urdf = read(tmp_path, (yaw, r'\1<mimic joint="l_hip_yaw"/>\2'))
    found = find_anatomy(urdf, Shapes(urdf, SMALL))
    assert [leg[0] for leg in found.legs.values()] == ["l_hip_roll", "r_hip_roll"]
    assert (found.sideways, found.turns) == (True, False)


@pytest.mark.long
def test_the_weight_of_the_posture_against_lengths_is_that_of_a_smaller_robot(tmp_path: Path) -> None:
    """The error of the CoM is a length, the posture is angles: for half the size the ratio of their squares is 1/4."""
    half = Urdf(in_units(SMALL.read_text(), 0.5), "half")
    half.scale_mass(0.5)
    weights = [
        adopt(path, tmp_path / path.stem).config.task.posture_weight for path in (SMALL, written(tmp_path, half))
    ]
    assert weights[1] == pytest.approx(0.25 * weights[0], rel=0.01)


@pytest.mark.long
@pytest.mark.parametrize(
    "perturb", [one for one, refusal, _ in PERTURBED if not refusal], ids=lambda one: getattr(one, "__name__", "")
)
def test_perturbed_robots_walk(
    perturb: Callable[[Path], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["adopt", str(perturb(tmp_path)), "--out", str(tmp_path / "out"), "--yes", "--quiet"]) == 0
    assert re.search(r"dynamic walk: walked 3\.\d+ m(, \w+ needs [^,;]*)?\n", capsys.readouterr().out)
