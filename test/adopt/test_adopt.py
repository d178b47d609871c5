"""Adoption of unknown robots: detected anatomy, rejected robots, and walks of the generated configurations."""

from __future__ import annotations

import itertools
import math
import re
import shutil
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from robots import edited

from benchmark.lab import robots as robots_table
from dqwalk_ros import cli
from dqwalk_ros.adopt import Adoption, adopt, trial
from dqwalk_ros.adopt.anatomy import find_anatomy
from dqwalk_ros.adopt.check import check
from dqwalk_ros.adopt.files import write_yaml
from dqwalk_ros.adopt.parameters import climb_parameters
from dqwalk_ros.adopt.skeleton import Entry
from dqwalk_ros.adopt.trial import Trial, cures, dynamic_walks, first_walks, legs_touching, too_much
from dqwalk_ros.cli.adopt import _walk
from dqwalk_ros.config import load, overlaid, with_files
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.plants.mujoco import own_contacts
from dqwalk_ros.robot.model import find_urdf, load_model
from dqwalk_ros.robot.servos import Drive
from dqwalk_ros.robot.shapes import Shapes
from dqwalk_ros.robot.standing_limits import Finding
from dqwalk_ros.robot.urdf import Urdf
from dqwalk_ros.studies.pushes import Push, pushed
from dqwalk_ros.support import strict_yaml
from dqwalk_ros.support.errors import ConfigError, ModelError
from dqwalk_ros.walks.table import make_controller

DATA = Path(__file__).parents[1] / "data"
SMALL, SMALLER = DATA / "small_humanoid.urdf", DATA / "smaller_humanoid.urdf"


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Adoption:
    return adopt(SMALL, tmp_path_factory.mktemp("small"))


def test_anatomy_is_detected(small: Adoption) -> None:
    anatomy = small.anatomy
    assert anatomy.legs[Foot.LEFT] == tuple(
        f"l_{name}" for name in ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle_pitch", "ankle_roll")
    )
    assert anatomy.kinds == "YRPPPR"
    assert (anatomy.pelvis, anatomy.torso, anatomy.imu) == ("trunk", "trunk", "imu")
    assert anatomy.hands == {Foot.LEFT: "l_lower_arm", Foot.RIGHT: "r_lower_arm"}
    # the feet are boxes of 115 x 75 x 12 mm, made 1.1 times as large
    for foot, side in ((Foot.LEFT, 1.0), (Foot.RIGHT, -1.0)):
        sole = anatomy.soles[foot]
        np.testing.assert_allclose([sole.length, sole.width], [0.1265, 0.0825], atol=1e-4)
        np.testing.assert_allclose(sole.pose.translation(), 1.1 * np.array([0.012, side * 0.008, -0.042]), atol=1e-4)


def test_the_initial_posture_is_statically_stable(small: Adoption) -> None:
    """Soles level and side by side, CoM above their midpoint, knees forward although these joints bend both ways."""
    model, q = small.model, small.model.posture(small.config.standing.posture)
    kin = Kinematics(model, q, Foot.LEFT)
    np.testing.assert_allclose(kin.pose(model.soles[Foot.RIGHT].frame)[:4], [1.0, 0.0, 0.0, 0.0], atol=1e-3)
    right = kin.point(model.soles[Foot.RIGHT].frame)
    np.testing.assert_allclose(right, [0.0, -small.config.gait.step_width, 0.0], atol=1e-3)
    np.testing.assert_allclose(kin.com[:2], 0.5 * right[:2], atol=1e-3)
    assert kin.point("l_shank")[0] > kin.point("l_foot")[0]
    assert not check(small.config, model)


def test_arms_that_cannot_be_straight_are_locked_at_their_limit(small: Adoption) -> None:
    assert "l_elbow=-0.1" in small.config.robot.lock


