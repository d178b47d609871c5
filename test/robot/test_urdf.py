"""Robot descriptions: what is rejected, with element and line, what is repaired, what is written."""

from __future__ import annotations

import os
import re
import time
from pathlib import Path

import numpy as np
import pytest
import yourdfpy
from hypothesis import given
from hypothesis import strategies as st

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.robot.packages import find_package_file
from dqwalk_ros.robot.urdf import Urdf, moves, pose_at, pose_of
from dqwalk_ros.support.errors import ModelError

ROOT = Path(__file__).resolve().parents[2]
OURS = [*(ROOT / "urdf").glob("*.urdf"), *(ROOT / "test" / "data").glob("*.urdf")]
POPPY = (ROOT / "urdf" / "poppy.urdf").read_text(encoding="utf-8")
MASS = '<mass value="1"/>'
ROUND = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'


def link(name: str = "b", inertial: str = "", more: str = "") -> str:
    return f'<link name="{name}">{f"<inertial>{inertial}</inertial>" if inertial else ""}{more}</link>'


def joint(name: str = "j", parent: str = "a", child: str = "b", kind: str = "revolute", more: str | None = None) -> str:
    inside = '<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="7" effort="3"/>' if more is None else more
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inside}</joint>'


def robot(*parts: str) -> str:
    return '<robot name="r">\n' + "\n".join(parts) + "\n</robot>"


A, B, J = link("a"), link("b", MASS + ROUND), joint()

BAD = {
    "empty": ("", "not XML"),
    "not xml": ("hello", "not XML"),
    "cut off": (POPPY[:5000], "not XML"),
    "pointer": ("version https://git-lfs.github.com/spec/v1\noid sha256:4d1b\n", "Git LFS pointer .*'git lfs pull'"),
    "link of git": ("../talos_full.urdf", "symbolic link that was not made.* '../talos_full.urdf'"),
    "another root": ("<svg/>", "line 1: <svg>: not a URDF"),
    "no links": (robot(), "no links"),
    "doctype": (f'<!DOCTYPE robot SYSTEM "file:///etc/passwd">{robot(A)}', "line 1: <!DOCTYPE is not allowed"),
    "bomb": ('<!DOCTYPE r [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]>' + robot(A), "DOCTYPE"),
    "xacro without prefix": (
        robot('<property name="m" value="1"/>', '<macro name="leg"><link name="a"/></macro>'),
        "line 2: <property> is xacro without its prefix.* write <xacro:include>",
    ),
    "long name": (robot(link("a" * 100_000)), "line 2: <link> has an attribute of more than 65536 characters"),
    "undefined entity": (robot("<link name='&xxe;'/>"), "not XML"),
    "too deep": (robot(A, "<a>" * 100_000), "line 3: <a> is nested too deeply"),
    "too large": (robot(A, " " * (1 << 25)), "more than 32 MiB"),
    "nameless link": (robot("<link/>"), "line 2: <link> has no name"),
    "doubled link": (robot(A, A), "line 3: <link> 'a' has the name of the one in line 2"),
    "doubled joint": (
        robot(A, B, link("c"), J, joint(child="c")),
        "line 6: <joint> 'j' has the name of the one in line 5",
    ),
    "two roots": (robot(A, B), "one root link, this has 2: a, b"),
    "a loop": (robot(A, B, J, joint("k", "b", "a")), "line 2: <link> 'a' is part of a loop"),
    "a loop beside": (robot(A, B, link("c"), joint("j", "b", "c"), joint("k", "c", "b")), "'b' is part of a loop"),
    "its own parent": (robot(A, B, joint("j", "b", "b")), "line 3: <link> 'b' is part of a loop"),
    "two parents": (robot(A, B, J, joint("k")), "line 5: <joint> 'k' is the second joint"),
    "no such parent": (robot(A, B, joint(parent="x")), "names the parent 'x'"),
    "no such link": (robot(A, B, link("c"), joint(child="x"), joint("k", "x", "c")), "names the child 'x'"),
    "no parent": (robot(A, '<joint name="j" type="fixed"><child link="a"/></joint>'), 'one <parent link="..."/>'),
    "joint type": (robot(A, B, joint(kind="magic")), "line 4: <joint> 'j' has the type 'magic'"),
    "nan limit": (robot(A, B, joint(more='<limit lower="nan" upper="1"/>')), "line 4: <limit> has lower = 'nan'"),
    "words": (robot(A, B, joint(more='<limit lower="0" upper="1_0"/>')), "has upper = '1_0'"),
    "macro": (robot(A, B, joint(more='<limit lower="${-pi}" upper="1"/>')), "has lower = '\\$\\{-pi\\}'"),
    "no axis": (robot(A, B, joint(more='<axis xyz="0 0 0"/><limit upper="1"/>')), "axis without direction"),
    "flat axis": (robot(A, B, joint(more='<axis xyz="0 1"/><limit upper="1"/>')), "must have 3 numbers in xyz"),
    "decimal commas": (robot(A, B, joint(more='<origin xyz="0,5 0,1 2"/>')), "has xyz = '0,5', which is no number"),
    "two decimal commas": (robot(A, B, joint(more='<origin xyz="0,5 1"/>')), "must have 3 numbers in xyz"),
    "nan origin": (robot(A, B, joint(more='<origin xyz="0 nan 0"/>')), "<origin> has xyz = 'nan'"),
    "far origin": (robot(A, B, joint(more='<origin xyz="0 1e9 0"/>')), "'1e9'"),
    "negative mass": (robot(link("a", '<mass value="-1"/>')), "line 2: <link> 'a' has a negative mass"),
    "nan mass": (robot(link("a", '<mass value="nan"/>')), "<mass> has value = 'nan'"),
    "sphere": (robot(link("a", more='<visual><geometry><sphere radius="-1"/></geometry></visual>')), "negative size"),
    "twelve times": (
        robot(*(link(f"l{k}", f'<mass value="{k},5"/>') for k in range(12))),
        r"bad.urdf, line 2: <mass> has value = '0,5', which is no number that a robot has \(11 more like this\)$",
    ),
    "all at once": (robot("<link/>", A, joint(kind="magic")), "line 2: .*; line 4: "),
}


