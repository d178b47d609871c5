"""Write a walk of phases as the rosbag2 that the recorder node would have made of it."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros import provenance
from dqwalk_ros.config import to_yaml
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import BagError
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.report.bag import columns
from dqwalk_ros.report.bag.columns import NS, new, pack, pack_joint_states, pack_poses, pose_numbers, text
from dqwalk_ros.report.bag.storage import connect, flush, writing
from dqwalk_ros.report.verdict import Assessor
from dqwalk_ros.robot import Foot
from dqwalk_ros.simulation import PhaseRecord, Trace
from dqwalk_ros.topics import FINISHED, ODOM, TOPICS, WORLD
from dqwalk_ros.walk import com_target

__all__ = ["stamps_of", "write"]

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
_Entry = tuple[str, bytes]


def stamps_of(time: Array) -> Stamps:
    """Return the time stamps [ns] of times [s]."""
    return np.round(time * NS).astype(np.int64)


def write(trace: Trace, path: str | os.PathLike[str], *, diagnostics: bool = True, overwrite: bool = False) -> None:
    """Write a walk to the folder `path`, which appears only once it is complete.

    Parameters
    ----------
    trace : Trace
        With one state at least.
    path : path-like
        The bag's folder.
    diagnostics : bool
        Add ``/diagnostics`` at ``monitor.rate``.
    overwrite : bool
        Replace a bag that is there already.

    Raises
    ------
    BagError
        If there is nothing to write, something is there already, or the disk refuses.
    """
    if len(trace.time) == 0:
        raise BagError("a walk without a single state makes no bag")
    said = {name for name, topic in TOPICS.items() if topic.source != "physics" or trace.physics is not None}
    if not diagnostics:
        said.remove("diagnostics")
    with writing(path, overwrite=overwrite) as writer:
        connections = {name: connect(writer, "/" + name, TOPICS[name]) for name in TOPICS if name in said}
        due = trace.epoch
        for stamp, name, raw in _entries(trace, diagnostics):
            writer.write(connections[name], stamp, raw)
            if stamp >= due:  # a second of walking is the most that damage takes
                due = stamp + NS
                flush(writer)


def _entries(trace: Trace, diagnostics: bool) -> Iterator[tuple[int, str, bytes]]:
    """Yield stamp [ns], topic and message, in the order in which a walk publishes them."""
    stamps = stamps_of(trace.time) + trace.epoch
    names = trace.model.joint_names
    applied = np.zeros_like(trace.u)  # the velocity that led to a state is the command before it
    applied[1:] = np.nan_to_num(trace.u[:-1])
    states = pack_joint_states(stamps, names, position=trace.q, velocity=applied)
    commands = pack_joint_states(stamps, names, velocity=trace.u)
    answered = ~np.isnan(trace.u[:, 0])
    pelvis = pack_poses(stamps, ODOM, _pelvis_in_odom(trace))
    starts = {record.start: record for record in trace.phases}
    monitor = _Monitor(trace) if diagnostics else None
    physics = _physics_messages(trace, stamps)

    stamp = int(stamps[0])
    for name, raw in _opening(trace):
        yield stamp, name, raw
    for tick, stamp in enumerate(stamps.tolist()):
        for name, column in physics.items():
            if column[tick]:
                yield stamp, name, column[tick]
        yield stamp, "joint_states", states[tick]
        if tick in starts:
            for name, raw in _phase_start(trace, starts[tick], stamp):
                yield stamp, name, raw
        if answered[tick]:
            yield stamp, "joint_velocity_commands", commands[tick]
        yield stamp, "base_pose", pelvis[tick]
        if monitor is not None and (status := monitor.at(tick, stamp)):
            yield stamp, "diagnostics", status
    if trace.finished:
        yield stamp, "phase", text(FINISHED)


def _stamped(name: str, frame: str) -> object:
    """Return an empty message of a topic in a frame."""
    return new(TOPICS[name].type, header=new("std_msgs/msg/Header", frame_id=frame))


def _physics_messages(trace: Trace, stamps: Stamps) -> dict[str, list[bytes]]:
    """Return the messages of a physics engine by topic, one per tick, empty where there is none."""
    known = trace.physics
    if known is None:
        return {}
    unsure = np.zeros((len(stamps), 9))
    turned = np.concatenate([known.orientation[:, 1:], known.orientation[:, :1]], axis=1)
    numbers = {
        "imu": np.concatenate([turned, unsure, known.gyro, unsure, known.acceleration, unsure], axis=1),
        "true_base_pose": pose_numbers(known.pelvis),
        **{f"{foot.value}_foot_wrench": known.wrenches[foot] for foot in Foot},
        "center_of_pressure": known.cop,
    }
    frames = {"imu": trace.model.imu, "true_base_pose": WORLD, "center_of_pressure": WORLD}
    frames |= {f"{foot.value}_foot_wrench": trace.model.soles[foot].frame for foot in Foot}
    out: dict[str, list[bytes]] = {}
    for name, column in numbers.items():
        raws = pack(_stamped(name, frames[name]), stamps, column)
        there = np.isfinite(column).all(axis=1)
        out[name] = [raw if one else b"" for raw, one in zip(raws, there, strict=True)]
    return out


def _opening(trace: Trace) -> Iterator[_Entry]:
    yield "walk_config", text(to_yaml(trace.config))
    if trace.origin:
        yield "walk_origin", text(provenance.to_text(trace.origin))
    yield "robot_description", text(trace.model.urdf)


def _phase_start(trace: Trace, record: PhaseRecord, stamp: int) -> Iterator[_Entry]:
    model, frame = trace.model, trace.model.soles[record.base].frame
    when = np.array([stamp])
    yield "phase", text(record.name)
    yield "support_foot", text(record.support.value)
    (start,) = pack_joint_states(when, model.joint_names, position=record.q_start[None], frame=frame)
    yield "phase_start", start
    if record.swing_target is not None:
        yield "swing_target", pack_poses(when, frame, record.swing_target[None])[0]
    else:
        target = com_target(model, record.kind, record.base, record.q_start)
        yield "com_target", pack(_stamped("com_target", frame), when, target[None])[0]


def _pelvis_in_odom(trace: Trace) -> Array:
    """Return the pose of the pelvis in odom at every tick, shape (N, 8)."""
    out = np.tile(DQ(1.0).vec8(), (len(trace.time), 1))
    ends = [record.start for record in trace.phases[1:]] + [len(trace.time)]
    for record, end in zip(trace.phases, ends, strict=True):
        for tick in range(record.start, end):
            out[tick] = Kinematics(trace.model, trace.q[tick], record.base).pose(trace.model.pelvis)
        span = slice(record.start, end)
        out[span] = (DQ(record.x_odom_base) * DQ(out[span])).vec8()
    return out


class _Monitor:
    """What the phase monitor would have published, at its rate."""

    def __init__(self, trace: Trace) -> None:
        self._trace = trace
        self._period = round(NS / trace.config.monitor.rate)
        self._next = 0
        self._phase = -1
        self._assess: Assessor | None = None

    def at(self, tick: int, stamp: int) -> bytes | None:
        """Return the diagnostics of a tick, or None where none is due."""
        trace = self._trace
        phases = trace.phases
        if self._phase + 1 < len(phases) and tick >= phases[self._phase + 1].start:
            self._phase += 1
            record = phases[self._phase]
            phase = record.phase(trace.config, trace.model)
            self._assess = Assessor(trace.config, trace.model, phase)
            self._next = stamp
        if self._assess is None or stamp < self._next:
            return None
        self._next = stamp + self._period
        kin = Kinematics(trace.model, trace.q[tick], self._assess.phase.base)
        found = self._assess(kin, float(trace.time[tick]) - phases[self._phase].time)
        values: dict[str, float | str] = {"phase": self._assess.phase.name, **found.values}
        return columns.diagnostics(stamp, "phase_monitor: walk", trace.model.name, found.level, found.message, values)
