"""The phases of a recorded walk, also where messages of their starts are lost."""

from __future__ import annotations

import bisect
import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind, names_phase
from dqwalk_ros.paper.walk import kind_with_target
from dqwalk_ros.report.bag.messages import NS, Stamps, aligned, joint_states, pose_of, tables, texts
from dqwalk_ros.report.bag.recording import Recording
from dqwalk_ros.report.bag.storage import Column
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import BagError, PhaseError
from dqwalk_ros.support.wording import listed, shown
from dqwalk_ros.trace import PhaseRecord
from dqwalk_ros.walks.table import walk_type

FARTHEST = 100.0
"""Angles above this [rad] are errors of a sensor or of the file; positions above this [m] likewise."""
_SAME_POSE = 5e-3
"""Largest difference of a pose from the origin that is attributed to the estimation of the base."""
_TOGETHER = 100_000_000
"""Largest time between the messages of one start [ns]: live ones are recorded some periods after their state."""
_Name = tuple[PhaseKind, Foot]


def starts(bag: Recording) -> dict[int, PhaseRecord]:
    """Return the record of every phase by its stamp [ns], in order, still without tick, pose in odom and changes.

    A phase begins with its name, its angles, and the target of the swing foot or of the CoM. Names are assigned to the
    angles in the order of both or, where one is lost, by the time at which they were recorded. What is lost follows
    from the rest as far as it can. A swing target cannot: it is nan, and the phase must not be judged.

    Raises
    ------
    BagError
        If there is no phase, or the phases contradict each other or are those of another robot.
    """
    said = list(zip(bag.columns["phase"].times, texts(bag.columns["phase"]), strict=True))
    labels = [(time, _parsed(text)) for time, text in said if names_phase(text)]
    known = _begun(bag, labels)
    if strange := next((text for _, text in said if names_phase(text) and _parsed(text) is None), ""):
        bag.notes.append(f"unknown phase '{shown(strange)}': phases are identified by their base sole and swing target")
    swings, places = _targets(bag.columns.get("swing_target")), _targets(bag.columns.get("com_target"))
    decisions: dict[int, str] = {}
    timed = [(time, name) for time, name in labels if name is not None]
    # a name is published again after a pause, so it does not identify its start
    if len(timed) == len(labels) == len(known) == len(bag.columns["phase_start"].raws):
        named = dict(zip(known, (name for _, name in timed), strict=True))
        decisions = dict(zip(known, _decisions([text for _, text in said]), strict=True))
    else:
        named, rest = _by_time(timed, list(known))
        lost = _lost(bag, rest, named, swings, places)
        known = {stamp: (base, q) for stamp, (_, base, q) in lost.items()} | known
        named = {stamp: name for stamp, (name, _, _) in lost.items()} | named
        if not strange and (without := known.keys() - named.keys()):
            bag.notes.append(f"{len(without)} names of phases are missing: they follow from the targets")
    found: dict[int, PhaseRecord] = {}
    for stamp, (base, q) in sorted(known.items()):
        time, target = stamp / NS, pose_of(swings[stamp].numbers) if stamp in swings else None
        kind, support = named.get(stamp) or _guessed(Kinematics(bag.model, q, base), target, places.get(stamp))
        name = f"{kind.value}/{support.value}"
        if base is not (support if kind is PhaseKind.SINGLE_SUPPORT else support.other):
            raise BagError(
                f"'{bag.path}': {name} at {time:.3f} s cannot stand on the {base.value} foot: messages of phase, "
                "phase_start or swing_target are missing or in another order"
            )
        if kind is PhaseKind.SINGLE_SUPPORT and not (target is not None and _is_pose(target)):
            bag.notes.append(f"the swing target of {name} at {time:.3f} s is missing: its states are left out")
            target = np.full(8, np.nan)
        why = decisions.get(stamp, "")
        found[stamp] = PhaseRecord(name, kind, support, base, 0, time, q, target, DQ(1.0).vec8(), decision=why)
    return found


