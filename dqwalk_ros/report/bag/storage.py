"""Reads and writes the serialised messages of a rosbag2, also of a damaged one.

Bags are written by `rosbags`. They are read in the order of the file, with `mcap` and SQLite, because the reader of
`rosbags` rejects a truncated recording and decompresses without a limit. Here memory and time are bounded by the size
of the bag, every checksum is verified, and a damaged file is read up to the damage.
"""

from __future__ import annotations

import errno
import io
import os
import re
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
from mcap.records import Channel, Footer, Schema, Statistics
from numpy.typing import NDArray
from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer, WriterError
from rosbags.typesys import Stores, get_typestore

from dqwalk_ros.support.errors import BagError, OutputError
from dqwalk_ros.support.output import refuse_existing, written
from dqwalk_ros.support.topics import BODY_TOPICS, TOPICS, Topic


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
    """Write the buffered messages of an open writer to the file, so that they survive a kill of the process.

    Raises
    ------
    OSError
        If they cannot be written, or the file was removed or replaced.
    """
    storage: Any = writer.storage  # rosbags buffers up to a megabyte, which is many seconds of walking
    if storage is None:
        return
    if storage.chunk.msgs:
        storage.close_chunk()
        storage.bio.flush()
    if not os.path.samestat(os.stat(storage.bio.name), os.fstat(storage.bio.fileno())):
        raise OSError("its file was replaced")


def refuse_other(path: str | os.PathLike[str]) -> None:
    """Raise BagError if there is something else than a bag, which a bag must not replace; a link is replaced."""
    path = Path(path)
    if path.exists() and not path.is_symlink() and not any(path.glob("*.mcap")) and not any(path.glob("*.db3")):
        raise BagError(f"'{path}' is not a bag and is not replaced; choose another folder with --out")


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
    entries = [
        (stamp, order, name, raw)
        for order, (name, stamps, raws) in enumerate(columns)
        for stamp, raw in zip(stamps.tolist(), raws, strict=True)
    ]
    entries.sort(key=lambda entry: entry[:2])
    try:
        if overwrite:
            refuse_other(path)
        else:
            refuse_existing([Path(path)])
        with written(path, overwrite=overwrite) as made, closing(open_writer(made)) as writer:
            due = 0
            connections = {name: connect(writer, "/" + name, topic) for name, topic in topics.items()}
            for stamp, _, name, raw in entries:
                writer.write(connections[name], stamp, raw)
                if stamp >= due:  # so that damage costs at most one second
                    due = stamp + 1_000_000_000
                    flush(writer)
    except (OSError, WriterError, OutputError) as error:
        raise BagError(f"cannot write '{path}': {error}") from error


# ---------------------------------------------------------------------- reading

_MOST = 16 << 20
"""Largest message that is read, and largest chunk that is decompressed in memory [bytes]: writers make chunks of about
one megabyte, and larger ones only for a message that is itself larger, such as an image."""
_ROOM, _RATIO = 256 << 20, 200
"""Largest decompressed size of a bag: this many bytes plus this many times its size on disk. States of a robot that
stands still are compressed to a fiftieth."""
_BLOCK = 1 << 20
"""Size of the blocks in which large records are skipped or decompressed [bytes]."""
_MAGIC = b"\x89MCAP0\r\n"
_ZSTD = b"\x28\xb5\x2f\xfd"
_HEAD = struct.Struct("<BQ")  # head of every record of an MCAP file: opcode, length
_MESSAGE = struct.Struct("<HIQQ")  # head of a message, most of the records: channel, number, times [ns]
_CHUNK = struct.Struct("<QQQII")  # head of a chunk: times [ns], decompressed size, checksum, length of a name
_SIZE = struct.Struct("<Q")
_Wanted = Callable[[str, str], bool]
"""Whether the messages of a topic, given its name and type, are read; all others are skipped by their length."""
_Item = tuple[str, str, int, bytes | None]  # topic, type, time of recording [ns], message; None only names the topic


@dataclass
class Column:
    """All messages of one topic, in the order of the bag."""

    type: str
    times: list[int] = field(default_factory=list)
    """When each was recorded [ns]."""
    order: list[int] = field(default_factory=list)
    """Position of each among all messages of the bag."""
    raws: list[bytes] = field(default_factory=list)

    def since(self, place: int) -> Column:
        """Return the messages from a position in the bag on, or the last message of all if none is that late."""
        first = next((i for i, order in enumerate(self.order) if order >= place), max(len(self.order) - 1, 0))
        return Column(self.type, self.times[first:], self.order[first:], self.raws[first:])


