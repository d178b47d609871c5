"""The walks of a study: schedulers, interruption and resumption, and the file of outcomes."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from distributed import LocalCluster
from distributed.client import FutureCancelledError
from full_disk import limited_file_size
from points import Number
from pyarrow import parquet
from study_files import SHORT, write

from dqwalk_ros.studies import read, walk_all
from dqwalk_ros.studies.runner import Store, _backend, run
from dqwalk_ros.support.errors import ConfigError, StudyError

ROOT = Path(__file__).resolve().parents[2]


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


def test_a_scheduler_that_is_lost_is_named(monkeypatch):
    monkeypatch.setattr("distributed.Client", lambda *_, **__: contextlib.nullcontext())
    monkeypatch.setattr("joblib.parallel_config", lambda *_: contextlib.nullcontext())
    lost = FutureCancelledError("walk", "scheduler-connection-lost")
    with pytest.raises(StudyError, match="tcp://x is lost; started again, the command continues"), _backend("tcp://x"):
        raise lost


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
    assert [row["walk"] for row in rows] == list(range(12))
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
    assert [one.square for _, one in done] == [0.0, 1.0, 4.0, 9.0, 16.0]
    with_all = Store(path, "me", POINTS, Number)
    assert with_all.done == {k: one for k, (_, one) in enumerate(done)}
    with_all.close()


def test_without_semaphores_the_walks_run_one_after_the_other(tmp_path, monkeypatch, caplog):
    """In a container whose /dev/shm cannot be written, where joblib ends in an AssertionError."""

    def refuse(*_, **__):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr("multiprocessing.synchronize._multiprocessing.SemLock", refuse)
    monkeypatch.setitem(sys.modules, "joblib", None)  # must not be asked
    done = run(square, Store(tmp_path / "walks.jsonl", "me", POINTS, Number), jobs=2)
    assert [one.square for _, one in done] == [0.0, 1.0, 4.0, 9.0, 16.0]
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
