"""Damaged, malicious or inconsistent bags: one clear error message, bounded memory and time, no traceback."""

from __future__ import annotations

import json
import os
import pathlib
import resource
import shutil
import sqlite3
import subprocess
import sys
import textwrap
from dataclasses import replace

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from recorded import rewrite
from rosbags.rosbag2 import StoragePlugin

from dqwalk_ros import KinematicPlant, cli, load, load_model, make_controller, report, simulate
from dqwalk_ros.report import bag
from dqwalk_ros.report.bag import messages, storage
from dqwalk_ros.support.errors import BagError
from dqwalk_ros.whole_body.bag import read_body

RECORDED = pathlib.Path(__file__).parents[1] / "data" / "recorded"
"""Bags recorded live: a walk of 581 states and four phases, and one of the whole body."""


@pytest.fixture(scope="module")
def trace():
    return bag.read(RECORDED / "walk")


def reported(bag_path, out, *options):
    """Return exit code and report of `dqwalk report`."""
    code = cli.main(["report", str(bag_path), "--no-figures", "--quiet", "--out", str(out), *options])
    file = out / "report.json"
    return code, json.loads(file.read_text()) if file.exists() else None


# ---------------------------------------------------------------------- recordings cut off by a crash


def test_a_bag_without_metadata_is_reported(path, tmp_path):
    shutil.copytree(path, tmp_path / "b")
    (tmp_path / "b/metadata.yaml").unlink()
    code, report = reported(tmp_path / "b", tmp_path / "out")
    assert code == 0
    assert "metadata.yaml is missing: the recorder was not shut down properly" in report["notes"]


