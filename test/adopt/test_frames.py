"""Any link may be the root, and any axis of it up."""

from __future__ import annotations

import io
import math
import re
from pathlib import Path

import numpy as np
import pytest
from robots import edited
from small_humanoid import SMALL, X, Z, anatomy_of, at, moved, read, small_model, written

from dqwalk_ros import cli
from dqwalk_ros.adopt import adopt
from dqwalk_ros.config import Config
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.plants.mujoco import build
from dqwalk_ros.robot.urdf import Urdf


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
