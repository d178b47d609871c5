"""Read a walk of phases back from a rosbag2, whatever recorded it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros import config as configuration
from dqwalk_ros import provenance
from dqwalk_ros.config import Config
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import BagError, ConfigError, ModelError
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.report.bag.columns import NS, JointStates, aligned, joint_states, pose_of, tables, texts
from dqwalk_ros.report.bag.storage import Column, Content, load
from dqwalk_ros.robot import Foot, RobotModel, load_model, parse_model
from dqwalk_ros.simulation import PhaseRecord, PhysicsRecord, Trace
from dqwalk_ros.topics import FAILED, FALLEN, FINISHED, REQUIRED, TOPICS
from dqwalk_ros.walk import PhaseKind

__all__ = [
    "check_same_robot",
    "columns_of",
    "config_in",
    "last_run",
    "model_in",
    "origin_in",
    "read",
]

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
_WANTED = {name: topic.type for name, topic in TOPICS.items() if name != "diagnostics"}
_CLOCK = 10**18
"""A stamp beyond this [ns], in 2001, is that of a clock; a simulation's time begins by itself."""
_FARTHEST = 100.0
"""An angle beyond this [rad] is an error of a sensor or of a file."""


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
    content = load(path, lambda topic, kind: _WANTED.get(topic.rpartition("/")[2]) == kind)
    notes = list(content.notes)
    columns = columns_of(path, content, namespace, _WANTED, REQUIRED)
    config = config_in(path, columns)
    model = model_in(path, config, columns, notes)
    states = joint_states(columns["joint_states"], model.joint_names)
    check_same_robot(path, model, states)

    rows, begin = last_run(states.stamps, notes)
    if begin:
        since = columns["joint_states"].order[states.rows[begin]]
        columns = {name: column.since(since) for name, column in columns.items()}
    starts = _starts(path, model, columns, notes)
    stamps, first = np.unique(states.stamps[rows], return_index=True)
    rows = rows[first]
    walking = stamps >= starts[0].stamp
    whole = ~(~(np.abs(states.position[rows]) < _FARTHEST)).any(axis=1)  # no nan is less
    if early := int(np.count_nonzero(~walking)):
        notes.append(f"{early} states before the first phase are left out")
    if not walking.any():
        raise BagError(f"'{path}': every joint state is older than the first phase")
    if not (whole & walking).any():
        lack = [n for n, q in zip(model.joint_names, states.position.T, strict=True) if not np.isfinite(q).all()]
        raise BagError(f"'{path}': joint_states lack positions of {', '.join(lack) or 'every joint'}")
    if bad := int(np.count_nonzero(walking & ~whole)):
        notes.append(f"{bad} states without a number for every joint are left out")
    kept = np.flatnonzero(walking & whole)
    rows, stamps = rows[kept], stamps[kept]
    q: Array = np.ascontiguousarray(states.position[rows])
    u = _commands(path, model, stamps, columns["joint_velocity_commands"], notes)
    unanswered = np.flatnonzero(np.isnan(u).any(axis=1))
    last_word = texts(columns["phase"])[-1]
    if last_word in (FAILED, FALLEN):
        notes.append("the walk failed: a phase could not end by its rule")
    if last_word == FINISHED and len(unanswered) < len(u):  # what the plant published after the walk is no part of it
        end = int(np.setdiff1d(np.arange(len(u)), unanswered)[-1]) + 1
        stamps, q, u, unanswered = stamps[:end], q[:end], u[:end], unanswered[unanswered < end]
    if len(unanswered):
        notes.append(f"{len(unanswered)} of {len(stamps)} states have no command")
    epoch = int(stamps[0]) if stamps[0] > _CLOCK else 0
    return Trace(
        config=config,
        model=model,
        time=(stamps - epoch) / NS,
        q=q,
        u=u,
        phases=_records(model, starts, stamps, _first_base(model, columns, starts[0]), epoch, notes),
        solve_time=np.full(len(stamps), np.nan),
        finished=last_word == FINISHED,
        notes=tuple(notes),
        origin=origin_in(columns),
        physics=_physics(stamps, columns),
        epoch=epoch,
    )


# ---------------------------------------------------------------------- whose walk it is


