"""Columns of messages of one topic, packed and unpacked together (JointState: see `dqwalk_ros.report.bag.joints`).

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

from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import BagError

__all__ = [
    "NS",
    "STAMP",
    "diagnostics",
    "joint_states",
    "number_bytes",
    "point",
    "pose_numbers",
    "pose_of",
    "poses",
    "six_of",
    "stamp_of",
    "stream",
    "text",
    "typestore",
    "unpack",
    "unpack_stream",
]

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
NS = 1_000_000_000
"""Nanoseconds of a second."""
_LEVELS = ("OK", "WARN", "ERROR", "STALE")
STAMP = slice(4, 12)
"""Bytes of sec and nanosec, behind the four bytes of the CDR encapsulation."""


@cache
def typestore() -> Any:
    """Return the message definitions of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def _pack(type_name: str, **fields: Any) -> bytes:
    store = typestore()
    return bytes(store.serialize_cdr(store.types[type_name](**fields), type_name))


def _header(stamp: int, frame: str) -> Any:
    types = typestore().types
    time = types["builtin_interfaces/msg/Time"](sec=stamp // NS, nanosec=stamp % NS)
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
    stamps: Stamps,
    names: Sequence[str],
    position: Array | None,
    velocity: Array | None,
    frame: str = "",
    *,
    effort: Array | None = None,
) -> list[bytes]:
    """Return JointState messages.

    Parameters
    ----------
    stamps : ndarray of int64, shape (N,) [ns]
    names : sequence of str, n of them
    position, velocity, effort : ndarray, shape (N, n) [rad, rad/s, N m], or None
    frame : str
    """
    count = len(stamps)
    none = np.zeros(0)
    example = _pack(
        "sensor_msgs/msg/JointState",
        header=_header(int(stamps[0]), frame),
        name=list(names),
        position=none if position is None else np.ascontiguousarray(position[0]),
        velocity=none if velocity is None else np.ascontiguousarray(velocity[0]),
        effort=none if effort is None else np.ascontiguousarray(effort[0]),
    )
    at_position, at_velocity, at_effort = number_bytes(example)
    block = _copies(example, stamps)
    if position is not None:
        block[:, at_position] = _as_bytes(position, count)
    if velocity is not None:
        block[:, at_velocity] = _as_bytes(velocity, count)
    if effort is not None:
        block[:, at_effort] = _as_bytes(effort, count)
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


def _empty_twist(types: Any) -> dict[str, Any]:
    linear, angular = _zeros(types, "Vector3"), _zeros(types, "Vector3")
    return {"twist": types["geometry_msgs/msg/Twist"](linear=linear, angular=angular)}


def _empty_pose(types: Any) -> dict[str, Any]:
    turned = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    return {"pose": types["geometry_msgs/msg/Pose"](position=_zeros(types, "Point"), orientation=turned)}


_STREAMS = {
    "sensor_msgs/msg/Imu": _Stream(37, _empty_imu),
    "geometry_msgs/msg/WrenchStamped": _Stream(6, _empty_wrench),
    "geometry_msgs/msg/TwistStamped": _Stream(6, _empty_twist),
    "geometry_msgs/msg/PoseStamped": _Stream(7, _empty_pose),
    "geometry_msgs/msg/PointStamped": _Stream(3, lambda types: {"point": _zeros(types, "Point")}),
}


def stream(kind: str, stamps: Stamps, frame: str, numbers: Array) -> list[bytes]:
    """Return messages of a type that ends in doubles.

    Parameters
    ----------
    kind : str
        Imu, WrenchStamped, TwistStamped, PoseStamped or PointStamped, with its package.
    stamps : ndarray of int64, shape (N,) [ns]
    frame : str
    numbers : ndarray, shape (N, k)
        Every double behind the header, in the order of the message.
    """
    of = _STREAMS[kind]
    if not len(stamps):
        return []
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
        stamps.append(sec * NS + nanosec)
        numbers.append(np.frombuffer(raw, order + "f8", count, at))
    return np.array(stamps, np.int64), np.array(numbers, np.float64).reshape(-1, count)


def pose_numbers(x: Array) -> Array:
    """Return position and quaternion, real part last, of unit dual quaternions (N, 8), shape (N, 7)."""
    return np.concatenate([DQ(x).translation(), x[:, 1:4], x[:, :1]], axis=1)


def six_of(message: Any) -> Array:
    """Return the numbers (6,) of a TwistStamped or a WrenchStamped."""
    if hasattr(message, "twist"):
        a, b = message.twist.linear, message.twist.angular
    else:
        a, b = message.wrench.force, message.wrench.torque
    return np.array([a.x, a.y, a.z, b.x, b.y, b.z])


def stamp_of(message: Any) -> int:
    """Return the stamp in a message's header [ns]."""
    return int(message.header.stamp.sec) * NS + int(message.header.stamp.nanosec)


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
    parts = np.stack([stamps // NS, stamps % NS], axis=1).astype("<u4")
    block[:, STAMP] = parts.view(np.uint8).reshape(len(stamps), 8)
    return block


def _as_bytes(numbers: Array, count: int) -> NDArray[np.uint8]:
    return np.ascontiguousarray(numbers, dtype="<f8").view(np.uint8).reshape(count, -1)


def number_bytes(raw: bytes) -> tuple[slice, slice, slice]:
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