@dataclass(frozen=True)
class Content:
    """Content of a bag at `path`: the requested columns, and name and type of every topic."""

    path: Path
    columns: dict[str, Column]
    topics: dict[str, str]
    notes: tuple[str, ...]
    """Descriptions of damage."""
    cut: bool
    """Whether a file is damaged or cut off, so that messages are missing, most likely the last ones."""


Source = str | os.PathLike[str] | Content
"""A bag: its folder, one of its files, or its content as of `content_of`."""


class _Damage(Exception):
    """A file cannot be read beyond here."""


@dataclass
class _Part:
    """What a file of a bag contains: its wanted messages, its topics, and its damage, empty if there is none."""

    name: str
    found: list[tuple[str, str, int, bytes]] = field(default_factory=list)
    topics: list[tuple[str, str]] = field(default_factory=list)
    damage: str = ""


def load(path: str | os.PathLike[str], wanted: _Wanted) -> Content:
    """Read every message of the topics for which ``wanted(name, type)``.

    Messages of other topics, of another serialisation than CDR, and larger than 16 MiB are skipped.

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
    notes: list[str] = []
    if path.is_dir() and not (path / "metadata.yaml").exists():
        notes.append("metadata.yaml is missing: the recorder was not shut down properly")
    is_wanted = cache(wanted)
    parts = _without_copies([_part_of(file, is_wanted) for file in files], notes)
    notes += [
        f"{one.name} is damaged or cut off ({one.damage}): {len(one.found)} messages recovered"
        for one in parts
        if one.damage
    ]
    topics: dict[str, str] = {}
    for name, kind in (topic for one in parts for topic in one.topics):
        if name not in topics or is_wanted(name, kind):  # channels of several types may share a name
            topics[name] = kind
    if not topics:
        raise BagError(f"cannot read '{path}': {'; '.join(notes) or 'it contains no topic'}")
    columns: dict[str, Column] = {}
    for place, (topic, kind, time, raw) in enumerate(message for one in parts for message in one.found):
        if topic not in columns:
            columns[topic] = Column(kind)
        if (column := columns[topic]).type == kind:
            column.times.append(time)
            column.order.append(place)
            column.raws.append(raw)
    return Content(path, columns, topics, tuple(notes), any(one.damage for one in parts))


def _part_of(file: Path, wanted: _Wanted) -> _Part:
    """Return the content of a file, up to its damage if there is any."""
    out = _Part(file.name)
    try:
        for topic, kind, time, raw in _messages(file, wanted):
            if raw is None:
                out.topics.append((topic, kind))
            else:
                out.found.append((topic, kind, time, raw))
    except BagError:
        raise
    except OSError as error:
        if error.errno != errno.EIO:  # no permission, no room for what is decompressed: not of the file
            raise BagError(f"cannot read '{file}': {error.strerror or error}") from error
        out.damage = str(error)
    except sqlite3.DatabaseError as error:
        out.damage = f"{error}; the .recover command of sqlite3 may save what is left"
    except Exception as error:  # damaged bytes may raise any exception in a parser
        out.damage = str(error) or type(error).__name__
    return out


def _without_copies(parts: Iterable[_Part], notes: list[str]) -> list[_Part]:
    """Return files without those whose messages are the first ones of another file: copies, maybe cut off."""
    out: list[_Part] = []
    for new in parts:
        for k, known in enumerate(out):
            n = min(len(known.found), len(new.found))
            if n and known.found[0] == new.found[0] and known.found[:n] == new.found[:n]:
                less, more = sorted((known, new), key=lambda one: len(one.found))
                notes.append(f"{less.name} is a copy of {more.name} and is left out")
                out[k] = more
                break
        else:
            out.append(new)
    return out


_TYPES = {name: topic.type for name, topic in (TOPICS | BODY_TOPICS).items()}


def content_of(source: Source) -> Content:
    """Return a bag's messages on the topics of both kinds of walk, and all diagnostics; errors are those of `load`."""
    if isinstance(source, Content):
        return source
    return load(source, lambda topic, kind: kind in (_TYPES["diagnostics"], _TYPES.get(topic.rpartition("/")[2])))


def _files(path: Path) -> list[Path]:
    """Return the files of a bag in the order of their numbers."""
    named = re.compile(r"\.(mcap|db3)(\.zstd)?$")
    files = [file for file in path.iterdir() if named.search(file.name)] if path.is_dir() else [path]
    for file in files:
        if not stat.S_ISREG(file.stat().st_mode):
            raise BagError(f"'{file}' is not a regular file")
        if not named.search(file.name):
            with file.open("rb") as stream:
                head = stream.read(len(_MAGIC))
            if head != _MAGIC:
                how = "a bag of ROS 1, which rosbags-convert converts" if head == b"#ROSBAG " else "not a bag of ROS 2"
                raise BagError(f"'{file}' is {how}: it is no .mcap and no .db3 file")
    return sorted(files, key=lambda file: [int(s) if s.isdigit() else s for s in re.split(r"(\d+)", file.name)])


