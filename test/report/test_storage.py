"""Bags with more in them than a walk: what is foreign or large is skipped, what is a copy is left out."""

from __future__ import annotations

import errno
import json
import os
import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from recorded import rewrite
from rosbags.rosbag2 import StoragePlugin

from dqwalk_ros import cli
from dqwalk_ros.report import bag
from dqwalk_ros.support.errors import BagError

RECORDED = Path(__file__).parents[1] / "data" / "recorded" / "walk"
STATES = 581
LARGE = 17 << 20


def copied(target: Path, foreign: str, compression: CompressionType, chunked: bool) -> None:
    """Copy the recorded walk, as the program of a robot with more sensors would have recorded it."""
    rng = np.random.default_rng(1)
    with next(RECORDED.glob("*.mcap")).open("rb") as source, target.open("wb") as out:
        writer = McapWriter(out, compression=compression, use_chunking=chunked)
        writer.start("ros2", "test")
        text = writer.register_schema("sensor_msgs/msg/Image", "ros2msg", b"")
        state = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", b"")
        more = {
            "no schema": writer.register_channel("/status", "json", 0),
            "no schema, a topic of the walk": writer.register_channel("/joint_states", "", 0),
            "another encoding": writer.register_channel("/joint_states", "json", state),
            "a large image": writer.register_channel("/camera/image", "cdr", text),
            "a large state": writer.register_channel("/joint_states", "cdr", state),
        }
        channels: dict[int, int] = {}
        for k, (schema, channel, message) in enumerate(make_reader(source).iter_messages()):
            if channel.id not in channels:
                assert schema is not None
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, "cdr", number)
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
            if k in (100, 1000):
                data = rng.bytes(LARGE) if "large" in foreign else b"{}"
                writer.add_message(more[foreign], message.log_time, data, message.publish_time)
        writer.finish()


@pytest.mark.parametrize("code", [errno.EACCES, errno.ENOSPC])
@pytest.mark.parametrize("suffix", ["mcap", "db3"])
def test_a_file_that_cannot_be_read_is_not_called_damaged(
    suffix: str, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / f"walk.{suffix}").write_bytes(b"")

    def refused(*_: object, **__: object) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(Path, "open", refused)
    with pytest.raises(BagError, match=f"cannot read '.*walk.{suffix}': {os.strerror(code)}$"):
        bag.read(tmp_path)


@pytest.mark.parametrize("length", [1 << 62, (1 << 63) + 5, (1 << 64) - 1])
def test_a_record_of_an_impossible_length_is_where_a_file_is_cut_off(length: int, tmp_path: Path) -> None:
    (tmp_path / "walk.mcap").write_bytes(b"\x89MCAP0\r\n\x01" + length.to_bytes(8, "little"))
    with pytest.raises(BagError, match=r"damaged or cut off \(its last record is incomplete\)"):
        bag.read(tmp_path)


@pytest.mark.parametrize("foreign", ["no schema", "no schema, a topic of the walk", "another encoding"])
def test_messages_of_other_programs_are_skipped(foreign: str, tmp_path: Path) -> None:
    copied(tmp_path / "walk.mcap", foreign, CompressionType.ZSTD, True)
    walked = bag.read(tmp_path / "walk.mcap")
    assert (len(walked), walked.finished, walked.cut, walked.notes) == (STATES, True, False, ())


@pytest.mark.parametrize(
    ("compression", "chunked"),
    [(CompressionType.NONE, False), *((kind, True) for kind in CompressionType)],  # only chunks are compressed
)
@pytest.mark.parametrize("foreign", ["a large image", "a large state"])
def test_large_messages_are_skipped(foreign: str, compression: CompressionType, chunked: bool, tmp_path: Path) -> None:
    copied(tmp_path / "walk.mcap", foreign, compression, chunked)
    walked = bag.read(tmp_path / "walk.mcap")
    assert (len(walked), walked.finished, walked.cut, walked.notes) == (STATES, True, False, ())


def test_damage_in_a_chunk_with_a_large_message_is_detected(tmp_path: Path) -> None:
    copied(tmp_path / "walk.mcap", "a large image", CompressionType.NONE, True)
    data = bytearray((tmp_path / "walk.mcap").read_bytes())
    data[9 * len(data) // 10] ^= 1  # in the second image
    (tmp_path / "walk.mcap").write_bytes(data)
    walked = bag.read(tmp_path / "walk.mcap")
    assert walked.cut
    assert "checksum is wrong" in walked.notes[0]


def test_large_messages_are_skipped_in_sqlite(tmp_path: Path) -> None:
    file = rewrite(RECORDED, tmp_path / "walk", storage=StoragePlugin.SQLITE3) / "walk.db3"
    base = sqlite3.connect(file)
    (number,) = base.execute("SELECT id FROM topics WHERE name = '/joint_states'").fetchone()
    base.execute("INSERT INTO topics(id, name, type, serialization_format, offered_qos_profiles, type_description_hash)"
                 " VALUES (90, '/camera', 'sensor_msgs/msg/Image', 'cdr', '', ''),"
                 " (91, '/joint_states', 'sensor_msgs/msg/JointState', 'json', '', '')")  # fmt: skip
    row = "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, 1, ?)"
    base.executemany(row, [(90, bytes(LARGE)), (number, bytes(LARGE)), (91, b"{}")])
    base.commit()
    base.close()
    walked = bag.read(tmp_path / "walk")
    assert (len(walked), walked.finished, walked.cut, walked.notes) == (STATES, True, False, ())


def test_a_recording_that_is_cut_off_is_no_verdict_on_the_robot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The walk until then is judged; whether it was finished is not known."""
    data = next(RECORDED.glob("*.mcap")).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: 3 * len(data) // 4])
    assert cli.main(["report", str(tmp_path / "cut.mcap"), "--no-figures", "--out", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    assert "NOT OK" not in shown
    assert "the recording is cut off" in shown
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert report["ok"]
    assert report["walk"]["cut"]
    assert not report["walk"]["finished"]


@pytest.mark.parametrize("suffix", ["mcap", "mcap.zstd"])
@pytest.mark.parametrize("part", [1.0, 0.7])
def test_copies_of_a_recording_are_left_out(suffix: str, part: float, tmp_path: Path) -> None:
    """Two of them compressed, or one of them the beginning of the other."""
    file = next(RECORDED.glob("*.mcap"))
    packed = zstandard.compress(file.read_bytes())
    (tmp_path / "walk_0.mcap.zstd").write_bytes(packed)
    data = packed if suffix == "mcap.zstd" else file.read_bytes()
    (tmp_path / f"copy_0.{suffix}").write_bytes(data[: int(part * len(data))])
    shutil.copy(RECORDED / "metadata.yaml", tmp_path)
    walked = bag.read(tmp_path)
    assert (len(walked), walked.finished, walked.cut) == (STATES, True, False)
    (note,) = walked.notes
    assert "is a copy of walk_0.mcap.zstd and is left out" in note or part == 1.0
    assert "is a copy of" in note
