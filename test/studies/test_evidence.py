"""The table of evidence: which walks it simulates, and what it says of them."""

from __future__ import annotations

import math
import re
import signal
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from dqwalk_ros import cli
from dqwalk_ros.cli.evidence import table
from dqwalk_ros.config import Config, load, to_yaml
from dqwalk_ros.plants import mujoco
from dqwalk_ros.plants.base import Plant
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.robot.model import RobotModel, load_model
from dqwalk_ros.studies import evidence, robustness
from dqwalk_ros.studies.evidence import Row, WalkOutcome, bounds, points, read
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.walks.course import Course, speeds
from dqwalk_ros.walks.table import make_controller

ROOT = Path(__file__).resolve().parents[2]


def test_the_shipped_rows_are_valid_and_each_is_walked_in_every_engine() -> None:
    rows = read("evidence")
    every = points(rows, ("physics", "drake"))
    assert len(every) == 2 * sum(64 if row.push and not row.anywhere else row.seeds for row in rows.values())
    assert len(points(read("arms"), ["physics"])) == 160
    assert len(points(read("obstacles"), ["physics"])) == 1005
    assert len(points(read("as_built"), ["physics"])) == 624
    sample = points(rows, ("physics", "drake"), 2)
    kept = {
        engine: [{**one, "engine": ""} for one in sample if one["engine"] == engine] for engine in ("physics", "drake")
    }
    assert kept["physics"] == kept["drake"]  # the same seeds and pushes
    assert all(one in every for one in sample)


