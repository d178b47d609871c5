"""Study files: their points, and the walks at them."""

from __future__ import annotations

import itertools
import os
import resource

import pytest
from study_files import SHORT, write

from dqwalk_ros import cli
from dqwalk_ros.report.figures.studies import study_figure
from dqwalk_ros.studies import read, walk_all
from dqwalk_ros.support.errors import ConfigError


def test_a_grid_is_every_combination_in_order(small):
    lengths = [0.01, 0.02, 0.03]
    expected = [{"gait.step_length": x, "dsp.flat_feet": y} for x, y in itertools.product(lengths, [True, False])]
    assert read(small).points() == expected


@pytest.mark.parametrize("sample", ["latin_hypercube", "sobol"])
def test_samples_fill_the_ranges_and_are_reproducible(tmp_path, sample):
    vary = "vary: {joints.eta: {from: 1, to: 2}, dsp.flat_feet: [true, false]}\n"
    text = f"{SHORT}sample: {sample}\ncount: 16\nseed: 4\n{vary}"
    points = read(write(tmp_path / "s.yaml", text)).points()
    assert points == read(tmp_path / "s.yaml").points()
    etas = sorted(point["joints.eta"] for point in points)
    # one in each sixteenth of the range
    assert all(i / 16 - 1e-9 <= eta - 1 <= (i + 1) / 16 + 1e-9 for i, eta in enumerate(etas))
    assert sum(point["dsp.flat_feet"] for point in points) == 8


SIX = ", ".join(
    f"{key}: {{from: 0.1, to: 0.2, steps: 100}}"
    for key in ("start.a", "start.b", "start.c", "mass.d", "mass.e", "mass.f")
)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("vary: {gait.step_lenght: [0.1]}", "step_lenght.*did you mean"),
        ("vary: {gait.step_length: {from: 0.1, to: 9.0}}", "gait.step_length.*must be a number in"),
        ("vary: {gait.step_length: 0.1}", "list of values"),
        ("vary: {gait.step_length: {from: 0.1, to: 0.2, stepss: 3}}", "list of values"),
        ("vary: {}", "vary"),
        ("[1, 2]", "--help"),
        ("sample: random\nvary: {dt: [0.005]}", "sample"),
        ("sample: sobol\ncount: 12\nvary: {dt: [0.005]}", "power of two"),
        ("count: 12\nvary: {dt: [0.005, 0.01]}", "'count' belongs to 'sample: latin_hypercube' or sobol"),
        ("vary: {start.l_knee_y: [a]}", "must be a finite number"),
        ("vary: {mass.pelvis: [.nan]}", "must be a finite number"),
        ("vary: {mass.pelvis: [-1.0]}", "must not be negative"),
        ("colour: red\nvary: {dt: [0.005]}", "colour"),
        ("vary: {dt: {from: 0.001, to: 0.005, steps: 1000000000}}", "list of values"),
        (f"vary: {{{SIX}}}", r"1e\+12 walks are too many"),
        ("count: 1000000000\nsample: sobol\nvary: {dt: [0.005]}", "count"),
        ("vary: {dt: [2024-13-45]}", "'dt' must be a number"),
        ("vary: {disturbance.velocityx: [0.1]}", "unknown parameter 'disturbance.velocityx'"),
        ("vary: {disturbance.velocity: [-1.0]}", "must not be negative"),
        ("vary: {gait.cycles: {from: 1, to: 3, steps: 3}}", "a list of values, such as .*not by a range"),
        ("set: {task.eta: 2.0}\nvary: {task.eta: [1.0]}", "'task.eta' is in 'set' and in 'vary'"),
        ("vary: {gait: [1]}", "'gait'; it is a section, whose parameters are named such as 'gait."),
        ("vary: " + "[" * 100, "nested too deeply"),
        ("vary: " + "[" * 3000, "nested too deeply|nesting depth"),  # the newer libyaml's own limit
    ],
)
def test_invalid_studies_are_rejected_before_the_first_walk(tmp_path, text, words):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ConfigError, match=words):
        read(write(tmp_path / "wrong.yaml", text))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # [kB]


