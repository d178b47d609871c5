"""Tests 1 and 2 as scenarios: how they are judged, drawn, and told on the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from dqwalk_ros import cli
from dqwalk_ros.analysis.figures.reaching import reactions, save_reaching
from dqwalk_ros.analysis.reaching import checks, render_checks, summary
from dqwalk_ros.config import load
from dqwalk_ros.controllers.whole_body import WholeBodyController
from dqwalk_ros.model import load_model
from dqwalk_ros.plants.rigid import RigidPlant
from dqwalk_ros.reach import SCENARIOS, Reaching, Scenario, follow


@cache
def walked() -> Reaching:
    config = load("whole_body")
    model = load_model(config.robot)
    controller = WholeBodyController(config, model)
    scenario = Scenario("Test 1", 1.0, ((0.0, (0.6, -0.4, 0.9)),), ((0.8, (0.0, 5.0, 0.0)),))
    return follow(controller, RigidPlant(model, controller.start, pushed="chest"), scenario)


def test_what_is_kept_is_said_to_be() -> None:
    found = {check.name: check for check in checks(walked())}
    assert all(check.ok for check in found.values())
    assert found["ticks that miss capturability (14)"].value == 0
    assert "NOT REACHED" not in render_checks(walked(), list(found.values()))


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"margins": "cop_margin"}, "least CoP to the edge of its rectangle"),
        ({"margins": "torque"}, "least torque to its limit"),
        ({"capturability": None}, "ticks that miss capturability (14)"),
        ({"violation": None}, "ticks whose level 1 gave way"),
        ({"note": "fell at 0.5 s"}, "stood for"),
    ],
)
def test_what_is_violated_is_said(change: dict, name: str) -> None:
    w = walked()
    (key, value), *_ = change.items()
    spoilt = np.where(np.arange(len(w.time)) == 50, 1e-3, 0.0)
    new = {
        "margins": lambda: w.margins | {value: w.margins[value] - 1.0},
        "note": lambda: value,
        "capturability": lambda: spoilt,
        "violation": lambda: spoilt,
    }[key]()
    bad = replace(w, **{key: new})
    found = checks(bad)
    assert [check.name for check in found if not check.ok] == [name]
    assert "NOT REACHED" in render_checks(bad, found)
    assert not summary(bad, found)["ok"]


def test_the_hand_is_judged_by_the_papers_figures() -> None:
    """A walk made up of numbers: 0.12 m off at 4 s, 5 mm over the last three."""
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
        capturability=np.zeros(n),
        violation=np.zeros(n),
        **many,
    )
    found = {check.name: check for check in checks(bad)}
    assert found["hand from target at 4 s"].value == pytest.approx(0.12)
    assert not found["hand from target at 4 s"].ok
    assert found["the same, rms of the last 3 s"].value == pytest.approx(0.005)
    assert found["the same, rms of the last 3 s"].ok


def test_a_push_is_judged_by_the_step_after_it() -> None:
    w = walked()
    other = replace(w, support=w.support.copy())
    moved = replace(w, scenario=replace(w.scenario, pushes=((0.2, (0.0, 5.0, 0.0)),)), support=w.support.copy())
    late = moved.time >= 0.3
    moved.support[late] += [0.0, 0.08]
    found = {check.name: check for check in checks(moved, [other])}
    assert found["footstep moved by the push at 0.2 s"].value == pytest.approx(0.08)


def test_figures(tmp_path: Path) -> None:
    files = save_reaching([walked(), walked()], tmp_path, ("png", "svg"))
    assert {file.name for file in files} >= {"figure2.png", "figure3.svg", "figure4.png", "figure5.png"}
    assert all(file.stat().st_size > 10_000 for file in files)
    lines = reactions(walked()).axes[0].get_lines()
    hand = next(line for line in lines if line.get_label() == "hand [m]")
    assert hand.get_ydata()[-1] == pytest.approx(walked().hand[-1, 0])


def test_the_papers_pushes_and_jumps_are_what_it_says() -> None:
    assert [push for _, push in SCENARIOS["2"].pushes] == [(0.0, 15.0, 0.0), (-15.0, 0.0, 0.0)]
    assert [when for when, _ in SCENARIOS["2"].pushes] == [2.5, 7.0]
    assert SCENARIOS["1"].pushes == ()


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
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
    assert cli.main(["reach", "--target", "0.5", "--out", str(out), "--force"]) == 2
    assert "--target X,Y,Z wants 3 numbers" in capsys.readouterr().err
