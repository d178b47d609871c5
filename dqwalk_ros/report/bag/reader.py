"""Read a rosbag2 back into a `Trace`, whoever recorded it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import BagError
from dqwalk_ros.model import Foot, RobotModel
from dqwalk_ros.report.bag import messages, storage
from dqwalk_ros.report.bag.joints import unpack_joint_states
from dqwalk_ros.report.bag.robot import (
    after_restart,
    check_same_robot,
    config_in,
    model_in,
    of_one_robot,
    origin_in,
)
from dqwalk_ros.report.bag.starts import first_base, records, starts, texts
from dqwalk_ros.report.bag.storage import Column
from dqwalk_ros.topics import FAILED, FINISHED, REQUIRED, TOPICS
from dqwalk_ros.trace import PhysicsRecord, Trace

__all__ = ["read"]

Array = NDArray[np.float64]
_WANTED = {name: topic.type for name, topic in TOPICS.items() if name != "diagnostics"}
_CLOCK = 10**18
"""A stamp beyond this [ns], in 2001, is that of a clock; a simulation's time begins by itself."""


def read(path: str | os.PathLike[str], *, namespace: str | None = None) -> Trace:
    """Read a recorded walk.

    The bag may be MCAP or SQLite, split or compressed, recorded live (more joints, another order, states without
    a command) or cut off by a crash. The robot is that of the bag's ``robot_description``.

    Parameters
    ----------
    path : path-like
        The bag's folder, or one of its files.
    namespace : str, optional
        Of the robot, where the bag holds several.

    Returns
    -------
    Trace
        Velocities are nan where a state has no command; what was missing or left out is in ``notes``.

    Raises
    ------
    BagError
        If the bag cannot be read, lacks a topic that is needed, or is that of another robot.
    """
    path = Path(path)
    content = storage.load(path, lambda topic, kind: _WANTED.get(topic.rsplit("/", 1)[-1]) == kind)
    notes = list(content.notes)
    columns = of_one_robot(path, content, namespace, _WANTED, REQUIRED)
    config = config_in(path, columns)
    model = model_in(path, config, columns, notes)
    states = unpack_joint_states(columns["joint_states"].raws)
    check_same_robot(path, model, states)

    first = after_restart(states.stamps, notes)
    since = columns["joint_states"].times[first] if first else None
    began = starts(path, model, {name: _cut(column, since) for name, column in columns.items()})
    stamps, rows = _ticks(states.stamps, first, began[0].stamp, notes)
    q = np.ascontiguousarray(states.position[rows][:, states.columns(model.joint_names)])
    whole = np.isfinite(q).all(axis=1)
    if not whole.any():
        bad = [name for name, column in zip(model.joint_names, q.T, strict=True) if not np.isfinite(column).all()]
        raise BagError(f"'{path}': joint_states lack positions of {', '.join(bad)}" if bad else _too_old(path))
    if not whole.all():
        notes.append(f"{np.count_nonzero(~whole)} states without a number for every joint are left out")
        stamps, q = stamps[whole], q[whole]
    u, answered = _commands(model, stamps, columns["joint_velocity_commands"], notes)
    last_word = texts(_cut(columns["phase"], since))[-1]
    finished = last_word == FINISHED
    if last_word == FAILED:
        notes.append("the walk failed: a phase could not end by its rule")
    if finished and answered.any():  # what the plant went on to say is no part of the walk
        last = int(np.flatnonzero(answered)[-1]) + 1
        stamps, q, u, answered = stamps[:last], q[:last], u[:last], answered[:last]
    if not answered.all():
        notes.append(f"{np.count_nonzero(~answered)} of {len(stamps)} states have no command")
    epoch = int(stamps[0]) if stamps[0] > _CLOCK else 0
    return Trace(
        config=config,
        model=model,
        time=(stamps - epoch) / 1e9,
        q=q,
        u=u,
        phases=records(model, began, stamps, first_base(model, columns, began[0]), epoch, notes),
        solve_time=np.full(len(stamps), np.nan),
        finished=finished,
        notes=tuple(notes),
        origin=origin_in(columns),
        physics=_physics(stamps, columns),
        epoch=epoch,
    )


def _too_old(path: Path) -> str:
    return f"'{path}': every joint state is older than the first phase"


# ---------------------------------------------------------------------- time


def _cut(column: Column, since: int | None) -> Column:
    """Return the messages recorded at `since` [ns] or later, and where there is none the last before it."""
    if since is None:
        return column
    first = next((i for i, time in enumerate(column.times) if time >= since), len(column.times) - 1)
    return Column(column.type, column.times[first:], column.raws[first:])


def _ticks(
    stamps: NDArray[np.int64], first: int, start: int, notes: list[str]
) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """Return the stamps from `start` [ns] on and their rows, each once."""
    unique, rows = np.unique(stamps[first:], return_index=True)
    keep = unique >= start
    if before := int(np.count_nonzero(~keep)):
        notes.append(f"{before} states before the first phase are left out")
    return unique[keep], rows[keep] + first


def _commands(
    model: RobotModel, stamps: NDArray[np.int64], column: Column, notes: list[str]
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the velocity that answers each state, shape (N, n), nan where none does; and which are answered."""
    commands = unpack_joint_states(column.raws)
    u = np.full((len(stamps), model.n), np.nan)
    missing = [name for name in model.joint_names if name not in commands.names]
    if missing:
        raise BagError(f"joint_velocity_commands lack {', '.join(missing)}")
    place = np.searchsorted(stamps, commands.stamps)
    place[place == len(stamps)] = 0
    match = stamps[place] == commands.stamps
    u[place[match]] = commands.velocity[match][:, commands.columns(model.joint_names)]
    if stray := int(np.count_nonzero(~match)):
        notes.append(f"{stray} commands answer a state the bag does not hold")
    return u, ~np.isnan(u).any(axis=1)


def _physics(stamps: NDArray[np.int64], columns: Mapping[str, Column]) -> PhysicsRecord | None:
    """Return what a physics engine said at each state, nan where it did not; None where there was none."""
    if "true_base_pose" not in columns:
        return None

    def column(name: str, width: int) -> Array:
        out = np.full((len(stamps), width), np.nan)
        if name in columns:
            when, numbers = messages.unpack_stream(columns[name].type, columns[name].raws)
            place = np.searchsorted(stamps, when)
            place[place == len(stamps)] = 0
            match = stamps[place] == when
            out[place[match]] = numbers[match]
        return out

    imu, pose = column("imu", 37), column("true_base_pose", 7)
    return PhysicsRecord(
        pelvis=DQ.from_pose(pose[:, :3], pose[:, [6, 3, 4, 5]]).vec8(),
        wrenches={foot: column(f"{foot.value}_foot_wrench", 6) for foot in Foot},
        cop=column("center_of_pressure", 3),
        orientation=imu[:, [3, 0, 1, 2]],
        gyro=imu[:, 13:16],
        acceleration=imu[:, 25:28],
    )
