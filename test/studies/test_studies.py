"""Studies: their walks, interruption and resumption, and independence of the machine."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import itertools
import json
import math
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from distributed import LocalCluster
from full_disk import limited_file_size
from points import Number
from pyarrow import parquet

from dqwalk_ros import cli
from dqwalk_ros.cli.robustness import table
from dqwalk_ros.config import load, overlaid
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.state import Command
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.report.figures.studies import robustness_figure, study_figure
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.studies import loads, pushes, read, robustness, walk_all
from dqwalk_ros.studies.bisection import largest
from dqwalk_ros.studies.runner import Store, run
from dqwalk_ros.support.errors import ConfigError, ModelError, PlantError, StudyError
from dqwalk_ros.walks.table import make_walk

ROOT = Path(__file__).resolve().parents[2]
SHORT = (
    "config: paper\n"
    "set: {dt: 0.02, task.eta: 2.0, task.damping: 0.02, ssp.threshold: 0.02, dsp.stall_rate: 0.005, qp.solver: daqp,"
    " gait.phase_timeout: 3.0}\n"
)
POPPY = load("poppy")


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def small(tmp_path):
    vary = "vary: {gait.step_length: {from: 0.01, to: 0.03, steps: 3}, dsp.flat_feet: [true, false]}\n"
    return write(tmp_path / "small.yaml", SHORT + vary)


# ---------------------------------------------------------------------- the points of a study


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
    assert not any(row["finished"] for row in rows.values())
    assert all("double_support/left" in row["end"] for row in rows.values())


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
    results = [(row["duration"], row["error"], row["margin/true"]) for row in rows.values()]
    assert len(set(results)) == len(results)
    assert walk_all(study, tmp_path / "b") == rows


# ---------------------------------------------------------------------- schedulers, interruption and resumption


@pytest.mark.long
def test_results_do_not_depend_on_the_scheduler(small, tmp_path):
    study = read(small)
    one = walk_all(study, tmp_path / "one")
    assert walk_all(study, tmp_path / "two", jobs=2) == one
    with LocalCluster(
        n_workers=1, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, processes=False, protocol="tcp"
    ) as cluster:
        assert walk_all(study, tmp_path / "dask", scheduler=cluster.scheduler_address) == one
    table = parquet.read_table(tmp_path / "one" / "walks.parquet").to_pylist()
    assert table == list(one.values())
    assert [row["walk"] for row in table] == list(range(6))
    assert all(row["finished"] for row in table), [row["end"] for row in table]


def test_a_missing_scheduler_is_an_error(small, tmp_path, monkeypatch):
    monkeypatch.setattr("dqwalk_ros.studies.runner._CONNECT_TIMEOUT", "1s")
    with pytest.raises(ConfigError, match="no Dask scheduler answers at tcp://"):
        walk_all(read(small), tmp_path / "out", scheduler="tcp://127.0.0.1:9")


@pytest.mark.parametrize(
    "number", [pytest.param(signal.SIGKILL, marks=pytest.mark.long), signal.SIGINT], ids=["killed", "Ctrl-C"]
)
def test_an_interrupted_study_resumes_without_losing_a_walk(tmp_path, number):
    text = SHORT + "vary: {gait.step_length: {from: 0.01, to: 0.03, steps: 12}}\n"
    study, out = write(tmp_path / "long.yaml", text), tmp_path / "out"
    command = [sys.executable, "-m", "dqwalk_ros.cli", "study", str(study), "--out", str(out), "--jobs", "1"]
    process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    log, deadline = out / "walks.jsonl", time.monotonic() + 120
    while not (log.exists() and len(log.read_text().splitlines()) > 3) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(number)
    output = process.communicate(timeout=60)[1]
    if number == signal.SIGINT:
        assert process.returncode == 1
        assert "of 12 walks are saved, the same command continues" in output
        assert "Traceback" not in output
    before = log.read_text().splitlines()
    assert 3 < len(before) < 13
    with log.open("a") as file:
        file.write('{"walk": 11, "finis')  # an incomplete line, as after a kill during a write
    walked = []
    rows = walk_all(read(study), out, progress=lambda done, total, last: walked.append(done))
    whole = [json.loads(line) for line in before[1:] if line.endswith("}")]
    assert len(walked) == 12 - len(whole)
    assert list(rows) == list(range(12))
    assert [rows[line["walk"]] for line in whole] == whole


POINTS = [{"x": float(k)} for k in range(5)]


def square(index: int, point: dict[str, float]) -> Number:
    return Number(point["x"] ** 2)


def test_workers_ignore_ctrl_c_and_end_with_their_study(tmp_path):
    """Also after SIGTERM, which the study answers as Ctrl-C: with an error that says what is saved."""
    files = [tmp_path / "one", tmp_path / "two"]
    points = [{"file": str(file)} for file in files]
    program = (
        "from pathlib import Path; from points import Number, hold_a_lock; "
        "from dqwalk_ros.studies.runner import Store, run; "
        f"run(hold_a_lock, Store(Path({str(tmp_path / 'walks.jsonl')!r}), 'x', {points}, Number), jobs=2)"
    )
    study = subprocess.Popen([sys.executable, "-c", program], cwd=ROOT / "test/support", stderr=subprocess.PIPE)
    while not all(file.exists() and file.read_text() for file in files):
        assert study.poll() is None
        time.sleep(0.02)
    assert {file.read_text() for file in files} == {"True"}
    study.terminate()
    assert b"StudyError: interrupted; 0 of 2 walks are saved" in study.communicate(timeout=60)[1]
    assert all(map(released, files))


def released(file: Path) -> bool:
    """Return whether the lock of a file is released within a minute."""
    deadline = time.monotonic() + 60.0
    with file.open() as one:
        while time.monotonic() < deadline:
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(one, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return True
            time.sleep(0.02)
    return False


@pytest.mark.parametrize(
    "line",
    [
        b"\xff\xfe\x00binary",
        b'{"walk": [1], "square": 1.0}',
        b'{"walk": 1}',
        b'{"walk": 1, "square": "a"}',
        b'{"walk": 7, "square": 1.0}',
        b'{"walk": true, "square": 1.0}',
        b"[" * 100_000,
        b"",
    ],
)
def test_the_walk_of_a_damaged_line_is_repeated(tmp_path, line):
    path = tmp_path / "walks.jsonl"
    path.write_bytes(b'{"study":"me"}\n{"walk":0,"square":0.0}\n' + line + b'\n{"walk":2,"square":4.0}\n')
    store = Store(path, "me", POINTS, Number)
    assert store.done == {0: Number(0.0), 2: Number(4.0)}
    again = []
    done = run(square, store, progress=lambda count, total, last: again.append(last.square))
    store.close()
    assert sorted(again) == [1.0, 9.0, 16.0]
    assert [done[k].square for k in range(5)] == [0.0, 1.0, 4.0, 9.0, 16.0]
    with_all = Store(path, "me", POINTS, Number)
    assert with_all.done == done
    with_all.close()


def test_without_semaphores_the_walks_run_one_after_the_other(tmp_path, monkeypatch, caplog):
    """In a container whose /dev/shm cannot be written, joblib ended in an AssertionError."""

    def refuse(*_, **__):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr("multiprocessing.synchronize._multiprocessing.SemLock", refuse)
    monkeypatch.setitem(sys.modules, "joblib", None)  # must not be asked
    done = run(square, Store(tmp_path / "walks.jsonl", "me", POINTS, Number), jobs=2)
    assert [done[k].square for k in range(5)] == [0.0, 1.0, 4.0, 9.0, 16.0]
    assert "one after the other: [Errno 30] Read-only file system; is /dev/shm writable?" in caplog.text


def test_a_store_has_one_study_and_one_writer(tmp_path):
    path = tmp_path / "walks.jsonl"
    store = Store(path, "me", POINTS, Number)
    with pytest.raises(ConfigError, match="another process"):
        Store(path, "me", POINTS, Number)
    store.add(3, Number(9.0))
    store.close()
    with pytest.raises(ConfigError, match="another study"):
        Store(path, "you", POINTS, Number)
    replaced = Store(path, "you", POINTS, Number, force=True)
    assert replaced.done == {}
    replaced.close()


def test_a_folder_in_place_of_the_file_is_an_error(tmp_path):
    (tmp_path / "walks.jsonl").mkdir()
    with pytest.raises(StudyError, match="Is a directory"):
        Store(tmp_path / "walks.jsonl", "me", POINTS, Number)


def test_a_full_disk_is_an_error_and_loses_no_outcome(tmp_path):
    path = tmp_path / "walks.jsonl"
    store = Store(path, "me", POINTS * 20, Number)
    with limited_file_size(200), pytest.raises(StudyError, match="cannot read and write"):
        run(square, store)
    store.close()
    store = Store(path, "me", POINTS * 20, Number)
    assert len(store.done) > 3
    assert len(run(square, store)) == 100
    store.close()


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


# ---------------------------------------------------------------------- robustness


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


# ---------------------------------------------------------------------- pushes


@pytest.mark.parametrize("limit", [0.77, 0.001, 3.999, 0.25])
def test_the_largest_load_is_found_by_bisection(limit):
    tried = []

    def fails(load):
        tried.append(load)
        return "" if load < limit else "fell"

    found = largest(fails, first=0.25, most=4.0, tolerance=0.02)
    assert found.survived < limit <= found.failed <= found.survived + 0.02
    assert found.reason == "fell"
    assert len(tried) < 14
    nothing = largest(lambda load: "", first=0.25, most=4.0, tolerance=0.02)
    assert (nothing.survived, nothing.failed, nothing.reason) == (4.0, None, "")


def test_pushes_scale_with_the_robot():
    scale = pushes.impulse_scale(POPPY)
    assert scale == pytest.approx(5.5, abs=0.3)
    data = Path(__file__).parents[1] / "data"
    big = load(data / "biped12.yaml").updated({"robot.urdf": str(data / "biped12.urdf")})
    assert pushes.impulse_scale(big) > 1.5 * scale


def test_limits_of_pushes_are_saved_and_printed(tmp_path, monkeypatch, capsys):
    def pushed(config, push):
        assert config.servo.assumed_damping == 0.02  # of config/plants/physics.yaml, as with `dqwalk simulate`
        return "fell" if push.impulse > 0.8 + 0.1 * push.direction else ""

    monkeypatch.setattr(pushes, "pushed", pushed)
    command = ["pushes", "--moment", "standing", "--directions", "4", "--jobs", "1", "--out", str(tmp_path)]
    assert cli.main(command) == 0
    shown = capsys.readouterr().out
    assert "M sqrt(g h)" in shown
    rows = [line.split(",") for line in (tmp_path / "pushes.csv").read_text().splitlines()[1:]]
    for moment, degrees, survived, failed, reason in rows:
        limit = 0.8 + 0.1 * float(degrees) * 3.14159265 / 180
        assert (moment, reason) == ("standing", "fell")
        assert float(survived) <= limit < float(failed)
    monkeypatch.setattr(pushes, "pushed", lambda config, push: pytest.fail("it is kept"))
    assert cli.main([*command, "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert (tmp_path / "pushes.txt").read_text() == shown


@pytest.mark.parametrize(("given", "length"), [((), 0.0), (("--set", "gait.step_length=0.03"), 0.03)])
def test_the_bottle_of_robocup_is_measured_by_the_rules(given, length, tmp_path, monkeypatch, capsys):
    """M and the distance of the release, of the weaker foot; on the spot, unless the steps are given."""

    def pushed(config, push):
        assert config.gait.step_length == length
        assert push.bottle == 3.0
        return "fell" if push.impulse > (2.0 if push.direction > 1.0 else 3.0) + (push.moment == "left") else ""

    monkeypatch.setattr(pushes, "pushed", pushed)
    command = ["pushes", "--bottle", "3", *given, "--out", str(tmp_path)]
    assert cli.main([*command, "--jobs", "1", "--tolerance", "1e-4"]) == 0
    shown = capsys.readouterr().out
    model = load_model(POPPY.robot)
    kin = Kinematics(model, make_walk(POPPY, model).posture, Foot.LEFT)
    for where, momentum in (("from behind", 3.0), ("from the front", 2.0)):
        drop = (momentum / 3.0) ** 2 / (2.0 * 9.81)
        away = math.sqrt(1.75**2 - (1.75 - drop) ** 2)
        measure = math.sqrt(drop) / kin.com[2] * 3.0 / model.mass * kin.point(model.pelvis)[2] / kin.com[2]
        assert f"{where}: released {away:.2f} m away, on a rope of 1.75 m: M = {measure:.2f}" in shown
    assert cli.main([*command, "--moment", "standing"]) == 2


def test_another_link_is_pushed(tmp_path, monkeypatch, capsys):
    """The link of --link is pushed, and named in the table; one that the robot has not is an error."""
    monkeypatch.setattr(
        pushes, "pushed", lambda config, push: "fell" if push.impulse > 0.7 or push.link != "chest" else ""
    )
    command = ["pushes", "--jobs", "1", "--moment", "standing", "--directions", "1", "--out", str(tmp_path)]
    assert cli.main([*command, "--link", "chest", "--tolerance", "1e-3"]) == 0
    shown = capsys.readouterr().out
    assert "impulse of a push of 0.1 s on chest" in shown
    assert ">= " not in shown
    assert "0.699 (0.81)" in shown
    assert "in brackets: what a pendulum on these soles catches" in shown
    assert cli.main([*command, "--link", "wing"]) == 2
    assert "--link wing: the links of poppy_humanoid are" in capsys.readouterr().err
    assert cli.main([*command, "--link", "chest", "--bottle", "3"]) == 2


def test_pushes_anywhere_are_drawn_by_their_seed():
    """Over all heavy links, both feet, all directions and the whole step."""
    model = load_model(POPPY.robot)
    drawn = [pushes.Push.anywhere(0.3, model, seed) for seed in range(300)]
    assert drawn[7] == pushes.Push.anywhere(0.3, model, 7)
    heavy = {link for link, body in zip(model.links, model.bodies, strict=True) if body.mass > 0.02 * model.mass}
    assert {push.link for push in drawn} == heavy
    assert {push.moment for push in drawn} == {"left", "right"}
    for values, most in (([push.direction for push in drawn], 2.0 * math.pi), ([push.part for push in drawn], 0.95)):
        counts, _ = np.histogram(values, 4, (0.0, most))
        assert counts.sum() == 300
        assert counts.min() > 45


@pytest.mark.parametrize("mass", [3.0, 10.0])
@pytest.mark.parametrize("dt", [0.0025, 0.005, 0.02])
def test_a_bottle_loses_the_momentum_that_a_free_body_receives(mass, dt):
    """The hit is nearly inelastic, for any period of control."""
    bottle, robot, x, v = loads.Bottle(mass, 2.0, 2.6), 2.6, 0.0, 0.0
    impulse = [dt * bottle.force(x, dt)]
    while impulse[-1] > 0.0:
        v += impulse[-1] / robot
        x += v * dt
        impulse.append(dt * bottle.force(x, dt))
    inelastic = 2.0 * robot / (mass + robot)
    assert inelastic < sum(impulse) < 1.15 * inelastic
    assert len(impulse) * dt < 0.2


def test_the_farthest_bottle_is_released_at_three_quarters_of_the_rope():
    for mass in (3.0, 5.0, 10.0):
        assert loads.release_distance(mass, loads.farthest_momentum(mass)) == pytest.approx(0.75 * loads.ROPE)


@pytest.mark.long
def test_a_bottle_on_a_walk_on_the_spot():
    """Poppy walks on after 1.5 N s, and falls after 6, from behind and from the front."""
    config = overlaid(load("poppy_dynamic"), "physics").updated({"gait.step_length": 0.0})
    for direction in (0.0, math.pi):
        assert not pushes.pushed(config, pushes.Push("left", direction, 1.5, bottle=3.0))
        assert "fell" in pushes.pushed(config, pushes.Push("left", direction, 6.0, bottle=3.0))


def test_a_small_push_is_survived_and_a_large_one_is_not():
    assert not pushes.pushed(POPPY, pushes.Push("standing", 0.0, 0.1))
    assert "fell" in pushes.pushed(POPPY, pushes.Push("standing", 0.0, 3.0))


@pytest.mark.parametrize(("duration", "dt"), [(0.1, 0.005), (0.1, 0.03), (0.012, 0.005), (0.001, 0.005)])
def test_the_impulse_of_a_push_does_not_depend_on_the_period(monkeypatch, duration, dt):
    """The integral of the force over the ticks is the impulse, also if the duration is no multiple of the period.

    It acts on the link of the push.
    """
    given = []

    class Pushed(KinematicPlant):
        def push(self, force, link=""):
            assert link == "chest"
            given.append(np.asarray(force) * dt)

    class Standing:
        finished = False

        def __init__(self, config):
            self.config = config

        def step(self, state, dt):
            return Command(state.time, np.zeros_like(state.q))

    monkeypatch.setattr(pushes, "make_controller", lambda config, model: Standing(config))
    monkeypatch.setattr(pushes, "make_plant", lambda name, config, model: Pushed(model, np.zeros(model.n)))
    monkeypatch.setattr(pushes, "_due", lambda controller, time, number, part: time > 0.1)
    monkeypatch.setattr(pushes, "_STANDS", 0.3)
    assert not pushes.pushed(POPPY.updated({"dt": dt}), pushes.Push("standing", 0.0, 2.0, duration, link="chest"))
    assert sum(given) == pytest.approx([2.0, 0.0, 0.0])


def test_a_push_in_a_phase_that_never_begins_is_an_error(monkeypatch):
    monkeypatch.setattr(pushes, "_due", lambda controller, time, number, part: False)
    monkeypatch.setattr(pushes, "_LATE", -1.0)
    monkeypatch.setattr(pushes, "_STANDS", 0.1)
    with pytest.raises(PlantError, match="before the push"):
        pushes.pushed(POPPY, pushes.Push("standing", 0.0, 0.1))
