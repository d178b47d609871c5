"""Conversion between the messages of a topic and arrays.

A walk has some hundred thousand joint states that differ only in stamp and numbers. `rosbags` deserialises or
serialises one of them; for the others only the bytes of stamp and numbers are copied.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.report.bag.storage import Column, Source, content_of, typestore
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import BagError
from dqwalk_ros.support.wording import without_numbers

Stamps = NDArray[np.int64]
"""Time stamps, shape (N,) [ns]."""
Messages = tuple[str, Stamps, list[bytes]]
"""Name of a topic, and stamps and bytes of its messages."""
NS = 1_000_000_000
"""Nanoseconds per second."""
_DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
_LEVELS = ("OK", "WARN", "ERROR", "STALE")
"""Levels of diagnostic_msgs/DiagnosticStatus [REP-107]."""
_ALL_BITS = float(np.frombuffer(b"\xff" * 8)[0])  # a nan of which every bit is set


def stamps_of(time: Array) -> Stamps:
    """Return the time stamps [ns] of times (N,) [s]."""
    return np.round(time * NS).astype(np.int64)


# ---------------------------------------------------------------------- one message


def new(kind: str, **values: Any) -> Any:
    """Return a message of a type; fields that are not in `values` are empty or zero."""
    store = typestore()
    return store.types[kind](**{name: values.get(name, _zero(desc)) for name, desc in store.fielddefs[kind][1]})


def _zero(description: Any) -> Any:
    node, inner = description
    if node is Nodetype.NAME:
        return new(inner)
    if node is Nodetype.BASE:
        return {"string": "", "float64": 0.0}.get(inner[0], 0)
    return np.zeros(inner[1] if node is Nodetype.ARRAY else 0)


def serialize(message: Any) -> bytes:
    """Return the bytes of a message."""
    return bytes(typestore().serialize_cdr(message, message.__msgtype__))


def unpack(raw: bytes, kind: str) -> Any:
    """Return one deserialised message.

    Extra bytes at the end are accepted: rclpy appends some after an empty last sequence, which
    `Typestore.deserialize_cdr` would reject.

    Raises
    ------
    BagError
        If the bytes are not a message of this type.
    """
    store = typestore()
    definition = store.get_msgdef(kind)
    try:
        parse = definition.deserialize_cdr_le if raw[1] else definition.deserialize_cdr_be
        return parse(raw[4:], 0, definition.cls, store)[0]
    except Exception as error:  # damaged bytes may raise any exception in the parser
        raise BagError(f"a damaged {kind}: {error}") from error


def text(value: str) -> bytes:
    """Return a std_msgs/String."""
    return serialize(new("std_msgs/msg/String", data=value))


def texts(column: Column) -> list[str]:
    """Return the texts of a column of std_msgs/String; damaged ones are empty."""
    return [_text_of(raw, column.type) for raw in column.raws]


def _text_of(raw: bytes, kind: str) -> str:
    try:
        return str(unpack(raw, kind).data)
    except BagError:
        return ""


def stamped(kind: str, frame: str = "", *, stamp: int = 0, **values: Any) -> Any:
    """Return a message of a type that has a header, with the stamp [ns]; other fields are as in `new`."""
    time = new("builtin_interfaces/msg/Time", sec=stamp // NS, nanosec=stamp % NS)
    return new(kind, header=new("std_msgs/msg/Header", stamp=time, frame_id=frame), **values)


def diagnostics(stamp: int, name: str, hardware: str, level: str, message: str, values: Mapping[str, Any]) -> bytes:
    """Return a DiagnosticArray of one status; `level` is OK, WARN, ERROR or STALE."""
    pairs = [
        new("diagnostic_msgs/msg/KeyValue", key=key, value=v if isinstance(v, str) else repr(float(v)))
        for key, v in values.items()
    ]
    status = new(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=_LEVELS.index(level),
        name=name,
        message=message,
        hardware_id=hardware,
        values=pairs,
    )
    return serialize(stamped(_DIAGNOSTICS, stamp=stamp, status=[status]))


# ---------------------------------------------------------------------- many messages


def _doubles(message: Any) -> Iterator[tuple[Any, str, Any]]:
    """Yield every field of doubles in a message, in the order of its bytes: its owner, its name, its value."""
    for entry in fields(message):
        value = getattr(message, entry.name)
        if isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype == np.float64):
            yield message, entry.name, value
        elif is_dataclass(value):
            yield from _doubles(value)


def _filled(message: Any, double: float, bits: int) -> NDArray[np.uint8]:
    """Set all doubles of a message to `double` and its stamp to the given bits, and return its bytes."""
    for owner, name, value in list(_doubles(message)):
        setattr(owner, name, np.full_like(value, double) if isinstance(value, np.ndarray) else double)
    message.header.stamp.sec, message.header.stamp.nanosec = -(bits & 1), bits
    return np.frombuffer(serialize(message), np.uint8)


@dataclass(frozen=True)
class Table:
    """Messages that differ in stamp and numbers only."""

    message: Any
    """One of them."""
    rows: NDArray[np.intp]
    """Their indices in the column, shape (N,)."""
    stamps: Stamps
    """Shape (N,) [ns]."""
    numbers: Array
    """Every double behind the header, in the order of the message, shape (N, k)."""


class _Layout:
    """The positions of stamp and doubles among the bytes of messages like one of them."""

    def __init__(self, message: Any) -> None:
        self._message = message
        like = copy.deepcopy(message)
        self._bytes = _filled(like, 0.0, 0)
        changed = np.flatnonzero(self._bytes != _filled(like, _ALL_BITS, 0xFFFFFFFF))
        self._stamp, self._doubles = changed[:8], changed[8:]
        same = np.setdiff1d(np.arange(4, len(self._bytes)), changed)  # the first four bytes are the encapsulation
        parts = [part for part in np.split(same, np.flatnonzero(np.diff(same) > 1) + 1) if len(part)]
        self._same = [(slice(part[0], part[-1] + 1), self._bytes[part].tobytes()) for part in parts]

    def fits(self, raw: bytes) -> bool:
        """Return whether a message differs only in stamp, doubles and padding at its end."""
        size = len(self._bytes)
        return size <= len(raw) < size + 8 and raw[1] == 1 and all(raw[part] == same for part, same in self._same)

    def pack(self, stamps: Stamps, numbers: Array) -> list[bytes]:
        """Return messages with these stamps and numbers."""
        block = np.tile(self._bytes, (len(stamps), 1))
        times = np.stack([stamps // NS, stamps % NS], axis=1).astype("<u4")
        block[:, self._stamp] = times.view(np.uint8)
        block[:, self._doubles] = np.ascontiguousarray(numbers, "<f8").view(np.uint8)
        return [row.tobytes() for row in block]

    def table(self, rows: list[int], raws: list[bytes]) -> Table:
        """Return the stamps and numbers of messages, which are the given rows of their column."""
        size = len(self._bytes)
        block = np.frombuffer(b"".join([raw[:size] for raw in raws]), np.uint8).reshape(len(raws), size)
        times = np.ascontiguousarray(block[:, self._stamp]).view([("sec", "<i4"), ("nanosec", "<u4")])[:, 0]
        numbers = np.ascontiguousarray(block[:, self._doubles]).view("<f8").astype(np.float64)
        return Table(self._message, np.array(rows), times["sec"].astype(np.int64) * NS + times["nanosec"], numbers)


def pack(message: Any, stamps: Stamps, numbers: Array) -> list[bytes]:
    """Return messages like `message`, which has a header.

    Parameters
    ----------
    stamps : ndarray of int64, shape (N,) [ns]
    numbers : ndarray, shape (N, k)
        Every double behind the header, in the order of the message.
    """
    return _Layout(message).pack(stamps, numbers) if len(stamps) else []


def pack_known(topic: tuple[str, str], frame: str, stamps: Stamps, numbers: Array) -> Messages:
    """Return the messages of a topic (name, type) for the rows of `numbers` (N, k) that are finite."""
    (name, kind), known = topic, np.isfinite(numbers).all(axis=1)
    return name, stamps[known], pack(stamped(kind, frame), stamps[known], numbers[known])


def tables(column: Column | None) -> Iterator[Table]:
    """Yield the messages of a column as tables; a new table begins where anything but stamp and numbers changes.

    Raises
    ------
    BagError
        If all messages are damaged; if only some are, those are omitted.
    """
    if column is None:
        return
    layout: _Layout | None = None
    rows: list[int] = []
    raws: list[bytes] = []
    damaged: BagError | None = None
    for row, raw in enumerate(column.raws):
        if layout is None or not layout.fits(raw):
            try:
                message = unpack(raw, column.type)
            except BagError as error:
                damaged = error
                continue
            raw = serialize(message)  # in this machine's byte order
            if layout is None or not layout.fits(raw):
                if layout is not None:
                    yield layout.table(rows, raws)
                layout, rows, raws = _Layout(message), [], []
        rows.append(row)
        raws.append(raw)
    if layout is not None:
        yield layout.table(rows, raws)
    elif damaged is not None:
        raise damaged


def at_stamps(stamps: Stamps, found: Stamps, values: Array) -> Array:
    """Return the value with each of some ascending stamps, shape (N, k).

    Stamps without a value, or with one that is not finite, have nan; of several values with one stamp the last counts.
    """
    out = np.full((len(stamps), values.shape[1]), np.nan)
    place = np.searchsorted(stamps, found)
    place[place == len(stamps)] = 0
    good = (stamps[place] == found) & np.isfinite(values).all(axis=1)
    out[place[good]] = values[good]
    return out


def aligned(column: Column | None, stamps: Stamps, width: int) -> Array:
    """Return the numbers of the message with each stamp, shape (N, width); nan without a message of finite numbers.

    Parameters
    ----------
    column : Column or None
        Of a type with a fixed number of doubles.
    stamps : ndarray of int64, shape (N,) [ns]
        In ascending order.
    """
    found = list(tables(column))
    if not found or not len(stamps):
        return np.full((len(stamps), width), np.nan)
    numbers = np.concatenate([table.numbers for table in found])
    return at_stamps(stamps, np.concatenate([table.stamps for table in found]), numbers)


# ---------------------------------------------------------------------- poses


def pack_poses(stamps: Stamps, frame: str, x: Array) -> list[bytes]:
    """Return PoseStamped messages of unit dual quaternions `x` (N, 8)."""
    return pack(stamped("geometry_msgs/msg/PoseStamped", frame), stamps, pose_numbers(x))


def pose_numbers(x: Array) -> Array:
    """Return position 2 D(x) P(x)*, (U1), and quaternion, real part last, of unit dual quaternions (N, 8): (N, 7)."""
    return np.concatenate([DQ(x).translation(), x[:, 1:4], x[:, :1]], axis=1)


def pose_of(numbers: Array) -> Array:
    """Return the unit dual quaternions (..., 8) of the numbers (..., 7) of PoseStamped messages."""
    return DQ.from_pose(numbers[..., :3], numbers[..., [6, 3, 4, 5]]).vec8()


# ---------------------------------------------------------------------- joint states


@dataclass(frozen=True)
class JointStates:
    """The JointState messages of one topic."""

    rows: NDArray[np.intp]
    """Their indices in the column, shape (N,); damaged messages, and those of other joints, are omitted."""
    stamps: Stamps
    """Shape (N,) [ns]."""
    frames: tuple[str, ...]
    """N of them."""
    named: tuple[str, ...]
    """The joints named in all messages, at most a hundred."""
    position: Array
    velocity: Array
    effort: Array
    """Of the requested joints, shape (N, n); nan where a message has no value."""


def joint_states(column: Column, names: Sequence[str]) -> JointStates:
    """Return the JointState messages of a column with any of some joints, in any order of their joints.

    Raises
    ------
    BagError
        If all of them are damaged.
    """
    count, n = len(column.raws), len(names)
    rows, stamps, frames = [], [], []
    named: dict[str, None] = {}
    values = np.full((3, count, n), np.nan)
    done = 0
    for found in tables(column):
        m, end = found.message, done + len(found.rows)
        at = {name: i for i, name in reversed(list(enumerate(m.name)))}
        if len(named) < 100:
            named |= dict.fromkeys(m.name[:100])
        mine = [i for i, name in enumerate(names) if name in at]
        if at and not mine:  # of a gripper
            continue
        theirs = [at[names[i]] for i in mine]
        sizes = [len(m.position), len(m.velocity), len(m.effort)]
        for out, part in zip(values, np.split(found.numbers, np.cumsum(sizes)[:2], axis=1), strict=True):
            if part.shape[1] == len(m.name):
                out[done:end, mine] = part[:, theirs]
        rows.append(found.rows)
        stamps.append(found.stamps)
        frames += [m.header.frame_id] * len(found.rows)
        done = end
    position, velocity, effort = values[:, :done]
    empty = np.zeros(0, np.int64)
    return JointStates(
        np.concatenate([empty, *rows]),
        np.concatenate([empty, *stamps]),
        tuple(frames),
        tuple(named),
        position,
        velocity,
        effort,
    )


def pack_joint_states(
    stamps: Stamps,
    names: Sequence[str],
    *,
    position: Array | None = None,
    velocity: Array | None = None,
    effort: Array | None = None,
    frame: str = "",
) -> list[bytes]:
    """Return JointState messages with positions, velocities and torques (N, n) [rad, rad/s, N m], if given."""
    parts = {"position": position, "velocity": velocity, "effort": effort}
    known = {name: part for name, part in parts.items() if part is not None}
    sized: dict[str, Any] = {name: np.zeros(len(names)) for name in known}
    message = stamped("sensor_msgs/msg/JointState", frame, name=list(names), **sized)
    return pack(message, stamps, np.concatenate(list(known.values()), axis=1))


# ---------------------------------------------------------------------- diagnostics

_WORST = ("ERROR", "STALE", "WARN")


@dataclass(frozen=True)
class Status:
    """One status, the time at which it was recorded [s], and the time of the solver [s], nan if it has none."""

    time: float
    name: str
    level: str
    message: str
    solve_time: float


@dataclass(frozen=True)
class Fault:
    """A fault on /diagnostics, with its first and last time and the number of its messages."""

    name: str
    level: str
    message: str
    first: float
    last: float
    count: int


def diagnostics_of(source: Source) -> list[Status]:
    """Return every status in the order of time; damaged messages are omitted.

    Raises
    ------
    BagError
        If the bag cannot be read.
    """
    out = []
    for column in content_of(source).columns.values():
        if column.type != _DIAGNOSTICS:
            continue
        for time, raw in zip(column.times, column.raws, strict=True):
            try:
                array = unpack(raw, _DIAGNOSTICS)
            except BagError:
                continue
            for status in array.status:
                level = _LEVELS[min(int(status.level), len(_LEVELS) - 1)]
                solved = next((pair.value for pair in status.values if pair.key == "solve time"), "nan")
                out.append(Status(time / NS, status.name, level, status.message, _number(solved)))
    return sorted(out, key=lambda status: status.time)


def _number(value: str) -> float:
    """Return a value as a number; nan if it is not a number."""
    try:
        return float(value)
    except ValueError:
        return math.nan


def faults(statuses: list[Status]) -> list[Fault]:
    """Return each fault once, the worst first; messages that differ in numbers only are the same fault."""
    same: dict[tuple[str, str, str], list[Status]] = {}
    for status in statuses:
        if status.level != "OK":
            same.setdefault((status.name, status.level, without_numbers(status.message)), []).append(status)
    found = [Fault(s[0].name, s[0].level, s[0].message, s[0].time, s[-1].time, len(s)) for s in same.values()]
    return sorted(found, key=lambda fault: (_WORST.index(fault.level), fault.first))
