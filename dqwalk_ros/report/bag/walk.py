"""Writes a walk of phases as a rosbag2, in the form of the recorder node, and reads one back."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator, Mapping

import numpy as np

from dqwalk_ros.config import to_yaml
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.paper.walk import com_target
from dqwalk_ros.report.bag import messages
from dqwalk_ros.report.bag.messages import (
    NS,
    Messages,
    Stamps,
    aligned,
    at_stamps,
    joint_states,
    pack,
    pack_joint_states,
    pack_known,
    pack_poses,
    pose_numbers,
    pose_of,
    stamped,
    stamps_of,
    tables,
    text,
    texts,
)
from dqwalk_ros.report.bag.recording import Recording, open_recording, preamble
from dqwalk_ros.report.bag.storage import Column, Source, write_columns
from dqwalk_ros.report.metrics import pelvis_in_odom
from dqwalk_ros.report.verdict import Assessor
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import BagError, listed, shown
from dqwalk_ros.support.topics import FAILED, FALLEN, FINISHED, ODOM, REQUIRED, TOPICS, WORLD
from dqwalk_ros.trace import PhaseRecord, PhysicsRecord, Trace, known_loads

__all__ = ["read", "read_orientations", "write"]

_CLOCK = 10**18
"""Stamps above this [ns], a time in 2001, are those of a clock; smaller ones are simulated time."""
_FARTHEST = 100.0
"""Angles above this [rad] are errors of a sensor or of the file; positions above this [m] likewise."""
_UNIT = 0.01
"""Largest difference of the norm of a recorded orientation from one."""
_SAME_POSE = 5e-3
"""Largest difference of a pose from the origin that is attributed to the estimation of the base."""


# ---------------------------------------------------------------------- writing


def write(trace: Trace, path: str | os.PathLike[str], *, diagnostics: bool = True, overwrite: bool = False) -> None:
    """Write a walk to the folder `path`, which is created when the bag is complete.

    Parameters
    ----------
    trace : Trace
        With at least one state.
    diagnostics : bool
        Add ``/diagnostics`` at ``monitor.rate``.
    overwrite : bool
        Replace an existing bag.

    Raises
    ------
    BagError
        If the walk has no state, or the folder exists already or cannot be written.
    """
    if len(trace.time) == 0:
        raise BagError("a walk without a state cannot be written as a bag")
    known = {"physics": trace.physics is not None, "effort": trace.loads is not None}
    topics = {name: topic for name, topic in TOPICS.items() if known.get(topic.source, True)}
    if not diagnostics:
        del topics["diagnostics"]
    write_columns(path, topics, _columns(trace, diagnostics), overwrite=overwrite)


def _columns(trace: Trace, diagnostics: bool) -> list[Messages]:
    """Return the messages of each topic, in the order of publication within one period."""
    stamps, names, model = stamps_of(trace.time) + trace.epoch, trace.model.joint_names, trace.model
    applied = np.zeros_like(trace.u)  # the velocity that led to a state is the command before it
    applied[1:] = np.nan_to_num(trace.u[:-1])
    answered = ~np.isnan(trace.u[:, 0])
    effort = None if trace.physics is None else trace.physics.effort
    found = preamble(trace, stamps[:1])
    before = trace.config
    for record in trace.phases:
        config = record.config or trace.config
        if config != before:
            stamp = stamps[[record.start]]
            found.append(("walk_config", stamp, [text(to_yaml(config, int(stamp[0])))]))
        before = config
    found += [
        *([] if trace.physics is None else _physics_messages(model, stamps, trace.physics)),
        *([] if trace.loads is None else _loads(model, stamps, trace.loads)),
        ("joint_states", stamps, pack_joint_states(stamps, names, position=trace.q, velocity=applied, effort=effort)),
        *(column for record in trace.phases for column in _phase_start(model, record, stamps[[record.start]])),
        (
            "joint_velocity_commands",
            stamps[answered],
            pack_joint_states(stamps[answered], names, velocity=trace.u[answered]),
        ),
        ("base_pose", stamps, pack_poses(stamps, ODOM, pelvis_in_odom(trace))),
        *(_diagnostics(trace, stamps) if diagnostics else []),
    ]
    if trace.finished:
        found.append(("phase", stamps[-1:], [text(FINISHED)]))
    return found


def _physics_messages(model: RobotModel, stamps: Stamps, known: PhysicsRecord) -> list[Messages]:
    """Return the messages of the physics node, for the ticks on which their values are known."""
    unsure = np.zeros((len(stamps), 9))
    turned = known.orientation[:, [1, 2, 3, 0]]
    felt = np.concatenate([turned, unsure, known.gyro, unsure, known.acceleration, unsure], axis=1)
    numbers = {
        "imu": (model.imu_link, felt),
        "true_base_pose": (WORLD, pose_numbers(known.pelvis)),
        **{f"{foot.value}_foot_wrench": (model.soles[foot].frame, known.wrenches[foot]) for foot in Foot},
        "center_of_pressure": (WORLD, known.cop),
    }
    found = [pack_known((name, TOPICS[name].type), frame, stamps, column) for name, (frame, column) in numbers.items()]
    there = np.isfinite(known.q).all(axis=1)
    angles = pack_joint_states(stamps[there], model.joint_names, position=known.q[there])
    return [*found, ("true_joint_states", stamps[there], angles)]


def _loads(model: RobotModel, stamps: Stamps, loads: Array) -> Iterator[Messages]:
    """Return the messages of the estimated loads (N, 2) of the feet [N], of the states at which they are known."""
    for foot, load in zip(Foot, loads.T, strict=True):
        name, wrench = f"{foot.value}_foot_load", np.zeros((len(load), 6))
        wrench[:, 2] = load
        yield pack_known((name, TOPICS[name].type), model.soles[foot].frame, stamps, wrench)


def _phase_start(model: RobotModel, record: PhaseRecord, stamp: Stamps) -> list[Messages]:
    """Return the messages published at the start of a phase."""
    frame = model.soles[record.base].frame
    shown = [label for label in (record.name, record.decision) if label]
    found = [
        ("phase", np.repeat(stamp, len(shown)), [text(label) for label in shown]),
        ("support_foot", stamp, [text(record.support.value)]),
        ("phase_start", stamp, pack_joint_states(stamp, model.joint_names, position=record.q_start[None], frame=frame)),
    ]
    if record.swing_target is not None:
        return [*found, ("swing_target", stamp, pack_poses(stamp, frame, record.swing_target[None]))]
    target = com_target(record.kind, Kinematics(model, record.q_start, record.base))
    return [*found, ("com_target", stamp, pack(stamped(TOPICS["com_target"].type, frame), stamp, target[None]))]


def _diagnostics(trace: Trace, stamps: Stamps) -> list[Messages]:
    """Return the messages of the phase monitor, at its rate from the beginning of each phase."""
    period, found = round(NS / trace.config.monitor.rate), []
    for record, ticks in zip(trace.phases, trace.spans, strict=True):
        assess = Assessor(trace.config, trace.model, record.phase(trace.config, trace.model))
        due = np.arange(stamps[ticks.start], stamps[ticks.stop - 1] + 1, period)
        for tick in np.unique(np.searchsorted(stamps, due)).tolist():
            kin = Kinematics.measured(trace.model, trace.q[tick], record.base, trace.up(tick))
            seen = assess(kin, float(trace.time[tick]) - record.time)
            values = {"phase": assess.phase.name, **seen.values}
            status = "phase_monitor: walk", trace.model.name, seen.level, seen.message, values
            found.append(("diagnostics", stamps[[tick]], [messages.diagnostics(int(stamps[tick]), *status)]))
    return found


# ---------------------------------------------------------------------- reading


def read(source: Source, *, namespace: str | None = None, walk: str = "") -> Trace:
    """Read a recorded walk.

    The bag may be MCAP or SQLite, split or compressed, recorded live (more joints, another order, states without
    a command) or cut off by a crash. The robot is that of the bag's ``robot_description``.

    Parameters
    ----------
    source : path-like or Content
        The bag's folder, one of its files, or its content as of `content_of`.
    namespace : str, optional
        Of the robot, if the bag contains several.
    walk : str
        The class MODULE:CLASS of the walk, if it is not one of this package: a recording cannot name code to import.

    Returns
    -------
    Trace
        Velocities are nan where a state has no command; missing and omitted data are listed in ``notes``.

    Raises
    ------
    BagError
        If the bag cannot be read, lacks a required topic, or is that of another robot.
    """
    bag = open_recording(source, namespace, TOPICS, REQUIRED, walk)
    path, model, notes, stamps = bag.path, bag.model, bag.notes, bag.stamps
    starts = _starts(bag)
    q = bag.states.position[bag.rows]
    walking = stamps >= min(starts)
    whole = ~(~(np.abs(q) < _FARTHEST)).any(axis=1)  # false for nan
    if early := int(np.count_nonzero(~walking)):
        notes.append(f"{early} states before the first phase are left out")
    if not walking.any():
        raise BagError(f"'{path}': every joint state is older than the first phase")
    if not (whole & walking).any():
        lack = [n for n, a in zip(model.joint_names, bag.states.position.T, strict=True) if not np.isfinite(a).all()]
        raise BagError(f"'{path}': joint_states lack positions of {', '.join(lack) or 'every joint'}")
    if bad := int(np.count_nonzero(walking & ~whole)):
        notes.append(f"{bad} states without a number for every joint are left out")
    stamps, q = stamps[walking & whole], q[walking & whole]
    u = _commands(bag, stamps)
    unanswered = np.flatnonzero(np.isnan(u).any(axis=1))
    last_phase = next((name for name in reversed(texts(bag.columns["phase"])) if name), "")
    if last_phase in (FAILED, FALLEN):
        notes.append("the walk failed: a phase could not end by its rule")
    if last_phase == FINISHED and len(unanswered) < len(u):  # states after the end of the walk are omitted
        end = int(np.setdiff1d(np.arange(len(u)), unanswered)[-1]) + 1
        stamps, q, u, unanswered = stamps[:end], q[:end], u[:end], unanswered[unanswered < end]
    if len(unanswered):
        notes.append(f"{len(unanswered)} of {len(stamps)} states have no command")
    epoch = int(stamps[0]) if stamps[0] > _CLOCK else 0
    whole_walk = max(starts) <= int(stamps[-1])  # else the states of its last phases are missing
    return Trace(
        config=bag.config,
        model=model,
        time=(stamps - epoch) / NS,
        q=q,
        u=u,
        phases=_records(bag, starts, stamps, epoch),
        solve_time=np.full(len(stamps), np.nan),
        finished=last_phase == FINISHED and whole_walk,
        notes=tuple(notes),
        origin=bag.origin,
        physics=_physics(bag, stamps),
        loads=known_loads(np.column_stack([force[:, 2] for force in _forces(bag, stamps, "load").values()])),
        epoch=epoch,
        cut=not whole_walk or (bag.cut and last_phase not in (FINISHED, FAILED, FALLEN)),
    )


def read_orientations(path: str | os.PathLike[str]) -> Array:
    """Return the recorded orientations of the inertial sensor, unit quaternions (m, 4), real part first.

    Without a sensor m is zero. Errors are those of `read`.
    """
    columns = open_recording(path, None, TOPICS, REQUIRED).columns
    seen = np.concatenate([np.zeros((0, 4)), *(table.numbers[:, :4] for table in tables(columns.get("imu")))])
    out: Array = seen[np.abs(np.linalg.norm(seen, axis=1) - 1.0) < _UNIT][:, [3, 0, 1, 2]]
    return out


# ---------------------------------------------------------------------- phases


def _starts(bag: Recording) -> dict[int, PhaseRecord]:
    """Return the record of every phase by its stamp [ns], in order, still without tick, pose in odom and changes.

    Published names are assigned to the starts in the order of both.
    """
    path, model, columns = bag.path, bag.model, bag.columns
    names = [name for name in texts(columns["phase"]) if "/" in name]
    begun = joint_states(columns["phase_start"], model.joint_names)
    if not names or not len(begun.stamps):
        raise BagError(f"'{path}' contains no phase of a walk")
    if not set(begun.frames) <= set(model.foot_of) or not set(model.joint_names) <= set(begun.named):
        given = f"{shown(begun.frames[0])} and {listed(begun.named)}"
        raise BagError(f"'{path}' is of another robot: phase_start names {given}")
    targets = _swing_targets(columns.get("swing_target"))
    known = [_parsed(name) for name in names]
    # a name is published again after a pause, so it does not identify its start
    in_order = len(names) == len(begun.stamps) == len(columns["phase_start"].raws) and None not in known
    if None in known:
        strange = shown(names[known.index(None)])
        bag.notes.append(f"unknown phase '{strange}': phases are identified by their base sole and swing target")
    found: dict[int, PhaseRecord] = {}
    for i, stamp in enumerate(begun.stamps.tolist()):
        base, q, target = model.foot_of[begun.frames[i]], begun.position[i], targets.get(stamp)
        kind = PhaseKind.DOUBLE_SUPPORT if target is None else PhaseKind.SINGLE_SUPPORT
        support = base if kind is PhaseKind.SINGLE_SUPPORT else base.other
        name = f"{kind.value}/{support.value}"
        if in_order and (parsed := known[i]) is not None:
            name, (kind, support) = names[i], parsed
        time = stamp / NS
        if base is not (support if kind is PhaseKind.SINGLE_SUPPORT else support.other):
            raise BagError(
                f"'{path}': {name} at {time:.3f} s cannot stand on the {base.value} foot: messages of phase, "
                "phase_start or swing_target are missing or in another order"
            )
        if kind is PhaseKind.SINGLE_SUPPORT and target is None:
            raise BagError(f"'{path}': the swing target of {name} at {time:.3f} s is missing")
        if not (np.abs(q) < _FARTHEST).all() or not (target is None or _is_pose(target)):
            raise BagError(f"'{path}': {name} at {time:.3f} s begins with impossible numbers")
        found[stamp] = PhaseRecord(name, kind, support, base, 0, time, q, target, DQ(1.0).vec8())
    return dict(sorted(found.items()))


def _parsed(name: str) -> tuple[PhaseKind, Foot] | None:
    kind, _, foot = name.partition("/")
    try:
        return PhaseKind(kind), Foot(foot)
    except ValueError:
        return None


def _is_pose(x: Array) -> bool:
    """Return whether (8,) is a unit dual quaternion with a plausible position."""
    return bool(np.isfinite(x).all() and abs(np.linalg.norm(x[:4]) - 1.0) < 1e-6 and np.abs(x[4:]).max() < _FARTHEST)


def _swing_targets(column: Column | None) -> dict[int, Array]:
    """Return the targets (8,) of the swing foot by their stamp [ns]."""
    out: dict[int, Array] = {}
    for found in tables(column):
        out |= dict(zip(found.stamps.tolist(), pose_of(found.numbers), strict=True))
    return out


def _first_base(bag: Recording, stamp: int, start: PhaseRecord) -> Array:
    """Return the pose of the first phase's base sole in odom: the origin, unless the recording started later."""
    (recorded,) = pose_of(aligned(bag.columns.get("base_pose"), np.array([stamp]), 7))
    if not _is_pose(recorded):
        return start.x_odom_base
    x = (DQ(recorded) * DQ(Kinematics(bag.model, start.q_start, start.base).pose(bag.model.pelvis)).conj()).vec8()
    one = start.x_odom_base
    return one if min(np.abs(x - one).max(), np.abs(x + one).max()) < _SAME_POSE else x


