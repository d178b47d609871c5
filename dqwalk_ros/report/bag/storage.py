"""The raw messages of a rosbag2: MCAP or SQLite, one file or many, compressed, or cut off by a crash.

`rosbags` reads what is whole. What it refuses is read file by file up to the damage: MCAP with `mcap`,
including what the last, unfinished chunk still holds, and SQLite row by row.
"""

from __future__ import annotations

import io
import re
import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import lz4.frame
import zstandard
from mcap.records import Channel, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.rosbag2 import Reader

from dqwalk_ros.errors import BagError

__all__ = ["Column", "Content", "load"]

_ZSTD = b"\x28\xb5\x2f\xfd"
_CHUNK = 0x06
_Item = tuple[str, str, int, bytes]  # topic, type, time [ns], message


@dataclass
class Column:
    """All messages of one topic, in the order of the bag.

    Attributes
    ----------
    type : str
    times : list of int [ns]
        When each was recorded.
    raws : list of bytes
    """

    type: str
    times: list[int] = field(default_factory=list)
    raws: list[bytes] = field(default_factory=list)


@dataclass(frozen=True)
class Content:
    """What a bag holds: the columns asked for, the name and type of everything, and what is wrong with it."""

    columns: dict[str, Column]
    topics: dict[str, str]
    notes: tuple[str, ...]


def load(path: Path, wanted: Callable[[str, str], bool]) -> Content:
    """Read every message of the topics for which ``wanted(name, type)``.

    Raises
    ------
    BagError
        If there is no bag at `path`, or nothing in it can be read.
    """
    if not path.exists():
        raise BagError(f"no bag at '{path}'")
    files = _files(path)
    if not files:
        raise BagError(f"'{path}' is no rosbag2: it holds no .mcap or .db3 file")
    try:
        return _gather(_whole(path, wanted))
    except BagError:
        raise
    except Exception as error:  # whatever damage or a missing metadata.yaml makes the reader raise
        reason = str(error)
    notes: list[str] = []
    if path.is_dir() and not (path / "metadata.yaml").exists():
        notes.append("metadata.yaml is missing: the recorder did not end as it should")
    content = _gather(item for file in files for item in _file(file, wanted, notes))
    if not content.columns:
        raise BagError(f"cannot read '{path}': {reason}")
    return Content(content.columns, content.topics, tuple(notes or [f"the bag is damaged: {reason}"]))


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    files = [file for file in path.iterdir() if re.search(r"\.(mcap|db3)(\.zstd)?$", file.name)]
    return sorted(files, key=lambda file: [int(s) if s.isdigit() else s for s in re.split(r"(\d+)", file.name)])


def _gather(items: Iterator[_Item]) -> Content:
    columns: dict[str, Column] = {}
    topics: dict[str, str] = {}
    for topic, kind, time, raw in items:
        topics[topic] = kind
        if time < 0:  # the topic alone
            continue
        column = columns.get(topic)
        if column is None:
            column = columns[topic] = Column(kind)
        column.times.append(time)
        column.raws.append(raw)
    return Content(columns, topics, ())


def _whole(path: Path, wanted: Callable[[str, str], bool]) -> Iterator[_Item]:
    with Reader(path) as reader:
        for connection in reader.connections:
            yield connection.topic, connection.msgtype, -1, b""
        chosen = [c for c in reader.connections if wanted(c.topic, c.msgtype)]
        if not chosen:
            return
        for connection, time, raw in reader.messages(chosen):
            yield connection.topic, connection.msgtype, time, bytes(raw)


def _file(file: Path, wanted: Callable[[str, str], bool], notes: list[str]) -> Iterator[_Item]:
    """Read one file as far as it goes; say in `notes` where that is not its end."""
    count = 0
    source = _mcap if ".mcap" in file.name else _sqlite
    try:
        for item in source(file):
            count += item[2] >= 0
            if item[2] < 0 or wanted(item[0], item[1]):
                yield item
    except Exception as error:  # whatever damage makes a parser raise
        what = str(error) or type(error).__name__
        notes.append(f"{file.name} is damaged or cut off ({what}): {count} messages recovered")


def _mcap(file: Path) -> Iterator[_Item]:
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    with file.open("rb") as raw:
        stream: IO[bytes] = _inflated(raw) if file.suffix == ".zstd" else raw
        for record in _records(stream):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
                yield record.topic, schemas[record.schema_id].name, -1, b""
            elif isinstance(record, Message) and record.channel_id in channels:
                channel = channels[record.channel_id]
                data = record.data
                if data[:4] == _ZSTD:  # compressed message by message; CDR never begins like this
                    data = zstandard.decompress(data)
                yield channel.topic, schemas[channel.schema_id].name, record.log_time, data


def _records(stream: IO[bytes]) -> Iterator[McapRecord]:
    """Yield records, and those of a chunk that was not written to its end, then raise."""
    records = StreamReader(stream).records
    while True:
        start = stream.tell()
        try:
            record = next(records, None)
        except Exception:
            stream.seek(start)
            yield from _unfinished_chunk(stream.read())
            raise
        if record is None:
            return
        yield record


def _unfinished_chunk(raw: bytes) -> Iterator[McapRecord]:
    """Yield the records in front of the damage; `raw` begins with a chunk that ends early, or something else."""
    head = struct.Struct("<BQQQQII")  # opcode, length, first and last time, size, checksum, length of the next text
    if len(raw) < head.size or raw[0] != _CHUNK:
        return
    at = head.size + head.unpack_from(raw)[-1]
    compression = raw[head.size : at]
    data = raw[at + 8 :]
    try:
        if compression == b"zstd":
            data = zstandard.ZstdDecompressor().decompressobj().decompress(data)
        elif compression == b"lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(data)
        yield from StreamReader(io.BytesIO(data), skip_magic=True).records
    except Exception:  # the end of what there is
        return


def _inflated(raw: IO[bytes]) -> IO[bytes]:
    """Return a file compressed as a whole, up to where it is cut off."""
    out, engine = io.BytesIO(), zstandard.ZstdDecompressor().decompressobj()
    while block := raw.read(1 << 20):
        out.write(engine.decompress(block))
    out.seek(0)
    return out


def _sqlite(file: Path) -> Iterator[_Item]:
    query = "SELECT topics.name, topics.type, timestamp, data FROM messages JOIN topics ON topics.id = topic_id"
    with tempfile.TemporaryDirectory() as scratch:
        file = _of_full_length(file, Path(scratch))
        with closing(sqlite3.connect(f"file:{file}?mode=ro", uri=True)) as connection:
            for name, kind in connection.execute("SELECT name, type FROM topics"):
                yield name, kind, -1, b""
            for name, kind, time, data in connection.execute(f"{query} ORDER BY messages.id"):
                yield name, kind, time, zstandard.decompress(data) if data[:4] == _ZSTD else data


def _of_full_length(file: Path, scratch: Path) -> Path:
    """Return the database, or a copy with holes where it is cut off: SQLite opens none that is shorter than it says."""
    if file.suffix == ".zstd":
        with file.open("rb") as raw:
            (scratch / file.stem).write_bytes(_inflated(raw).read())
        file = scratch / file.stem
    with file.open("rb") as raw:
        head = raw.read(32)
    size = int.from_bytes(head[16:18], "big") * int.from_bytes(head[28:32], "big")  # of a page, number of pages
    if file.stat().st_size >= size:
        return file
    copy = Path(shutil.copy(file, scratch / "copy.db3"))
    with copy.open("r+b") as raw:
        raw.truncate(size)
    return copy
