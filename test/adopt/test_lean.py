"""Robots without ankle roll, whose trunk leans."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from robots import edited
from small_humanoid import NO_ROLL, SMALL, X, Z, anatomy_of, read

from dqwalk_ros.adopt import adopt
from dqwalk_ros.adopt.lean import Lean
from dqwalk_ros.adopt.skeleton import Skeleton
from dqwalk_ros.adopt.trial import walk
from dqwalk_ros.config import load
from dqwalk_ros.robot.shapes import Shapes
from dqwalk_ros.robot.urdf import Urdf
from dqwalk_ros.support.errors import ModelError

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


def test_a_trunk_that_cannot_lean_as_far_as_a_walk_needs_is_an_error(tmp_path: Path) -> None:
    narrow = r'(name="._hip_roll".*?lower=)"[^"]*" upper="[^"]*"', r'\1"-0.02" upper="0.02"'
    with pytest.raises(ModelError, match=r"lean by \d+ degrees in .*; its hips roll by 1 degrees to one side$"):
        adopt(edited(tmp_path, SMALL, NO_ROLL, narrow), tmp_path / "out")