def columns_of(
    path: Path, content: Content, namespace: str | None, wanted: Mapping[str, str], required: Sequence[str]
) -> dict[str, Column]:
    """Return the columns of one namespace by the names of the contract.

    Parameters
    ----------
    path : Path
        For the messages.
    content : Content
    namespace : str or None
        Of the robot, where the bag holds several.
    wanted : mapping of str to str
        The type of each topic.
    required : sequence of str
        Without these it is not a walk.

    Raises
    ------
    BagError
        If one of those is missing, or there are several robots to choose from.
    """
    found: dict[str, set[str]] = {}
    for topic, kind in content.topics.items():
        prefix, _, name = topic.rpartition("/")
        if wanted.get(name) == kind:
            found.setdefault(prefix, set()).add(name)
    if namespace is not None:
        prefix = "/" + namespace.strip("/") if namespace.strip("/") else ""
    else:
        prefix = max(sorted(found), key=lambda key: len(found[key] & set(required)), default="")
        whole = [key for key, names in found.items() if names >= set(required)]
        if len(whole) > 1:
            raise BagError(f"'{path}' holds the walks of {len(whole)} robots; choose a namespace: {_listed(whole)}")
    columns = {name: content.columns[key] for name in wanted if (key := f"{prefix}/{name}") in content.columns}
    missing = [name for name in required if name not in columns]
    if missing:
        have = _listed(content.topics) or "none"
        raise BagError(f"'{path}' is not a walk: it has no messages on {', '.join(missing)}; its topics are {have}")
    return columns


def _listed(names: Sequence[str] | Mapping[str, str]) -> str:
    """Return some names of a bag, for a message that fits on a line; whatever is in them cannot act on a terminal."""
    shown = [ascii(name)[1:-1][:60] for name in sorted(names)[:12]]
    return ", ".join([*shown, f"and {len(names) - 12} more"] if len(names) > 12 else shown)


def config_in(path: Path, columns: Mapping[str, Column]) -> Config:
    """Return the configuration of the walk.

    Raises
    ------
    BagError
        If it cannot be used.
    """
    try:
        return configuration.from_yaml(texts(columns["walk_config"])[-1], source=f"{path} walk_config")
    except ConfigError as error:
        raise BagError(str(error)) from error


def model_in(path: Path, config: Config, columns: Mapping[str, Column], notes: list[str]) -> RobotModel:
    """Return the robot of the bag; the URDF that is installed serves where the bag has none."""
    if "robot_description" not in columns:
        notes.append(f"robot_description is missing: {config.robot.urdf} as installed here was used")
        return load_model(config.robot)
    try:
        return parse_model(texts(columns["robot_description"])[-1], config.robot)
    except ModelError as error:
        raise BagError(f"'{path}' is of another robot than its walk_config: {error}") from error


def origin_in(columns: Mapping[str, Column]) -> dict[str, str]:
    """Return the versions and the machine that walked, where the bag has them and they can be read."""
    try:
        return provenance.from_text(texts(columns["walk_origin"])[-1]) if "walk_origin" in columns else {}
    except BagError:
        return {}


def check_same_robot(path: Path, model: RobotModel, states: JointStates) -> None:
    """Check that the states name every joint of the model.

    Raises
    ------
    BagError
        If they do not.
    """
    missing = [name for name in model.joint_names if name not in states.named]
    if missing:
        raise BagError(
            f"'{path}' is of another robot: joint_states lack {', '.join(missing)} of {model.name}; "
            f"they name {_listed(states.named)}"
        )


# ---------------------------------------------------------------------- time

_GAP = NS
"""A stamp this far ahead of the one before it [ns] may be an error of one message."""
_FEW, _PART = 5, 0.01
"""So many states, or this part of all, may have a stamp that cannot be; more of them are another run."""


