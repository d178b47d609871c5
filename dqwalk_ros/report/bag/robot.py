"""Whose walk a bag holds: its topics, configuration and robot, and the last run of several."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros import config as configuration
from dqwalk_ros.config import Config
from dqwalk_ros.errors import BagError, ConfigError, ModelError
from dqwalk_ros.model import RobotModel, load_model, parse_model
from dqwalk_ros.origin import from_text
from dqwalk_ros.report.bag import storage
from dqwalk_ros.report.bag.joints import JointColumn
from dqwalk_ros.report.bag.starts import texts
from dqwalk_ros.report.bag.storage import Column, Content

__all__ = [
    "after_restart",
    "check_same_robot",
    "config_in",
    "is_body",
    "model_in",
    "of_one_robot",
    "origin_in",
]


def is_body(path: str | os.PathLike[str]) -> bool:
    """Tell whether a bag holds a whole-body walk rather than one of phases.

    Raises
    ------
    BagError
        If there is no bag, or it cannot be read.
    """
    topics = storage.load(Path(path), lambda topic, kind: False).topics
    names = {topic.rpartition("/")[2] for topic in topics}
    return "joint_effort_commands" in names and "phase_start" not in names


def of_one_robot(
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
        rivals = [key for key, names in found.items() if names >= set(required)]
        if len(rivals) > 1:
            raise BagError(
                f"'{path}' holds the walks of {len(rivals)} robots; choose a namespace: {', '.join(sorted(rivals))}"
            )
    columns = {name: content.columns[key] for name in wanted if (key := f"{prefix}/{name}") in content.columns}
    missing = [name for name in required if name not in columns]
    if missing:
        have = ", ".join(sorted(content.topics)) or "none"
        raise BagError(f"'{path}' is not a walk: it has no messages on {', '.join(missing)}; its topics are {have}")
    return columns


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
    """Return the versions and the machine that walked, where the bag says and can be read."""
    try:
        return from_text(texts(columns["walk_origin"])[-1]) if "walk_origin" in columns else {}
    except BagError:
        return {}


def check_same_robot(path: Path, model: RobotModel, states: JointColumn) -> None:
    """Check that the states name every joint of the model.

    Raises
    ------
    BagError
        If they do not.
    """
    missing = [name for name in model.joint_names if name not in states.names]
    if missing:
        raise BagError(
            f"'{path}' is of another robot: joint_states lack {', '.join(missing)} of {model.name}; "
            f"they name {', '.join(states.names)}"
        )


def after_restart(stamps: NDArray[np.int64], notes: list[str]) -> int:
    """Return the first state of the last run: time goes back where the plant was reset."""
    back = np.flatnonzero(np.diff(stamps) < 0)
    if not len(back):
        return 0
    notes.append(f"time went back {len(back)} times: only the last run is read")
    return int(back[-1]) + 1
