"""Walks in physics that fall, each for one known cause, which the report must name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs the extra sim")

from dqwalk_ros import cli
from dqwalk_ros.adopt.trial import cures
from dqwalk_ros.config import Config, load, overlaid
from dqwalk_ros.plants.base import orientation_of, upward
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.report import analyse, report
from dqwalk_ros.report.causes import causes
from dqwalk_ros.report.html import page
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.robot.standing_limits import Finding, longest_delay
from dqwalk_ros.simulation import simulate
from dqwalk_ros.trace import Trace
from dqwalk_ros.walks.table import make_controller

CONFIG = overlaid(load("poppy"), "physics").updated({"gait.steps": 4, "gait.recover": ""})
MODEL = load_model(CONFIG.robot)


def walk(changes: dict[str, Any], push: float = 0.0, of: Config = CONFIG) -> Trace:
    config = of.updated(changes)
    plant = make_plant("physics", config, MODEL)

    def before_step(time: float) -> None:
        plant.push([0.0, push if 1.0 <= time < 1.1 else 0.0, 0.0])

    return simulate(make_controller(config, MODEL), plant, before_step=before_step if push else None)


WEAK, PATH = "servo.torque_scale", "standing.transfer_duration"
UNDAMPED = {"servo.damping": 0.0, "servo.assumed_damping": 0.0}
TOLD = {"servo.latency": 0.12, "servo.assumed_latency": 0.12}
FALLS: dict[str, tuple[dict[str, Any], str, str, str]] = {
    "soft servos": ({"servo.stiffness": 15.0}, "stiffness", "15 N m/rad (assumed: 60) is 1.3 m g h", "servo.stiffness"),
    "no damping": (UNDAMPED, "damping", "ratio of a swinging leg is 0.00", "servo.damping"),
    "weak servos": ({WEAK: 0.2}, "torque", "_knee_y' was at its limit of 0.62 N m", WEAK),
    "latency": ({"servo.latency": 0.12}, "latency", "follow their commands 125 ms late", "servo.latency"),
    "latency that is told": (TOLD, "latency", "servo.assumed_latency is 120 ms", "servo.latency"),
    "a path too fast": ({PATH: 0.5}, "pressure", "centre of pressure beyond the soles", PATH),
}


LONG = ("soft servos", "no damping", "latency that is told")


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.long) if n in LONG else n for n in FALLS])
def test_the_cause_of_a_fall_is_reported(name: str) -> None:
    changes, what, text, parameter = FALLS[name]
    trace = walk(changes)
    assert not trace.finished
    first = causes(analyse(trace))[0]
    assert (first.what, first.parameter.split(",")[0]) == (what, parameter)
    assert text in first.message


OTHERS: dict[str, tuple[str, str, dict[str, Any], str]] = {
    "as built, late": ("poppy", "poppy_as_built", {"gait.steps": 3, "servo.latency": 0.15}, "latency"),
    "as built, too fast": ("poppy", "poppy_as_built", {"gait.steps": 3, PATH: 0.6}, "pressure"),
    "dynamic, late": ("poppy_dynamic", "physics", {"servo.latency": 0.1}, "latency"),
    "dynamic, weak": ("poppy_dynamic", "physics", {WEAK: 0.25}, "torque"),
}


@pytest.mark.long
@pytest.mark.parametrize("name", OTHERS)
def test_causes_with_noisy_sensors_and_in_the_dynamic_walk(name: str) -> None:
    config, plant, changes, what = OTHERS[name]
    trace = walk(changes, of=overlaid(load(config), plant))
    assert not trace.finished
    assert causes(analyse(trace))[0].what == what


def test_an_unexplained_fall_has_an_unknown_cause() -> None:
    """A push is not recorded; the report gives the time at which the fall became inevitable."""
    trace = walk({}, push=60.0)
    assert not trace.finished
    (only,) = causes(analyse(trace))
    assert only.what == "unknown"
    assert 1.0 < only.time < 1.5
    assert "a push" in only.message


@pytest.mark.long
def test_a_walk_without_a_fall_has_no_cause() -> None:
    """Even with soft or late servos."""
    for changes in ({"servo.stiffness": 25.0, "servo.assumed_stiffness": 25.0}, {"servo.latency": 0.05}):
        trace = walk({**changes, "gait.steps": 1})
        assert trace.finished
        assert causes(analyse(trace)) == []


EXPECTED = "it fell because: the path of the CoM requires a centre of pressure beyond the soles"


def test_the_cause_is_printed_and_in_the_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "walk"
    options = ["--config", "poppy", "--plant", "physics", "--set", "standing.transfer_duration=0.5", "--no-figures"]
    assert cli.main(["simulate", *options, "--out", str(out)]) == 1
    output = capsys.readouterr()
    assert EXPECTED in output.out
    assert EXPECTED in output.err
    assert "(standing.transfer_duration)" in output.out
    assert cli.main(["report", str(out / "bag"), "--no-figures", "--json"]) == 1  # read from the bag
    (cause,) = json.loads(capsys.readouterr().out)["causes"]
    assert cause["what"] == "pressure"
    assert cause["parameter"] == "standing.transfer_duration"


@pytest.mark.long
def test_the_cause_is_in_the_html_report(tmp_path: Path) -> None:
    series = analyse(walk({"standing.transfer_duration": 0.5}))
    page.write([page.Subject("walk", series, report(series), [], [])], tmp_path / "report.html")
    assert EXPECTED in (tmp_path / "report.html").read_text()


def test_the_longest_delay_is_the_stability_bound() -> None:
    """Delayed feedback of the divergent component, integrated: it is stable below the bound and unstable above."""
    for gain, height in ((0.5, 0.4), (1.0, 0.8), (2.0, 0.3)):
        w, bound = np.sqrt(9.80665 / height), longest_delay(gain, height)
        for part, stable in ((0.9, True), (1.1, False)):
            dt, lag = bound / 400.0, round(400.0 * part)
            xi = [1e-3] * (lag + 1)
            for _ in range(60_000):
                xi.append(xi[-1] + dt * w * (xi[-1] - (1.0 + gain) * xi[-1 - lag]))
            assert bool(max(map(abs, xi[-4000:])) < 1e-4) is stable


@pytest.mark.parametrize("up", [[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, -0.8, -0.6], [0.0, 0.0, -1.0]])
def test_the_orientation_has_the_given_vertical(up: list[float]) -> None:
    r = orientation_of(np.array(up))
    np.testing.assert_allclose(np.linalg.norm(r), 1.0)
    np.testing.assert_allclose(upward(*r), up, atol=1e-12)


def test_changes_against_the_cause_come_first() -> None:
    class Numbers:
        mgh = 12.0

        @staticmethod
        def damping(stiffness: float, ratio: float, armature: float) -> float:
            return 1.0 / stiffness

    def order(*what: str) -> list[list[str]]:
        found = [Finding("", "", name) for name in what]
        return [list(changes) for _, changes in cures(CONFIG, Numbers(), found)]  # type: ignore[arg-type]

    assert order()[0] == ["servo.damping"]
    assert order("pressure", "damping")[:2] == [
        ["standing.transfer_duration"],
        ["standing.transfer_duration", "servo.damping"],
    ]
    assert order("latency", "stiffness")[0] == ["servo.stiffness", "servo.assumed_stiffness", "servo.damping"]
    every = set(order()[-1])
    assert {"servo.stiffness", "servo.damping", "standing.transfer_duration", "gait.step_length"} < every
    for found in (("pressure",), ("stiffness",), ("unknown",)):
        assert set(order(*found)[-1]) == every