def _messages(file: Path, wanted: _Wanted) -> Iterator[_Item]:
    status = file.stat()  # st_blocks: a sparse file may be much smaller than its nominal size
    room = _Room(_ROOM + _RATIO * min(status.st_size, 512 * status.st_blocks))
    with tempfile.TemporaryDirectory() as scratch:
        if file.suffix == ".zstd":
            plain = Path(scratch) / file.stem
            with file.open("rb") as packed, plain.open("wb") as out:
                for block in _blocks(zstandard.ZstdDecompressor().stream_reader(packed)):
                    room.take(len(block))
                    out.write(block)
            file = plain
        with file.open("rb") as stream:
            if file.suffix == ".db3":
                yield from _sqlite(file, room, wanted)
            else:
                yield from _Mcap(room, wanted).read(stream)


class _Room:
    """Limits the decompressed size of a file; `left` is what is left of it [bytes]."""

    def __init__(self, left: int) -> None:
        self.left = left

    def take(self, size: int) -> None:
        """Count `size` bytes more."""
        self.left -= size
        if self.left < 0:
            raise BagError("the decompressed bag is larger than any walk: it is damaged, or not a bag of a walk")


def _blocks(stream: Any) -> Iterator[bytes]:
    """Yield the rest of a stream in blocks."""
    return iter(partial(stream.read, _BLOCK), b"")


def _inflate(data: bytes, compression: str, size: int) -> bytes:
    """Return `data` decompressed, at most `size` + 1 bytes; of data that are cut off, what they contain."""
    if compression == "lz4":
        plain: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
        return plain
    found: bytes = _opened(io.BytesIO(data), compression).read(size + 1)
    return found


def _opened(data: Any, compression: str) -> Any:
    """Return a stream of what a stream contains in compressed form."""
    if compression == "zstd":
        return zstandard.ZstdDecompressor().stream_reader(data)
    if compression == "lz4":
        return lz4.frame.LZ4FrameFile(data)
    if compression:
        raise _Damage(f"unknown compression {compression!r}")
    return data


def _message(data: bytes, room: _Room) -> bytes:
    if data[:4] == _ZSTD:  # compressed message by message; CDR never begins with these bytes
        data = _inflate(data, "zstd", _MOST)
    room.take(len(data))
    return data


class _Record:
    """The content of a record that begins at the present position of a stream; `left` bytes of it are not yet read."""

    def __init__(self, stream: Any, left: int) -> None:
        self._stream, self.left = stream, left

    def read(self, size: int = -1) -> bytes:
        """Return some bytes, by default all that are left; fewer where the file is cut off."""
        data: bytes = self._stream.read(self.left if size < 0 else min(size, self.left))
        self.left -= len(data)
        return data

    def whole(self, size: int = -1) -> bytes:
        """Return some bytes, by default all that are left, of a record that is not cut off."""
        wanted = self.left if size < 0 else size
        if wanted > _MOST:
            raise _Damage("the next bytes are not a record")
        if len(data := self.read(wanted)) < wanted:
            raise _Damage("its last record is incomplete")
        return data

    def skip(self) -> None:
        """Go to the end of the record."""
        if self.left > _BLOCK and self._stream.seekable():
            try:
                self._stream.seek(self.left - 1, io.SEEK_CUR)
            except (OSError, ValueError):
                raise _Damage("its last record is incomplete") from None
            self.left = 1
        while self.left:
            self.whole(min(self.left, _BLOCK))

    def seekable(self) -> bool:
        """Return that this is no stream in which one can go to another place."""
        return False


