"""Robots from MJCF: the conversion is the same robot, and what it cannot say is named."""

from __future__ import annotations

import math
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from dqwalk_ros import cli
from dqwalk_ros.adopt import adopt
from dqwalk_ros.adopt.anatomy import find_anatomy
from dqwalk_ros.adopt.mjcf import MjcfDrive, is_mjcf, load_mjcf
from dqwalk_ros.adopt.parameters import drive_parameters
from dqwalk_ros.config import RobotConfig, load
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.robot.model import parse_model
from dqwalk_ros.robot.shapes import Shapes
from dqwalk_ros.support.errors import ModelError

SMALL = Path(__file__).parents[1] / "data" / "small_biped.xml"


def edited(folder: Path, *changes: tuple[str, str]) -> Path:
    text = SMALL.read_text()
    for old, new in changes:
        assert re.search(old, text, re.DOTALL), old
        text = re.sub(old, new, text, flags=re.DOTALL)
    path = folder / "robot.xml"
    path.write_text(text)
    return path


def test_mjcf_is_recognized_by_its_root(tmp_path: Path) -> None:
    assert is_mjcf(SMALL)
    assert not is_mjcf(SMALL.with_suffix(".none"))
    (tmp_path / "a.urdf").write_text('<robot name="a"><mujoco><compiler/></mujoco></robot>')
    assert not is_mjcf(tmp_path / "a.urdf")
    comments = "<!-- generated --><!-- - - -->\n" * 40  # as xacro writes them, in a time that does not grow with 2^n
    for root, expected in (("robot", False), ("mujoco", True)):
        (tmp_path / "b.xml").write_text(f'<?xml version="1.0"?>\n{comments}<{root} name="b"/>')
        assert is_mjcf(tmp_path / "b.xml") is expected


@pytest.mark.parametrize("reference", ["", ' ref="20"'])
def test_the_converted_robot_moves_as_that_of_mujoco(reference: str, tmp_path: Path) -> None:
    path = edited(tmp_path, ('(name="left_hip_roll")', rf"\1{reference}"), ('(name="right_knee")', rf"\1{reference}"))
    urdf, _ = load_mjcf(path)
    robot = RobotConfig(pelvis="trunk", left_sole="left_foot", right_sole="right_foot", sole_length=0.1, sole_width=0.1)
    model = parse_model(urdf.text(), robot)
    mj = mujoco.MjModel.from_xml_path(str(path))
    data, random = mujoco.MjData(mj), np.random.default_rng(0)
    assert model.n == 12
    for _ in range(3):
        q = random.uniform(model.q_min, model.q_max)
        for name, angle in zip(model.joint_names, q, strict=True):
            data.qpos[mj.joint(name).qposadr[0]] = angle
        mujoco.mj_forward(mj, data)
        kin, left = Kinematics(model, q, Foot.LEFT), data.body("left_foot")
        base = DQ.from_pose(left.xpos, left.xquat).conj()
        trunk = mj.body("trunk").id
        com = base.transform_point(data.subtree_com[trunk])
        np.testing.assert_allclose(kin.com, com, atol=2e-4)  # the links between the joints of a hip weigh 1 g each
        for link in ("right_foot", "right_shank", "trunk", "imu"):
            place = data.site(link).xpos if link == "imu" else data.body(link).xpos
            np.testing.assert_allclose(kin.point(link), base.transform_point(place), atol=1e-9, err_msg=link)
    for link in ("trunk", "left_shank"):
        body = mj.body(link)
        np.testing.assert_allclose(
            np.sort(np.linalg.eigvalsh(urdf.links[link].inertial.inertia)), np.sort(body.inertia)
        )


def test_limits_efforts_drives_and_shapes_are_those_of_the_file() -> None:
    urdf, drives = load_mjcf(SMALL)
    knee = urdf.joints["left_knee"]
    assert (knee.limit.lower, knee.limit.upper) == pytest.approx((0.0, np.radians(130.0)))
    assert knee.limit.effort == 6.0
    drive = drives["left_knee"]
    assert (drive.stiffness, drive.damping, drive.armature, drive.friction) == pytest.approx((70.0, 1.4, 0.005, 0.02))
    foot = urdf.links["left_foot"]
    np.testing.assert_allclose(foot.collisions[0].geometry.box.size, [0.12, 0.076, 0.02])
    assert [visual.geometry.sphere.radius for visual in foot.visuals] == [0.02]
    assert any("'trunk' are left out: crate" in text for text in urdf.repairs)
    sole = find_anatomy(urdf, Shapes(urdf, SMALL)).soles[Foot.LEFT]
    np.testing.assert_allclose([sole.length, sole.width], [0.12, 0.076], atol=1e-3)
    np.testing.assert_allclose(sole.pose.translation(), [0.015, 0.006, -0.045], atol=1e-6)