def _begun(bag: Recording, labels: Sequence[object]) -> dict[int, tuple[Foot, Array]]:
    """Return base foot and angles (n,) [rad] of each phase_start by its stamp [ns]; errors are those of `starts`."""
    begun = joint_states(bag.columns["phase_start"], bag.model.joint_names)
    if not labels or not len(begun.stamps):
        raise BagError(f"'{bag.path}' contains no phase of a walk")
    if not set(begun.frames) <= set(bag.model.foot_of) or not set(bag.model.joint_names) <= set(begun.named):
        given = f"{shown(begun.frames[0])} and {listed(begun.named)}"
        raise BagError(f"'{bag.path}' is of another robot: phase_start names {given}")
    known = {
        stamp: (bag.model.foot_of[frame], q)
        for stamp, frame, q in zip(begun.stamps.tolist(), begun.frames, begun.position, strict=True)
        if (np.abs(q) < FARTHEST).all()
    }
    if not known:
        raise BagError(f"'{bag.path}': every phase begins with impossible numbers")
    return known


def judged(begun: Mapping[int, PhaseRecord], stamps: Stamps) -> NDArray[np.bool_]:
    """Return which states, none of which is older than the first phase, are not of a phase without its swing target."""
    whole = np.array([record.swing_target is None or _is_pose(record.swing_target) for record in begun.values()])
    found: NDArray[np.bool_] = whole[np.searchsorted(np.array([*begun]), stamps, side="right") - 1]
    return found


def is_last(bag: Recording, begun: Mapping[int, PhaseRecord], stamp: int, q: Array) -> bool:
    """Return whether the last phase of all is over by its rule at a state, at which the next one would begin.

    Parameters
    ----------
    stamp : int
        Of the state [ns].
    q : ndarray, shape (n,)
        Its joint angles [rad].
    """
    began = max(begun)
    record = dataclasses.replace(begun[began], config=_config_at(bag, began))
    whole = 0 < walk_type(bag.config).phases(bag.config) <= len(begun)
    transfers = record.kind is PhaseKind.DOUBLE_SUPPORT  # which always leads to another phase
    if not whole or transfers or stamp <= began or not (record.swing_target is None or _is_pose(record.swing_target)):
        return False
    phase, elapsed = record.phase(bag.config, bag.model), (stamp - began) / NS
    try:
        kin = Kinematics(bag.model, q, phase.base)
        return phase.rule.is_over(lambda: phase.assembly.error(kin, elapsed), elapsed)
    except PhaseError:
        return False


def _config_at(bag: Recording, stamp: int) -> Config | None:
    """Return the changed configuration that applied from a stamp [ns] or before; None for that of the whole walk."""
    return bag.tuned.get(max((since for since in bag.tuned if since <= stamp), default=-1))


def _decisions(said: Sequence[str]) -> list[str]:
    """Return the last decision in each phase, the sentence after its name; empty if there is none."""
    found: list[str] = []
    for words in said:
        if names_phase(words):
            found.append("")
        elif found and " " in words:
            found[-1] = words
    return found


def _parsed(name: str) -> _Name | None:
    kind, _, foot = name.partition("/")
    try:
        return PhaseKind(kind), Foot(foot)
    except ValueError:
        return None


def _by_time(
    labels: Sequence[tuple[int, _Name]], begun: Sequence[int]
) -> tuple[dict[int, _Name], list[tuple[int, _Name]]]:
    """Return the names of the stamps [ns] near which they were recorded, and those of phases that begin elsewhere.

    A name that repeats the one before it is that of a phase which continues after a pause. Names that were recorded by
    another clock than that of the stamps belong to no phase.
    """
    named: dict[int, _Name] = {}
    rest, before, stamps = [], None, sorted(begun)
    for time, name in labels:
        k = bisect.bisect(stamps, time)
        stamp = min(stamps[max(k - 1, 0) : k + 1], key=lambda one: abs(one - time))
        if stamp not in named and abs(stamp - time) < _TOGETHER:
            named[stamp] = name
        elif name != before:
            rest.append((time, name))
        before = name
    return (named, rest) if 2 * len(named) > len(labels) else ({}, [])