def test_trailing_zeros_of_a_recording_are_not_read(path, tmp_path):
    """A preallocated, sparse file after a power failure: 6 GB of zeros."""
    data = (path / "walk.mcap").read_bytes()
    (tmp_path / "x.mcap").write_bytes(data[: len(data) // 2])
    os.truncate(tmp_path / "x.mcap", 6 << 30)
    assert len(bag.read(tmp_path / "x.mcap")) > 50


def test_flipped_bits_are_detected(trace, path, tmp_path):
    """Otherwise it makes no difference, for example in an unused index."""
    data = (path / "walk.mcap").read_bytes()
    rng = np.random.default_rng(5)
    detected = 0
    for at in rng.integers(0, 8 * len(data), 24).tolist():
        damaged = bytearray(data)
        damaged[at // 8] ^= 1 << at % 8
        (tmp_path / "x.mcap").write_bytes(damaged)
        try:
            back = bag.read(tmp_path / "x.mcap")
        except BagError:
            detected += 1
            continue
        if back.notes:
            detected += 1
            continue
        np.testing.assert_array_equal(back.q, trace.q)
        np.testing.assert_array_equal(back.u, trace.u)
        assert len(back.phases) == len(trace.phases)
    assert detected > 18


# ---------------------------------------------------------------------- impossible values


def edited(path, target, topic, change):
    """Copy a bag; `change` gets each message of a topic and its number, and may alter it."""
    count = 0

    def edit(name, time, message):
        nonlocal count
        change(count, message)
        count += 1
        return time, message

    return rewrite(path, target, edit=edit, edits=topic)


@pytest.mark.parametrize("seconds", [2_145_916_800, -5, 0], ids=["2038", "before 1970", "the beginning"])
@pytest.mark.parametrize("part", [0.0, 0.5, 0.99, 1.0])
def test_a_state_with_an_impossible_stamp_is_left_out(trace, path, tmp_path, seconds, part):
    """At most this state is left out, wherever it is."""
    row = int(part * (len(trace) - 1))

    def change(number, message):
        if number == row:
            message.header.stamp.sec = seconds

    back = bag.read(edited(path, tmp_path / "b", "/joint_states", change))
    lost = len(trace) - len(back)
    assert lost <= 1
    np.testing.assert_array_equal(back.q, np.delete(trace.q, row, axis=0) if lost else trace.q)
    assert [p.name for p in back.phases] == [p.name for p in trace.phases]


def test_a_state_stamped_five_seconds_ahead_is_left_out(trace, path, tmp_path):
    def change(number, message):
        if number == len(trace) - 4:
            message.header.stamp.sec += 5

    back = bag.read(edited(path, tmp_path / "b", "/joint_states", change))
    assert len(back) == len(trace) - 1
    assert "1 states with an impossible stamp are left out" in back.notes
    assert back.finished


def test_states_of_one_stamp_are_no_walk(trace, path, tmp_path):
    """All but one had been dropped, and this one state was reported as a walk that is OK as far as it is recorded."""

    def change(_number, message):
        message.header.stamp.sec = message.header.stamp.nanosec = 0

    with pytest.raises(BagError, match=f"all {len(trace)} joint_states have the stamp 0 s; header.stamp must be"):
        bag.read(edited(path, tmp_path / "b", "/joint_states", change))


def nan(number, message):
    message.pose.orientation.x = np.nan


def wrong_phase(text):
    def change(number, message):
        if number == 1:
            message.data = text

    return change


def nan_angles(number, message):
    message.position = message.position * np.nan


def infinite_velocities(number, message):
    if number % 7 == 0:
        message.velocity = np.full_like(message.velocity, (np.inf, -np.inf, np.nan)[number % 3])


def huge_angles(number, message):
    if number == 100:
        message.position = message.position + 1e300


def wrong_solver_values(number, message):
    for status in message.status:
        status.name = "controller: walk"
        time = "0.5 ms" if number % 4 < 2 else "-1"
        status.values = [messages.new("diagnostic_msgs/msg/KeyValue", key="solve time", value=time)]
        if number % 2:
            status.values.append(messages.new("diagnostic_msgs/msg/KeyValue", key="iterations", value="many"))


@pytest.mark.parametrize(
    ("topic", "wrong", "left_out"),
    [
        ("/phase_start", False, [None] * 4),
        ("/phase_start", True, [None] * 4),
        ("/phase", False, [None] * 4),
        ("/com_target", False, [None] * 2),
        ("/swing_target", False, [1, 3]),
        ("/swing_target", True, [1, 3]),
    ],
)
def test_a_lost_message_of_a_phase_start_is_made_up_for_or_its_phase_left_out(
    trace, path, tmp_path, topic, wrong, left_out
):
    """Without it the states of a phase were judged as those of the phase before, or the bag was refused."""
    for k in range(len(left_out)):
        seen = []

        def edit(name, time, message):
            seen.append(name)  # noqa: B023
            if len(seen) - 1 != k:  # noqa: B023
                return time, message
            if topic == "/phase_start":
                nan_angles(0, message)
            elif topic == "/swing_target":
                nan(0, message)
            return (time, message) if wrong else None

        back = bag.read(rewrite(path, tmp_path / f"{k}", edit=edit, edits=topic))
        gone = left_out[k]
        expected = [record for i, record in enumerate(trace.phases) if i != gone]
        assert [record.name for record in back.phases] == [record.name for record in expected]
        for found, record in zip(back.phases, expected, strict=True):
            assert found.time == record.time
            np.testing.assert_array_equal(found.q_start, record.q_start)
            np.testing.assert_allclose(found.x_odom_base, record.x_odom_base, atol=1e-12)
        assert len(back) == len(trace) - (0 if gone is None else len(trace.spans[gone]))
        assert len(back.notes) == (topic != "/com_target"), back.notes
        assert report.report(report.analyse(back))["ok"]


def test_a_lost_phase_start_whose_state_is_damaged_is_taken_from_the_next_one(trace, path, tmp_path):
    numbers = iter(range(len(trace.phases)))
    one = rewrite(
        path, tmp_path / "one", edits="/phase_start", edit=lambda _, *given: None if next(numbers) == 1 else given
    )
    second = trace.phases[1]

    def damage(number, message):
        if number == second.start:
            nan_angles(number, message)

    back = bag.read(edited(one, tmp_path / "two", "/joint_states", damage))
    assert [(record.name, record.time) for record in back.phases] == [(one.name, one.time) for one in trace.phases]
    np.testing.assert_array_equal(back.phases[1].q_start, trace.q[second.start + 1])
    assert all(np.isfinite(record.x_odom_base).all() for record in back.phases)


@pytest.mark.parametrize(
    ("topic", "change", "sentence"),
    [
        ("/phase", wrong_phase("foo/left"), ""),
        ("/phase", wrong_phase("single_support/middle"), ""),
        ("/phase", wrong_phase("\x1b[31m/\x1b[2J"), ""),
        ("/phase_start", nan_angles, "every phase begins with impossible numbers"),
        ("/swing_target", nan, ""),
        ("/base_pose", nan, ""),
        ("/joint_velocity_commands", infinite_velocities, ""),
        ("/joint_states", huge_angles, ""),
        ("/diagnostics", wrong_solver_values, ""),
    ],
    ids=lambda value: value if isinstance(value, str) else getattr(value, "__name__", ""),
)
def test_impossible_values_give_at_most_one_line(path, tmp_path, capsys, monkeypatch, topic, change, sentence):
    monkeypatch.setattr("dqwalk_ros.report.figures.FIGURES", {})
    html = ["--html"] if topic == "/diagnostics" else []
    code, report = reported(edited(path, tmp_path / "b", topic, change), tmp_path / "out", *html)
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert "\x1b" not in said + json.dumps(report, ensure_ascii=False)
    if sentence:
        assert code == 1
        assert report is None
        (line,) = said.strip().splitlines()
        assert sentence in line
    else:
        assert report["walk"]["ticks"] > (100 if topic == "/swing_target" else 400)


def test_phases_whose_states_are_missing_are_not_judged(trace, path, tmp_path):
    """The walk has finished, but of its last phases there is no state: the recording is cut off."""
    last = int(1e9 * trace.phases[1].time)

    def edit(topic, time, message):
        return None if time > last else (time, message)

    code, report = reported(rewrite(path, tmp_path / "b", edit=edit, edits="/joint_states"), tmp_path / "out")
    assert code == 0
    assert report["walk"]["cut"]
    assert not report["walk"]["finished"]
    assert any("after the last state, and is left out" in note for note in report["notes"])


def kept(content, keeps):
    """Return the walk of the messages for which keeps(place in the bag, bytes)."""
    columns = {}
    for topic, column in content.columns.items():
        few = [one for one in zip(column.times, column.order, column.raws, strict=True) if keeps(*one[1:])]
        columns[topic] = storage.Column(column.type, *map(list, zip(*few, strict=True)))
    return bag.read(replace(content, columns=columns))


def test_a_lost_end_of_a_walk_follows_from_its_last_state_and_from_no_other(trace, path, tmp_path):
    """Without the message 'finished' a whole walk was NOT OK: "the walk stopped before its end"."""
    config = load("poppy_dynamic").updated({"gait.steps": 1})  # of which some phases take longer than planned
    model = load_model(config.robot)
    dynamic = simulate(make_controller(config, model), KinematicPlant(model, model.posture(config.standing.posture)))
    bag.write(dynamic, tmp_path / "dynamic")
    for walk, content in ((trace, bag.content_of(path)), (dynamic, bag.content_of(tmp_path / "dynamic"))):
        back = kept(content, lambda _, raw: not raw.endswith(b"finished\0"))
        assert len(back) == len(walk)
        assert back.finished
        assert back.notes == ("the message 'finished' is missing: the last phase is over, and no other has begun",)
        assert report.report(report.analyse(back))["ok"]
        for ticks in (*(span[-1] for span in walk.spans[1:]), *(span[-1] + 1 for span in walk.spans[:-1])):
            end = content.columns["/joint_states"].order[ticks]
            cut = kept(content, lambda order, _: order < end)  # noqa: B023
            assert len(cut) == ticks
            assert not cut.finished


@pytest.mark.parametrize(
    "stamp", [0, None, 19 * 10**17], ids=["unstamped", "with the stamps of the robot", "of another clock"]
)
def test_the_states_of_a_gripper_hide_none_of_the_robot(trace, path, stamp):
    """Those with the stamp of a state replaced it; others were restarts, and only the last run was read."""
    content = bag.content_of(path)
    found, both = content.columns["/joint_states"], storage.Column("sensor_msgs/msg/JointState")
    own = messages.joint_states(found, trace.model.joint_names).stamps.tolist()
    for time, order, raw, at in zip(found.times, found.order, found.raws, own, strict=True):
        at = at if stamp is None else stamp
        gripper = messages.stamped(both.type, stamp=at, name=["gripper"], position=np.array([0.1]))
        for one in (messages.serialize(gripper), raw):
            both.times.append(time), both.order.append(order), both.raws.append(one)
    back = bag.read(replace(content, columns=content.columns | {"/joint_states": both}))
    np.testing.assert_array_equal(back.q, trace.q)
    np.testing.assert_array_equal(back.u, trace.u)
    assert back.finished
    assert not back.notes


def test_a_text_that_is_damaged_does_not_hide_the_walk(trace, path):
    content = bag.content_of(path)
    found = content.columns["/phase"]
    for row in range(0, len(found.raws), 3):
        found.raws[row] = found.raws[row][:8] + b"\xff\xfe" + found.raws[row][10:]
    read = bag.read(content)
    assert read.finished
    assert [one.name for one in read.phases] == [one.name for one in trace.phases]


def test_topics_of_another_bag_are_shortened(path, tmp_path):
    """Escape sequences and long lists of topic names are not printed."""
    names = iter([f"/\x1b[31m{'x' * 300}{k}" for k in range(20)])
    other = rewrite(path, tmp_path / "b", rename=lambda topic: next(names))
    with pytest.raises(BagError, match="is not a walk") as raised:
        bag.read(other)
    assert len(str(raised.value)) < 1200 + len(str(other))
    assert str(raised.value).isprintable()


# ---------------------------------------------------------------------- memory and time


def chunk_bomb(folder):
    """Write MCAP files of 96 kB with a chunk that decompresses to 3 GB."""
    out = folder / "chunk.mcap"
    with out.open("wb") as file:
        writer = McapWriter(file, chunk_size=1 << 30, compression=CompressionType.NONE)
        writer.start("ros2", "")
        writer.finish()
    packer = zstandard.ZstdCompressor(level=3).compressobj()
    data = b"".join([*(packer.compress(bytes(1 << 20)) for _ in range(3000)), packer.flush()])
    body = b"".join(
        [
            bytes(16),
            (3000 << 20).to_bytes(8, "little"),
            bytes(4),
            b"\x04\0\0\0zstd",
            len(data).to_bytes(8, "little"),
            data,
        ]
    )
    head = out.read_bytes()[:8]
    out.write_bytes(head + b"\x06" + len(body).to_bytes(8, "little") + body)
    lying = body[:16] + (1 << 20).to_bytes(8, "little") + body[24:]
    (folder / "lying.mcap").write_bytes(head + b"\x06" + len(lying).to_bytes(8, "little") + lying)
    (folder / "file.mcap.zstd").write_bytes(data)
    base = sqlite3.connect(folder / "message.db3")
    base.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT)")
    base.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
    base.execute("INSERT INTO topics VALUES (1, '/joint_states', 'sensor_msgs/msg/JointState')")
    base.execute("INSERT INTO messages VALUES (1, 1, 0, ?)", (data,))
    base.commit()
    base.close()


def endless_view(path, folder):
    """Write an SQLite bag in which `messages` is an infinite recursive view."""
    file = rewrite(path, folder / "view", storage=StoragePlugin.SQLITE3) / "view.db3"
    base = sqlite3.connect(file)
    base.execute("DROP TABLE messages")
    base.execute(
        "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n) "
        "SELECT id, 1 AS topic_id, id AS timestamp, zeroblob(1000) AS data FROM n"
    )
    base.commit()
    base.close()
    shutil.copy(file, folder / "bare_view.db3")


def changing_names(path, folder):
    """Write a bag in which each state has 40 joints that are in no other state."""

    def edit(topic, time, message):
        if topic == "/joint_states":
            own = [f"joint_{time}_{k}" for k in range(40)]
            message.name = [*message.name, *own]
            message.position = np.append(message.position, np.zeros(40))
            message.velocity = np.append(message.velocity, np.zeros(40))
        return time, message

    rewrite(path, folder / "names", edit=edit)


@pytest.mark.long
def test_memory_and_time_are_bounded(path, tmp_path):
    """All are read in one process, which stays below 500 MB."""
    bags = tmp_path / "bags"
    bags.mkdir()
    chunk_bomb(bags)
    endless_view(path, bags)
    changing_names(path, bags)
    os.mkfifo(bags / "pipe.mcap")
    (bags / "zero.mcap").symlink_to("/dev/zero")
    script = textwrap.dedent(
        """
        import json, pathlib, re, sys, time
        from dqwalk_ros.support.errors import BagError
        from dqwalk_ros.report import bag
        from dqwalk_ros.report.bag.messages import diagnostics_of
        for file in sorted(pathlib.Path(sys.argv[1]).iterdir()):
            began = time.process_time()
            try:
                said = f"{len(bag.read(file))} states"
                diagnostics_of(file)
            except BagError as error:
                said = str(error)
            print(json.dumps([file.name, said, time.process_time() - began]))
        # ru_maxrss would contain the memory of the process that forked this one
        print(re.search(r"VmHWM:\\s*(\\d+)", pathlib.Path("/proc/self/status").read_text())[1])
        """
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(bags)],
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (120, 120)),
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},  # compilation would need additional memory
    )
    assert done.returncode == 0, done.stderr
    *lines, most = done.stdout.splitlines()
    said = {name: text for name, text, _ in map(json.loads, lines)}
    assert said.pop("names") == "581 states"
    assert len(said) == 8, said
    assert "not a regular file" in said["pipe.mcap"]
    assert "not a regular file" in said["zero.mcap"]
    assert "is larger than any walk" in said["file.mcap.zstd"]
    assert "a chunk or message of 3000 MB" in said["chunk.mcap"]
    assert "it has no tables" in said["view"]
    assert all("\n" not in text and len(text) < 400 for text in said.values()), said
    assert all(seconds < 10.0 for _, _, seconds in map(json.loads, lines)), lines
    assert int(most) < 500_000  # kB


# ---------------------------------------------------------------------- recorded on another machine


def test_bags_of_another_machine_are_read(trace, tmp_path):
    assert trace.finished
    assert trace.notes == ()
    assert len(trace) == 581
    assert trace.origin["host"] == "recorded before"
    assert [p.name for p in trace.phases] == [
        "double_support/left", "single_support/left", "double_support/right", "single_support/right",
    ]  # fmt: skip
    code, report = reported(RECORDED / "walk", tmp_path / "out")
    assert code == 0
    assert report["walk"]["steps"] == 2
    body = read_body(RECORDED / "whole_body")
    assert len(body) == 40
    assert body.notes == ()
    assert body.scenario.targets == ((0.0, (0.5, -0.4, 0.9)),)