@pytest.mark.parametrize("name", BAD)
def test_invalid_descriptions_are_rejected_with_element_and_line(name: str) -> None:
    text, expected = BAD[name]
    began = time.process_time()
    with pytest.raises(ModelError, match=expected):
        Urdf(text, "bad.urdf")
    assert time.process_time() - began < 2.0


REPAIRED = {
    "no such child": (
        robot(A, B, J, joint("k", "b", "eye")),
        "line 5: <joint> 'k' names 'eye', and there is no such link: left out",
    ),
    "no such parent": (
        robot(A, B, link("c"), J, joint("k", "wrist", "c")),
        "line 6: <joint> 'k' names 'wrist', and there is no such link: left out, with 1 of 3 links that it carries",
    ),
    "carried by no joint": (
        robot(A, B, link("c"), J),
        "line 4: <link> 'c' is carried by no joint: left out with what it carries, as the robot is 'a'",
    ),
    "no name of the robot": ("<robot><link name='a'/></robot>", ""),
    "declared late": ("\n<!-- a -->\n<?xml version='1.0'?>\n" + robot(A), ""),
    "many links": (robot(A, *(link(f"l{i}") + joint(f"j{i}", "a", f"l{i}", "fixed") for i in range(500))), ""),
    "infinite limit": (robot(A, B, joint(more='<limit lower="-inf" upper="1e999" effort="1"/>')), ""),
    "no limit": (robot(A, B, joint(more="")), "line 4: <joint> 'j' has no <limit>: it moves without one"),
    "turned limits": (robot(A, B, joint(more='<limit lower="1" upper="-1"/>')), "lower 1 above upper -1: exchanged"),
    "no range": (robot(A, B, joint(more='<limit effort="1"/>')), "without lower and upper: it moves"),
    "equal limits": (robot(A, B, joint(more='<limit lower="1" upper="1"/>')), "no range, .*: fixed there"),
    "no effort": (robot(A, B, joint(more='<limit upper="1" effort="0"/>')), "effort limit 0: taken as none"),
    "limits beyond": (robot(A, B, joint(more='<limit lower="1e9" upper="1e9" effort="1e7"/>')), ""),
    "negative length": (
        robot(link("a", more='<visual><geometry><cylinder radius="1" length="-2"/></geometry></visual>')),
        "line 2: <cylinder> has the negative length -2: taken as positive",
    ),
    "capsule": (
        robot(link("a", more='<collision><geometry><capsule radius="1" length="2"/></geometry></collision>')),
        "line 2: <capsule> is taken as a cylinder between two spheres, of the same extent",
    ),
    "no color": (
        robot(
            link(
                "a",
                more='<visual><geometry><sphere radius="1"/></geometry><material><color rgba="1"/></material></visual>',
            )
        ),
        "",
    ),
    "long axis": (robot(A, B, joint(more='<axis xyz="0 0 2"/><limit upper="1"/>')), "axis of length 2: made a unit"),
    "commas": (robot(A, B, joint(more='<axis xyz="0, 0,1"/><limit upper="1"/>')), "line 4: <axis> has commas between"),
    "floating": (robot(A, B, joint(kind="floating")), "is floating: taken as fixed"),
    "no mass": (robot(link("a", '<mass value="0"/>')), "line 2: <link> 'a' has the mass 0 kg: taken as a frame"),
    "no inertia": (
        robot(link("a", MASS)),
        "principal moments 0, 0, 0 kg m.2, which no body has: 0.0001, 0.0001, 0.0001",
    ),
    "indefinite": (
        robot(link("a", MASS + ROUND.replace('ixy="0"', 'ixy="2"'))),
        "moments -1, 1, 3 .*: 2, 1, 3|: 1, 2, 3",
    ),
    "no body": (robot(link("a", MASS + ROUND.replace('izz="1"', 'izz="3"'))), "moments 1, 1, 3 "),
    "world": (robot(link("world"), A, joint("j", "world", "a", "fixed")), "'world' is no part of the robot"),
    "world with a ground": (
        robot(
            link("world", more='<collision><geometry><box size="9 9 0.1"/></geometry></collision>'),
            A,
            joint("j", "world", "a", "fixed"),
        ),
        "'world' is no part of the robot",
    ),
}


