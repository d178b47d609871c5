"""Soles, and the shapes and meshes that they are found from."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from robots import edited
from small_humanoid import FOOT_BOX, SMALL, anatomy_of, read

from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.robot import shapes as shapes_of
from dqwalk_ros.robot.shapes import Shapes
from dqwalk_ros.robot.urdf import Urdf
from dqwalk_ros.support.errors import ModelError


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


def test_a_capsule_that_leans_reaches_no_further_down_than_its_round_ends(tmp_path: Path) -> None:
    """As the feet of humanoids in MJCF: a cylinder of the same length reaches below them."""

    def capsules(box: re.Match[str]) -> str:
        x, y, z = map(float, box[1].split())
        out = ""
        for side in (-0.03, 0.03):
            for front in (-1.0, 1.0):  # from the middle down to heel and toe
                origin = f'xyz="{x + front * 0.025} {y + side} {z + 0.01 - 0.0066}" rpy="0 {front * 1.951302703907} 0"'
                geometry = '<geometry><capsule radius="0.01" length="0.0538516"/></geometry>'
                out += f"<collision><origin {origin}/>{geometry}</collision>"
        return out

    foot = rf'<collision>\s*<origin xyz="([^"]*)"/>\s*<geometry>{FOOT_BOX}</geometry>\s*</collision>'
    path = tmp_path / "capsules.urdf"
    path.write_text(re.sub(foot, capsules, SMALL.read_text()))
    found, plain = (anatomy_of(Urdf.load(file)).soles[Foot.LEFT] for file in (path, SMALL))
    assert found.pose.translation()[2] == pytest.approx(plain.pose.translation()[2] - 0.01, abs=2e-4)


def test_a_long_sole_may_be_narrow_but_not_one_like_a_point(tmp_path: Path) -> None:
    """As Unitree's H1, whose soles are 300 x 30 mm, and which does the dynamic walk."""
    box = '<box size="0.1265 0.0825 0.0132"/>'
    assert anatomy_of(read(tmp_path, (box, '<box size="0.1265 0.01 0.0132"/>'))).soles[Foot.LEFT].width < 0.011
    with pytest.raises(ModelError, match="points or edges: its left sole is 20 x 10 mm"):
        anatomy_of(read(tmp_path, (box, '<box size="0.02 0.01 0.0132"/>')))


def test_a_flat_sole_may_have_edges_that_are_rounded(tmp_path: Path) -> None:
    """As the foot of a duck: 22 mm are flat, and 32 mm on both sides of these bend up."""
    bend = np.linspace(0.0, math.radians(45.0), 16)
    side = np.column_stack([0.011 + 0.045 * np.sin(bend), 0.045 * (1.0 - np.cos(bend)) - 0.0066])
    corners = [(x, y * way, z) for x in (-0.05, 0.05) for way in (-1.0, 1.0) for y, z in side]
    trimesh.convex.convex_hull(np.array(corners)).export(tmp_path / "foot.stl")
    found = anatomy_of(read(tmp_path, (FOOT_BOX, '<mesh filename="foot.stl"/>')), tmp_path / "robot.urdf")
    assert found.soles[Foot.LEFT].length == pytest.approx(0.1, abs=1e-3)


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


def test_meshes_of_one_name_in_two_folders_are_two_meshes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A relative path means another file after the process has changed its folder."""
    for size in (0.1, 0.2):
        folder = tmp_path / f"{size}"
        folder.mkdir()
        trimesh.creation.box((size, size, size)).export(folder / "box.stl")
        shape = '<visual><geometry><mesh filename="box.stl"/></geometry></visual>'
        (folder / "robot.urdf").write_text(f'<robot name="r"><link name="a">{shape}</link></robot>')
        monkeypatch.chdir(folder)
        path = Path("robot.urdf")
        (surface,) = Shapes(Urdf.load(path), path).of("a", "visuals")
        np.testing.assert_allclose(np.ptp(surface.vertices, axis=0), size, rtol=1e-6)


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


def test_a_round_foot_is_not_blamed_on_a_mesh_of_another_link(tmp_path: Path) -> None:
    lost = r'(<link name="trunk">.*?<geometry>\s*)<box [^>]*/>', r'\1<mesh filename="lost.stl"/>'
    with pytest.raises(ModelError, match=r"round below$"):
        anatomy_of(read(tmp_path, ("<box [^>]*0132[^>]*>", '<sphere radius="0.03"/>'), lost))


def test_a_mesh_has_one_convex_hull_however_its_link_is_turned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot that is no biped is looked at with each link as its root."""
    trimesh.creation.icosphere(subdivisions=3, radius=0.02).export(tmp_path / "ball.stl")
    urdf = read(tmp_path, (FOOT_BOX, '<mesh filename="ball.stl"/>'))
    shapes, corners, counts = Shapes(urdf, tmp_path / "robot.urdf"), shapes_of._corners, list[int]()
    monkeypatch.setattr(shapes_of, "_corners", lambda points: counts.append(len(points)) or corners(points))
    for root in ("l_foot", "trunk"):
        urdf.reroot(root)
        shapes.forget()
        assert len(shapes.hulls(["l_foot", "r_foot"])[0]) == 2
    assert len(counts) == 1
