"""Columns of messages of one topic, packed and unpacked together.

A walk has some hundred thousand joint states which differ in their stamp and their numbers only. So one
message is serialised by `rosbags`, the rest are copies of its bytes with stamp and numbers put in; the other way
round, the numbers are cut out of all messages at once wherever nothing else differs.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore

from dqwalk_ros.dq import DQ
from dqwalk_ros.exceptions import BagError

__all__ = [
    "JointColumn",
    "diagnostics",
    "joint_states",
    "point",
    "pose_numbers",
    "pose_of",
    "poses",
    "stream",
    "text",
    "typestore",
    "unpack",
    "unpack_joint_states",
    "unpack_stream",
]

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
_NS = 1_000_000_000
_LEVELS = ("OK", "WARN", "ERROR", "STALE")
_STAMP = slice(4, 12)  # bytes of sec and nanosec, behind the four bytes of the CDR encapsulation


@cache
def typestore() -> Any:
    """Return the message definitions of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def _pack(type_name: str, **fields: Any) -> bytes:
    store = typestore()
    return bytes(store.serialize_cdr(store.types[type_name](**fields), type_name))


def _header(stamp: int, frame: str) -> Any:
    types = typestore().types
    time = types["builtin_interfaces/msg/Time"](sec=stamp // _NS, nanosec=stamp % _NS)
    return types["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def unpack(raw: bytes, type_name: str) -> Any:
    """Return one message.

    Bytes left over at the end are no damage: rclpy leaves some behind an empty last sequence, and
    `Typestore.deserialize_cdr` would refuse them.

    Raises
    ------
    BagError
        If the bytes are no such message.
    """
    store = typestore()
    definition = store.get_msgdef(type_name)
    try:
        parse = definition.deserialize_cdr_le if raw[1] else definition.deserialize_cdr_be
        return parse(raw[4:], 0, definition.cls, store)[0]
    except Exception as error:  # whatever damaged bytes make the parser raise
        raise BagError(f"a damaged {type_name}: {error}") from error


# ---------------------------------------------------------------------- packing


def text(value: str) -> bytes:
    """Return a std_msgs/String."""
    return _pack("std_msgs/msg/String", data=value)


def point(stamp: int, frame: str, p: Array) -> bytes:
    """Return a PointStamped of the point `p` (3,) [m]."""
    x, y, z = map(float, p)
    value = typestore().types["geometry_msgs/msg/Point"](x=x, y=y, z=z)
    return _pack("geometry_msgs/msg/PointStamped", header=_header(stamp, frame), point=value)


def joint_states(
    stamps: Stamps, names: Sequence[str], position: Array | None, velocity: Array | None, frame: str = ""
) -> list[bytes]:
    """Return JointState messages.

    Parameters
    ----------
    stamps : ndarray of int64, shape (N,) [ns]
    names : sequence of str, n of them
    position, velocity : ndarray, shape (N, n) [rad, rad/s], or None
    """
    count = len(stamps)
    none = np.zeros(0)
    example = _pack(
        "sensor_msgs/msg/JointState",
        header=_header(int(stamps[0]), frame),
        name=list(names),
        position=none if position is None else np.ascontiguousarray(position[0]),
        velocity=none if velocity is None else np.ascontiguousarray(velocity[0]),
        effort=none,
    )
    at_position, at_velocity, _ = _number_bytes(example)
    block = _copies(example, stamps)
    if position is not None:
        block[:, at_position] = _as_bytes(position, count)
    if velocity is not None:
        block[:, at_velocity] = _as_bytes(velocity, count)
    return [row.tobytes() for row in block]


def poses(stamps: Stamps, frame: str, x: Array) -> list[bytes]:
    """Return PoseStamped messages of unit dual quaternions `x` (N, 8); position is 2 D(x) P(x)*, (1)."""
    return stream("geometry_msgs/msg/PoseStamped", stamps, frame, pose_numbers(x))


@dataclass(frozen=True)
class _Stream:
    """A type whose messages end in a fixed count of numbers, all of them doubles: a header comes before."""

    count: int
    empty: Callable[[Any], dict[str, Any]]
    """Its fields besides the header, of the types of a typestore."""


def _zeros(types: Any, name: str) -> Any:
    return types[f"geometry_msgs/msg/{name}"](x=0.0, y=0.0, z=0.0)


def _empty_imu(types: Any) -> dict[str, Any]:
    unsure = np.zeros(9)
    return {
        "orientation": types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        "orientation_covariance": unsure,
        "angular_velocity": _zeros(types, "Vector3"),
        "angular_velocity_covariance": unsure,
        "linear_acceleration": _zeros(types, "Vector3"),
        "linear_acceleration_covariance": unsure,
    }


def _empty_wrench(types: Any) -> dict[str, Any]:
    force, torque = _zeros(types, "Vector3"), _zeros(types, "Vector3")
    return {"wrench": types["geometry_msgs/msg/Wrench"](force=force, torque=torque)}


def _empty_pose(types: Any) -> dict[str, Any]:
    turned = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    return {"pose": types["geometry_msgs/msg/Pose"](position=_zeros(types, "Point"), orientation=turned)}


_STREAMS = {
    "sensor_msgs/msg/Imu": _Stream(37, _empty_imu),
    "geometry_msgs/msg/WrenchStamped": _Stream(6, _empty_wrench),
    "geometry_msgs/msg/PoseStamped": _Stream(7, _empty_pose),
    "geometry_msgs/msg/PointStamped": _Stream(3, lambda types: {"point": _zeros(types, "Point")}),
}


def stream(kind: str, stamps: Stamps, frame: str, numbers: Array) -> list[bytes]:
    """Return messages of a type that ends in doubles.

    Parameters
    ----------
    kind : str
        Imu, WrenchStamped, PoseStamped or PointStamped, with its package.
    stamps : ndarray of int64, shape (N,) [ns]
    frame : str
    numbers : ndarray, shape (N, k)
        Every double behind the header, in the order of the message.
    """
    of = _STREAMS[kind]
    example = _pack(kind, header=_header(int(stamps[0]), frame), **of.empty(typestore().types))
    block = _copies(example, stamps)
    block[:, -8 * of.count :] = _as_bytes(numbers, len(stamps))
    return [row.tobytes() for row in block]


def unpack_stream(kind: str, raws: Sequence[bytes]) -> tuple[Stamps, Array]:
    """Return stamps [ns] and numbers (N, k) of what `stream` makes; who cannot be read is left out."""
    count = _STREAMS[kind].count
    stamps, numbers = [], []
    for raw in raws:
        order = "<" if len(raw) > 1 and raw[1] & 1 else ">"
        if len(raw) < 16:
            continue
        sec, nanosec, length = struct.unpack_from(order + "iII", raw, 4)
        at = 16 + length
        at += -(at - 4) % 8  # eight bytes align to the body, which begins at 4
        if len(raw) < at + 8 * count:
            continue
        stamps.append(sec * _NS + nanosec)
        numbers.append(np.frombuffer(raw, order + "f8", count, at))
    return np.array(stamps, np.int64), np.array(numbers, np.float64).reshape(-1, count)


def pose_numbers(x: Array) -> Array:
    """Return position and quaternion, real part last, of unit dual quaternions (N, 8), shape (N, 7)."""
    return np.concatenate([DQ(x).translation(), x[:, 1:4], x[:, :1]], axis=1)


def pose_of(message: Any) -> Array:
    """Return the unit dual quaternion (8,) of a PoseStamped."""
    p, r = message.pose.position, message.pose.orientation
    return DQ.from_pose([p.x, p.y, p.z], [r.w, r.x, r.y, r.z]).vec8()


def diagnostics(
    stamp: int, name: str, hardware: str, level: str, message: str, values: Mapping[str, float | str]
) -> bytes:
    """Return a DiagnosticArray of one status [REP-107]; `level` is OK, WARN, ERROR or STALE."""
    types = typestore().types
    pairs = [
        types["diagnostic_msgs/msg/KeyValue"](key=key, value=v if isinstance(v, str) else repr(float(v)))
        for key, v in values.items()
    ]
    status = types["diagnostic_msgs/msg/DiagnosticStatus"](
        level=_LEVELS.index(level), name=name, message=message, hardware_id=hardware, values=pairs
    )
    return _pack("diagnostic_msgs/msg/DiagnosticArray", header=_header(stamp, ""), status=[status])


def _copies(example: bytes, stamps: Stamps) -> NDArray[np.uint8]:
    block = np.tile(np.frombuffer(example, np.uint8), (len(stamps), 1))
    parts = np.stack([stamps // _NS, stamps % _NS], axis=1).astype("<u4")
    block[:, _STAMP] = parts.view(np.uint8).reshape(len(stamps), 8)
    return block


def _as_bytes(numbers: Array, count: int) -> NDArray[np.uint8]:
    return np.ascontiguousarray(numbers, dtype="<f8").view(np.uint8).reshape(count, -1)


# ---------------------------------------------------------------------- unpacking


@dataclass(frozen=True)
class JointColumn:
    """The JointState messages of one topic.

    Attributes
    ----------
    stamps : ndarray of int64, shape (N,) [ns]
    frames : tuple of str, N
    names : tuple of str, m
        Every joint that any message names.
    position, velocity : ndarray, shape (N, m)
        nan where a message does not say.
    """

    stamps: Stamps
    frames: tuple[str, ...]
    names: tuple[str, ...]
    position: Array
    velocity: Array

    def columns(self, names: Sequence[str]) -> list[int]:
        """Return the columns of the joints `names`."""
        return [self.names.index(name) for name in names]


def unpack_joint_states(raws: Sequence[bytes]) -> JointColumn:
    """Return all JointState messages, in any order of their joints.

    Raises
    ------
    BagError
        If every one of them is damaged.
    """
    if not raws:
        return JointColumn(np.zeros(0, np.int64), (), (), np.zeros((0, 0)), np.zeros((0, 0)))
    return _unpack_alike(raws) or _unpack_each(raws)


def _unpack_alike(raws: Sequence[bytes]) -> JointColumn | None:
    """Cut the numbers out of messages that differ in nothing but stamp and numbers; else return None."""
    try:
        first = unpack(raws[0], "sensor_msgs/msg/JointState")
    except BagError:
        return None
    size, n = len(raws[0]), len(first.name)
    n_position, n_velocity = len(first.position), len(first.velocity)
    if raws[0][1] != 1 or not {n_position, n_velocity} <= {0, n} or any(len(raw) != size for raw in raws):
        return None
    at_position, at_velocity, at_effort = _number_bytes(raws[0])
    block = np.frombuffer(b"".join(raws), np.uint8).reshape(len(raws), size)
    same = np.ones(size, bool)
    same[_STAMP] = same[at_position] = same[at_velocity] = False
    same[at_effort.start :] = False  # and what may be left over behind it
    if not (block[:, same] == block[0, same]).all():
        return None

    def numbers(where: slice, count: int) -> Array:
        if not count:
            return np.full((len(raws), n), np.nan)
        return np.ascontiguousarray(block[:, where]).view("<f8").reshape(len(raws), n).astype(np.float64)

    parts = np.ascontiguousarray(block[:, _STAMP]).view("<u4").astype(np.int64).reshape(len(raws), 2)
    return JointColumn(
        stamps=parts[:, 0] * _NS + parts[:, 1],
        frames=(first.header.frame_id,) * len(raws),
        names=tuple(first.name),
        position=numbers(at_position, n_position),
        velocity=numbers(at_velocity, n_velocity),
    )


def _number_bytes(raw: bytes) -> tuple[slice, slice, slice]:
    """Return where positions, velocities and efforts stand in a little-endian JointState."""
    at = 12  # behind encapsulation (4) and stamp (8)

    def take(width: int) -> slice:
        """Return where the items of the next sequence stand, whose length comes first."""
        nonlocal at
        at += -at % 4 + 4
        length = int.from_bytes(raw[at - 4 : at], "little")
        if length and width == 8:
            at += -(at - 4) % 8  # eight bytes align to the body, which begins at 4
        at += length * width
        return slice(at - length * width, at)

    take(1)  # frame_id
    at += -at % 4 + 4
    for _ in range(int.from_bytes(raw[at - 4 : at], "little")):
        take(1)  # a name
    return take(8), take(8), take(8)


def _unpack_each(raws: Sequence[bytes]) -> JointColumn:
    """Read messages one by one; a damaged one has the stamp of the one before it, and no numbers."""
    messages: list[Any] = []
    damaged: BagError | None = None
    for raw in raws:
        try:
            messages.append(unpack(raw, "sensor_msgs/msg/JointState"))
        except BagError as error:
            damaged = error
            messages.append(None)
    if damaged is not None and not any(messages):
        raise damaged
    names = tuple(dict.fromkeys(name for message in messages if message for name in message.name))
    column = {name: i for i, name in enumerate(names)}
    position, velocity = np.full((2, len(messages), len(names)), np.nan)
    stamps, frames = [-1], [""]
    for row, message in enumerate(messages):
        if message is None:
            stamps.append(stamps[-1])
            frames.append(frames[-1])
            continue
        at = [column[name] for name in message.name]
        if len(message.position) == len(at):
            position[row, at] = message.position
        if len(message.velocity) == len(at):
            velocity[row, at] = message.velocity
        stamps.append(message.header.stamp.sec * _NS + message.header.stamp.nanosec)
        frames.append(message.header.frame_id)
    return JointColumn(np.array(stamps[1:], np.int64), tuple(frames[1:]), names, position, velocity)
