"""Units, inertias and masses that cannot be right are repaired, or named."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from robots import edited
from small_humanoid import SMALL, Z, anatomy_of, in_units, read, small_model, written

from dqwalk_ros import cli
from dqwalk_ros.adopt import adopt
from dqwalk_ros.adopt.adoption import _mass_evidence
from dqwalk_ros.adopt.doubts import assume_masses, list_massless, repair_degrees, repair_inertias
from dqwalk_ros.adopt.parameters import Numbers
from dqwalk_ros.adopt.posture import Standing
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.robot.shapes import Shapes
from dqwalk_ros.robot.urdf import Urdf
from dqwalk_ros.support.errors import ModelError


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
