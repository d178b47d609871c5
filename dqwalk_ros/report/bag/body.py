"""A whole-body walk as a rosbag2: what the nodes' recorder makes of one, and what is read of any."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import to_yaml
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import BagError
from dqwalk_ros.model import RobotModel
from dqwalk_ros.origin import to_text
from dqwalk_ros.report.bag import messages, storage
from dqwalk_ros.report.bag.joints import unpack_joint_states
from dqwalk_ros.report.bag.robot import after_restart, check_same_robot, config_in, model_in, of_one_robot, origin_in
from dqwalk_ros.report.bag.storage import Column
from dqwalk_ros.report.bag.writer import bag_at, qos, stamps_of
from dqwalk_ros.topics import BODY_REQUIRED, BODY_TOPICS, ODOM
from dqwalk_ros.whole_body.records import BodyState
from dqwalk_ros.whole_body.scenario import PAPER_TIMES, SCENARIOS, Scenario, Timed
from dqwalk_ros.whole_body.trace import FEET, BodyLog, Reaching

__all__ = ["read_body", "write_body"]

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
_TWIST, _WRENCH = BODY_TOPICS["base_twist"].type, BODY_TOPICS["left_wrench"].type
_WANTED = {name: topic.type for name, topic in BODY_TOPICS.items() if name != "diagnostics"}


# ---------------------------------------------------------------------- writing


def write_body(walked: Reaching, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write a walk to the folder `path`, which appears only once it is complete.

    Raises
    ------
    BagError
        If something is there already, or the disk refuses.
    """
    with bag_at(path, overwrite=overwrite) as writer:
        connections = {
            name: writer.add_connection(
                "/" + name, topic.type, typestore=messages.typestore(), offered_qos_profiles=[qos(topic)]
            )
            for name, topic in BODY_TOPICS.items()
            if name != "diagnostics"
        }
        entries = [
            (int(stamp), order, connections[name], raw)
            for order, (name, stamps, raws) in enumerate(_columns(walked))
            for stamp, raw in zip(stamps, raws, strict=True)
        ]
        for stamp, _, connection, raw in sorted(entries, key=lambda entry: entry[:2]):
            writer.write(connection, stamp, raw)


def _columns(walked: Reaching) -> list[tuple[str, Stamps, list[bytes]]]:
    """Return the messages of each topic and when they came, in the order of one period."""
    model, stamps = walked.model, stamps_of(walked.time)
    first = stamps[:1]
    targets, pushes = walked.scenario.targets, walked.scenario.pushes
    found = [
        ("walk_config", first, [messages.text(to_yaml(walked.config))]),
        ("walk_origin", first, [messages.text(to_text(walked.origin))]),
        ("robot_description", first, [messages.text(model.urdf)]),
        ("push_applied", _when(pushes, stamps), _impulses(pushes, stamps)),
        ("base_pose", stamps, messages.poses(stamps, ODOM, walked.x_base)),
        ("base_twist", stamps, messages.stream(_TWIST, stamps, model.pelvis, walked.v_base)),
        ("joint_states", stamps, messages.joint_states(stamps, model.joint_names, walked.q, walked.dq)),
        ("hand_target_applied", _when(targets, stamps), _places(targets, stamps)),
        (
            "joint_effort_commands",
            stamps,
            messages.joint_states(stamps, model.joint_names, None, None, effort=walked.effort),
        ),
    ]
    for foot, column in zip(FEET, walked.wrenches.swapaxes(0, 1), strict=True):
        stands = np.isfinite(column).all(axis=1)
        told = messages.stream(_WRENCH, stamps[stands], ODOM, column[stands])
        found.append((f"{foot.value}_wrench", stamps[stands], told))
    return found


def _when(timed: tuple[Timed, ...], stamps: Stamps) -> Stamps:
    """Return the stamp of the first state that each target or push shows in."""
    asked = stamps_of(np.array([when for when, _ in timed]))
    found: Stamps = stamps[np.searchsorted(stamps, asked[asked <= stamps[-1]])]
    return found


def _places(targets: tuple[Timed, ...], stamps: Stamps) -> list[bytes]:
    when = _when(targets, stamps)
    x = np.array([DQ.from_pose(place).vec8() for _, place in targets]).reshape(-1, 8)
    return messages.poses(when, ODOM, x[: len(when)]) if len(when) else []


def _impulses(pushes: tuple[Timed, ...], stamps: Stamps) -> list[bytes]:
    when = _when(pushes, stamps)
    numbers = np.array([(*impulse, 0.0, 0.0, 0.0) for _, impulse in pushes[: len(when)]])
    return messages.stream(_WRENCH, when, ODOM, numbers)


# ---------------------------------------------------------------------- reading


