"""Writes a walk of phases as a rosbag2, in the form of the recorder node, and reads one back."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

import numpy as np

from dqwalk_ros.config import to_yaml
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import names_phase
from dqwalk_ros.paper.walk import com_target
from dqwalk_ros.report.bag import messages, phases
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
from dqwalk_ros.report.bag.phases import FARTHEST
from dqwalk_ros.report.bag.recording import Recording, open_recording, preamble
from dqwalk_ros.report.bag.storage import Source, write_columns
from dqwalk_ros.report.metrics import pelvis_in_odom
from dqwalk_ros.report.verdict import Assessor
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import BagError
from dqwalk_ros.support.interrupts import postponed_interrupts
from dqwalk_ros.support.topics import FAILED, FALLEN, FINISHED, ODOM, REQUIRED, TOPICS, WORLD
from dqwalk_ros.support.wording import one_line
from dqwalk_ros.trace import PhaseRecord, PhysicsRecord, Trace, known_loads

_CLOCK = 10**18
"""Stamps above this [ns], a time in 2001, are those of a clock; smaller ones are simulated time."""
_UNIT = 0.01
"""Largest difference of the norm of a recorded orientation from one."""


# ---------------------------------------------------------------------- writing


def write(trace: Trace, path: str | os.PathLike[str], *, diagnostics: bool = True, overwrite: bool = False) -> None:
    """Write a walk to the folder `path`, which is created when the bag is complete.

    Ctrl-C meanwhile acts afterwards, unless the walk was interrupted, too; a second one acts at once.

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
    known = {"physics": trace.physics is not None, "effort": trace.loads is not None, "warning": False}
    topics = {name: topic for name, topic in TOPICS.items() if known.get(topic.source, True)}
    if not diagnostics:
        del topics["diagnostics"]
    with contextlib.nullcontext() if trace.interrupted else postponed_interrupts():
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
    begun, notes = phases.starts(bag), bag.notes
    stamps, q = _walking(bag, min(begun))
    u = _commands(bag, stamps)
    answered = np.flatnonzero(~np.isnan(u).any(axis=1))
    last = next((name for name in reversed(texts(bag.columns["phase"])) if name), "")
    failed, finished = last in (FAILED, FALLEN), last == FINISHED
    if failed:
        notes.append("the walk failed: a phase could not end by its rule")
    warned = bag.columns.get("plant_warning")
    if warned is not None and (asked := next(filter(None, texts(warned)), "")):
        notes.append(f"the plant has asked for the end of the walk: {one_line(asked)}")
    if len(answered) and names_phase(last) and phases.is_last(bag, begun, int(stamps[answered[-1]]), q[answered[-1]]):
        finished = True
        notes.append(f"the message '{FINISHED}' is missing: the last phase is over, and no other has begun")
    if finished and len(answered):  # states after the end of the walk are omitted
        end = int(answered[-1]) + 1
        stamps, q, u = stamps[:end], q[:end], u[:end]
    if unanswered := len(stamps) - len(answered):
        notes.append(f"{unanswered} of {len(stamps)} states have no command")
    judged = phases.judged(begun, stamps)
    if not judged.any():
        raise BagError(f"'{bag.path}': the swing targets of all phases are missing")
    stamps, q, u = stamps[judged], q[judged], u[judged]
    epoch = int(stamps[0]) if stamps[0] > _CLOCK else 0
    whole_walk = max(begun) <= int(stamps[-1])  # else the states of its last phases are missing
    return Trace(
        config=bag.config,
        model=bag.model,
        time=(stamps - epoch) / NS,
        q=q,
        u=u,
        phases=phases.records(bag, begun, stamps, epoch),
        solve_time=np.full(len(stamps), np.nan),
        finished=finished and whole_walk,
        notes=tuple(notes),
        origin=bag.origin,
        physics=_physics(bag, stamps),
        loads=known_loads(np.column_stack([force[:, 2] for force in _forces(bag, stamps, "load").values()])),
        epoch=epoch,
        cut=not whole_walk or (bag.cut and not finished and not failed),
    )


def _walking(bag: Recording, begun: int) -> tuple[Stamps, Array]:
    """Return stamps and angles (N, n) [rad] of the states with a number for every joint, from the first phase on."""
    q, walking = bag.states.position[bag.rows], bag.stamps >= begun
    whole = (np.abs(q) < FARTHEST).all(axis=1)  # false for nan
    if early := int(np.count_nonzero(~walking)):
        bag.notes.append(f"{early} states before the first phase are left out")
    if not walking.any():
        raise BagError(f"'{bag.path}': every joint state is older than the first phase")
    if not (whole & walking).any():
        columns = zip(bag.model.joint_names, bag.states.position.T, strict=True)
        lack = [name for name, angles in columns if not np.isfinite(angles).all()]
        raise BagError(f"'{bag.path}': joint_states lack positions of {', '.join(lack) or 'every joint'}")
    if bad := int(np.count_nonzero(walking & ~whole)):
        bag.notes.append(f"{bad} states without a number for every joint are left out")
    return bag.stamps[walking & whole], q[walking & whole]


def read_orientations(path: str | os.PathLike[str]) -> Array:
    """Return the recorded orientations of the inertial sensor, unit quaternions (m, 4), real part first.

    Without a sensor m is zero. Errors are those of `read`.
    """
    columns = open_recording(path, None, TOPICS, REQUIRED).columns
    seen = np.concatenate([np.zeros((0, 4)), *(table.numbers[:, :4] for table in tables(columns.get("imu")))])
    out: Array = seen[np.abs(np.linalg.norm(seen, axis=1) - 1.0) < _UNIT][:, [3, 0, 1, 2]]
    return out


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
