"""Write a `Trace` as the rosbag2 the recorder node would have made of it."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer, WriterError

from dqwalk_ros import origin
from dqwalk_ros.config import to_yaml
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import BagError
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.model import Foot
from dqwalk_ros.phases import com_target, make_phase
from dqwalk_ros.report.assessment import Assessor
from dqwalk_ros.report.bag import messages
from dqwalk_ros.topics import FINISHED, ODOM, TOPICS, WORLD, Topic
from dqwalk_ros.trace import PhaseRecord, Trace

__all__ = ["bag_at", "flush", "qos", "stamps_of", "write"]

Stamps = NDArray[np.int64]
_Entry = tuple[str, bytes]
_FOREVER = QosTime(sec=9223372036, nsec=854775807)  # RMW_DURATION_INFINITE


def stamps_of(time: NDArray[np.float64]) -> Stamps:
    """Return the time stamps [ns] of times [s]."""
    return np.round(time * 1e9).astype(np.int64)


def qos(topic: Topic) -> Qos:
    """Return the quality of service a topic is offered with, for the bag's metadata."""
    return Qos(
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


def flush(writer: Writer) -> None:
    """Hand to the system what an open MCAP writer holds back, so that it can be read even if nobody ends the bag."""
    storage: Any = writer.storage  # rosbags holds up to a megabyte back, which is many seconds of walking
    if storage is not None and storage.chunk.msgs:
        storage.close_chunk()
        storage.bio.flush()


def write(
    trace: Trace,
    path: str | os.PathLike[str],
    *,
    diagnostics: bool = True,
    storage: str = "mcap",
    compress: bool = True,
    overwrite: bool = False,
) -> None:
    """Write a walk to the folder `path`, which appears only once it is complete.

    Parameters
    ----------
    trace : Trace
        With one state at least.
    path : path-like
        The bag's folder.
    diagnostics : bool
        Add ``/diagnostics`` at ``monitor.rate``.
    storage : {"mcap", "sqlite3"}
    compress : bool
        Compress the chunks of an MCAP file (zstd, which every reader of MCAP knows).
    overwrite : bool
        Replace a bag that is there already.

    Raises
    ------
    BagError
        If there is nothing to write, something is there already, or the disk refuses.
    """
    if len(trace.time) == 0:
        raise BagError("a walk without a single state makes no bag")
    with bag_at(path, storage=storage, compress=compress, overwrite=overwrite) as writer:
        _fill(writer, trace, diagnostics)


@contextmanager
def bag_at(
    path: str | os.PathLike[str], *, storage: str = "mcap", compress: bool = True, overwrite: bool = False
) -> Iterator[Writer]:
    """Give a writer of the bag `path`, which appears only once it is complete.

    Raises
    ------
    BagError
        If something is there already, or the disk refuses.
    """
    target = Path(path)
    if target.exists() and not overwrite:
        raise BagError(f"'{target}' is there already; choose another folder, or ask for it to be overwritten")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=target.parent, prefix=f".{target.name}-") as scratch:
            made = Path(scratch) / target.name
            writer = Writer(made, version=9, storage_plugin=StoragePlugin[storage.upper()])
            if compress and storage == "mcap":
                writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            with writer:
                yield writer
            if target.is_dir():
                shutil.rmtree(target)
            elif target.exists():
                target.unlink()
            made.rename(target)
    except (OSError, WriterError) as error:
        raise BagError(f"cannot write '{target}': {error}") from error


def _fill(writer: Writer, trace: Trace, diagnostics: bool) -> None:
    connections: dict[str, Any] = {}
    for name, topic in TOPICS.items():
        if (name != "diagnostics" or diagnostics) and (topic.source != "physics" or trace.physics is not None):
            connections[name] = writer.add_connection(
                "/" + name, topic.type, typestore=messages.typestore(), offered_qos_profiles=[qos(topic)]
            )
    stamps = stamps_of(trace.time) + trace.epoch
    names = trace.model.joint_names
    applied = np.zeros_like(trace.u)  # the velocity that led to a state is the command before it
    applied[1:] = np.nan_to_num(trace.u[:-1])
    states = messages.joint_states(stamps, names, trace.q, applied)
    commands = messages.joint_states(stamps, names, None, trace.u)
    answered = ~np.isnan(trace.u[:, 0])
    pelvis = messages.poses(stamps, ODOM, _pelvis_in_odom(trace))
    starts = {record.start: record for record in trace.phases}
    status = _Status(trace) if diagnostics else None
    physics = _physics(trace, stamps)

    stamp = int(stamps[0])
    for name, raw in _opening(trace):
        writer.write(connections[name], stamp, raw)
    for tick, stamp in enumerate(stamps.tolist()):
        for name, column in physics.items():
            if column[tick]:
                writer.write(connections[name], stamp, column[tick])
        writer.write(connections["joint_states"], stamp, states[tick])
        if tick in starts:
            for name, raw in _phase_start(trace, starts[tick], stamp):
                writer.write(connections[name], stamp, raw)
        if answered[tick]:
            writer.write(connections["joint_velocity_commands"], stamp, commands[tick])
        writer.write(connections["base_pose"], stamp, pelvis[tick])
        if status is not None and (raw_status := status.at(tick, stamp)):
            writer.write(connections["diagnostics"], stamp, raw_status)
    if trace.finished:
        writer.write(connections["phase"], stamp, messages.text(FINISHED))


