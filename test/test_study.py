"""Studies: what they walk, that they can be killed, and that it does not matter where they run."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from distributed import LocalCluster
from pyarrow import parquet

from dqwalk_ros import cli
from dqwalk_ros.errors import ConfigError
from dqwalk_ros.studies import read, run

ROOT = Path(__file__).resolve().parent.parent
SHORT = (
    "config: paper\n"
    "set: {task.eta: 2.0, task.damping: 0.02, ssp.threshold: 0.02, dsp.stall_rate: 0.005, gait.phase_timeout: 3.0,"
    " qp.solver: daqp}\n"
)


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def small(tmp_path):
    vary = "vary: {gait.step_length: {from: 0.01, to: 0.03, steps: 3}, dsp.flat_feet: [true, false]}\n"
    return write(tmp_path / "small.yaml", SHORT + vary)


def test_a_grid_is_every_combination_in_order(small):
    lengths = [0.01, 0.02, 0.03]
    expected = [{"gait.step_length": x, "dsp.flat_feet": y} for x, y in itertools.product(lengths, [True, False])]
    assert read(small).points() == expected


@pytest.mark.parametrize("sample", ["latin_hypercube", "sobol"])
def test_samples_fill_the_ranges_and_repeat(tmp_path, sample):
    text = f"{SHORT}sample: {sample}\ncount: 16\nseed: 4\nvary: {{task.eta: {{from: 1, to: 2}}, dt: [0.005, 0.004]}}\n"
    points = read(write(tmp_path / "s.yaml", text)).points()
    assert points == read(tmp_path / "s.yaml").points()
    etas = sorted(point["task.eta"] for point in points)
    # one in each sixteenth of the range
    assert all(i / 16 - 1e-9 <= eta - 1 <= (i + 1) / 16 + 1e-9 for i, eta in enumerate(etas))
    assert sum(point["dt"] == 0.004 for point in points) == 8


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("vary: {gait.step_lenght: [0.1]}", "step_lenght.*did you mean"),
        ("vary: {gait.step_length: {from: 0.1, to: 9.0}}", "gait.step_length.*must be a number in"),
        ("vary: {gait.step_length: 0.1}", "list of values"),
        ("vary: {}", "at least one"),
        ("sample: random\nvary: {dt: [0.005]}", "sobol"),
        ("sample: sobol\ncount: 12\nvary: {dt: [0.005]}", "power of two"),
        ("vary: {start.l_knee_y: [a]}", "must be a number"),
        ("colour: red\nvary: {dt: [0.005]}", "colour"),
    ],
)
def test_studies_of_no_use_are_refused_before_the_first_walk(tmp_path, text, words):
    with pytest.raises(ConfigError, match=words):
        read(write(tmp_path / "wrong.yaml", text))


def test_results_do_not_depend_on_where_they_were_walked(small, tmp_path):
    study = read(small)
    one = run(study, tmp_path / "one")
    assert run(study, tmp_path / "two", jobs=2) == one
    with LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, processes=True
    ) as cluster:
        assert run(study, tmp_path / "dask", scheduler=cluster.scheduler_address) == one
    table = parquet.read_table(tmp_path / "one" / "walks.parquet").to_pylist()
    assert table == one
    assert [row["walk"] for row in table] == list(range(6))
    assert all(row["finished"] for row in table), [row["end"] for row in table]


def test_a_walk_that_fails_is_a_result(tmp_path):
    vary = "vary: {start.l_knee_y: [0.0, 0.1], start.nobody: [0.0], mass.pelvis: [1.0, 2.0]}\n"
    rows = run(read(write(tmp_path / "s.yaml", SHORT + vary)), tmp_path / "out")
    assert not any(row["finished"] for row in rows)
    assert all("no such joint" in row["end"] for row in rows)


def test_starts_masses_and_disturbances_change_the_walk_and_repeat(tmp_path):
    vary = "vary: {start.l_knee_y: [0.0, 0.1], mass.pelvis: [1.0, 2.0], disturbance.velocity: [0.0, 0.01]}\n"
    study = read(write(tmp_path / "s.yaml", SHORT + vary))
    rows = run(study, tmp_path / "a")
    results = [(row["duration"], row["error"], row["margin/true"]) for row in rows]
    assert len(set(results)) == len(results)
    assert run(study, tmp_path / "b") == rows


def test_a_killed_study_goes_on_without_losing_a_walk(tmp_path):
    text = SHORT + "vary: {gait.step_length: {from: 0.01, to: 0.03, steps: 30}}\n"
    study, out = write(tmp_path / "long.yaml", text), tmp_path / "out"
    command = [sys.executable, "-m", "dqwalk_ros.cli", "study", str(study), "--out", str(out), "--quiet"]
    process = subprocess.Popen(command, cwd=ROOT)
    log, deadline = out / "walks.jsonl", time.monotonic() + 120
    while not (log.exists() and len(log.read_text().splitlines()) > 3) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    before = log.read_text().splitlines()
    assert 3 < len(before) < 31
    with log.open("a") as file:
        file.write('{"walk": 29, "finis')  # as a kill in the middle of a write leaves it
    walked = []
    rows = run(read(study), out, progress=lambda done, total, some: walked.append(done))
    whole = [line for line in before if line.endswith("}")]
    assert len(walked) == 30 - (len(whole) - 1)
    assert [row["walk"] for row in rows] == list(range(30))
    assert [rows[json.loads(line)["walk"]] for line in whole[1:]] == [json.loads(line) for line in whole[1:]]


def test_another_study_is_not_mixed_in(small, tmp_path):
    run(read(small), tmp_path / "out")
    other = write(tmp_path / "other.yaml", SHORT + "vary: {gait.step_length: [0.02]}\n")
    with pytest.raises(ConfigError, match="another study"):
        run(read(other), tmp_path / "out")


def test_the_command_says_what_came_of_it(small, tmp_path, capsys):
    assert cli.main(["study", str(small), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    assert cli.main(["study", str(small), "--out", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    assert "small: 6 of 6 walks finished" in shown
    assert (tmp_path / "out" / "study.png").stat().st_size > 10_000
    assert cli.main(["study", str(tmp_path / "none.yaml")]) == 2
    assert "none.yaml" in capsys.readouterr().err
    assert os.path.exists(tmp_path / "out" / "walks.parquet")