def last_run(stamps: Stamps, notes: list[str]) -> tuple[NDArray[np.intp], int]:
    """Return the rows of the last run, in the order of time, and the row it begins with.

    Where time goes back the plant began anew. But a few states whose stamp fits neither before nor after them are
    errors of messages: they alone are left out.
    """
    few = max(_FEW, _PART * len(stamps))
    step = np.diff(stamps)
    kept: list[NDArray[np.intp]] = []
    wrong = again = begin = 0
    for run in np.split(np.arange(len(stamps)), np.flatnonzero((step < 0) | (step > _GAP)) + 1):
        while kept and stamps[kept[-1][-1]] > stamps[run[0]] and len(kept[-1]) <= min(few, len(run)):
            wrong += len(kept.pop())  # it lay ahead of what follows
        if not kept or stamps[run[0]] - stamps[kept[-1][-1]] > _GAP:
            kept.append(run)
        elif stamps[run[0]] >= stamps[kept[-1][-1]]:
            kept[-1] = np.concatenate([kept[-1], run])
        elif len(run) <= few:
            wrong += len(run)  # it lies behind what came before
        else:
            again, begin, kept = again + 1, int(run[0]), [run]
    if len(kept) > 1 and len(kept[-1]) <= _FEW:
        wrong += len(kept.pop())  # it lies ahead, and nothing follows
    if again:
        notes.append(f"time went back {again} times: only the last run is read")
    if wrong:
        notes.append(f"{wrong} states whose stamp cannot be are left out")
    return np.concatenate([np.zeros(0, np.intp), *kept]), begin


# ---------------------------------------------------------------------- phases


@dataclass(frozen=True)
class _Start:
    """The start of a phase as recorded."""

    name: str
    kind: PhaseKind
    support: Foot
    base: Foot
    stamp: int
    q: Array
    swing_target: Array | None


def _starts(path: Path, model: RobotModel, columns: Mapping[str, Column], notes: list[str]) -> list[_Start]:
    """Return every phase in order; the names that were published are joined to the starts in their order."""
    names = [name for name in texts(columns["phase"]) if "/" in name]
    begun = joint_states(columns["phase_start"], model.joint_names)
    if not names or not len(begun.stamps):
        raise BagError(f"'{path}' holds no phase of a walk")
    feet = {model.soles[foot].frame: foot for foot in Foot}
    if not set(begun.frames) <= set(feet) or not set(model.joint_names) <= set(begun.named):
        told = f"{ascii(begun.frames[0])[1:-1][:60]} and {_listed(begun.named)}"
        raise BagError(f"'{path}' is of another robot: phase_start names {told}")
    targets = _swing_targets(columns.get("swing_target"))
    known = [_parsed(name) for name in names]
    # a name is published again after a pause, and does not tell which start it belongs to
    in_order = len(names) == len(begun.stamps) == len(columns["phase_start"].raws) and None not in known
    if None in known:
        strange = ascii(names[known.index(None)])[:60]
        notes.append(f"no phase is called {strange}: phases are told by their base sole and swing target")
    found: dict[int, _Start] = {}
    for i, stamp in enumerate(begun.stamps.tolist()):
        base, q, target = feet[begun.frames[i]], begun.position[i], targets.get(stamp)
        kind = PhaseKind.DOUBLE_SUPPORT if target is None else PhaseKind.SINGLE_SUPPORT
        support = base if kind is PhaseKind.SINGLE_SUPPORT else base.other
        name = f"{kind.value}/{support.value}"
        if in_order and (parsed := known[i]) is not None:
            name, (kind, support) = names[i], parsed
        time = stamp / NS
        if base is not (support if kind is PhaseKind.SINGLE_SUPPORT else support.other):
            raise BagError(f"'{path}': {name} cannot stand on the {base.value} foot")
        if kind is PhaseKind.SINGLE_SUPPORT and target is None:
            raise BagError(f"'{path}': the swing target of {name} at {time:.3f} s is missing")
        if not (np.abs(q) < _FARTHEST).all() or not (target is None or _is_pose(target)):
            raise BagError(f"'{path}': {name} at {time:.3f} s begins with numbers that cannot be")
        found[stamp] = _Start(name, kind, support, base, stamp, q, target)
    return [found[stamp] for stamp in sorted(found)]


def _parsed(name: str) -> tuple[PhaseKind, Foot] | None:
    kind, _, foot = name.partition("/")
    try:
        return PhaseKind(kind), Foot(foot)
    except ValueError:
        return None


def _is_pose(x: Array) -> bool:
    """Tell whether (8,) is a unit dual quaternion at a place that a robot may reach."""
    return bool(np.isfinite(x).all() and abs(np.linalg.norm(x[:4]) - 1.0) < 1e-6 and np.abs(x[4:]).max() < _FARTHEST)