def _records(bag: Recording, starts: Mapping[int, PhaseRecord], stamps: Stamps, epoch: int) -> tuple[PhaseRecord, ...]:
    """Return the records of the phases, with times counted from `epoch` [ns].

    Where the base sole changes, its pose in odom is updated: x_odom_new = x_odom_old x_old_new(q_start). After a change
    of parameters a record has the changed configuration.
    """
    model, out = bag.model, list[PhaseRecord]()
    first = min(starts)
    x_odom_base = _first_base(bag, first, starts[first])
    for stamp, start in starts.items():
        if out and out[-1].base is not start.base:
            step = Kinematics(model, start.q_start, out[-1].base).pose(model.soles[start.base].frame)
            x_odom_base = (DQ(x_odom_base) * DQ(step)).vec8()
        tick, time = int(np.searchsorted(stamps, stamp)), (stamp - epoch) / NS
        if tick == len(stamps):
            bag.notes.append(f"{start.name} began at {time:.3f} s, after the last state, and is left out")
            break
        if out and out[-1].start == tick:  # ended before the recording started
            out.pop()
        if stamps[tick] != stamp:
            bag.notes.append(f"the state at which {start.name} began, {time:.3f} s, is missing")
        tuned = max((since for since in bag.tuned if since <= stamp), default=None)
        config = None if tuned is None else bag.tuned[tuned]
        out.append(dataclasses.replace(start, start=tick, time=time, x_odom_base=x_odom_base, config=config))
    return tuple(out)


