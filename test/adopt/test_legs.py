"""Legs that are unusual or wrong in one respect: found, or refused by name."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from robots import edited
from small_humanoid import SMALL, X, Y, Z, anatomy_of, at, moved, read

from dqwalk_ros.adopt import adopt
from dqwalk_ros.adopt.anatomy import find_anatomy
from dqwalk_ros.adopt.doubts import use_led_joints
from dqwalk_ros.adopt.legs import axes_differ, bent, freedom, leg_of
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.robot.model import find_urdf
from dqwalk_ros.robot.shapes import Shapes
from dqwalk_ros.robot.urdf import Urdf
from dqwalk_ros.support.errors import ModelError


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


def test_where_an_ankle_is_along_its_own_axis_does_not_tell_front_from_back(tmp_path: Path) -> None:
    """The origin of the roll joint is in front of the foot, as in HighTorque's Pi Plus."""
    usual, urdf = anatomy_of(read(tmp_path)), read(tmp_path)
    for side in "lr":
        moved(urdf, urdf.joints[f"{side}_ankle_roll"].child, at([0.08, 0.0, 0.0]))
    there, here = ({entry.what: entry.source for entry in found.evidence} for found in (usual, anatomy_of(urdf)))
    assert here["ahead"] == there["ahead"]
    assert "side names" not in here


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


def test_a_leg_that_ends_higher_than_the_other_is_refused_with_joint_and_distance(tmp_path: Path) -> None:
    urdf = Urdf.load(SMALL)
    urdf.joints["r_knee"].origin[:3, 3] += [0.1, 0.0, 0.05]
    with pytest.raises(ModelError, match=r"'l_knee' is 112 mm from the mirror image of 'r_knee', more than 6 mm"):
        anatomy_of(urdf)


def test_limits_that_do_not_mirror_each_other_are_doubted(tmp_path: Path) -> None:
    wrong = r'(name="r_knee".*?lower=)"-2.2" upper="2.2"', r'\1"-0.1" upper="1.7"'
    right = r'(name="l_knee".*?lower=)"-2.2" upper="2.2"', r'\1"-0.1" upper="2.2"'  # its axis is the opposite one
    found = {entry.what: entry for entry in anatomy_of(read(tmp_path, wrong, right)).evidence}
    assert "'l_knee' and 'r_knee' do not mirror each other: -0.10 to 2.20" in found["limits of the legs"].value
    assert "limits of the legs" not in {entry.what for entry in anatomy_of(Urdf.load(SMALL)).evidence}
    slow = r'(name="l_knee".*?velocity=)"[^"]*"', r'\1"0.001"'
    found = {entry.what: entry for entry in anatomy_of(read(tmp_path, slow)).evidence}
    assert "'l_knee' and 'r_knee' have the velocity limits 0.001 and " in found["limits of the legs"].value


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


def test_hips_that_yaw_together_are_locked(tmp_path: Path) -> None:
    """As NAO's, which have one motor for both: the legs walk without this joint."""
    yaw = r'(<joint name="r_hip_yaw".*?)(</joint>)'
    urdf = read(tmp_path, (yaw, r'\1<mimic joint="l_hip_yaw"/>\2'))
    found = find_anatomy(urdf, Shapes(urdf, SMALL))
    assert [leg[0] for leg in found.legs.values()] == ["l_hip_roll", "r_hip_roll"]
    assert (found.sideways, found.turns) == (True, False)


def test_a_linkage_that_is_described_as_a_chain_is_named() -> None:
    """A joint beside the leg, parallel to the roll of the hip, is farther from hip and ankle than the knee."""
    urdf = Urdf.load(SMALL)
    for side, y in (("l", 0.3), ("r", -0.3)):
        crank, knee = f"{side}_crank", urdf.joints[f"{side}_knee"]
        urdf.add_frame(crank, knee.parent, DQ.from_pose([0.0, y, knee.origin[2, 3]]))
        joint, roll = urdf.joints[f"{crank}_joint"], urdf.joints[f"{side}_hip_roll"]
        joint.type, joint.axis, joint.limit = "revolute", roll.axis, roll.limit
        knee.parent, knee.origin[1:3, 3] = crank, (knee.origin[1, 3] - y, 0.0)
    with pytest.raises(ModelError, match=r"'l_knee' bends the leg ahead, but 'l_crank_joint' .* l_hip_roll, .*mimic"):
        anatomy_of(urdf)


def knees_of(urdf: Urdf, left: tuple[float, float], right: tuple[float, float]) -> Urdf:
    """Give the knees other limits [rad]; the axis of the right one is the opposite one."""
    for side, ends in (("l", left), ("r", (-right[1], -right[0]))):
        limit = urdf.joints[f"{side}_knee"].limit
        limit.lower, limit.upper = ends
    return urdf


AHEAD, BACK = (-0.1, 2.2), (-2.2, 0.1)


@pytest.mark.parametrize("knees", [(BACK, AHEAD), (AHEAD, BACK)])
def test_a_knee_whose_limits_have_the_wrong_sign_bends_like_the_other_one(
    knees: tuple[tuple[float, float], ...],
) -> None:
    """As in Poppy's own first description."""
    urdf, right = knees_of(Urdf.load(SMALL), *knees), knees_of(Urdf.load(SMALL), AHEAD, AHEAD)
    found = anatomy_of(urdf)
    assert any("_knee' bends its knee back by" in repair for repair in urdf.repairs)
    for name in ("l_knee", "r_knee"):
        assert vars(urdf.joints[name].limit) == vars(right.joints[name].limit)
    assert not any(entry.what == "limits of the legs" for entry in found.evidence)


def test_knees_that_both_bend_back_are_those_of_a_bird() -> None:
    urdf = knees_of(Urdf.load(SMALL), BACK, BACK)
    anatomy_of(urdf)
    assert not any("bends its knee back" in repair for repair in urdf.repairs)