class _Mcap:
    """Reads the wanted messages of an MCAP file, record by record, with the records of a chunk at its position.

    `mcap.stream_reader.StreamReader` would read gigabytes of zeros, and decompress chunks without a limit.
    """

    def __init__(self, room: _Room, wanted: _Wanted) -> None:
        self._room, self._wanted = room, wanted
        self._schemas = {0: ""}  # of a channel without a schema
        self._channels: dict[int, tuple[str, str, bool]] = {}
        self._count, self._ended = 0, False

    def read(self, stream: IO[bytes]) -> Iterator[_Item]:
        """Yield the topics and messages of a file."""
        if stream.read(len(_MAGIC)) != _MAGIC:
            raise _Damage("it is not an MCAP file")
        yield from self._records(stream)
        if not self._ended:
            raise _Damage("its end is missing")

    def _records(self, stream: Any) -> Iterator[_Item]:
        while not self._ended and (head := stream.read(_HEAD.size)):
            if len(head) < _HEAD.size:
                raise _Damage("its last record is incomplete")
            opcode, length = _HEAD.unpack(head)
            if not (0 < opcode <= Opcode.DATA_END or opcode >= 0x80):
                raise _Damage("the next bytes are not a record")
            if opcode == Opcode.MESSAGE:
                self._count += 1
                if length <= _MOST:  # most of the records: in few operations
                    body = stream.read(length)
                    if len(body) < length:
                        raise _Damage("its last record is incomplete")
                    channel, _, time, _ = _MESSAGE.unpack_from(body)
                    if channel not in self._channels:
                        raise _Damage(f"a message of channel {channel}, which does not exist")
                    topic, kind, wanted = self._channels[channel]
                    if wanted:
                        yield topic, kind, time, _message(body[_MESSAGE.size :], self._room)
                    continue
            record = _Record(stream, length)
            if opcode == Opcode.CHUNK:
                yield from self._chunk(record, stream)
            elif opcode == Opcode.SCHEMA:
                schema = Schema.read(ReadDataStream(io.BytesIO(record.whole())))
                self._schemas[schema.id] = schema.name
            elif opcode == Opcode.CHANNEL:
                found = Channel.read(ReadDataStream(io.BytesIO(record.whole())))
                kind = _type(self._schemas[found.schema_id], found.message_encoding)
                name = f"/{found.topic.lstrip('/')}"  # which not every writer begins with a slash
                self._channels[found.id] = name, kind, self._wanted(name, kind)
                yield name, kind, 0, None
            elif opcode == Opcode.STATISTICS:
                stated = Statistics.read(ReadDataStream(io.BytesIO(record.whole()))).message_count
                if stated != self._count:
                    raise _Damage(f"its statistics state {stated} messages")
            elif opcode == Opcode.FOOTER:
                Footer.read(ReadDataStream(io.BytesIO(record.whole())))
                self._ended = True
            record.skip()

    def _chunk(self, record: _Record, stream: Any) -> Iterator[_Item]:
        """Yield the items of a chunk: from memory, or from the file if it is large, which is decompressed twice."""
        _, _, size, stated, length = _CHUNK.unpack(record.whole(_CHUNK.size))
        compression = record.whole(length).decode()
        record.whole(_SIZE.size)  # the compressed size is what is left of the record
        if size > self._room.left:
            raise _Damage(f"a chunk or message of {size >> 20} MB")
        begin, left, found, crc = 0, record.left, 0, 0
        if large := size > _MOST or left > 2 * _MOST:
            begin = stream.tell()
            blocks = _blocks(_opened(record, compression))
        else:
            data = _inflate(record.read(), compression, size)
            blocks = iter([data])
        for block in blocks:
            self._room.take(len(block))
            found, crc = found + len(block), zlib.crc32(block, crc)
        if not record.left and (found != size or stated not in (0, crc)):
            raise _Damage("a chunk's checksum is wrong")
        if not large:
            yield from self._records(io.BytesIO(data))
            return
        stream.seek(begin)
        record.left = left
        yield from self._records(_opened(record, compression))


def _type(name: str, encoding: str) -> str:
    """Return the type of a topic, which includes its encoding if it is not CDR, so that it is not read."""
    return name if encoding in ("cdr", "") else f"{name} as {encoding}"


def _sqlite(file: Path, room: _Room, wanted: _Wanted) -> Iterator[_Item]:
    with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)) as connection:
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MOST)
        tables: Iterable[tuple[str, str]] = connection.execute("SELECT name, sql FROM sqlite_master")
        plain = {name for name, sql in tables if sql and sql.lstrip().upper().startswith("CREATE TABLE")}
        if not {"topics", "messages"} <= plain:  # a view may be infinite
            raise _Damage("it has no tables of topics and messages")
        columns = {column for _, column, *_ in connection.execute("PRAGMA table_info(topics)")}
        encoding = "serialization_format" if "serialization_format" in columns else "'cdr'"
        topics: dict[int, tuple[str, str]] = {}
        for number, name, kind, coded in connection.execute(f"SELECT id, name, type, {encoding} FROM topics"):
            topics[number] = name, _type(kind, coded)
            yield *topics[number], 0, None
        numbers = [number for number, topic in topics.items() if wanted(*topic)]
        query = (
            f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({','.join('?' * len(numbers))}) "
            f"AND length(data) <= {_MOST} ORDER BY id"
        )
        for number, time, data in connection.execute(query, numbers):
            yield *topics[number], time, _message(data, room)
