"""Posture, distance of the soles and reach of robots with narrow limits."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from robots import edited
from small_humanoid import SMALL, anatomy_of, at, in_units, moved, narrowed, small_model, written

from dqwalk_ros.adopt import adopt, posture
from dqwalk_ros.adopt.anatomy import distances
from dqwalk_ros.adopt.check import check
from dqwalk_ros.adopt.parameters import Numbers
from dqwalk_ros.adopt.posture import Standing, stand
from dqwalk_ros.adopt.stance import find_stance
from dqwalk_ros.config import Config, load
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.robot.model import RobotModel, load_model
from dqwalk_ros.robot.urdf import Urdf
from dqwalk_ros.support.errors import ModelError
from dqwalk_ros.walks.footsteps import Footsteps


def legs_of(urdf: Urdf) -> RobotModel:
    """Return the model of which only the legs move."""
    legs = {joint for names in anatomy_of(urdf).legs.values() for joint in names}
    return small_model(urdf, lock=tuple(set(small_model(urdf).joint_names) - legs))


def test_skew_hips_stand_on_level_soles(tmp_path: Path) -> None:
    urdf = Urdf.load(SMALL)
    for side in "lr":
        urdf.joints[f"{side}_hip_yaw"].axis = np.array([0.6, 0.0, 0.8])
        urdf.joints[f"{side}_hip_roll"].axis = np.array([0.8, 0.0, -0.6])
    found = anatomy_of(urdf)
    assert found.kinds == "SSPPPR"
    assert (found.sideways, found.turns) == (True, True)
    assert stand(legs_of(urdf), found).error < 1e-3


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


def test_soles_are_wider_where_the_robot_stands_with_joints_at_their_limits(tmp_path: Path) -> None:
    """Hips that roll outwards from the zero posture only, as those of iCub Heidelberg01: there its walk stalls."""
    urdf = rolls(tmp_path, 0.0, 0.6, 0.5)
    model = legs_of(urdf)
    kin = Kinematics(model, np.zeros(model.n), Foot.LEFT)
    zero = replace(anatomy_of(urdf), apart=float(-kin.point(model.soles[Foot.RIGHT].frame)[1]))
    assert posture.at_limits(model, stand(model, zero))
    found = find_stance(model, zero)
    assert found.anatomy.apart == pytest.approx(1.3 * zero.apart, rel=1e-3)
    assert found.standing.off < 0.2  # at 1.15 it squats
    assert not posture.at_limits(model, replace(found.standing, margin=0.0))


def test_hips_that_hardly_roll_inwards_do_not_keep_the_feet_from_their_places(tmp_path: Path) -> None:
    """The postures with the CoM over one sole are far from that in which the robot stands, but the legs reach them."""
    urdf = rolls(tmp_path, 0.05, 0.6, 0.3)
    found = find_stance(legs_of(urdf), anatomy_of(urdf))
    assert (found.hindrance, found.anatomy.apart) == ("", anatomy_of(urdf).apart)
    assert found.step > 0.02
    walk = Config().updated({"gait.step_width": found.anatomy.apart})
    assert not Footsteps(walk, found.model, found.standing.q).not_beside()


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
@pytest.mark.parametrize(("limit", "part"), [(0.36, 0.87), (0.45, 1.0)])
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


@pytest.mark.long
def test_the_weight_of_the_posture_against_lengths_is_that_of_a_smaller_robot(tmp_path: Path) -> None:
    """The error of the CoM is a length, the posture is angles: for half the size the ratio of their squares is 1/4."""
    half = Urdf(in_units(SMALL.read_text(), 0.5), "half")
    half.scale_mass(0.5)
    weights = [
        adopt(path, tmp_path / path.stem).config.task.posture_weight for path in (SMALL, written(tmp_path, half))
    ]
    assert weights[1] == pytest.approx(0.25 * weights[0], rel=0.01)