def _physics(trace: Trace, stamps: Stamps) -> dict[str, list[bytes]]:
    """Return the messages of a physics engine by topic, one per tick, empty where there is none."""
    known = trace.physics
    if known is None:
        return {}
    unsure = np.zeros((len(stamps), 9))
    turned = np.concatenate([known.orientation[:, 1:], known.orientation[:, :1]], axis=1)
    numbers = {
        "imu": np.concatenate([turned, unsure, known.gyro, unsure, known.acceleration, unsure], axis=1),
        "true_base_pose": messages.pose_numbers(known.pelvis),
        **{f"{foot.value}_foot_wrench": known.wrenches[foot] for foot in Foot},
        "center_of_pressure": known.cop,
    }
    frames = {"imu": trace.model.imu, "true_base_pose": WORLD, "center_of_pressure": WORLD}
    frames |= {f"{foot.value}_foot_wrench": trace.model.soles[foot].frame for foot in Foot}
    out: dict[str, list[bytes]] = {}
    for name, column in numbers.items():
        raws = messages.stream(TOPICS[name].type, stamps, frames[name], column)
        whole = np.isfinite(column).all(axis=1)
        out[name] = [raw if there else b"" for raw, there in zip(raws, whole, strict=True)]
    return out


def _opening(trace: Trace) -> Iterator[_Entry]:
    yield "walk_config", messages.text(to_yaml(trace.config))
    if trace.origin:
        yield "walk_origin", messages.text(origin.to_text(trace.origin))
    yield "robot_description", messages.text(trace.model.urdf)


def _phase_start(trace: Trace, record: PhaseRecord, stamp: int) -> Iterator[_Entry]:
    model = trace.model
    base = model.soles[record.base]
    when = np.array([stamp])
    yield "phase", messages.text(record.name)
    yield "support_foot", messages.text(record.support.value)
    yield (
        "phase_start",
        messages.joint_states(when, model.joint_names, record.q_start[None], None, base.frame)[0],
    )
    if record.swing_target is not None:
        yield "swing_target", messages.poses(when, base.frame, record.swing_target[None])[0]
    else:
        target = com_target(model, record.kind, record.base, record.q_start)
        yield "com_target", messages.point(stamp, base.frame, target)


def _pelvis_in_odom(trace: Trace) -> NDArray[np.float64]:
    """Return the pose of the pelvis in odom at every tick, shape (N, 8)."""
    out = np.tile(DQ(1.0).vec8(), (len(trace.time), 1))
    ends = [record.start for record in trace.phases[1:]] + [len(trace.time)]
    for record, end in zip(trace.phases, ends, strict=True):
        for tick in range(record.start, end):
            out[tick] = Kinematics(trace.model, trace.q[tick], record.base).pose(trace.model.pelvis)
        span = slice(record.start, end)
        out[span] = (DQ(record.x_odom_base) * DQ(out[span])).vec8()
    return out


class _Status:
    """What the phase monitor would have said, at its rate."""

    def __init__(self, trace: Trace) -> None:
        self._trace = trace
        self._period = round(1e9 / trace.config.monitor.rate)
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
            phase = make_phase(
                trace.config, trace.model, record.kind, record.support, record.q_start, record.swing_target
            )
            self._assess = Assessor(trace.config, trace.model, phase)
            self._next = stamp
        if self._assess is None or stamp < self._next:
            return None
        self._next = stamp + self._period
        kin = Kinematics(trace.model, trace.q[tick], self._assess.phase.base)
        found = self._assess(kin, float(trace.time[tick]) - phases[self._phase].time)
        values: dict[str, float | str] = {"phase": self._assess.phase.name, **found.values}
        return messages.diagnostics(stamp, "phase_monitor: walk", trace.model.name, found.level, found.message, values)