@pytest.mark.parametrize("name", REPAIRED)
def test_flaws_that_ros_tools_accept_are_repaired(name: str) -> None:
    text, expected = REPAIRED[name]
    urdf = Urdf(text, "odd.urdf")
    if expected:
        (repair,) = urdf.repairs
        assert re.search(expected, repair), repair
    else:
        assert not urdf.repairs
    for one in urdf.links.values():
        a, b, c = np.linalg.eigvalsh(one.inertial.inertia)
        assert not one.inertial.mass or (a > 0.0 and a + b >= c * 0.999)
    again = Urdf(urdf.text(), "again")  # the written text needs no repair
    assert not again.repairs
    assert again.text() == urdf.text()


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "latin-1", "GB2312", "Shift_JIS"])
def test_a_file_is_read_in_its_encoding(encoding: str) -> None:
    name = {"latin-1": "Fu\u00df", "utf-8": "\u00df\u8db3", "utf-16": "\u00df\u8db3"}.get(encoding, "\u8db3")
    text = f'<?xml version="1.0" encoding="{encoding}"?>' + robot(link(name))
    assert list(Urdf(text.encode(encoding), "x").links) == [name]
    text = text.replace(encoding, "klingon")
    assert list(Urdf(text, "x").links) == [name]  # a text has no encoding
    with pytest.raises(ModelError, match="x: unknown encoding: klingon; save it as UTF-8"):
        Urdf(text.encode(), "x")