def _lost(
    bag: Recording,
    labels: Sequence[tuple[int, _Name]],
    named: Mapping[int, object],
    swings: Mapping[int, _Target],
    places: Mapping[int, _Target],
) -> dict[int, tuple[_Name, Foot, Array]]:
    """Return name, base foot and angles (n,) [rad] of the phases whose phase_start is lost, by their stamps [ns].

    The target has the stamp of the beginning; without one it is that of the state next to the name. The angles are
    those of that state, or of the next one with a number for every joint.
    """
    out: dict[int, tuple[_Name, Foot, Array]] = {}
    q = bag.states.position[bag.rows]
    whole = (np.abs(q) < FARTHEST).all(axis=1)
    states, q = bag.stamps[whole], q[whole]
    for time, (kind, support) in labels if len(states) else ():
        single = kind is PhaseKind.SINGLE_SUPPORT
        base = support if single else support.other
        frame = bag.model.soles[base].frame
        near = [
            stamp
            for stamp, target in (swings if single else places).items()
            if stamp not in named and target.frame == frame and abs(stamp - time) < _TOGETHER
        ]
        stamp = min(near, key=lambda one: abs(one - time), default=time)
        k = min(int(np.searchsorted(states, stamp)), len(states) - 1)
        out[stamp if near else int(states[k])] = (kind, support), base, q[k]
        bag.notes.append(
            f"the phase_start of {kind.value}/{support.value} at {stamp / NS:.3f} s is missing: it is taken from the "
            "state then"
        )
    return out


def _guessed(kin: Kinematics, swing: Array | None, place: _Target | None) -> _Name:
    """Return kind and support foot of a phase without a name, from what its target is."""
    if swing is not None:
        return PhaseKind.SINGLE_SUPPORT, kin.base
    kind = PhaseKind.DOUBLE_SUPPORT if place is None else kind_with_target(kin, place.numbers[:2])
    return kind, kin.base.other


def _is_pose(x: Array) -> bool:
    """Return whether (8,) is a unit dual quaternion with a plausible position."""
    return bool(np.isfinite(x).all() and abs(np.linalg.norm(x[:4]) - 1.0) < 1e-6 and np.abs(x[4:]).max() < FARTHEST)


class _Target(NamedTuple):
    """Frame and numbers of a swing_target or com_target."""

    frame: str
    numbers: Array


def _targets(column: Column | None) -> dict[int, _Target]:
    """Return the targets of the swing foot (7,) or of the CoM (3,) by their stamps [ns]."""
    return {
        stamp: _Target(found.message.header.frame_id, numbers)
        for found in tables(column)
        for stamp, numbers in zip(found.stamps.tolist(), found.numbers, strict=True)
    }


def _first_base(bag: Recording, stamp: int, start: PhaseRecord) -> Array:
    """Return the pose of the first phase's base sole in odom: the origin, unless the recording started later."""
    (recorded,) = pose_of(aligned(bag.columns.get("base_pose"), np.array([stamp]), 7))
    if not _is_pose(recorded):
        return start.x_odom_base
    x = (DQ(recorded) * DQ(Kinematics(bag.model, start.q_start, start.base).pose(bag.model.pelvis)).conj()).vec8()
    one = start.x_odom_base
    return one if min(np.abs(x - one).max(), np.abs(x + one).max()) < _SAME_POSE else x


def records(bag: Recording, starts: Mapping[int, PhaseRecord], stamps: Stamps, epoch: int) -> tuple[PhaseRecord, ...]:
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
        whole = start.swing_target is None or _is_pose(start.swing_target)
        if tick == len(stamps) and not whole:
            break
        if tick == len(stamps):
            bag.notes.append(f"{start.name} began at {time:.3f} s, after the last state, and is left out")
            break
        if out and out[-1].start == tick:  # ended before the recording started
            out.pop()
        if stamps[tick] != stamp and whole:
            bag.notes.append(f"the state at which {start.name} began, {time:.3f} s, is missing")
        config = _config_at(bag, stamp)
        out.append(dataclasses.replace(start, start=tick, time=time, x_odom_base=x_odom_base, config=config))
    return tuple(out)