def test_position_gains_are_the_stiffness_unless_they_are_too_soft_to_stand(tmp_path: Path) -> None:
    found = adopt(SMALL, tmp_path)
    servo = load(tmp_path / "robot.yaml").servo
    assert (servo.stiffness, servo.assumed_stiffness, servo.friction) == (70.0, 70.0, 0.02)
    assert (servo.armature, servo.assumed_armature) == (0.005, 0.005)
    assert servo.damping == pytest.approx(1.4 / 70.0, rel=0.01)
    soft = dict.fromkeys(found.anatomy.legs[Foot.LEFT], MjcfDrive(7.0, 0.2, 0.005, 0.0))
    values, (entry,) = drive_parameters(soft, found.numbers)
    damping = found.numbers.damping(found.numbers.stiffness, 0.5, 0.005)
    assert values == {"servo.armature": 0.005, "servo.assumed_armature": 0.005, "servo.damping": damping}
    assert (entry.value.split(",")[0], entry.confidence) == ("7 N m/rad", "guess")


REFUSED = {
    "a loop": (
        (r"</mujoco>", '<equality><connect body1="left_foot" body2="right_foot" anchor="0 0 0"/></equality></mujoco>'),
        r"left_hip_yaw, .*, right_ankle_roll are in a loop of links",
    ),
    "an arm": ((r"<freejoint/>.*?<site", '<geom type="box" size="1 1 1"/><site'), "stands on its base"),
    "no body": ((r'<body name="crate".*</worldbody>.*</actuator>', "</worldbody>"), "has no body, so no robot"),
    "legs on the world": (
        (r'<body name="trunk".*?name="imu" pos="0 0 0.05"/>(.*)</body>\s*</worldbody>.*</actuator>', r"\1</worldbody>"),
        r"the bodies left_thigh, right_thigh are attached to the world by joints of their own, so the link that",
    ),
    "an error": ((r'joint="left_knee"/>', 'joint="knee"/>'), "MuJoCo refuses .*knee"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_walk_is_refused_in_one_sentence(name: str, tmp_path: Path) -> None:
    change, expected = REFUSED[name]
    with pytest.raises(ModelError, match=expected):
        adopt(edited(tmp_path, change), tmp_path / "out")


def test_ankles_without_an_actuator_beside_driven_joints_do_not_roll(tmp_path: Path) -> None:
    urdf, _ = load_mjcf(edited(tmp_path, (r'<position joint="[a-z]*_ankle_roll"/>', "")))
    assert find_anatomy(urdf, Shapes(urdf, SMALL)).lean is not None


@pytest.mark.parametrize(
    ("included", "expected"),
    [
        ("robot.mjcf", r"robot\.mjcf' includes itself"),
        ("bad.xml", r"bad\.xml': not well-formed"),
    ],
)
def test_what_is_wrong_with_an_included_file_is_said_with_its_name(
    included: str, expected: str, tmp_path: Path
) -> None:
    (tmp_path / "bad.xml").write_text("<mujoco><!-- -- --></mujoco>")
    path = edited(tmp_path, ("<worldbody>", f'<include file="{included}"/><worldbody>')).rename(tmp_path / "robot.mjcf")
    with pytest.raises(ModelError, match=expected):
        load_mjcf(path)


@pytest.mark.parametrize("ending", [".xml", ".mjcf"])
def test_an_included_file_that_is_missing_is_left_out_and_listed(ending: str, tmp_path: Path) -> None:
    """Such as the sky and floor of a package, which a robot does not need."""
    sky = '<include file="./common/skybox.xml"/><worldbody><geom type="plane" size="1 1 1" material="grid"/>'
    path = edited(tmp_path, ("<worldbody>", sky)).rename(tmp_path / f"robot{ending}")
    urdf, _ = load_mjcf(path)
    assert find_anatomy(urdf, Shapes(urdf, path)).kinds == "YRPPPR"
    assert "the file './common/skybox.xml' that it includes is not found: left out" in urdf.repairs


def test_a_missing_mesh_of_a_trunk_is_said_and_that_of_a_foot_is_an_error(tmp_path: Path) -> None:
    asset = (r"<worldbody>", '<asset><mesh name="m" file="m.stl"/></asset><worldbody>')
    trunk = (r'<geom type="box" size="0.05 0.06 0.07" pos="0 0 0.08" mass="1.6"/>', r'<geom type="mesh" mesh="m"/>')
    inertial = (r"<freejoint/>", '<freejoint/><inertial pos="0 0 0.08" mass="1.6" diaginertia="0.01 0.01 0.01"/>')
    path = edited(tmp_path, asset, trunk, inertial)
    urdf, _ = load_mjcf(path)
    shapes = Shapes(urdf, path)
    assert find_anatomy(urdf, shapes).pelvis == "trunk"
    assert list(shapes.missing.values()) == ["not found"]
    foot = (r'type="box" size="0.06 0.038 0.01"', 'type="mesh" mesh="m"')
    path = edited(tmp_path, asset, foot)
    urdf, _ = load_mjcf(path)
    with pytest.raises(ModelError, match=r"m\.stl' not found"):
        find_anatomy(urdf, Shapes(urdf, path))


def test_what_follows_from_a_missing_mesh_is_named_and_a_file_of_another_machine_is_found(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.1, 0.12, 0.14))
    (tmp_path / "meshes").mkdir()
    asset = (r"<worldbody>", r'<asset><mesh name="m" file="C:/Users/me/robot/meshes/m.stl"/></asset><worldbody>')
    path = edited(
        tmp_path, asset, (r'type="box" size="0.05 0.06 0.07" pos="0 0 0.08" mass="1.6"', 'type="mesh" mesh="m"')
    )
    with pytest.raises(ModelError, match=r"the mass of 'trunk' follows from the mesh '.*m\.stl', which is not found"):
        load_mjcf(path)
    box.export(tmp_path / "meshes" / "m.stl")
    urdf, _ = load_mjcf(path)
    assert urdf.links["trunk"].inertial.mass == pytest.approx(1000.0 * box.volume, rel=1e-3)
    (name,) = Shapes(urdf, path).of("trunk", "collisions")
    assert name.what == "m.stl"


def test_meshes_are_found_beside_the_folder_of_the_file_and_in_given_folders_where_the_file_places_them(
    tmp_path: Path,
) -> None:
    """A folder of meshes that MJCF and URDF share; the mesh is neither centred nor along the axes of its frame."""
    (tmp_path / "mjcf").mkdir()
    compiler = (r"<worldbody>", '<compiler meshdir="meshes"/><asset><mesh name="m" file="f.stl"/></asset><worldbody>')
    foot = (r'type="box" size="0.06 0.038 0.01" pos="[^"]*"', 'type="mesh" mesh="m" pos="0 0 0.01"')
    foot_mass = (r'(<body name="\w+_foot"[^>]*>)', r'\1<inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>')
    path = edited(tmp_path / "mjcf", compiler, foot, foot_mass)
    box = trimesh.creation.box((0.12, 0.076, 0.02))
    box.apply_translation((0.015, 0.006, -0.045))
    for folder, places in (("meshes", []), ("elsewhere", [tmp_path / "elsewhere"])):
        (tmp_path / folder).mkdir()
        box.export(tmp_path / folder / "f.stl")
        urdf, _ = load_mjcf(path, places)
        sole = find_anatomy(urdf, Shapes(urdf, path)).soles[Foot.LEFT]
        np.testing.assert_allclose([sole.length, sole.width], [0.12, 0.076], atol=1e-3)
        np.testing.assert_allclose(sole.pose.translation(), [0.015, 0.006, -0.045], atol=1e-6)
        (tmp_path / folder / "f.stl").unlink()
    foot, _ = load_mjcf(path)
    assert foot.links["left_foot"].collisions[0].origin[:3, 3] == pytest.approx([0.0, 0.0, 0.01])  # without the mesh


def test_pictures_height_fields_and_settings_of_other_versions_are_not_needed(tmp_path: Path) -> None:
    old = '<option collision="predefined"><flag sensornoise="enable"/></option>'
    lost = (
        '<asset><texture name="t" type="2d" file="logo.png"/><material name="logo" texture="t"/>'
        '<hfield name="hills" file="hills.png" size="1 1 1 1"/></asset>'
    )
    hills = '<geom type="hfield" hfield="hills" material="of another file"/>'
    drawn = (r'<geom class="picture" type="sphere"', '<geom class="picture" material="logo" type="sphere"')
    path = edited(tmp_path, (r"<worldbody>", f'{lost}<include file="old.xml"/><worldbody>{hills}'), drawn)
    (tmp_path / "old.xml").write_text(f"<mujoco>{old}</mujoco>")
    urdf, _ = load_mjcf(path)
    assert find_anatomy(urdf, Shapes(urdf, path)).kinds == "YRPPPR"
    assert [text for text in urdf.repairs if "another version" in text] == [
        "<option> has the attribute 'collision' of another version of MuJoCo: left out",
        "<flag> has the attribute 'sensornoise' of another version of MuJoCo: left out",
    ]


def test_the_joints_of_a_robot_whose_actuators_turn_ball_joints_only_move(tmp_path: Path) -> None:
    """Only beside a driven joint with an axis is one without actuator passive."""
    neck = '<joint name="neck" type="ball" range="0 60"/>'
    ball = f'<body name="head" pos="0 0 0.2">{neck}<geom type="sphere" size="0.03"/></body>'
    motor = '<actuator><motor joint="neck" gear="1 0 0"/></actuator>'
    urdf, _ = load_mjcf(edited(tmp_path, ("<freejoint/>", f"<freejoint/>{ball}"), ("<actuator>.*</actuator>", motor)))
    assert sum(joint.type == "revolute" for joint in urdf.joints.values()) == 12


def test_an_orientation_beside_all_moments_of_inertia_is_left_out_as_older_versions_did(tmp_path: Path) -> None:
    full = '<inertial pos="0 0 0.08" quat="0 1 0 0" mass="1.6" fullinertia="0.01 0.02 0.025 0 0 0.001"/>'
    urdf, _ = load_mjcf(edited(tmp_path, (r"<freejoint/>", f"<freejoint/>{full}")))
    trunk = urdf.links["trunk"].inertial
    np.testing.assert_allclose(np.diag(trunk.inertia), [0.01, 0.02, 0.025], rtol=1e-6)
    assert trunk.inertia[1, 2] == pytest.approx(0.001)
    assert sum("beside 'fullinertia'" in text for text in urdf.repairs) == 1


def test_numbers_with_commas_and_files_with_another_ending_are_read(tmp_path: Path) -> None:
    path = edited(tmp_path, (r'<body name="left_foot"', '<body name="left_foot" quat="1, 0, 0, 0"'))
    urdf, _ = load_mjcf(path.rename(tmp_path / "robot.mjcf"))
    assert find_anatomy(urdf, Shapes(urdf, path)).kinds == "YRPPPR"
    assert "<body> has commas between the numbers of 'quat': left out" in urdf.repairs


def test_what_a_scene_has_beside_the_robot_is_not_needed(tmp_path: Path) -> None:
    """A pair of contacts with the floor of another file, a keyframe of another size, and a mesh without a volume."""
    flat = '<asset><mesh name="flat" vertex="0 0 0 1e-6 0 0 0 1e-6 0 0 0 1e-6"/></asset><worldbody>'
    pair = '<contact><pair geom1="lost" geom2="floor"/></contact><keyframe><key qpos="0 0 0"/></keyframe></mujoco>'
    drawn = (
        r'<geom class="picture" type="sphere" size="0.02" mass="0"/>',
        '<geom class="picture" type="mesh" mesh="flat"/>',
    )
    urdf, _ = load_mjcf(edited(tmp_path, (r"<worldbody>", flat), ("</mujoco>", pair), drawn))
    assert find_anatomy(urdf, Shapes(urdf, SMALL)).kinds == "YRPPPR"
    assert "the mesh 'flat' encloses no volume: taken as a shell" in urdf.repairs


CRANK = (
    '<body name="crank" pos="0.03 0 0"><joint name="motor" axis="0 1 0"/><geom type="sphere" size="0.01" mass="0.01"/>'
    '<body name="rod"><joint name="pin" axis="0 1 0"/><geom type="sphere" size="0.01" mass="0.01"/></body></body>'
)


def test_a_joint_that_a_linkage_moves_is_driven_as_its_motor(tmp_path: Path) -> None:
    crank = (r'(<body name="left_shank".*?mass="0.25"/>)', rf"\1{CRANK}")
    loop = '<equality><connect body1="rod" body2="left_foot" anchor="0 0 0"/></equality></mujoco>'
    motor = r'<position joint="left_ankle_pitch"/>', '<position joint="motor" forcerange="-5 5"/>'
    urdf, drives = load_mjcf(edited(tmp_path, crank, ("</mujoco>", loop), motor))
    assert any("a loop of links moves left_ankle_pitch" in text for text in urdf.repairs)
    assert [urdf.joints[name].limit.effort for name in ("left_ankle_pitch", "left_ankle_roll")] == [5.0, 6.0]
    assert drives["left_ankle_pitch"].stiffness == 70.0
    assert not {"motor", "pin"} & drives.keys()
    assert find_anatomy(urdf, Shapes(urdf, SMALL)).kinds == "YRPPPR"
    none = r'<position joint="left_ankle_roll"/>', ""
    urdf, _ = load_mjcf(edited(tmp_path, crank, ("</mujoco>", loop), motor, none))
    assert any("has the joints left_ankle_pitch, left_ankle_roll and 1 actuators" in text for text in urdf.repairs)


CYLINDER = (
    '<body name="cylinder" pos="0.03 0 0"><joint name="hang" axis="0 1 0"/><geom type="sphere" size="0.01" mass="0.2"/>'
    '<body name="rod"><joint name="slide" type="slide"/><geom type="sphere" size="0.01" mass="0.1"/></body></body>'
)


def test_a_linear_actuator_in_a_loop_is_no_limb_however_heavy_it_is(tmp_path: Path) -> None:
    cylinder = (r'(<body name="left_shank".*?mass="0.25"/>)', rf"\1{CYLINDER}")
    loop = '<equality><connect body1="rod" body2="left_foot" anchor="0 0 0"/></equality></mujoco>'
    slide = r'<position joint="left_ankle_pitch"/>', '<motor joint="slide" ctrlrange="-500 500"/>'
    urdf, drives = load_mjcf(edited(tmp_path, cylinder, ("</mujoco>", loop), slide))
    assert any("moves left_ankle_pitch, left_ankle_roll: taken as driven" in text for text in urdf.repairs)
    assert any("the torques of its linear actuators are not known" in text for text in urdf.repairs)
    assert math.isinf(urdf.joints["left_ankle_pitch"].limit.effort)
    assert not {"hang", "slide"} & drives.keys()
    assert find_anatomy(urdf, Shapes(urdf, SMALL)).kinds == "YRPPPR"


def test_loops_of_a_robot_without_actuators_are_opened_in_both_legs(tmp_path: Path) -> None:
    crank = (r'(<body name="(left|right)_shank".*?mass="0.25"/>)', r"\1" + CRANK.replace('name="', r'name="\2_'))
    ends = "".join(f'<connect body1="{s}_rod" body2="{s}_foot" anchor="0 0 0"/>' for s in ("left", "right"))
    loops = r"<actuator>.*</actuator>", f"<equality>{ends}</equality>"
    urdf, _ = load_mjcf(edited(tmp_path, crank, loops))
    assert find_anatomy(urdf, Shapes(urdf, SMALL)).kinds == "YRPPPR"


def test_what_a_robot_does_not_need_may_be_wrong(tmp_path: Path) -> None:
    """A contact of the floor in another file, a colour without a name, a head without mass."""
    assets = r"<worldbody>", '<asset><material name="" rgba="1 1 1 1"/></asset><worldbody>'
    scene = "</mujoco>", '<contact><exclude body1="terrain" body2="left_foot"/></contact></mujoco>'
    head = (r'(<site name="imu")', r'<body name="head"><joint name="neck"/><geom size="0.01" mass="0"/></body>\1')
    urdf, _ = load_mjcf(edited(tmp_path, assets, scene, head))
    assert find_anatomy(urdf, Shapes(urdf, SMALL)).kinds == "YRPPPR"
    assert any("body 'head' moves, but has no mass or inertia: at least 1e-05 kg" in text for text in urdf.repairs)


def test_of_three_axes_of_a_knee_one_bends_it(tmp_path: Path) -> None:
    knee = r'<joint name="(\w+_knee)" axis="0 1 0" (range="\S+ \S+")/>'
    axes = "".join(
        rf'<joint name="\1_{name}" axis="{xyz}" \2/>'
        for name, xyz in zip("xyz", ("1 0 0", "0 1 0", "0 0 1"), strict=True)
    )
    motors = r'<position joint="(\w+_knee)"/>', "".join(rf'<position joint="\1_{name}"/>' for name in "xyz")
    urdf, _ = load_mjcf(edited(tmp_path, (knee, axes), motors))
    assert find_anatomy(urdf, Shapes(urdf, SMALL)).kinds == "YRPPPR"
    moving = [name for name, joint in urdf.joints.items() if "knee" in name and joint.type != "fixed"]
    assert moving == ["left_knee_y", "right_knee_y"]
    assert "joint 'left_knee_x' is one of three or more axes of a knee: taken as fixed" in urdf.repairs


@pytest.mark.long
def test_a_robot_from_mjcf_walks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["adopt", str(SMALL), "--out", str(tmp_path), "--yes", "--quiet"]) == 0
    out = capsys.readouterr().out
    assert re.search(r"physics: walked 0\.\d+ m(, \w+ needs [^,;]*)?\n", out)
    assert re.search(r"dynamic walk: walked 3\.\d+ m(, \w+ needs [^,;]*)?\n", out)
