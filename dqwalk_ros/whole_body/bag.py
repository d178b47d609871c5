"""Writes a whole-body walk as a rosbag2, in the form of the recorder node, and reads one back."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
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
    pose_of,
    stamped,
    stamps_of,
    tables,
)
from dqwalk_ros.report.bag.recording import Recording, open_recording, preamble
from dqwalk_ros.report.bag.storage import Column, Source, write_columns
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import BagError
from dqwalk_ros.support.topics import BODY_REQUIRED, BODY_TOPICS, ODOM
from dqwalk_ros.whole_body.scenario import PAPER_TIMES, SCENARIOS, Scenario, Timed
from dqwalk_ros.whole_body.trace import BodyLog

# ---------------------------------------------------------------------- writing


def write_body(walked: BodyLog, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write a walk to the folder `path`, which is created when the bag is complete.

    Raises
    ------
    BagError
        If the folder exists already, or cannot be written.
    """
    topics = {name: topic for name, topic in BODY_TOPICS.items() if name != "diagnostics"}
    write_columns(path, topics, _columns(walked), overwrite=overwrite)


def _columns(walked: BodyLog) -> list[Messages]:
    """Return stamps and messages of each topic, in the order of publication within one period."""
    model, stamps = walked.model, stamps_of(walked.time)
    targets, pushes = walked.scenario.targets, walked.scenario.pushes
    pushed, led = _when(pushes, stamps), _when(targets, stamps)
    impulses = np.array([(*impulse, 0.0, 0.0, 0.0) for _, impulse in pushes]).reshape(-1, 6)[: len(pushed)]
    places = DQ.from_pose(np.array([place for _, place in targets]).reshape(-1, 3)).vec8()[: len(led)]
    found = [
        *preamble(walked, stamps[:1]),
        ("push_applied", pushed, pack(stamped(BODY_TOPICS["push_applied"].type, ODOM), pushed, impulses)),
        ("base_pose", stamps, pack_poses(stamps, ODOM, walked.x_base)),
        ("base_twist", stamps, pack(stamped(BODY_TOPICS["base_twist"].type, model.pelvis), stamps, walked.v_base)),
        ("joint_states", stamps, pack_joint_states(stamps, model.joint_names, position=walked.q, velocity=walked.dq)),
        ("hand_target_applied", led, pack_poses(led, ODOM, places)),
        ("joint_effort_commands", stamps, pack_joint_states(stamps, model.joint_names, effort=walked.effort)),
    ]
    for foot, column in zip(Foot, walked.wrenches.swapaxes(0, 1), strict=True):
        name = f"{foot.value}_wrench"
        found.append(pack_known((name, BODY_TOPICS[name].type), ODOM, stamps, column))
    return found


def _when(timed: tuple[Timed, ...], stamps: Stamps) -> Stamps:
    """Return the stamp of the first state to which each target or push applies."""
    asked = stamps_of(np.array([when for when, _ in timed]))
    found: Stamps = stamps[np.searchsorted(stamps, asked[asked <= stamps[-1]])]
    return found


# ---------------------------------------------------------------------- reading


def read_body(source: Source, *, namespace: str | None = None) -> BodyLog:
    """Read a recorded whole-body walk, whichever program recorded it; see `walk.read` for parameters and errors."""
    bag = open_recording(source, namespace, BODY_TOPICS, BODY_REQUIRED)
    columns, notes = bag.columns, bag.notes
    joints, rows, stamps = bag.states, bag.rows, bag.stamps
    poses, twists = aligned(columns["base_pose"], stamps, 7), aligned(columns["base_twist"], stamps, 6)
    efforts = _efforts(bag)
    everything = np.hstack([joints.position[rows], joints.velocity[rows], poses, twists, efforts])
    whole = np.isfinite(everything).all(axis=1)
    if not whole.any():
        raise BagError(f"'{bag.path}': no state has joints, pose, twist and torques with one stamp")
    if left_out := int(np.count_nonzero(~whole)):
        notes.append(f"{left_out} states are incomplete or have no command, and are left out")
    stamps, rows, poses, twists, efforts = stamps[whole], rows[whole], poses[whole], twists[whole], efforts[whole]
    if gaps := int(np.count_nonzero(np.diff(stamps) > 1.5 * NS * bag.config.dt)):
        notes.append(f"{gaps} gaps of one period or more between two states")
    begin, end = int(stamps[0]), int(stamps[-1])
    wrenches = np.stack([aligned(columns.get(f"{foot.value}_wrench"), stamps, 6) for foot in Foot], axis=1)
    # of the targets before the first state, the last one applies
    led = {max(stamp, begin): place for stamp, place in _places(columns.get("hand_target_applied")) if stamp <= end}
    targets = tuple(((stamp - begin) / NS, place) for stamp, place in led.items())
    pushed = [(stamp, place) for stamp, place in _places(columns.get("push_applied")) if begin <= stamp <= end]
    pushes = tuple(((stamp - begin) / NS, impulse) for stamp, impulse in pushed)
    return BodyLog(
        config=bag.config,
        model=bag.model,
        time=(stamps - begin) / NS,
        q=joints.position[rows],
        notes=tuple(notes),
        origin=bag.origin,
        scenario=_named(Scenario("recorded walk", len(stamps) * bag.config.dt, targets, pushes)),
        dq=joints.velocity[rows],
        x_base=pose_of(poses),
        v_base=twists,
        effort=efforts,
        wrenches=wrenches,
    )


def _places(column: Column | None) -> list[tuple[int, tuple[float, float, float]]]:
    """Return the first three numbers of each message and its stamp [ns], in the order of time."""
    found = [
        (stamp, (float(x), float(y), float(z)))
        for part in tables(column)
        for stamp, (x, y, z) in zip(part.stamps.tolist(), part.numbers[:, :3], strict=True)
        if np.isfinite([x, y, z]).all()
    ]
    return sorted(found, key=lambda one: one[0])


def _efforts(bag: Recording) -> Array:
    """Return the torques (N, n) [N m] of each stamp, nan where none were sent; of several, the first."""
    names = bag.model.joint_names
    commands = joint_states(bag.columns["joint_effort_commands"], names)
    finite = np.isfinite(commands.effort).all(axis=1)
    if not finite.any():
        lack = [n for n, torques in zip(names, commands.effort.T, strict=True) if not np.isfinite(torques).all()]
        raise BagError(f"'{bag.path}': joint_effort_commands lack numbers of {', '.join(lack)}")
    if refused := int(np.count_nonzero(~finite)):
        bag.notes.append(f"{refused} torque commands are incomplete or not finite, and are left out")
    return at_stamps(bag.stamps, commands.stamps[::-1], commands.effort[::-1])


def _named(scenario: Scenario) -> Scenario:
    """Return the matching test of the paper, as long as it was recorded, or the scenario itself if there is none."""
    times = Scenario("Test 1, the paper's times", 14.0, PAPER_TIMES)
    for known in (*SCENARIOS.values(), times):
        if abs(known.duration - scenario.duration) < 0.05 and all(
            len(a) == len(b) and np.allclose([(t, *x) for t, x in a], [(t, *x) for t, x in b], atol=1e-6)
            for a, b in ((known.targets, scenario.targets), (known.pushes, scenario.pushes))
        ):
            return replace(known, duration=scenario.duration)
    return scenario
