"""All JointState messages of a topic at once: the numbers are cut out wherever nothing else differs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.errors import BagError
from dqwalk_ros.report.bag.messages import NS, STAMP, number_bytes, unpack

__all__ = ["JointColumn", "unpack_joint_states"]

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]


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
    at_position, at_velocity, at_effort = number_bytes(raws[0])
    block = np.frombuffer(b"".join(raws), np.uint8).reshape(len(raws), size)
    same = np.ones(size, bool)
    same[STAMP] = same[at_position] = same[at_velocity] = False
    same[at_effort.start :] = False  # and what may be left over behind it
    if not (block[:, same] == block[0, same]).all():
        return None

    def numbers(where: slice, count: int) -> Array:
        if not count:
            return np.full((len(raws), n), np.nan)
        return np.ascontiguousarray(block[:, where]).view("<f8").reshape(len(raws), n).astype(np.float64)

    parts = np.ascontiguousarray(block[:, STAMP]).view("<u4").astype(np.int64).reshape(len(raws), 2)
    return JointColumn(
        stamps=parts[:, 0] * NS + parts[:, 1],
        frames=(first.header.frame_id,) * len(raws),
        names=tuple(first.name),
        position=numbers(at_position, n_position),
        velocity=numbers(at_velocity, n_velocity),
    )


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
        stamps.append(message.header.stamp.sec * NS + message.header.stamp.nanosec)
        frames.append(message.header.frame_id)
    return JointColumn(np.array(stamps[1:], np.int64), tuple(frames[1:]), names, position, velocity)