def _swing_targets(column: Column | None) -> dict[int, Array]:
    """Return the landing places (8,) by their stamp [ns]."""
    out: dict[int, Array] = {}
    for found in tables(column) if column is not None else ():
        out |= dict(zip(found.stamps.tolist(), pose_of(found.numbers), strict=True))
    return out


def _first_base(model: RobotModel, columns: Mapping[str, Column], start: _Start) -> Array:
    """Return the pose of the first phase's base sole in odom: the origin, unless the recording began later."""
    one = DQ(1.0).vec8()
    (told,) = pose_of(aligned(columns.get("base_pose"), np.array([start.stamp]), 7))
    if not _is_pose(told):
        return one
    x = (DQ(told) * DQ(Kinematics(model, start.q, start.base).pose(model.pelvis)).conj()).vec8()
    return one if min(np.abs(x - one).max(), np.abs(x + one).max()) < _SAME_POSE else x


_SAME_POSE = 1e-9


def _records(
    model: RobotModel, starts: Sequence[_Start], stamps: Stamps, x_odom_base: Array, epoch: int, notes: list[str]
) -> tuple[PhaseRecord, ...]:
    """Return the records; odometry goes on where the base changes: x_odom_new = x_odom_old x_old_new(q_start).

    Their times count from `epoch` [ns].
    """
    out: list[PhaseRecord] = []
    for start in starts:
        if out and out[-1].base is not start.base:
            step = Kinematics(model, start.q, out[-1].base).pose(model.soles[start.base].frame)
            x_odom_base = (DQ(x_odom_base) * DQ(step)).vec8()
        tick, time = int(np.searchsorted(stamps, start.stamp)), (start.stamp - epoch) / NS
        if tick == len(stamps):
            notes.append(f"{start.name} began at {time:.3f} s, after the last state, and is left out")
            break
        if out and out[-1].start == tick:  # over before the recording began
            out.pop()
        if stamps[tick] != start.stamp:
            notes.append(f"the state at which {start.name} began, {time:.3f} s, is missing")
        out.append(
            PhaseRecord(
                name=start.name,
                kind=start.kind,
                support=start.support,
                base=start.base,
                start=tick,
                time=time,
                q_start=start.q,
                swing_target=start.swing_target,
                x_odom_base=x_odom_base,
            )
        )
    return tuple(out)


# ---------------------------------------------------------------------- what goes with the states


def _commands(path: Path, model: RobotModel, stamps: Stamps, column: Column, notes: list[str]) -> Array:
    """Return the velocity that answers each state, shape (N, n), nan where none does."""
    commands = joint_states(column, model.joint_names)
    if missing := [name for name in model.joint_names if name not in commands.named]:
        raise BagError(f"'{path}': joint_velocity_commands lack {', '.join(missing)}")
    u = np.full((len(stamps), model.n), np.nan)
    place = np.searchsorted(stamps, commands.stamps)
    place[place == len(stamps)] = 0
    match = stamps[place] == commands.stamps
    finite = np.isfinite(commands.velocity).all(axis=1)
    u[place[match & finite]] = commands.velocity[match & finite]
    if stray := int(np.count_nonzero(~match)):
        notes.append(f"{stray} commands answer a state the bag does not hold")
    if wrong := int(np.count_nonzero(~finite)):
        notes.append(f"{wrong} commands are not of finite numbers")
    return u


def _physics(stamps: Stamps, columns: Mapping[str, Column]) -> PhysicsRecord | None:
    """Return what a physics engine said at each state, nan where it did not; None where there was none."""
    if "true_base_pose" not in columns:
        return None
    imu, pose = (aligned(columns.get(name), stamps, width) for name, width in (("imu", 37), ("true_base_pose", 7)))
    return PhysicsRecord(
        pelvis=pose_of(pose),
        wrenches={foot: aligned(columns.get(f"{foot.value}_foot_wrench"), stamps, 6) for foot in Foot},
        cop=aligned(columns.get("center_of_pressure"), stamps, 3),
        orientation=imu[:, [3, 0, 1, 2]],
        gyro=imu[:, 13:16],
        acceleration=imu[:, 25:28],
    )