def test_a_failed_walk_is_a_result(tmp_path):
    text = SHORT.replace("gait.phase_timeout: 3.0", "gait.phase_timeout: 0.1")
    vary = "vary: {start.l_knee_y: [0.0, 0.1], mass.pelvis: [1.0, 2.0]}\n"
    rows = walk_all(read(write(tmp_path / "s.yaml", text + vary)), tmp_path / "out")
    assert len(rows) == 4
    assert not any(row["finished"] for row in rows)
    assert all("double_support/left" in row["end"] for row in rows)


@pytest.mark.parametrize(
    "vary", ["gait.step_side: [0.0, 0.01]", "gait.step_side: [0.0], gait.step_length: [0.0, 0.01]"]
)
def test_a_walk_without_the_planes_of_the_paper_can_be_studied(tmp_path, capsys, vary):
    study = write(tmp_path / "s.yaml", f"config: poppy_dynamic\nset: {{gait.steps: 1}}\nvary: {{{vary}}}\n")
    assert cli.main(["study", str(study), "--out", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    assert "2 of 2 walks finished" in shown
    assert "to the edge of the soles" in shown


def test_a_walk_that_does_not_end_is_not_studied(tmp_path):
    study = write(tmp_path / "s.yaml", "config: poppy\nset: {gait.steps: 0}\nvary: {gait.step_length: [0.01]}\n")
    with pytest.raises(ConfigError, match=r"the walk has no end.*gait\.steps"):
        walk_all(read(study), tmp_path / "out")


@pytest.mark.parametrize(("name", "words"), [("start.nobody", "no such joint.*l_knee_y"), ("mass.no", "no such link")])
def test_a_wrong_joint_or_link_is_an_error_before_the_first_walk(tmp_path, name, words):
    study = write(tmp_path / "s.yaml", f"{SHORT}vary: {{{name}: [1.0, 2.0]}}\n")
    with pytest.raises(ConfigError, match=words):
        walk_all(read(study), tmp_path / "out")
    assert not (tmp_path / "out").exists()
    assert cli.main(["study", str(study), "--dry-run"]) == 2


def test_starts_masses_and_disturbances_change_the_walk_reproducibly(tmp_path):
    vary = "vary: {start.l_knee_y: [0.1], mass.pelvis: [1.0, 2.0], disturbance.velocity: [0.0, 0.01]}\n"
    study = read(write(tmp_path / "s.yaml", SHORT + vary))
    rows = walk_all(study, tmp_path / "a")
    results = [(row["duration"], row["error"], row["margin/true"]) for row in rows]
    assert len(set(results)) == len(results)
    assert walk_all(study, tmp_path / "b") == rows


def test_the_study_command_reports_its_results_and_errors(small, tmp_path, capsys):
    out = tmp_path / "out"
    assert cli.main(["study", str(small), "--out", str(out), "--quiet", "--jobs", "1"]) == 0
    assert cli.main(["study", str(small), "--out", str(out)]) == 0
    shown = capsys.readouterr().out
    assert "small: 6 of 6 walks finished" in shown
    assert (out / "study.png").stat().st_size > 10_000
    assert os.path.exists(out / "walks.parquet")
    assert cli.main(["study", str(tmp_path / "none.yaml")]) == 2
    assert capsys.readouterr().err == f"dqwalk: no study file '{tmp_path / 'none.yaml'}'\n"
    (out / "walks.parquet").unlink()
    (out / "walks.parquet").mkdir()
    assert cli.main(["study", str(small), "--out", str(out)]) == 1
    assert "walks.parquet" in capsys.readouterr().err


@pytest.mark.parametrize("drops", [["abs_y"], ["abs_y", "head_y"]])
def test_the_figure_of_a_study_shows_its_whole_legend(drops):
    rows = [
        {"x": x, "drop": drop, "finished": x < 3.0, "margin/paper": 0.01, "margin/true": -0.01}
        for drop in drops
        for x in (1.0, 2.0, 3.0)
    ]
    figure = study_figure(rows, ["x", "drop"], {"x": "m"})
    figure.draw_without_rendering()
    assert figure.bbox_inches.padded(0.01).count_contains(figure.get_tightbbox().corners()) == 4
