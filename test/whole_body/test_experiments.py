"""Tests 1 and 2 as scenarios: requirements, figures, bags and command line."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from functools import cache
from pathlib import Path

import acceptance
import numpy as np
import pytest
from exactness import Answers

from dqwalk_ros import cli
from dqwalk_ros.config import load
from dqwalk_ros.report import bag
from dqwalk_ros.report.figures.studies import pushes_figure
from dqwalk_ros.studies.pushes import Limit
from dqwalk_ros.support.errors import BagError
from dqwalk_ros.whole_body import (
    SCENARIOS,
    BodyLog,
    Scenario,
    WholeBodyController,
    WholeBodyTrace,
    retrace,
    torso_pushes,
)
from dqwalk_ros.whole_body.bag import read_body, write_body
from dqwalk_ros.whole_body.demands import checks, render_checks, summary
from dqwalk_ros.whole_body.experiments import walk
from dqwalk_ros.whole_body.figures import reactions, walk_from_above
from dqwalk_ros.whole_body.scenario import fitted


@cache
def walked() -> WholeBodyTrace:
    targets = ((0.0, (0.6, -0.4, 0.9)), (0.7, (0.6, -0.2, 0.9)))  # the second jump is in mid-swing
    return walk(load("whole_body"), Scenario("Test 1", 1.0, targets, ((0.8, (0.0, 5.0, 0.0)),)))


def test_satisfied_requirements_are_reported() -> None:
    found = {check.name: check for check in checks(walked())}
    assert all(check.ok for check in found.values())
    assert found["ticks that miss capturability (S14)"].value == 0
    assert "NOT REACHED" not in render_checks(walked(), list(found.values()))


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"margins": "cop_margin"}, "least CoP to the edge of its rectangle"),
        ({"margins": "torque"}, "least torque to its limit"),
        ({"residual": None}, "ticks that miss capturability (S14)"),
        ({"violation": None}, "ticks in which level 1 was violated"),
        ({"note": "fell at 0.5 s"}, "stood for"),
    ],
)
def test_violated_requirements_are_reported(change: dict, name: str) -> None:
    w = walked()
    (key, value), *_ = change.items()
    spoilt = np.where(np.arange(len(w.time)) == 50, 1e-3, 0.0)
    new = {
        "margins": lambda: w.margins | {value: w.margins[value] - 1.0},
        "note": lambda: value,
        "residual": lambda: spoilt,
        "violation": lambda: spoilt,
    }[key]()
    bad = replace(w, **{key: new})
    found = checks(bad)
    assert [check.name for check in found if not check.ok] == [name]
    assert "NOT REACHED" in render_checks(bad, found)
    assert not summary(bad, found)["ok"]


def test_the_hand_is_checked_at_4_s_and_over_the_last_3_s() -> None:
    """A synthetic walk: the hand is 0.12 m from the target at 4 s, and 5 mm over the last 3 s."""
    w = walked()
    time = np.arange(0.0, 14.0, 0.005)
    n = len(time)
    names = ("com", "com_velocity", "support", "landing", "single", "height_error", "tilt", "times", "iterations")
    many = {name: np.resize(getattr(w, name), (n, *getattr(w, name).shape[1:])) for name in names}
    hand, target = np.zeros((n, 3)), np.zeros((n, 3))
    hand[:, 0] = np.where(time < 5.0, 0.12, 0.005)
    bad = replace(
        w,
        scenario=Scenario("Test 1", 14.0),
        time=time,
        hand=hand,
        target=target,
        residual=np.zeros(n),
        violation=np.zeros(n),
        **many,
    )
    found = {check.name: check for check in checks(bad)}
    assert found["hand from target at 4 s"].value == pytest.approx(0.12)
    assert not found["hand from target at 4 s"].ok
    assert found["hand from target, rms of the last 3 s"].value == pytest.approx(0.005)
    assert found["hand from target, rms of the last 3 s"].ok


def test_a_push_is_evaluated_by_the_next_footstep() -> None:
    w = walked()
    other = replace(w, support=w.support.copy())
    moved = replace(w, scenario=replace(w.scenario, pushes=((0.2, (0.0, 5.0, 0.0)),)), support=w.support.copy())
    late = moved.time >= 0.3
    moved.support[late] += [0.0, 0.08]
    found = {check.name: check for check in checks(moved, [other])}
    assert found["footstep moved by the push at 0.2 s"].value == pytest.approx(0.08)


def test_figures() -> None:
    """One panel per walk from above, steps and CoM in each; the hand of the walk over time."""
    panels = walk_from_above([walked(), walked()]).axes
    assert len(panels) == 2
    steps = len(walked().footholds())
    assert all(len(panel.patches) >= steps for panel in panels)
    lines = reactions(walked()).axes[0].get_lines()
    hand = next(line for line in lines if line.get_label() == "hand [m]")
    assert hand.get_ydata()[-1] == pytest.approx(walked().hand[-1, 0])


def test_the_scenarios_have_the_pushes_of_the_paper() -> None:
    assert [push for _, push in SCENARIOS["2"].pushes] == [(0.0, 15.0, 0.0), (-15.0, 0.0, 0.0)]
    assert [when for when, _ in SCENARIOS["2"].pushes] == [2.5, 7.0]
    assert SCENARIOS["1"].pushes == ()


def test_scenarios_are_scaled_to_the_robot() -> None:
    """Half the height and an eighth of the mass: half the distances, and half the motion of the capture point."""
    controller = WholeBodyController(load("whole_body"), walked().model)
    assert fitted(SCENARIOS["2"], controller) is SCENARIOS["2"]
    h, weight = controller.point_mass.height, controller.weight
    controller.point_mass = replace(controller.point_mass, height=0.5 * h)
    controller.weight = weight / 8.0
    small = fitted(SCENARIOS["2"], controller)
    assert small.size == pytest.approx(0.5, rel=0.01)
    for (t, place), (t0, place0) in zip(small.targets, SCENARIOS["2"].targets, strict=True):
        assert t == pytest.approx(t0)
        assert place == pytest.approx(small.size * np.array(place0))
    # the capture point moves by J/(m omega), which must scale with the height
    moved = [
        np.linalg.norm(s.pushes[0][1]) / (m * np.sqrt(9.81 / z))
        for s, m, z in ((small, weight / 8.0, 0.5 * h), (SCENARIOS["2"], weight, h))
    ]
    assert moved[0] / moved[1] == pytest.approx(0.5, rel=0.02)


def test_the_command_reach(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "reach"
    arguments = ["reach", "--test", "1", "--duration", "0.5", "--target", "0.5,-0.4,0.9", "--no-figures"]
    assert cli.main([*arguments, "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert "your target" in said.out
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert report[0]["ticks"] == 100
    assert report[0]["ok"]
    assert cli.main([*arguments, "--out", str(out)]) == 1
    assert "--force" in capsys.readouterr().err
    short = ["reach", "--test", "1", "--duration", "0.001", "--out", str(out), "--force", "--quiet"]
    assert cli.main(short) == 1
    assert "ended before its first tick: it is shorter than one" in capsys.readouterr().err
    assert cli.main(["reach", "--target", "0.5", "--out", str(out), "--force"]) == 2
    assert "3 numbers separated by commas" in capsys.readouterr().err
    assert cli.main(["reach", "--set", "whole_body.hand=nothing", "--out", str(tmp_path / "new")]) == 2
    assert not (tmp_path / "new").exists()


# ---------------------------------------------------------------------- requirements


def test_a_jump_in_mid_swing_moves_the_next_footstep_at_once() -> None:
    (jump,) = walked().reactions
    assert jump.time == pytest.approx(0.7)
    assert jump.swinging
    assert jump.moved[0] > 1e-3
    assert not jump.held

    def judged(moved: tuple[float, float], held: bool) -> bool:
        one = replace(walked(), reactions=(replace(jump, moved=moved, held=held),), scenario=SCENARIOS["1"])
        (check,) = [check for check in checks(one) if "in the tick of the jump" in check.name]
        return check.ok

    assert judged(jump.moved, held=False)
    assert not judged((0.0, 0.1), held=False)
    assert judged((0.0, 0.1), held=True)  # in the corner of its region
    assert not judged((0.0, 0.0), held=True)


def test_all_requirements_on_the_equations_are_met() -> None:
    rows = acceptance.unit_demands(load("whole_body"))
    assert len(rows) == 7
    assert all(row.ok and row.must for row in rows), acceptance.render(rows)


def test_every_requirement_is_evaluated() -> None:
    """Short walks and wrong solutions: the failed requirements are reported."""
    w = walked()
    names = acceptance.walks()
    short = {name: replace(w, scenario=one) for name, (one, _) in names.items()}
    short |= {name: replace(short[name], note="fell at 0.9 s") for name in names if "level 2" in name}
    good = acceptance.judge(short, Answers(ticks=10, sampled=1))
    by_name = {row.name: row for row in good}
    assert by_name["without level 2, in place"].ok
    assert by_name["15 N s, N = 8"].ok
    assert not by_name["footstep moved by the push at 2.5 s"].ok  # there was no such push
    bad = acceptance.judge(
        short | {"15 N s, N = 8": replace(w, note="fell at 0.9 s")}, Answers(ticks=10, sampled=1, acceleration=2e-3)
    )
    wrong = {row.name for row in bad if not row.ok} - {row.name for row in good if not row.ok}
    assert wrong == {"15 N s, N = 8", "v' and Clarabel's, 1 ticks, differ by [rad/s^2]"}
    text = acceptance.render(bad)
    assert "NOT OK" in text
    assert f"of {sum(row.must for row in bad)} requirements met" in text


@pytest.mark.long
def test_all_mandatory_requirements_are_met(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["acceptance", "--out", str(tmp_path)])
    code = acceptance.main()
    demands = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))["demands"]
    must = [row for row in demands if row["must"]]
    assert len(must) == 56
    missed = [row for row in must if not row["ok"]]
    assert code == bool(missed)
    assert [row for row in missed if not row["topic"].startswith("CPU time")] == []  # those depend on the machine too
    assert {file.name for file in tmp_path.iterdir()} >= {"bag_1", "bag_2", "figure2.png", "figure5.png"}


# ---------------------------------------------------------------------- pushes


def test_the_largest_push_is_found_by_bisection(monkeypatch: pytest.MonkeyPatch) -> None:
    hits = []

    def falling(config, scenario, plant):  # falls from 21.3 N s on
        ((when, impulse),) = scenario.pushes
        hits.append((when, *impulse))
        return replace(walked(), note="" if np.linalg.norm(impulse) < 21.3 else "fell at 3 s")

    monkeypatch.setattr(torso_pushes, "walk", falling)
    point = {"moment": "physics", "direction": np.radians(135.0)}
    found = torso_pushes.limit(load("whole_body"), 1.5, 1.0, 0, point)
    assert (found.survived, found.failed, found.reason) == (21.0, 22.0, "fell at 3 s")
    tried = [float(np.linalg.norm(hit[1:])) for hit in hits]
    assert tried == pytest.approx([8.0, 16.0, 32.0, 24.0, 20.0, 22.0, 21.0])
    assert hits[0] == pytest.approx((1.5, -8.0 / np.sqrt(2), 8.0 / np.sqrt(2), 0.0))


@pytest.mark.long
def test_the_command_reach_with_pushes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["reach", "--pushes", "--tolerance", "8", "--when", "1.7", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "the left foot stands" in said
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))["rigid"]
    assert len(report) == 8
    assert max(one["stood"] for one in report) >= 16.0
    assert (tmp_path / "pushes.png").exists()


def test_the_figure_of_push_limits() -> None:
    limits = [Limit("physics", 0.25 * np.pi * k, 10.0 + k, 11.0 + k, "fell") for k in range(8)]
    figure = pushes_figure({"physics": limits, "rigid": limits}, "hit")
    lines = figure.axes[0].get_lines()
    assert [line.get_label() for line in lines] == ["physics", "rigid"]
    assert lines[0].get_ydata() == pytest.approx([*range(10, 18), 10])


# ---------------------------------------------------------------------- bags


def test_a_bag_reproduces_the_walk(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Measured values are read back bit for bit; recomputed torques agree to 1e-4."""
    w = walked()
    write_body(w, tmp_path / "bag")
    log = read_body(tmp_path / "bag")
    assert bag.is_body(tmp_path / "bag")
    assert log.notes == ()
    assert log.scenario.targets == w.scenario.targets
    assert log.scenario.pushes == w.scenario.pushes
    assert log.config == w.config
    assert log.q.tobytes() == w.q.tobytes()
    assert log.effort.tobytes() == w.effort.tobytes()
    again, off = retrace(log)
    assert off < 1e-4
    assert again.note == ""
    assert again.landing == pytest.approx(w.landing, abs=1e-6)
    assert again.margins["cop_margin"] == pytest.approx(w.margins["cop_margin"], abs=1e-6)
    assert [jump.time for jump in again.reactions] == pytest.approx([0.7])
    with pytest.raises(BagError, match="exists already"):
        write_body(w, tmp_path / "bag")

    words = ["report", str(tmp_path / "bag"), "--html", "--out", str(tmp_path / "out"), "--no-figures"]
    assert cli.main(words) == 0
    said = capsys.readouterr().out
    assert "recorded and recomputed torques differ by at most" in said
    names = {file.name for file in (tmp_path / "out").iterdir()}
    assert names == {"report.html", "report.json"}
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "hrp2_like" in page
    assert "every requirement met" in page
    assert page.count("data:image/svg+xml") == 3


