"""Robustness: cells, what the controller assumes in them, and the figure."""

from __future__ import annotations

import pytest

from dqwalk_ros import cli
from dqwalk_ros.cli.robustness import table
from dqwalk_ros.config import load, overlaid
from dqwalk_ros.report.figures.studies import robustness_figure
from dqwalk_ros.studies import robustness
from dqwalk_ros.support.errors import ConfigError, ModelError

POPPY = load("poppy")


def test_robustness_samples_cells_and_counts_failures():
    axes = {"physics.friction": (0.4, 0.8), "servo.latency": (0.0, 0.02, 0.04)}
    assert len(robustness.cells(axes)) == 6
    drawn = robustness.cells(axes, sample=4, seed=1)
    assert drawn == robustness.cells(axes, sample=4, seed=1)
    assert len(drawn) == 4
    done = [(values, robustness.CellOutcome(k > 0, 1.0, 3, "" if k else "fell")) for k, values in enumerate(drawn)]
    text = table(done, axes)
    assert text.startswith("3 of 4 cells stood (4 of the 6 combinations were walked)")
    assert "failed at" in text


def test_a_robot_that_does_not_exist_is_an_error_before_the_first_cell(tmp_path):
    with pytest.raises(ModelError, match=r"nowhere\.urdf"):
        robustness.walk_all(POPPY.updated({"robot.urdf": "nowhere.urdf"}), [{}], tmp_path / "out")
    assert "the walk has no end" in robustness.walk(POPPY, 0, {"gait.steps": 0}).reason
    assert not (tmp_path / "out").exists()


def test_stiffness_is_varied_relative_to_the_robots_own():
    assert robustness.axes_of(POPPY)["servo.stiffness"] == (25.0, 40.0, 60.0, 90.0)
    big = robustness.axes_of(POPPY.updated({"servo.stiffness": 4000.0}))["servo.stiffness"]
    assert big[2] == 4000.0
    assert big[0] == pytest.approx(4000.0 * 25 / 60)


def test_the_assumed_latency_can_be_wrong():
    config = POPPY.updated({"servo.latency": 0.03, "sensors.age": 0.01})
    for error, expected in ((0.0, 0.04), (0.02, 0.06), (-0.02, 0.02), (-0.1, 0.0)):
        assert robustness.assumed(config, error)["servo.assumed_latency"] == pytest.approx(expected)


@pytest.mark.parametrize(("lead", "damping", "assumed"), [(0.0, 0.02, 0.0), (0.005, 0.02, 0.005), (0.02, 0.01, 0.01)])
def test_the_lead_is_that_of_the_configuration_but_not_more_than_the_damping(lead, damping, assumed):
    found = robustness.assumed(POPPY.updated({"servo.assumed_lead": lead, "servo.damping": damping}))
    assert (found["servo.assumed_lead"], found["servo.assumed_damping"]) == (assumed, damping)


def test_an_interrupted_robustness_study_says_how_to_continue(tmp_path, monkeypatch, capsys):
    def walk(config, index, values):
        if (tmp_path / "cells.jsonl").read_text().count("stood"):
            raise KeyboardInterrupt
        return robustness.CellOutcome(True, 1.0, 3, "")

    monkeypatch.setattr(robustness, "walk", walk)
    options = ["--axis", "physics.friction=0.4,0.8", "--sample", "5", "--jobs", "1", "--out", str(tmp_path)]
    assert cli.main(["robustness", *options]) == 1
    output = capsys.readouterr()
    assert "interrupted; 1 of 5 cells are saved, the same command continues" in output.err
    assert not output.out
    assert [file.name for file in tmp_path.iterdir()] == ["cells.jsonl"]


def test_robustness_as_built_varies_gain_and_seed():
    axes = robustness.axes_of(overlaid(POPPY, "poppy_as_built"))
    assert len(robustness.cells(axes)) == 40
    assert axes["servo.p_gain"] == (254, 127)
    values = [{"servo.p_gain": 254.0, "sensors.seed": k} for k in range(3)]
    done = [(one, robustness.CellOutcome(True, 1.0, 3, "", 0.001 * k)) for k, one in enumerate(values)]
    assert "the largest of each walk: median 0.06, worst 0.11 degrees" in table(done, axes)


@pytest.mark.parametrize(
    "axes",
    [
        robustness.axes_of(POPPY),
        {"servo.p_gain": (254, 127), "sensors.seed": tuple(range(20))},
        {"servo.p_gain": (254,), "physics.slope": (-0.05, 0.0, 0.05), "sensors.seed": tuple(range(10))},
        {"servo.stiffness": (60.0, 90.0)},
        {"physics.friction": (0.4,)},
    ],
)
def test_the_figure_of_any_axes_shows_each_cell_and_all_its_texts(axes):
    cells = robustness.cells(axes)
    done = [(cell, robustness.CellOutcome(k > 0, 1.0, 3, "")) for k, cell in enumerate(cells)]
    figure = robustness_figure(done, axes, 10)
    assert sum(len(plot.patches) for plot in figure.axes) == len(cells)
    assert "".join(text.get_text() for plot in figure.axes for text in plot.texts) == "3"  # steps of the one that fell
    figure.draw_without_rendering()
    assert figure.bbox_inches.padded(0.01).count_contains(figure.get_tightbbox().corners()) == 4


def test_a_robot_with_weak_servos_falls(tmp_path):
    """8 N m/rad per joint is less than the gravitational stiffness m g h of the robot requires."""
    values = {"servo.stiffness": 8.0, "servo.assumed_stiffness": 0.0, "standing.balance": 0.0}
    config = POPPY.updated({"gait.steps": 1})
    (cell,) = robustness.walk_all(config, [values], tmp_path)
    assert not cell[1].stood
    assert cell[1].reason
    assert robustness.walk_all(config, [values], tmp_path) == [cell]  # from the file
    with pytest.raises(ConfigError, match="another study"):
        robustness.walk_all(config.updated({"gait.steps": 2}), [values], tmp_path)