def read_body(path: str | os.PathLike[str], *, namespace: str | None = None) -> BodyLog:
    """Read a recorded whole-body walk, whoever recorded it.

    Parameters
    ----------
    path : path-like
        The bag's folder, or one of its files.
    namespace : str, optional
        Of the robot, where the bag holds several.

    Raises
    ------
    BagError
        If the bag cannot be read, lacks a topic that is needed, or is that of another robot.
    """
    path = Path(path)
    content = storage.load(path, lambda topic, kind: _WANTED.get(topic.rsplit("/", 1)[-1]) == kind)
    notes = list(content.notes)
    columns = of_one_robot(path, content, namespace, _WANTED, BODY_REQUIRED)
    config = config_in(path, columns)
    model = model_in(path, config, columns, notes)
    joints = unpack_joint_states(columns["joint_states"].raws)
    check_same_robot(path, model, joints)
    first = after_restart(joints.stamps, notes)
    since = columns["joint_states"].times[first] if first else 0
    rows = {stamp: row for row, stamp in enumerate(joints.stamps.tolist()) if row >= first}
    poses, twists = (_by_stamp(columns[name], since) for name in ("base_pose", "base_twist"))
    efforts = _efforts(path, model, columns["joint_effort_commands"], since, notes)
    stamps = sorted(rows.keys() & poses.keys() & twists.keys() & efforts.keys())
    if not stamps:
        raise BagError(f"'{path}': no state has joints, pose, twist and torques with one stamp")
    left_out = len(rows.keys() | efforts.keys()) - len(stamps)
    if left_out:
        notes.append(f"{left_out} states are not complete, or have no answer, and are left out")
    gaps = int(np.count_nonzero(np.diff(stamps) > 1.5e9 * config.dt))
    if gaps:
        notes.append(f"{gaps} times a period or more is missing between two states")
    at = [rows[stamp] for stamp in stamps]
    order = joints.columns(model.joint_names)
    q, dq = joints.position[at][:, order], joints.velocity[at][:, order]
    begin, told = stamps[0], len(stamps)
    states = tuple(
        BodyState((stamp - begin) / 1e9, q[k], dq=dq[k], x_base=messages.pose_of(poses[stamp]), v_base=twist)
        for k, stamp in enumerate(stamps)
        for twist in (messages.six_of(twists[stamp]),)
    )
    wrenches = np.full((told, 2, 6), np.nan)
    place = {stamp: k for k, stamp in enumerate(stamps)}
    for side, foot in enumerate(FEET):
        for stamp, message in _by_stamp(columns.get(f"{foot.value}_wrench"), since).items():
            if stamp in place:
                wrenches[place[stamp], side] = messages.six_of(message)
    led = {
        max(stamp, begin): _xyz(message.pose.position)  # of those from before the first state, the last
        for stamp, message in sorted(_by_stamp(columns.get("hand_target_applied"), 0).items())
        if stamp <= stamps[-1]
    }
    targets = tuple(((stamp - begin) / 1e9, place) for stamp, place in led.items())
    pushes = tuple(
        ((stamp - begin) / 1e9, _xyz(message.wrench.force))
        for stamp, message in _stamped(columns.get("push_applied"), since)
        if begin <= stamp <= stamps[-1]
    )
    scenario = _named(Scenario("recorded walk", told * config.dt, targets, pushes))
    return BodyLog(
        config,
        model,
        scenario,
        states,
        np.array([efforts[stamp] for stamp in stamps]),
        wrenches,
        tuple(notes),
        origin_in(columns),
    )


def _stamped(column: Column | None, since: int) -> list[tuple[int, Any]]:
    """Return the messages recorded at `since` [ns] or later, each with its stamp [ns]."""
    if column is None:
        return []
    found = (
        messages.unpack(raw, column.type) for time, raw in zip(column.times, column.raws, strict=True) if time >= since
    )
    return [(messages.stamp_of(message), message) for message in found]


def _by_stamp(column: Column | None, since: int) -> dict[int, Any]:
    """Return the last message of each stamp."""
    return dict(_stamped(column, since))


def _efforts(path: Path, model: RobotModel, column: Column, since: int, notes: list[str]) -> dict[int, Array]:
    """Return the torques (n,) [N m] of each stamp, in the order of the model: the first that a plant would take."""
    found: dict[int, Array] = {}
    lacking: set[str] = set()
    refused = 0
    for stamp, message in _stamped(column, since):
        by_name = dict(zip(message.name, message.effort, strict=False))
        effort = np.array([by_name.get(name, np.nan) for name in model.joint_names])
        if np.isfinite(effort).all():
            found.setdefault(stamp, effort)
            continue
        refused += 1
        lacking |= {name for name, torque in zip(model.joint_names, effort, strict=True) if not np.isfinite(torque)}
    if refused and not found:
        raise BagError(f"'{path}': joint_effort_commands lack numbers of {', '.join(sorted(lacking))}")
    if refused:
        notes.append(f"{refused} torque commands are incomplete or not finite, and are left out")
    return found


def _xyz(p: Any) -> tuple[float, float, float]:
    return (float(p.x), float(p.y), float(p.z))


def _named(scenario: Scenario) -> Scenario:
    """Return the scenario under the name of the test it is, if it is one."""
    times = Scenario("Test 1, the paper's times", 14.0, PAPER_TIMES)
    for known in (*SCENARIOS.values(), times):
        if abs(known.duration - scenario.duration) < 0.05 and all(
            len(a) == len(b) and np.allclose([(t, *x) for t, x in a], [(t, *x) for t, x in b], atol=1e-6)
            for a, b in ((known.targets, scenario.targets), (known.pushes, scenario.pushes))
        ):
            return known
    return scenario