def test_mesh_files_are_not_opened(tmp_path: Path) -> None:
    trap = tmp_path / "trap.stl"
    os.mkfifo(trap)  # opening it would block forever
    mesh = f'<visual><geometry><mesh filename="{trap}" scale="0.1 0.1 0.1"/></geometry></visual>'
    (shape,) = Urdf(robot(link("a", more=mesh)), "x").links["a"].visuals
    assert shape.geometry.mesh == yourdfpy.Mesh(str(trap), np.full(3, 0.1))


@pytest.mark.parametrize("path", OURS, ids=lambda path: path.name)
def test_own_descriptions_need_no_repair_and_are_written_as_they_are(path: Path) -> None:
    urdf = Urdf.load(path)
    assert not urdf.repairs
    text = urdf.text()
    known = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=False).robot
    for links, joints in [(one.links, one.joints) for one in (urdf, Urdf(text, "again"))]:
        assert list(links) == [one.name for one in known.links]
        assert list(joints) == [one.name for one in known.joints]
        for one in known.joints:
            mine = joints[one.name]
            np.testing.assert_allclose(mine.origin, np.eye(4) if one.origin is None else one.origin, atol=1e-14)
            assert (mine.type, mine.parent, mine.child) == (one.type, one.parent, one.child)
            if moves(mine):
                np.testing.assert_array_equal(mine.axis, one.axis)
                assert mine.limit == one.limit
        for one in known.links:
            if one.inertial is not None:
                pose = np.eye(4) if one.inertial.origin is None else one.inertial.origin
                R, mine = pose[:3, :3], links[one.name].inertial
                assert mine.mass == one.inertial.mass
                np.testing.assert_allclose(mine.origin[:3, 3], pose[:3, 3], atol=1e-15)
                np.testing.assert_allclose(mine.inertia, R @ one.inertial.inertia @ R.T, atol=1e-15)
            shapes = (*links[one.name].visuals, *links[one.name].collisions)
            for mine, other in zip(shapes, (*one.visuals, *one.collisions), strict=True):
                assert mine.geometry == other.geometry
                np.testing.assert_allclose(mine.origin, np.eye(4) if other.origin is None else other.origin, atol=1e-14)
    assert Urdf(text, "again").text() == text


angles = st.floats(-4.0, 4.0) | st.sampled_from([0.0, np.pi / 2, -np.pi / 2, np.pi])


@given(st.tuples(angles, angles, angles))
def test_a_frame_is_written_at_its_pose(rpy: tuple[float, float, float]) -> None:
    pose = DQ.from_roll_pitch_yaw(rpy, (1.0, 2.0, 3.0))
    urdf = Urdf(robot(A), "x")
    urdf.add_frame("b", "a", pose)
    off = pose.conj() * pose_of(Urdf(urdf.text(), "again").joints["b_joint"].origin)
    np.testing.assert_allclose(off.rotation_matrix(), np.eye(3), atol=1e-8)
    np.testing.assert_allclose(off.translation(), 0.0, atol=1e-8)


def test_a_joint_fixed_at_an_angle_has_the_pose_of_that_angle() -> None:
    urdf = Urdf(robot(A, B, joint(more='<origin xyz="1 0 0" rpy="1.5707963 0 0"/><axis xyz="0 0 1"/>')), "x")
    turned = pose_at(urdf.joints["j"], 0.3)
    urdf.weld({"j": 0.3})
    assert not moves(urdf.joints["j"])
    np.testing.assert_allclose(pose_of(urdf.joints["j"].origin).vec8(), turned.vec8(), atol=1e-15)
    assert turned.rotation_matrix()[2, 0] == pytest.approx(np.sin(0.3))  # about -y of the parent


