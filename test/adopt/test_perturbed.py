"""What people do to the description of a robot that walks is undone, or named."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from robots import edited
from small_humanoid import FOOT_BOX, SMALL, X, Y, Z, anatomy_of, at, in_units, moved, narrowed, written

from dqwalk_ros import cli
from dqwalk_ros.adopt import adopt
from dqwalk_ros.adopt.anatomy import find_anatomy
from dqwalk_ros.adopt.doubts import repair_degrees, repair_inertias
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.robot.shapes import Shapes
from dqwalk_ros.robot.urdf import Urdf
from dqwalk_ros.support.errors import ModelError


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
    (root_at_the_foot, "", "no two legs are seen from the root link"),
    (y_up, "", ""),
    (rolled, "", ""),
    (pitched, "", ""),
    (tilted_on_its_face, "", ""),
    (tilted_trunk_on_a_tilted_foot, "", "no two legs are seen from the root link"),
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


@pytest.mark.long
@pytest.mark.parametrize(
    "perturb", [one for one, refusal, _ in PERTURBED if not refusal], ids=lambda one: getattr(one, "__name__", "")
)
def test_perturbed_robots_walk(
    perturb: Callable[[Path], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["adopt", str(perturb(tmp_path)), "--out", str(tmp_path / "out"), "--yes", "--quiet"]) == 0
    assert re.search(r"dynamic walk: walked 3\.\d+ m(, \w+ needs [^,;]*)?\n", capsys.readouterr().out)