def test_a_test_whose_last_states_are_missing_is_evaluated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is that test as long as it was recorded."""
    w = walked()
    monkeypatch.setitem(SCENARIOS, "short", w.scenario)
    kept = {one.name: getattr(w, one.name) for one in fields(BodyLog)}
    kept |= {name: value[:-3] for name, value in kept.items() if isinstance(value, np.ndarray)}
    write_body(BodyLog(**kept), tmp_path / "bag")
    log = read_body(tmp_path / "bag")
    assert log.scenario == replace(w.scenario, duration=pytest.approx(w.time[-3]))
    again, _ = retrace(log)
    assert again.stood
    assert len(again) == len(log) == len(w) - 3


def test_recorded_values_are_evaluated_instead_of_recomputed_ones(tmp_path: Path) -> None:
    """Recorded torques beyond the limits and a pulling contact force are reported."""
    w = walked()
    wrong = replace(w, effort=w.effort.copy(), wrenches=w.wrenches.copy())
    wrong.effort[50] *= 10.0
    wrong.wrenches[50, :, 2] *= -1.0
    write_body(wrong, tmp_path / "bag")
    again, off = retrace(read_body(tmp_path / "bag"))
    assert off > 10.0
    broken = {check.name for check in checks(again) if not check.ok}
    assert {"least torque to its limit", "least force that presses on the ground"} <= broken
