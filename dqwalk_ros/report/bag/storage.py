"""Reads and writes the serialised messages of a rosbag2, also of a damaged one.

Bags are written by `rosbags`. They are read in the order of the file, with `mcap` and SQLite, because the reader of
`rosbags` rejects a truncated recording and decompresses without a limit. Here memory and time are bounded by the size
of the bag, every checksum is verified, and a damaged file is read up to the damage.
"""

from __future__ import annotations

import io
import os
import re
import shutil
import sqlite3
import stat
import struct
import tempfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import IO, Any

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Footer, Schema, Statistics
from numpy.typing import NDArray
from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer, WriterError
from rosbags.typesys import Stores, get_typestore

from dqwalk_ros.support.errors import BagError
from dqwalk_ros.support.topics import BODY_TOPICS, TOPICS, Topic

__all__ = [
    "Column", "Content", "Source", "connect", "content_of", "flush", "load", "open_writer", "typestore",
    "write_columns",
]  # fmt: skip


@cache
def typestore() -> Any:
    """Return the message definitions of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


# ---------------------------------------------------------------------- writing

_FOREVER = QosTime(sec=9223372036, nsec=854775807)  # RMW_DURATION_INFINITE


def open_writer(path: Path) -> Writer:
    """Return a writer of a new bag, an MCAP file whose chunks are compressed and carry a checksum.

    Raises
    ------
    BagError
        If the folder exists already, or cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        writer.open()
    except (OSError, WriterError) as error:
        raise BagError(f"cannot write '{path}': {error}") from error
    storage: Any = writer.storage
    storage.compressor = zstandard.ZstdCompressor(write_checksum=True).compress  # rosbags writes no checksum
    return writer


def connect(writer: Writer, name: str, topic: Topic) -> Connection:
    """Return the connection for writing the messages of a topic under the full name `name`."""
    qos = Qos(
        history=QosHistory.KEEP_LAST,
        depth=topic.depth,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if topic.latched else QosDurability.VOLATILE,
        deadline=_FOREVER,
        lifespan=_FOREVER,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_FOREVER,
        avoid_ros_namespace_conventions=False,
    )
    return writer.add_connection(name, topic.type, typestore=typestore(), offered_qos_profiles=[qos])


def flush(writer: Writer) -> None:
    """Write the buffered messages of an open writer to the file, so that they survive a kill of the process."""
    storage: Any = writer.storage  # rosbags buffers up to a megabyte, which is many seconds of walking
    if storage is not None and storage.chunk.msgs:
        storage.close_chunk()
        storage.bio.flush()


def write_columns(
    path: str | os.PathLike[str],
    topics: Mapping[str, Topic],
    columns: Iterable[tuple[str, NDArray[np.int64], Sequence[bytes]]],
    *,
    overwrite: bool,
) -> None:
    """Write the bag `path`, which is created when it is complete.

    Parameters
    ----------
    topics : mapping of str to Topic
        All topics of the bag.
    columns : iterable of (str, ndarray of int64, sequence of bytes)
        Topic, stamps [ns] and messages; at the same stamp they are written in the order of the columns.
    overwrite : bool
        Replace an existing file or folder.

    Raises
    ------
    BagError
        If the folder exists already, or cannot be written.
    """
    target = Path(path)
    if target.exists() and not overwrite:
        raise BagError(f"'{target}' exists already; choose another folder, or overwrite it")
    entries = [
        (stamp, order, name, raw)
        for order, (name, stamps, raws) in enumerate(columns)
        for stamp, raw in zip(stamps.tolist(), raws, strict=True)
    ]
    entries.sort(key=lambda entry: entry[:2])
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=target.parent, prefix=f".{target.name}-") as scratch:
            made, due = Path(scratch) / target.name, 0
            with closing(open_writer(made)) as writer:
                connections = {name: connect(writer, "/" + name, topic) for name, topic in topics.items()}
                for stamp, _, name, raw in entries:
                    writer.write(connections[name], stamp, raw)
                    if stamp >= due:  # so that damage costs at most one second
                        due = stamp + 1_000_000_000
                        flush(writer)
            if target.is_dir():
                shutil.rmtree(target)
            elif target.exists():
                target.unlink()
            made.rename(target)
    except (OSError, WriterError) as error:
        raise BagError(f"cannot write '{target}': {error}") from error


# ---------------------------------------------------------------------- reading

_MOST = 16 << 20
"""Largest message or chunk that is read [bytes]; writers make chunks of about one megabyte."""
_ROOM, _RATIO = 64 << 20, 200
"""Largest decompressed size of a bag: this many bytes plus this many times its size on disk. States of a robot that
stands still are compressed to a fiftieth."""
_MAGIC = b"\x89MCAP0\r\n"
_ZSTD = b"\x28\xb5\x2f\xfd"
_HEAD = struct.Struct("<BQ")  # head of every record of an MCAP file: opcode, length
_MESSAGE = struct.Struct("<HIQQ")  # head of a message, most of the records: channel, number, times [ns]
_Item = tuple[str, str, int, bytes | None]  # topic, type, time of recording [ns], message; None only names the topic