def test_another_robot_walks_the_rows_on_ground_in_proportion_to_its_legs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here a Poppy of half the size, whose servos have no types."""
    text = (ROOT / "urdf" / "poppy.urdf").read_text(encoding="utf-8")
    halved = re.sub(r'(?<=xyz=")[^"]+', lambda m: " ".join(str(0.5 * float(x)) for x in m[0].split()), text)
    (tmp_path / "half.urdf").write_text(halved, encoding="utf-8")
    config = load("poppy_dynamic").updated({"robot.urdf": str(tmp_path / "half.urdf")})
    (tmp_path / "half.yaml").write_text(to_yaml(config), encoding="utf-8")
    given: dict[str, Row] = {}
    monkeypatch.setattr(evidence, "collect", lambda rows, *_, **__: given.update(rows) or [])
    monkeypatch.setattr(evidence, "ceilings", lambda rows: {})
    asked = ["ground", "--config", str(tmp_path / "half.yaml"), "--out", str(tmp_path / "out")]
    assert cli.main(["evidence", *asked]) == 0
    made = {name: row.made() for name, row in given.items()}
    own = {name: row.made() for name, row in read("ground").items()}
    for key in ("rubble", "rise"):
        heights = [getattr(one.physics, key) for one in own.values()]
        assert [getattr(one.physics, key) for one in made.values()] == pytest.approx(0.5 * np.array(heights))
        assert any(heights)
    assert {one.robot.urdf for one in made.values()} == {str(tmp_path / "half.urdf")}
    assert [one.physics.slope for one in made.values()] == [one.physics.slope for one in own.values()]
    assert not any(one.servo.types for one in made.values())
    assert {one.standing.swing_duration for one in made.values()} == {config.standing.swing_duration}  # not "rough"


def test_the_hands_get_a_new_random_pose_after_every_interval() -> None:
    row = read("arms")["random poses"]
    config = row.made()
    model = load_model(config.robot)
    poses = []
    for seed in (1, 1, 2):
        controller = make_controller(config, model)
        order, hands = evidence._reaching(controller, 2.0, seed), controller.walk.arms.hands
        for time in (0.0, 1.9, 2.0):
            order(time)
            poses.append([hand.pose.translation() for hand in hands.values()])
    first, same, new, *rest = np.array(poses)
    assert (first == same).all()
    assert (first != new).all()
    assert (np.array(rest[:3]) == poses[:3]).all()  # the seed decides
    assert (rest[3] != first).all()
    with pytest.raises(ConfigError, match="hands need free arms"):
        Row("locked", "poppy_dynamic", hands=2.0).made()


@pytest.mark.parametrize(("count", "total"), [(0, 20), (3, 20), (20, 20), (36, 40)])
def test_the_bounds_are_those_at_which_the_count_has_a_chance_of_one_in_forty(count: int, total: int) -> None:
    def at_least(chance: float) -> float:
        return sum(math.comb(total, k) * chance**k * (1.0 - chance) ** (total - k) for k in range(count, total + 1))

    low, high = bounds(count, total)
    if count:
        assert at_least(low) == pytest.approx(0.025, abs=1e-6)
    else:
        assert low == 0.0
    if count < total:
        assert 1.0 - at_least(high) + math.comb(total, count) * high**count * (1.0 - high) ** (total - count) == (
            pytest.approx(0.025, abs=1e-6)
        )
    else:
        assert high == 1.0


def test_each_engine_has_a_table_with_a_line_per_row_and_the_proved_chance() -> None:
    done = [
        ({"row": "walk", "engine": "drake", "seed": k}, WalkOutcome(True, "", True, 0.01, 0.002, 0.99, 0.1, k))
        for k in range(19)
    ]
    done.append(({"row": "walk", "engine": "drake", "seed": 19}, WalkOutcome(False, "fell at 3.2 s")))
    done += [({"row": "pushes", "engine": "drake", "foot": "left"}, WalkOutcome(True))]
    text = table(done, {"walk": "0.35 m/s"})
    walk = next(line for line in text.splitlines() if line.lstrip().startswith("walk"))
    assert "19/20 (75 %)" in walk
    assert walk.split()[-7:] == ["0.57", "2.00", "99.00", "0.100", "0.35", "m/s", "18"]
    assert "1/1 (3 %)" in text
    assert text.startswith("drake:\n")
    assert "1 x walk, drake: fell" in text


def test_an_interrupted_walk_is_no_outcome(monkeypatch: pytest.MonkeyPatch) -> None:
    name, row = next((name, row) for name, row in read("evidence").items() if not row.push)

    def plant(name: str, config: Config, model: RobotModel) -> Plant:
        made = make_plant(name, config, model)
        monkeypatch.setattr(made, "step", lambda *_: signal.raise_signal(signal.SIGINT))
        return made

    monkeypatch.setattr(evidence, "make_plant", plant)
    with pytest.raises(KeyboardInterrupt):
        evidence._evaluate({name: row}, {name: row.made()}, 0, {"row": name, "engine": "physics", "seed": 1})


def test_an_unknown_set_and_an_unknown_file_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "rows.yaml"
    file.write_text("rows: [{name: a, config: poppy, use: [nosie]}]\nsets: {noise: {}}\n")
    with pytest.raises(ConfigError, match="'a' uses nosie; the sets are noise"):
        read(str(file))
    file.write_text("rows: [{name: a, config: poppy, cmd_vel: ['0.01,0,0,5'], set: {gait.steps: 4}}]\n")
    with pytest.raises(ConfigError, match="a: cmd_vel and course steer a standing or dynamic walk"):
        read(str(file))
    for rows, message in (
        ("{name: a, config: poppy}, {name: a, config: paper}", "two rows have the name 'a'"),
        ('{name: "a\\e[2J", config: poppy}', "name"),
        ("{name: '', config: poppy}", "name"),
        ("{name: a, config: poppy, push: .inf}", "push"),
        ("{name: a, config: poppy, set: {gait.steps: 0}}", "the walk has no end"),
    ):
        file.write_text(f"rows: [{rows}]\n")
        with pytest.raises(ConfigError, match=message):
            read(str(file))
    assert cli.main(["evidence", str(tmp_path / "none.yaml")]) == 2
    assert "none.yaml" in capsys.readouterr().err


def test_a_push_anywhere_is_that_of_its_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[evidence.Push] = []
    monkeypatch.setattr(evidence, "pushed", lambda config, push: given.append(push) or "fell")
    rows = {name: row for name, row in read("evidence").items() if row.anywhere}
    configs = {name: row.made() for name, row in rows.items()}
    every = points(rows, ["physics"])
    assert len(every) == 100
    for point in every[:5]:
        assert not evidence._evaluate(rows, configs, 0, point).stood
    model = load_model(next(iter(configs.values())).robot)
    assert given == [evidence.Push.anywhere(0.3, model, point["seed"]) for point in every[:5]]


def test_rows_are_chosen_by_their_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given: list[str] = []
    monkeypatch.setattr(evidence, "collect", lambda rows, *_, **__: given.extend(rows) or [])
    monkeypatch.setattr(evidence, "ceilings", lambda rows: {})
    rows = ["--row", "pushes*at*", "--row", "dynamic walk"]
    assert cli.main(["evidence", *rows, "--out", str(tmp_path)]) == 0
    assert given == ["dynamic walk", "pushes of 0.30 N s at 0.30 m/s"]
    assert cli.main(["evidence", "--row", "standing", "--out", str(tmp_path)]) == 2
    assert "--row standing: the rows are " in capsys.readouterr().err


def test_a_row_with_cmd_vel_is_steered_and_ends_after_its_course(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shapes that MuJoCo cannot read do not spoil the walk."""
    mesh = '<collision><geometry><mesh filename="none.stl"/></geometry></collision></link>'

    def unreadable(model: RobotModel, q: np.ndarray, near: Path) -> Counter[str]:
        return own_contacts(replace(model, urdf=model.urdf.replace("</link>", mesh)), q, near)

    own_contacts = mujoco.own_contacts
    monkeypatch.setattr(mujoco, "own_contacts", unreadable)
    row = evidence.Row("a", "poppy_dynamic", cmd_vel=["0.05,0,0,3"], set={"qp.solver": "daqp"})
    outcome = evidence._evaluate({"a": row}, {"a": row.made()}, 0, {"row": "a", "engine": "physics", "seed": 1})
    assert outcome.ok, outcome.reason
    assert outcome.speed is not None
    assert 0.005 < outcome.speed < 0.05
    assert outcome.touching is None