# ---------------------------------------------------------------------- commands and physics


def _commands(bag: Recording, stamps: Stamps) -> Array:
    """Return the velocity commanded for each state, shape (N, n); nan for a state without a command."""
    names = bag.model.joint_names
    commands = joint_states(bag.columns["joint_velocity_commands"], names)
    if missing := [name for name in names if name not in commands.named]:
        raise BagError(f"'{bag.path}': joint_velocity_commands lack {', '.join(missing)}")
    if stray := int(np.count_nonzero(~np.isin(commands.stamps, bag.states.stamps))):
        bag.notes.append(f"{stray} commands answer a state that is not in the bag")
    if wrong := int(np.count_nonzero(~np.isfinite(commands.velocity).all(axis=1))):
        bag.notes.append(f"{wrong} commands are not finite")
    return at_stamps(stamps, commands.stamps, commands.velocity)


def _forces(bag: Recording, stamps: Stamps, what: str) -> dict[Foot, Array]:
    """Return the messages (N, 6) of each foot on ``left_foot_WHAT`` and ``right_foot_WHAT``; nan where missing."""
    return {foot: aligned(bag.columns.get(f"{foot.value}_foot_{what}"), stamps, 6) for foot in Foot}


def _physics(bag: Recording, stamps: Stamps) -> PhysicsRecord | None:
    """Return the record of a walk in physics, nan where a message is missing; None for a walk without physics."""
    columns = bag.columns
    if "true_base_pose" not in columns:
        return None
    imu, pose = (aligned(columns.get(name), stamps, width) for name, width in (("imu", 37), ("true_base_pose", 7)))
    return PhysicsRecord(
        pelvis=pose_of(pose),
        wrenches=_forces(bag, stamps, "wrench"),
        cop=aligned(columns.get("center_of_pressure"), stamps, 3),
        orientation=imu[:, [3, 0, 1, 2]],
        gyro=imu[:, 13:16],
        acceleration=imu[:, 25:28],
        q=_true_angles(bag, stamps),
        effort=bag.states.effort[bag.rows[np.searchsorted(bag.stamps, stamps)]],
    )


def _true_angles(bag: Recording, stamps: Stamps) -> Array:
    """Return the true joint angles of each state, shape (N, n) [rad]; nan where they are missing."""
    names = bag.model.joint_names
    if (column := bag.columns.get("true_joint_states")) is None:
        return np.full((len(stamps), len(names)), np.nan)
    found = joint_states(column, names)
    return at_stamps(stamps, found.stamps, found.position)