@dataclass
class Column:
    """All messages of one topic, in the order of the bag.

    Attributes
    ----------
    times : list of int [ns]
        When each was recorded.
    order : list of int
        Position of each among all messages of the bag.
    """

    type: str
    times: list[int] = field(default_factory=list)
    order: list[int] = field(default_factory=list)
    raws: list[bytes] = field(default_factory=list)

    def since(self, place: int) -> Column:
        """Return the messages from a position in the bag on, or the last message of all if none is that late."""
        first = next((i for i, order in enumerate(self.order) if order >= place), max(len(self.order) - 1, 0))
        return Column(self.type, self.times[first:], self.order[first:], self.raws[first:])


@dataclass(frozen=True)
class Content:
    """Content of a bag at `path`: the requested columns, name and type of every topic, and notes on damage."""

    path: Path
    columns: dict[str, Column]
    topics: dict[str, str]
    notes: tuple[str, ...]


Source = str | os.PathLike[str] | Content
"""A bag: its folder, one of its files, or its content as of `content_of`."""


class _Damage(Exception):
    """A file cannot be read beyond here."""


def load(path: str | os.PathLike[str], wanted: Callable[[str, str], bool]) -> Content:
    """Read every message of the topics for which ``wanted(name, type)``.

    Parameters
    ----------
    path : path-like
        A bag's folder, or one of its files: MCAP or SQLite, split, compressed, or cut off by a crash.

    Raises
    ------
    BagError
        If there is no bag at `path`, nothing in it can be read, or its decompressed size is too large.
    """
    path = Path(path)
    if not path.exists():
        raise BagError(f"no bag at '{path}'")
    files = _files(path)
    if not files:
        inside = f"; did you mean '{path / 'bag'}'?" if (path / "bag").is_dir() else ""
        raise BagError(f"'{path}' is not a rosbag2: it contains no .mcap or .db3 file{inside}")
    is_wanted = cache(wanted)
    columns: dict[str, Column] = {}
    topics: dict[str, str] = {}
    notes: list[str] = []
    if path.is_dir() and not (path / "metadata.yaml").exists():
        notes.append("metadata.yaml is missing: the recorder was not shut down properly")
    place = 0
    for file in files:
        before, reason = place, ""
        try:
            for topic, kind, time, raw in _messages(file):
                topics[topic] = kind
                if raw is None:
                    continue
                place += 1
                if is_wanted(topic, kind):
                    if topic not in columns:
                        columns[topic] = Column(kind)
                    column = columns[topic]
                    column.times.append(time)
                    column.order.append(place)
                    column.raws.append(raw)
        except BagError:
            raise
        except sqlite3.DatabaseError as error:
            reason = f"{error}; the .recover command of sqlite3 may save what is left"
        except Exception as error:  # damaged bytes may raise any exception in a parser
            reason = str(error) or type(error).__name__
        if reason:
            notes.append(f"{file.name} is damaged or cut off ({reason}): {place - before} messages recovered")
    if not topics:
        raise BagError(f"cannot read '{path}': {'; '.join(notes) or 'it contains no topic'}")
    return Content(path, columns, topics, tuple(notes))


_TYPES = {name: topic.type for name, topic in (TOPICS | BODY_TOPICS).items()}


def content_of(source: Source) -> Content:
    """Return a bag's messages on the topics of both kinds of walk, and all diagnostics; errors are those of `load`."""
    if isinstance(source, Content):
        return source
    return load(source, lambda topic, kind: kind in (_TYPES["diagnostics"], _TYPES.get(topic.rpartition("/")[2])))


def _files(path: Path) -> list[Path]:
    """Return the files of a bag in the order of their numbers."""
    files = [path]
    if path.is_dir():
        files = [file for file in path.iterdir() if re.search(r"\.(mcap|db3)(\.zstd)?$", file.name)]
    for file in files:
        if not stat.S_ISREG(file.stat().st_mode):
            raise BagError(f"'{file}' is not a regular file")
    return sorted(files, key=lambda file: [int(s) if s.isdigit() else s for s in re.split(r"(\d+)", file.name)])