def test_files_are_found_from_any_working_directory(
    small: Adoption, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("robot.yaml", "paper.yaml"):
        assert load_model(load(small.folder / name).robot).joint_names == small.model.joint_names
    assert make_controller(load(small.folder / "robot.yaml"), small.model)  # with the steps of dynamic.yaml
    # none takes an optional solver
    assert {load(file).qp.solver for file in small.folder.glob("*.yaml")} == {"clarabel"}
    text = (small.folder / "robot.yaml").read_text()
    values = [line for line in text.splitlines() if re.match(r"\s+\w+: \S", line)]
    assert all("  # " in line for line in values), "every value has its reason in a comment"
    assert re.search(r"eta: 2\.0 +# as for every robot \(default\)\n", text)


def test_names_of_a_robot_are_only_names_in_its_configuration(tmp_path: Path) -> None:
    file, evil = tmp_path / "robot.yaml", "x\n/**:\n  ros__parameters: {gait: {walk: 'os:system'}}"
    names = ("on", "1", "1.5", "null", "a: b", "l knee ü✓", "\U0001f916", evil, "'\"\\#", "\x85\u2028\x7f", "")
    for name in names:
        entries = [Entry("robot.pelvis", name, f"link {name}"), Entry("robot.lock", [name, name], name)]
        write_yaml(file, entries, f"{name}, adopted:", overwrite=True)
        read = strict_yaml.read(file.read_text())
        assert read == {"/**": {"ros__parameters": {"robot": {"pelvis": name, "lock": [name, name]}}}}


def test_a_backward_facing_root_link_is_detected(tmp_path: Path) -> None:
    """The same robot below a root link rotated by 180 degrees."""
    root = '<link name="base"/><joint name="base_joint" type="fixed"><parent link="base"/><child link="trunk"/>'
    root += '<origin rpy="0 0 3.14159265358979"/></joint>'
    path = edited(tmp_path, SMALL, (r'(<robot name="small_humanoid">)', r"\1" + root))
    found = adopt(path, tmp_path / "out")
    assert found.anatomy.legs[Foot.LEFT][0] == "l_hip_yaw"
    assert not found.findings
    ahead = next(e for e in found.evidence if e.what == "ahead")
    assert ahead.value == "-x of base"
    assert "against it: x of the root link" in ahead.source


def test_exchanged_names_of_left_and_right_are_reported(tmp_path: Path) -> None:
    path = edited(tmp_path, SMALL, (r'"l_', '"x_'), (r'"r_', '"l_'), (r'"x_', '"r_'))
    urdf = Urdf.load(path)
    found = {entry.what: entry for entry in find_anatomy(urdf, Shapes(urdf, path)).evidence}
    assert found["side names"].value == "may be exchanged"
    assert found["side names"].source.startswith("by feet, ")  # the knees bend both ways


def test_knees_that_bend_backward_do_not_exchange_the_sides(tmp_path: Path) -> None:
    left = (r'(name="l_knee".*?lower="-2.2" upper=)"2.2"', r'\1"0.1"')
    right = (r'(name="r_knee".*?lower=)"-2.2"', r'\1"-0.1"')  # its axis points to the other side
    path = edited(tmp_path, SMALL, left, right)
    urdf = Urdf.load(path)
    found = {entry.what: entry for entry in find_anatomy(urdf, Shapes(urdf, path)).evidence}
    assert "against it: the direction in which the knees bend" in found["ahead"].source
    assert "side names" not in found


@pytest.mark.parametrize(("old", "new"), [("0.1265 0.0825", "0.1165 0.0825"), ("-0.0088 -0.0396", "0 -0.0396")])
def test_soles_that_do_not_mirror_each_other_are_a_guess(old: str, new: str, small: Adoption, tmp_path: Path) -> None:
    """A sole that is shorter, and one that is further inside."""
    path = edited(tmp_path, SMALL, (f'(<link name="r_foot">.*?<collision>.*?){old}', rf"\g<1>{new}"))
    urdf = Urdf.load(path)
    soles = find_anatomy(urdf, Shapes(urdf, path)).soles.values()
    assert {sole.confidence for sole in soles} == {"guess"}
    assert {sole.confidence for sole in small.anatomy.soles.values()} == {"sure"}


@pytest.mark.parametrize("names", [("left_", "right_"), ("Lft", "Rgt")])
def test_words_for_left_and_right_tell_the_sides(names: tuple[str, str], tmp_path: Path) -> None:
    path = edited(tmp_path, SMALL, (r'"l_', f'"{names[0]}'), (r'"r_', f'"{names[1]}'))
    urdf = Urdf.load(path)
    found = find_anatomy(urdf, Shapes(urdf, path))
    assert found.legs[Foot.LEFT][0] == f"{names[0]}hip_yaw"
    assert "the names of left and right" in next(e for e in found.evidence if e.what == "ahead").source


REFUSED = {
    "no shapes": ((r"<visual>.*?</visual>|<collision>.*?</collision>", ""), "no moving part has a shape"),
    "point feet": ((r'<box size="0.1265 0.0825 0.0132"/>', '<box size="0.01 0.01 0.0132"/>'), "points or edges"),
    "round feet": ((r'<box size="0.1265 0.0825 0.0132"/>', '<sphere radius="0.05"/>'), "'l_foot' is round below"),
    "edges": ((r'<box size="0.1265 0.0825 0.0132"/>', '<box size="0.1265 1e-30 0.0132"/>'), "has no flat area"),
    "bare feet": (
        (r'(<link name="._(?:foot|ankle_link)">.*?</inertial>).*?</link>', r"\1</link>"),
        "'l_foot' and 'r_foot' below have no shape; add a box as <collision>",
    ),
    "bare legs": (
        (r'(<link name="._(?:thigh|shank|foot|ankle_link)">.*?</inertial>).*?</link>', r"\1</link>"),
        "is below all links with a shape that can be read, so the soles are unknown: add a box as <collision>",
    ),
    "two joints": (
        (r'name="(._(?:hip_yaw|hip_roll|ankle_pitch|ankle_roll))" type="revolute"', r'name="\1" type="fixed"'),
        "is carried by 2 joints at most",
    ),
    "wide feet": (
        (r'<box size="0.1265 0.0825 0.0132"/>', '<box size="0.1265 0.3 0.0132"/>'),
        "soles overlap each other",
    ),
    "one leg": ((r'name="r_knee" type="revolute"', 'name="r_knee" type="fixed"'), "mirror each other"),
    "truncated": ((r"</robot>", ""), "not XML"),
    "grams": ((r'(mass value="[^"]*)', r"\1e3"), "'small_humanoid' weigh 4059 kg"),
    "missing meshes": (
        (r"<(box|cylinder|sphere) [^>]*/>", '<mesh filename="package://no/a.stl"/>'),
        "--package-path",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_unsuitable_robots_are_rejected_with_one_line(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change, expected = REFUSED[name]
    path = edited(tmp_path, SMALL, change)
    assert cli.main(["adopt", str(path), "--out", str(tmp_path / "out"), "--yes"]) == 2
    error = capsys.readouterr().err
    assert expected in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_an_invalid_value_given_by_the_user_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"^'gait.step_length' must be a number"):
        adopt(SMALL, tmp_path / "out", changes={"gait.step_length": 7.0})
    assert not (tmp_path / "out").exists()


MUTATIONS: dict[str, tuple[dict[str, Any], str]] = {
    "soles exchanged": (
        {"robot.left_sole": "dqwalk_right_sole", "robot.right_sole": "dqwalk_left_sole"},
        "left and right are exchanged",
    ),
    "a timeout of one period": ({"dt": 0.06}, "commands come every 0.06 s .*: the robot would stand still"),
    "soles 35 mm high": (
        {"robot.left_sole_xyz": [0.0, 0.0, 0.035], "robot.right_sole_xyz": [0.0, 0.0, 0.035]},
        "reaches 35 mm below its sole",
    ),
    "soles that look back": (
        {"robot.left_sole_rpy": [0.0, 0.0, np.pi], "robot.right_sole_rpy": [0.0, 0.0, np.pi]},
        "point backward",
    ),
    "knees the other way": ({"standing.posture": ["l_knee=-0.57", "r_knee=0.57"]}, "not level|ahead of|behind|degrees"),
    "a soft servo": ({"servo.stiffness": 22.0}, "m g h"),
    "a quarter of the damping": ({"servo.damping": 0.005}, "damping ratio"),
    "half the effort": ({"servo.torque_scale": 0.35}, "to stand on one foot"),
}


@pytest.mark.parametrize("name", MUTATIONS)
def test_check_reports_wrong_parameters(name: str, small: Adoption) -> None:
    changes, expected = MUTATIONS[name]
    config = small.config.updated(changes)
    found = check(config, load_model(config.robot))
    assert any(re.search(expected, str(finding)) for finding in found), found


def test_a_step_that_the_legs_reach_is_no_problem_and_another_one_is() -> None:
    config = load("poppy").updated({"gait.step_length": -0.05})
    assert not check(config, load_model(config.robot))
    far = load("poppy_dynamic").updated({"gait.step_length": 0.5})
    assert any("steps of 242 mm instead of 500 mm: l_hip_z" in str(one) for one in check(far, load_model(far.robot)))
    found = check(config.updated({"gait.step_width": 0.3}), load_model(config.robot))
    assert any("beside the other one is out of reach by" in str(one) for one in found), found


def test_config_check_loads_the_robot(small: Adoption, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(small.folder / "robot.yaml")
    assert cli.main(["config", path, "--check"]) == 0
    assert cli.main(["config", path, "--check", "--set", "servo.stiffness=10"]) == 1
    assert "servo.stiffness" in capsys.readouterr().out
    assert cli.main(["config", path, "--check", "--set", "robot.urdf=/nonexistent.urdf"]) == 2


@pytest.mark.long
@pytest.mark.parametrize("urdf", [SMALL, SMALLER])
def test_small_robots_walk_three_metres_dynamically(
    urdf: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["adopt", str(urdf), "--out", str(tmp_path), "--yes", "--quiet"]) == 0
    out = capsys.readouterr().out
    for walk, metres in (("integrator", 0), ("physics", 0), ("dynamic walk", 3)):  # whole, without a violation
        assert re.search(rf"{walk}: walked {metres}\.\d+ m(, \w+ needs [^,;]*)?\n", out)
    assert out.endswith("\nadopted: the standing and the dynamic walk stand in physics\n")


def test_the_dynamic_walk_has_the_froude_number_of_its_comment_and_the_drive_of_the_standing_walk(
    small: Adoption,
) -> None:
    config = load(small.folder / "dynamic.yaml")
    period = config.standing.transfer_duration + config.standing.swing_duration
    assert config.gait.step_length / period == pytest.approx(0.05 * math.sqrt(9.81 * small.anatomy.leg), rel=0.05)
    assert config.servo.stiffness == small.config.servo.stiffness
    assert config.servo.window * config.servo.stiffness == pytest.approx(0.03 * small.numbers.mgh, rel=0.05)
    assert config.robot == small.config.robot


@pytest.mark.parametrize("walk", ["robot", "dynamic"])
def test_the_controller_assumes_three_quarters_of_the_damping_of_the_servos_in_physics(
    walk: str, small: Adoption
) -> None:
    config = load(small.folder / f"{walk}.yaml")
    drive = Drive.of(overlaid(config, "physics"), small.model)
    assert drive.lag / drive.stiffness == pytest.approx(np.full(small.model.n, 0.75 * config.servo.damping), rel=0.02)
    cured = {key: value for _, values in cures(config, small.numbers, ()) for key, value in values.items()}
    drive = Drive.of(overlaid(config.updated(cured), "physics"), small.model)
    assert drive.lag / drive.stiffness == pytest.approx(np.full(small.model.n, 0.75 * cured["servo.damping"]), rel=0.02)


def test_a_joint_that_cannot_do_the_steps_of_the_dynamic_walk_is_named(small: Adoption) -> None:
    config, model = load(small.folder / "dynamic.yaml"), small.model
    assert too_much(config, model) == ""
    slow = replace(model, velocity_max=0.5 * np.ones(model.n))
    assert re.fullmatch(
        r"its steps need [1-9]\.\d+ rad/s of ._knee, whose limit is 0.50 rad/s .*", too_much(config, slow)
    )


FINE, CLOSE, BESIDE, FELL = (
    Trial("physics", stood, 1.0, 1.0, note, violations)
    for stood, note, violations in ((True, "", 0), (True, "6 mm off", 1), (True, "9 mm off", 3), (False, "fell", 0))
)
EARLY, STUCK = replace(FELL, plant="integrator"), replace(CLOSE, distance=0.4)
LATE = replace(FELL, late=True)


@pytest.mark.parametrize(
    ("walks", "given", "factors"),
    [
        ([FINE], (), (1.0, 0.75, 0.7, 1.0, 1.0, 1.0)),
        ([BESIDE, FINE], (), (0.4, 0.75, 0.7, 1.0, 1.0, 1.0)),
        ([BESIDE, FELL, FINE], (), (0.4, 1.0, 0.7, 1.0, 1.0, 1.0)),
        ([FELL, *[BESIDE] * 7], (), (0.4, 0.75, 0.7, 1.0, 1.0, 1.0)),
        ([BESIDE, FELL, FELL, FINE], (), (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)),
        ([BESIDE, FELL, FELL, *[BESIDE] * 5], (), (1.0, 0.75, 0.7, 1.0, 1.0, 1.0)),
        ([BESIDE, FELL, FELL, BESIDE, BESIDE, FINE], (), (1.0, 0.75, 0.7, 0.3, 1.0, 1.0)),
        ([BESIDE, FELL, FELL, BESIDE, BESIDE, CLOSE, FINE], (), (1.0, 0.75, 0.7, 0.3, 0.6, 1.0)),
        ([BESIDE, FELL, FELL, BESIDE, BESIDE, BESIDE, CLOSE, FINE], (), (1.0, 0.75, 0.7, 0.3, 0.6, 0.7)),
        ([BESIDE, FELL, FELL, *[BESIDE] * 4, CLOSE], (), (1.0, 0.75, 0.7, 1.0, 1.0, 0.7)),
        ([BESIDE, STUCK, *[BESIDE] * 6], (), (1.0, 0.75, 0.7, 1.0, 1.0, 1.0)),
        ([BESIDE, CLOSE, *[FELL] * 5, FINE], (), (0.4, 0.75, 0.7, 1.0, 1.0, 0.7)),
        ([BESIDE, FELL, FELL, CLOSE, *[FELL] * 3, FINE], ("gait.step_length",), (1.0, 1.0, 1.0, 1.0, 1.0, 0.7)),
        ([BESIDE, FELL, BESIDE, *[FELL] * 3, FINE], ("servo.window",), (1.0, 0.75, 0.7, 1.0, 1.0, 0.7)),
        ([LATE, LATE, FINE], (), (1.0, 0.75, 0.7, 0.3, 1.0, 1.0)),
        ([*[LATE] * 4, FINE], (), (1.0, 0.75, 0.7, 1.0, 1.0, 0.7)),
        ([BESIDE, *[LATE] * 4], (), (1.0, 0.75, 0.7, 1.0, 1.0, 1.0)),
    ],
)
def test_the_best_of_the_dynamic_walks_is_written_and_no_value_given_by_the_user_is_changed(
    walks: list[Trial],
    given: tuple[str, ...],
    factors: tuple[float, ...],
    small: Adoption,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = load(small.folder / "dynamic.yaml")
    own = {key: attrgetter(key)(before) for key in given}
    shutil.copytree(small.folder, tmp_path / "robot")
    found, left = replace(small, folder=tmp_path / "robot"), iter(walks)
    monkeypatch.setattr(trial, "walk", lambda *_: next(left))
    assert [done.stood for done, _ in dynamic_walks(found, own, None)] == [one.stood for one in walks]
    after = load(tmp_path / "robot" / "dynamic.yaml")
    servo, old = after.servo, before.servo
    lag = float(servo.assumed[0].removeprefix("*=damping ")) / servo.damping
    short = after.gait.step_length / before.gait.step_length
    low = after.gait.step_height / before.gait.step_height
    late = after.dynamic.land_late / before.dynamic.land_late
    changed = [servo.window / old.window, lag, servo.assumed_lead / servo.damping, late, low, short]
    assert changed == pytest.approx(factors, rel=0.06)  # of numbers of two digits
    far = (after.gait.steps - after.dynamic.ramp) * after.gait.step_length
    assert 3.2 <= far < 3.4


@pytest.mark.parametrize("known", ["", "servo.stiffness", "servo.types"])
@pytest.mark.parametrize("stands", [True, False])
def test_a_stiffness_that_is_a_guess_may_be_larger_in_both_walks(
    known: str, stands: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A robot has one: a cure of the dynamic walk with which the standing walk falls is none."""
    given = {"": {}, "servo.stiffness": {known: 60.0}, "servo.types": {known: ["*=MX-28"]}}[known]
    found = adopt(SMALL, tmp_path / "robot", changes=given)
    slow = iter([FINE if stands else FELL])
    fast = iter([*[BESIDE] * 4, FINE])
    monkeypatch.setattr(trial, "walk", lambda c, *_: next(fast if c.gait.style == "dynamic" else slow))
    cures = [(done.plant, cure) for done, cure in dynamic_walks(found, given, {})]
    stiffer = [plant for plant, cure in cures if cure == "stiffer servos (8 m g h, servo.stiffness)"]
    assert stiffer == ([] if known else ["physics", "dynamic walk"] if stands else ["physics"])
    servos = [load(tmp_path / "robot" / file).servo for file in ("robot.yaml", "dynamic.yaml")]
    assert servos[0].stiffness == servos[1].stiffness
    for servo in servos:
        assert servo.stiffness == servo.assumed_stiffness or known
        assert (servo.stiffness == pytest.approx(8.0 * found.numbers.mgh, rel=0.01)) == (not known and stands)


def test_a_walk_that_waits_has_not_fallen() -> None:
    cause = Finding("joints follow late", "servo.latency")
    assert "it fell because: joints" in str(replace(FELL, causes=(cause,)))
    assert "fell because" not in str(replace(LATE, causes=(cause,)))


def test_a_robot_that_waits_in_its_first_steps_does_not_walk_on(
    small: Adoption, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(small.folder, tmp_path / "robot")
    hindered, steps = replace(small.numbers, hindrance="no ankle rolls"), list[int]()
    monkeypatch.setattr(trial, "walk", lambda config, *_: steps.append(config.gait.steps) or LATE)
    list(dynamic_walks(replace(small, folder=tmp_path / "robot", numbers=hindered), {}, {}))
    assert steps == [10, 10, 10, 10, 10]


def test_a_robot_whose_feet_do_not_reach_their_places_is_not_tried_in_the_standing_walk(
    small: Adoption, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trial, "walk", lambda *_: FELL)
    assert not list(first_walks(replace(small, numbers=replace(small.numbers, reach=0.0)), {}))


def test_heavy_legs_are_named_where_a_dynamic_walk_lands_beside_its_targets(
    small: Adoption, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(small.folder, tmp_path / "robot")
    monkeypatch.setattr(trial, "walk", lambda *_: BESIDE)
    monkeypatch.setattr(trial, "HEAVY_LEGS", 0.9 * small.numbers.legs)
    done, _ = next(dynamic_walks(replace(small, folder=tmp_path / "robot"), {}, {}))
    assert re.search(r"9 mm off; its legs are 4\d % of its mass", done.note)


@pytest.mark.parametrize(
    ("walks", "given", "plants", "factor"),
    [
        ([FINE, FINE], (), "integrator physics", 1.0),
        ([FELL, FINE, FINE], (), "integrator integrator physics", 0.1),
        ([FELL, FINE, FELL, FINE], (), "integrator integrator physics physics", 0.1),
        ([FELL, FELL], (), "integrator integrator", 1.0),
        ([FELL], ("task.posture_weight",), "integrator", 1.0),
    ],
)
def test_a_posture_that_holds_the_com_off_its_goal_in_kinematics_weighs_less(
    walks: list[Trial],
    given: tuple[str, ...],
    plants: str,
    factor: float,
    small: Adoption,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shutil.copytree(small.folder, tmp_path / "robot")
    found, left, walked = replace(small, folder=tmp_path / "robot"), iter(walks), list[str]()
    monkeypatch.setattr(trial, "walk", lambda _config, _model, plant, _progress: walked.append(plant) or next(left))
    own = {key: attrgetter(key)(small.config) for key in given}
    assert [done.stood for done, _ in first_walks(found, own)] == [one.stood for one in walks]
    assert walked == plants.split()
    for file in ("robot.yaml", "dynamic.yaml"):
        after = load(tmp_path / "robot" / file)
        assert after.task.posture_weight / small.config.task.posture_weight == pytest.approx(factor, rel=0.03)


def adopted(folder: str, **anatomy: object) -> SimpleNamespace:
    return SimpleNamespace(folder=Path(folder), anatomy=SimpleNamespace(lean=None, **anatomy))


def test_what_lets_a_trunk_lean_less_is_said_where_no_ankle_rolls(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Double supports that wait for the CoM name no cause."""
    monkeypatch.setattr(trial, "first_walks", lambda *_: [])
    monkeypatch.setattr(trial, "dynamic_walks", lambda *_: [(replace(LATE, plant="dynamic walk"), "")])
    found = adopted("robot", apart=0.181)
    found.anatomy.lean = object()
    assert _walk(found, {}, quiet=True) == 1
    assert "with ankles that roll, soles less than 181 mm apart, or more mass above" in capsys.readouterr().out


def test_commands_to_be_copied_name_a_folder_with_blanks_as_a_shell_reads_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(trial, "first_walks", lambda *_: [(FINE, "")])
    monkeypatch.setattr(trial, "dynamic_walks", lambda *_: [(replace(FELL, plant="dynamic walk"), "")])
    assert _walk(adopted("my robot"), {}, quiet=True) == 0
    assert "\ndqwalk simulate --config 'my robot/robot.yaml' --plant physics\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("standing", "dynamic", "code", "last"),
    [
        (FINE, FINE, 0, "adopted: the standing and the dynamic walk stand in physics"),
        (FINE, BESIDE, 0, "adopted: the standing and the dynamic walk stand in physics"),
        (FINE, FELL, 0, "adopted: the standing walk stands in physics, the dynamic walk falls"),
        (FINE, LATE, 0, "adopted: the standing walk stands in physics, the dynamic walk waits in its double supports"),
        (FELL, FINE, 0, "adopted: the standing walk falls, the dynamic walk stands in physics"),
        (EARLY, FINE, 0, "adopted: the standing walk ends early in kinematics, the dynamic walk stands in physics"),
        (FELL, BESIDE, 1, "adopted, but does not walk, .* the standing walk falls, the dynamic walk is not OK: "),
        (EARLY, FELL, 1, "adopted, but does not walk, .* the standing walk ends early .*, the dynamic walk falls: "),
    ],
)
def test_a_robot_is_adopted_whose_standing_or_dynamic_walk_walks(
    standing: Trial,
    dynamic: Trial,
    code: int,
    last: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(trial, "first_walks", lambda *_: [(standing, "")])
    monkeypatch.setattr(trial, "dynamic_walks", lambda *_: [(replace(dynamic, plant="dynamic walk"), "")])
    monkeypatch.setattr(trial, "climb", lambda *_: "climb: tried")
    assert _walk(adopted("robot"), {}, quiet=True) == code
    lines = capsys.readouterr().out.splitlines()
    assert re.match(last, lines[-1])
    assert lines[-1].endswith("is not OK") == (dynamic.stood and bool(dynamic.note) and not code)
    assert ("climb: tried" in lines) == (dynamic.stood and not dynamic.note)
    walks = (("robot.yaml", standing.stood), ("dynamic.yaml", dynamic.stood and not code))
    told = [line for line in lines if line.startswith("dqwalk simulate")]
    assert told == [f"dqwalk simulate --config robot/{file} --plant physics" for file, good in walks if good]


def test_values_given_by_the_user_are_in_both_walks_unless_they_concern_the_steps(tmp_path: Path) -> None:
    changes = {
        "servo.stiffness": 70.0,
        "gait.step_length": 0.02,
        "standing.swing_duration": 2.0,
        "servo.assumed_lead": 0.01,
    }
    adopt(SMALL, tmp_path, changes=changes)
    standing, dynamic = load(tmp_path / "robot.yaml"), load(tmp_path / "dynamic.yaml")
    assert standing.servo.stiffness == dynamic.servo.stiffness == 70.0
    assert standing.servo.assumed_lead == dynamic.servo.assumed_lead == 0.01
    assert standing.gait.step_length == 0.02
    assert standing.standing.swing_duration == 2.0
    assert dynamic.gait.step_length > 0.03
    assert dynamic.standing.swing_duration < 0.5


@pytest.mark.long
def test_the_standing_walk_catches_a_push_by_steps_of_the_dynamic_walk(small: Adoption) -> None:
    config = overlaid(small.config, "physics").updated({"qp.solver": "daqp"})
    push = Push("left", -0.5 * math.pi, 1.4)  # in mid-step, towards the swing foot
    assert pushed(config, push) == ""
    assert pushed(config.updated({"gait.recover": ""}), push)


def test_meshes_in_folders_with_special_characters_are_found(tmp_path: Path) -> None:
    """The adopted file refers to meshes by URI, in which a space and a plus sign are percent-encoded."""
    folder = tmp_path / "my robots+more"
    folder.mkdir()
    trimesh.creation.box((0.1265, 0.0825, 0.0132)).export(folder / "foot.stl")
    box, mesh = r'<box size="0.1265 0.0825 0.0132"/>', '<mesh filename="foot.stl"/>'
    found = adopt(edited(folder, SMALL, (box, mesh)), tmp_path / "out")
    assert "%20" in (found.folder / "robot.urdf").read_text()
    high = found.config.updated({"robot.left_sole_xyz": [0.0, 0.0, 0.035], "robot.right_sole_xyz": [0.0, 0.0, 0.035]})
    assert "reaches 35 mm below its sole" in str(check(high, load_model(high.robot))[0])
    assert not own_contacts(found.model, np.zeros((1, found.model.n)))
    (folder / "foot.stl").unlink()
    assert "no shape of the left foot can be read" in str(check(found.config, found.model)[0])


def test_a_configuration_is_replaced_with_force_only(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    armless = edited(tmp_path, SMALL, (r'(name="._(?:shoulder|elbow)" type=)"revolute"', r'\1"fixed"'))
    command = ["adopt", str(armless), "--out", str(out), "--yes", "--no-walk", "--quiet"]
    out.mkdir()
    (out / "robot.yaml").write_text("edited")
    assert cli.main(command) == 2
    error = capsys.readouterr().err
    assert "robot.yaml' exists" in error
    assert "--force" in error
    assert "reading the robot" not in error  # nothing was computed
    assert [file.name for file in out.iterdir()] == ["robot.yaml"]
    assert (out / "robot.yaml").read_text() == "edited"
    (out / "whole_body.yaml").write_text("of another robot")
    assert cli.main([*command, "--force"]) == 0
    assert load(out / "robot.yaml").robot.urdf
    assert not (out / "whole_body.yaml").exists()


def test_adopt_refuses_a_file_as_its_folder_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "out").write_text("")
    assert cli.main(["adopt", str(SMALL), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert "is a file, not a folder" in error
    assert "reading the robot" not in error


def test_a_missing_robot_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="cannot read"):
        adopt(tmp_path / "nowhere.urdf", tmp_path)


def test_a_trial_in_which_the_legs_meet_says_so() -> None:
    model = load_model(load("poppy").robot)
    standing, crossed, arm = (
        model.posture([*load("poppy").standing.posture, *more])
        for more in ([], ["?_hip_z=0.5", "l_hip_x=-0.3"], ["abs_z=0.3"])
    )
    said = legs_touching(model, np.array([standing, crossed] * 4))
    assert said.startswith("the legs meet (l_foot and r_foot in 50 % of the states)"), said
    assert not legs_touching(model, np.array([standing, arm]))
    straight = load_model(
        load("poppy").updated({"robot.lock": ["head_*", "?_shoulder_*", "?_arm_*", "?_elbow_*"]}).robot
    )
    aside = straight.posture([*load("poppy").standing.posture, "l_hip_x=0.3"])
    said = legs_touching(straight, np.array([standing, aside]))
    assert said.startswith("a leg meets another link (l_forearm and l_thigh in 50 % of the states)"), said
    assert "robot.lock" in said


def test_links_with_meshes_meet_by_their_convex_hulls(tmp_path: Path) -> None:
    """Also of a package, scaled, in a format that MuJoCo does not read; without the files nobody knows."""
    config, shape = load("poppy"), '<mesh filename="package://shapes/{}.ply" scale="0.001 0.001 0.001"/>'
    text = find_urdf(config.robot.urdf).read_text()
    (tmp_path / "shapes").mkdir()
    for number, size in enumerate(sizes := re.findall(r'<box size="([^"]*)"\s*/>', text)):
        box = trimesh.creation.box([1e3 * float(side) for side in size.split()])
        box.export(tmp_path / "shapes" / f"{number}.ply")
    numbers = itertools.count()
    text = re.sub(r'<box size="[^"]*"\s*/>', lambda _: shape.format(next(numbers)), text)
    assert next(numbers) == len(sizes) > 5
    (file := tmp_path / "poppy.urdf").write_text(text)
    model = load_model(config.robot)
    sole = {f"robot.sole_{side}": getattr(model.soles[Foot.LEFT], side) for side in ("length", "width")}
    meshed = load_model(config.updated({"robot.urdf": str(file), **sole}).robot)
    q = np.array([model.posture(config.standing.posture), *np.random.default_rng(1).uniform(-0.6, 0.6, (40, model.n))])
    expected = own_contacts(model, q)
    assert expected
    assert own_contacts(meshed, q, file) == expected
    shutil.rmtree(tmp_path / "shapes")
    assert "not available" in legs_touching(meshed, q, file)


def test_the_dynamic_walk_climbs_a_step_by_touch_or_there_is_no_file_for_it(
    small: Adoption, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = small.folder / "climb.yaml"
    assert re.fullmatch(r"climb: climbed a step of 3\d mm that it does not know", trial.climb(small))
    dynamic = load(small.folder / "dynamic.yaml")
    climbing = with_files(dynamic, [file])
    assert climbing.gait.climb == pytest.approx(0.11 * small.anatomy.leg, rel=0.02)
    assert climbing.standing.swing_duration > dynamic.standing.swing_duration
    entries = climb_parameters(small.numbers, dynamic)
    entries[0] = replace(entries[0], value=0.058)  # a fifth of the leg
    monkeypatch.setattr(trial, "climb_parameters", lambda *_: entries)
    assert not trial.climb(small).startswith("climb: climbed")
    assert not file.exists()


def test_the_table_of_robots_is_printed_also_when_it_is_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "b", "c", "d"):
        (tmp_path / f"{name}.urdf").touch()

    def row(path: Path, out: Path) -> list[str]:
        if path.stem == "b":
            raise ModelError("it has one leg")
        if path.stem == "c":
            raise KeyboardInterrupt
        return [path.stem, *11 * ["1"]]

    monkeypatch.setattr(robots_table, "row", row)
    monkeypatch.setattr("sys.argv", ["robots", str(tmp_path), "--out", str(tmp_path / "out")])
    assert robots_table.main() == 1
    shown = capsys.readouterr().out
    assert "interrupted: the 2 robots from c on are not in the table" in shown
    assert "| a " in shown
    assert "- `b.urdf`: it has one leg" in shown