def test_package_files_are_found_near_the_description(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = tmp_path / "my_robot" / "meshes" / "foot.stl"
    near = tmp_path / "my_robot" / "urdf" / "deep" / "my.urdf"
    for path in (mesh, near):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")
    assert find_package_file("package://my_robot/meshes/foot.stl", near) == mesh
    assert find_package_file("package://another/meshes/foot.stl", near) == mesh  # the copy has another name
    assert find_package_file("../../meshes/foot.stl", near).resolve() == mesh
    assert find_package_file(f"file://{mesh}", near) == mesh
    assert find_package_file("package://my_robot/meshes/hand.stl", near) is None
    assert find_package_file("file://my_robot/stl/foot.stl", near) is None
    assert find_package_file("file://my_robot/stl/foot.stl", near, [mesh.parent]) == mesh
    beside = near.parent / "other.urdf"
    assert find_package_file("file://my_robot/stl/foot.stl", beside.parent) == mesh  # the only one of its name
    (near.parent.parent / "foot.stl").write_text("")
    assert find_package_file("file://my_robot/stl/foot.stl", beside.parent) is None
    installed = tmp_path / "prefix" / "share" / "their_robot"
    installed.mkdir(parents=True)
    (installed / "a.stl").write_text("")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "prefix"))
    assert find_package_file("package://their_robot/a.stl", near) == installed / "a.stl"


def test_xacro_is_expanded(tmp_path: Path) -> None:
    folder = tmp_path / "my_robot"
    folder.mkdir()
    (folder / "parts.xacro").write_text(
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="part" params="name">'
        '<link name="${name}"/></xacro:macro></robot>'
    )
    path = folder / "my.urdf.xacro"
    path.write_text(
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        '<xacro:include filename="$(find my_robot)/parts.xacro"/><xacro:part name="a"/></robot>'
    )
    assert list(Urdf.load(path).links) == ["a"]
    path.write_text(path.read_text()[:-20])
    with pytest.raises(ModelError, match="xacro refuses"):
        Urdf.load(path)


def test_a_package_has_the_name_of_its_manifest(tmp_path: Path) -> None:
    """A clone may be named after its repository, and a folder of Python modules in it after the package."""
    clone, parts = tmp_path / "clone", tmp_path / "clone-of-parts"
    for folder, name in ((clone, "my_robot"), (parts, "parts")):
        (folder / "urdf").mkdir(parents=True)
        (folder / "package.xml").write_text(f"<package><name> {name} </name></package>")
    (clone / "my_robot").mkdir()
    head = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    (parts / "urdf" / "b.xacro").write_text(f'{head}<link name="b"/></robot>')
    (clone / "urdf" / "more.xacro").write_text(f'{head}<link name="a"/></robot>')
    path, include = clone / "urdf" / "my.xacro", '<xacro:include filename="$(find {})/urdf/{}.xacro"/>'
    path.write_text(head + include.format("my_robot", "more") + "</robot>")
    assert list(Urdf.load(path).links) == ["a"]
    path.write_text(head + include.format("parts", "b") + "</robot>")
    assert list(Urdf.load(path).links) == ["b"]
    path.rename(tmp_path / "my.xacro")
    assert list(Urdf.load(tmp_path / "my.xacro", [parts]).links) == ["b"]


def test_xacro_files_are_read_in_their_encoding(tmp_path: Path) -> None:
    head = (
        '<?xml version="1.0" encoding="utf-8"?><!-- {} --><robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    )
    path, more = tmp_path / "my.xacro", tmp_path / "more.xacro"
    include = '<xacro:include filename="more.xacro"/></robot>'
    path.write_text(head.format("b\u00edpedo") + include, "latin-1")  # as an editor on Windows saves it
    more.write_text(head.format("\u8db3").replace("utf-8", "GB2312") + '<link name="\u8db3"/></robot>', "GB2312")
    assert list(Urdf.load(path).links) == ["\u8db3"]