def _messages(file: Path) -> Iterator[_Item]:
    status = file.stat()  # st_blocks: a sparse file may be much smaller than its nominal size
    room = _Room(_ROOM + _RATIO * min(status.st_size, 512 * status.st_blocks))
    with tempfile.TemporaryDirectory() as scratch:
        if file.suffix == ".zstd":
            plain = Path(scratch) / file.stem
            with file.open("rb") as packed, plain.open("wb") as out:
                for block in iter(partial(zstandard.ZstdDecompressor().stream_reader(packed).read, 1 << 20), b""):
                    room.take(len(block))
                    out.write(block)
            file = plain
        if file.suffix == ".db3":
            yield from _sqlite(file, room)
        else:
            with file.open("rb") as stream:
                yield from _mcap(stream, room)


class _Room:
    """Limits the decompressed size of a file."""

    def __init__(self, left: int) -> None:
        self._left = left

    def take(self, size: int) -> None:
        """Count `size` bytes more."""
        self._left -= size
        if self._left < 0:
            raise BagError("the decompressed bag is larger than any walk: it is damaged, or not a bag of a walk")


def _inflate(data: bytes, compression: str, size: int) -> bytes:
    """Return `data` decompressed, at most `size` + 1 bytes."""
    if size > _MOST:
        raise _Damage(f"a chunk or message of {size >> 20} MB")
    if compression == "zstd":
        data = zstandard.ZstdDecompressor().stream_reader(io.BytesIO(data)).read(size + 1)
    elif compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    elif compression:
        raise _Damage(f"unknown compression {compression!r}")
    return data


def _message(data: bytes, room: _Room) -> bytes:
    if data[:4] == _ZSTD:  # compressed message by message; CDR never begins with these bytes
        data = _inflate(data, "zstd", _MOST)
    room.take(len(data))
    return data


def _mcap(stream: IO[bytes], room: _Room) -> Iterator[_Item]:
    schemas: dict[int, str] = {}
    channels: dict[int, tuple[str, str]] = {}
    count, ended = 0, False
    if stream.read(len(_MAGIC)) != _MAGIC:
        raise _Damage("it is not an MCAP file")
    for opcode, body in _records(stream, room):
        if opcode == Opcode.MESSAGE:
            count += 1
            channel, _, time, _ = _MESSAGE.unpack(body[: _MESSAGE.size])
            yield *channels[channel], time, _message(body[_MESSAGE.size :], room)
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(io.BytesIO(body)))
            schemas[schema.id] = schema.name
        elif opcode == Opcode.CHANNEL:
            found = Channel.read(ReadDataStream(io.BytesIO(body)))
            channels[found.id] = found.topic, schemas[found.schema_id]
            yield *channels[found.id], 0, None
        elif opcode == Opcode.STATISTICS:
            stated = Statistics.read(ReadDataStream(io.BytesIO(body))).message_count
            if stated != count:
                raise _Damage(f"its statistics state {stated} messages")
        elif opcode == Opcode.FOOTER:
            Footer.read(ReadDataStream(io.BytesIO(body)))
        ended = opcode == Opcode.FOOTER
    if not ended:
        raise _Damage("its end is missing")


def _records(stream: IO[bytes], room: _Room) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of the records of an MCAP file one by one, with the records of a chunk at its position.

    `mcap.stream_reader.StreamReader` would read gigabytes of zeros, and decompress chunks without a limit.
    """
    while head := stream.read(_HEAD.size):
        opcode, length = _HEAD.unpack(head)
        if not (0 < opcode <= Opcode.DATA_END or opcode >= 0x80) or length > 2 * _MOST:
            raise _Damage("the next bytes are not a record")
        body = stream.read(length)
        if opcode == Opcode.CHUNK:
            chunk = Chunk.read(ReadDataStream(io.BytesIO(body)))
            data = _inflate(chunk.data, chunk.compression, chunk.uncompressed_size)
            if len(body) == length and (
                len(data) != chunk.uncompressed_size or chunk.uncompressed_crc not in (0, zlib.crc32(data))
            ):
                raise _Damage("a chunk's checksum is wrong")
            room.take(len(data))
            yield from _records(io.BytesIO(data), room)
        if len(body) < length:
            raise _Damage("its last record is incomplete")
        yield opcode, body
        if opcode == Opcode.FOOTER:
            return


def _sqlite(file: Path, room: _Room) -> Iterator[_Item]:
    with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)) as connection:
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MOST)
        tables: Iterable[tuple[str, str]] = connection.execute("SELECT name, sql FROM sqlite_master")
        plain = {name for name, sql in tables if sql and sql.lstrip().upper().startswith("CREATE TABLE")}
        if not {"topics", "messages"} <= plain:  # a view may be infinite
            raise _Damage("it has no tables of topics and messages")
        for name, kind in connection.execute("SELECT name, type FROM topics"):
            yield name, kind, 0, None
        query = "SELECT name, type, timestamp, data FROM messages JOIN topics ON topics.id = topic_id"
        for name, kind, time, data in connection.execute(f"{query} ORDER BY messages.id"):
            yield name, kind, time, _message(data, room)