def test_a_random_course_is_that_of_its_seed_with_a_push_in_each_leg() -> None:
    row = read("arms")["random courses"]
    config = row.made()
    model = load_model(config.robot)
    most = speeds(make_controller(config, model).walk)
    course = Course.random(row.course, most, 7)
    assert course == Course.random(row.course, most, 7) != Course.random(row.course, most, 8)
    assert row.course <= course.duration < row.course + 4.0
    asked = np.array([(leg.forward, leg.left, leg.turn) for leg in course.legs])
    assert (np.abs(asked) <= 1.5 * np.array(most)).all()
    given: list[tuple[np.ndarray, str]] = []
    plant = SimpleNamespace(push=lambda force, link: given.append((force, link)))
    order = evidence._pushing(plant, course, 0.2, model, config.dt, 7)
    for time in np.arange(0.0, course.duration, config.dt):
        order(time)
    impulse = config.dt * np.linalg.norm([force for force, _ in given], axis=1).sum()
    assert impulse == pytest.approx(0.2 * len(course.legs), rel=0.02)  # the last push may end after the course
    with pytest.raises(ConfigError, match="either cmd_vel or a random course"):
        Row("both", "poppy_dynamic", course=20.0, cmd_vel=["0.1,0,0,5"]).made()
    steps = Row("steps", "poppy_dynamic", course=20.0, set={"gait.steps": 4})
    with pytest.raises(ConfigError, match="cmd_vel and course steer"):
        steps.made()


@pytest.mark.long
def test_a_sample_is_walked_in_both_engines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pydrake", reason="there is no wheel of Drake for this machine")
    assert cli.main(["evidence", "--sample", "1", "--jobs", "2", "--out", str(tmp_path)]) == 0
    print(capsys.readouterr().out)


@pytest.mark.long
def test_a_walk_that_is_stopped_by_a_step_does_not_count_as_stood() -> None:
    row = Row("a step", "poppy_dynamic", set={"physics.rise": 0.06, "gait.steps": 20})
    found = evidence._evaluate({"": row}, {"": row.made()}, 0, {"row": "", "engine": "physics", "seed": 1})
    assert not found.stood
    assert found.reason.startswith("the robot was stopped: its soles moved 0.2")
    cell = robustness.walk(row.made(), 0, {})
    assert not cell.stood
    assert cell.reason.startswith("the robot was stopped: its soles moved 0.2")
