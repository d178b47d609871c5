"""Common content of the bags of both kinds of walk: topics, configuration and model of a robot, states of one run."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros import config as configuration
from dqwalk_ros.config import Config, to_yaml
from dqwalk_ros.report.bag.messages import NS, JointStates, Messages, Stamps, joint_states, text, texts
from dqwalk_ros.report.bag.storage import Column, Content, Source, content_of
from dqwalk_ros.robot.model import RobotModel, load_model, parse_model
from dqwalk_ros.support import provenance
from dqwalk_ros.support.errors import BagError, ConfigError, ModelError
from dqwalk_ros.support.topics import Topic
from dqwalk_ros.support.wording import listed
from dqwalk_ros.trace import Recorded
from dqwalk_ros.walks.table import refuse_foreign_code


@dataclass(frozen=True)
class Recording:
    """The last run in a bag."""

    path: Path
    columns: dict[str, Column]
    """By the names in `dqwalk_ros.support.topics`."""
    config: Config
    model: RobotModel
    states: JointStates
    """All readable messages of joint_states."""
    rows: NDArray[np.intp]
    """Indices of those of the last run, in the order of time, one for each stamp, shape (N,)."""
    stamps: Stamps
    """Their stamps, shape (N,) [ns]."""
    origin: dict[str, str]
    """Versions and machine of the recorded walk; empty if they are not in the bag."""
    notes: list[str]
    """Descriptions of missing or omitted data."""
    tuned: dict[int, Config]
    """Parameters that were changed during the walk, by the stamp [ns] from which they applied."""
    cut: bool
    """Whether the bag is damaged or cut off."""


def preamble(walked: Recorded, stamp: Stamps) -> list[Messages]:
    """Return what the bag of a walk begins with, at its first stamp (1,): parameters, origin, robot."""
    found = {"walk_config": to_yaml(walked.config), "walk_origin": provenance.to_text(walked.origin)}
    found["robot_description"] = walked.model.urdf
    return [(name, stamp, [text(value)]) for name, value in found.items() if value]


def is_body(source: Source) -> bool:
    """Return whether a bag contains a whole-body walk, not a walk of phases.

    Raises
    ------
    BagError
        If there is no bag, or it cannot be read.
    """
    names = {topic.rpartition("/")[2] for topic in content_of(source).topics}
    return "joint_effort_commands" in names and "phase_start" not in names


def open_recording(
    source: Source, namespace: str | None, topics: Mapping[str, Topic], required: Sequence[str], walk: str = ""
) -> Recording:
    """Read the topics of a kind of walk, of which some are required, from a bag; other arguments as of `walk.read`.

    Raises
    ------
    BagError
        If the bag cannot be read, lacks a required topic, or is that of another robot.
    """
    content = content_of(source)
    path, notes = content.path, list(content.notes)
    wanted = {name: topic.type for name, topic in topics.items() if name != "diagnostics"}
    columns = _columns_of(content, namespace, wanted, required)
    try:
        config, tuned = _configurations(texts(columns["walk_config"]), f"{path} walk_config")
        for one in (config, *tuned.values()):
            refuse_foreign_code(one, walk)
    except ConfigError as error:
        raise BagError(str(error)) from error
    model = _model_in(path, config, columns, notes)
    states = joint_states(columns["joint_states"], model.joint_names)
    if missing := [name for name in model.joint_names if name not in states.named]:
        raise BagError(
            f"'{path}' is of another robot: joint_states lack {', '.join(missing)} of {model.name}; "
            f"they name {listed(states.named)}"
        )
    try:
        origin = provenance.from_text(texts(columns["walk_origin"])[-1]) if "walk_origin" in columns else {}
    except BagError:
        origin = {}
    rows, begin = _last_run(states.stamps, notes)
    if begin:
        since = columns["joint_states"].order[states.rows[begin]]
        columns = {name: column.since(since) for name, column in columns.items()}
    stamps, first = np.unique(states.stamps[rows], return_index=True)
    if len(stamps) == 1 < len(rows):
        raise BagError(
            f"'{path}': all {len(rows)} joint_states have the stamp {stamps[0] / NS:g} s; "
            "header.stamp must be the time of the measurement, a new one for each state"
        )
    return Recording(path, columns, config, model, states, rows[first], stamps, origin, notes, tuned, content.cut)


def _configurations(found: Sequence[str], source: str) -> tuple[Config, dict[int, Config]]:
    """Return the configuration at the start of the last run, and the later ones by stamp [ns]."""
    began = max((k for k, one in enumerate(found) if configuration.applies_from(one) is None), default=0)
    first, *later = (configuration.from_yaml(one, source=source) for one in found[began:])
    stamps = (configuration.applies_from(one) for one in found[began + 1 :])
    return first, {stamp: one for stamp, one in zip(stamps, later, strict=True) if stamp is not None}


def _columns_of(
    content: Content, namespace: str | None, wanted: Mapping[str, str], required: Sequence[str]
) -> dict[str, Column]:
    """Return the columns of one namespace by the names in `dqwalk_ros.support.topics`."""
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
            choose = f"choose a namespace: {listed(whole)}"
            raise BagError(f"'{content.path}' holds the walks of {len(whole)} robots; {choose}")
    columns = {
        name: column
        for name, kind in wanted.items()
        if (column := content.columns.get(f"{prefix}/{name}")) is not None and column.type == kind
    }
    missing = [f"{prefix}/{name}".strip("/") for name in required if name not in columns]
    if missing and is_body(content):
        raise BagError(f"'{content.path}' is a whole-body walk, which only `dqwalk report` reads")
    if missing:
        odd = [f"{name} ({content.topics[f'/{name}']})" for name in missing if f"/{name}" in content.topics]
        if odd:
            raise BagError(f"'{content.path}' is not a walk: it has messages of another type on {listed(odd)}")
        have = listed(content.topics)
        lack = f"it has no messages on {', '.join(missing)}; its topics are {have}"
        raise BagError(f"'{content.path}' is not a walk: {lack}")
    return columns


def _model_in(path: Path, config: Config, columns: Mapping[str, Column], notes: list[str]) -> RobotModel:
    """Return the robot of the bag, or from the installed URDF if the bag contains none."""
    if "robot_description" not in columns:
        notes.append(f"robot_description is missing: {config.robot.urdf} as installed here was used")
        return load_model(config.robot)
    try:
        return parse_model(texts(columns["robot_description"])[-1], config.robot)
    except (ConfigError, ModelError) as error:
        raise BagError(f"'{path}' is of another robot than its walk_config: {error}") from error


_GAP = NS
"""Jump of the stamp [ns] above which the stamp of a single message may be wrong."""
_FEW, _PART = 5, 0.01
"""Number and fraction of consecutive states whose stamps may be wrong; more of them are another run."""


def _last_run(stamps: Stamps, notes: list[str]) -> tuple[NDArray[np.intp], int]:
    """Return the rows of the last run, in the order of time, and its first row.

    If time goes back, the plant was restarted. A few states whose stamps fit neither those before nor those after them
    are considered errors, and only they are omitted.
    """
    few = max(_FEW, _PART * len(stamps))
    step = np.diff(stamps)
    kept: list[NDArray[np.intp]] = []
    wrong = again = begin = 0
    for run in np.split(np.arange(len(stamps)), np.flatnonzero((step < 0) | (step > _GAP)) + 1):
        while kept and stamps[kept[-1][-1]] > stamps[run[0]] and len(kept[-1]) <= min(few, len(run)):
            wrong += len(kept.pop())  # its stamps were ahead of those that follow
        if not kept or stamps[run[0]] - stamps[kept[-1][-1]] > _GAP:
            kept.append(run)
        elif stamps[run[0]] >= stamps[kept[-1][-1]]:
            kept[-1] = np.concatenate([kept[-1], run])
        elif len(run) <= few:
            wrong += len(run)  # its stamps are behind those before
        else:
            again, begin, kept = again + 1, int(run[0]), [run]
    if len(kept) > 1 and len(kept[-1]) <= _FEW:
        wrong += len(kept.pop())  # its stamps are ahead, and nothing follows
    if again:
        notes.append(f"time went back {'once' if again == 1 else f'{again} times'}: only the last run is read")
    for before, after in itertools.pairwise(kept):
        at, ahead = (stamps[before[-1]] - stamps[kept[0][0]]) / NS, (stamps[after[0]] - stamps[before[-1]]) / NS
        notes.append(f"{at:.3f} s after the first state, time jumps by {ahead:.3f} s: no states, or a clock was set")
    if wrong:
        notes.append(f"{wrong} states with an impossible stamp are left out")
    return np.concatenate([np.zeros(0, np.intp), *kept]), begin
