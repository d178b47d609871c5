"""The tasks that all phases of the dynamic walk have: CoM and pelvis follow targets, the trunk does not turn."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config.sections import DynamicConfig
from dqwalk_ros.paper.features import CenterOfMass, CenterOfMassOnGround, Direction, JointAngles
from dqwalk_ros.paper.geometry import Z
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.tasks import Task
from dqwalk_ros.walks.following import AtRest, Follow, Target

FOLLOWED = {"com": 2, "height": 1, "upright": 2}
"""Number of coordinates of the targets that all phases have."""
_ALONG = 0.9
"""Least part along x or y of the axis of a joint that rolls or pitches the trunk."""


def upright_tasks(d: DynamicConfig, kin: Kinematics, at: Mapping[str, Target]) -> tuple[Task, ...]:
    """Return the tasks of CoM and pelvis, and those that keep the trunk from turning against the pelvis.

    A trunk that rolls moves the CoM sideways with little motion of the legs. While a push outwards is caught, it
    would be thrown against the push and tip the sole further. `kin` is that of the posture, `at` the targets.
    """
    model, (roll, pitch) = kin.model, _trunk(kin)
    tasks: list[Task] = [
        Follow(name="com", weight=d.com_weight, feature=CenterOfMassOnGround(), target=at["com"], eta=d.com_rate),
        Follow(
            name="height",
            weight=d.height_weight,
            feature=CenterOfMass(),
            selects=Z[None],
            target=at["height"],
            eta=d.height_rate,
        ),
        Follow(
            name="upright",
            weight=d.upright_weight,
            feature=Direction(model.pelvis, Z),
            selects=np.eye(2, 3),
            target=at["upright"],
            eta=d.upright_rate,
        ),
    ]
    held, eye = d.trunk_weight > 0.0, np.eye(model.n)
    if held and len(pitch):
        tasks.append(
            Follow(
                name="trunk",
                weight=d.trunk_weight,
                feature=JointAngles(),
                selects=eye[pitch],
                target=Target(kin.q[pitch], np.zeros(len(pitch))),
                eta=d.upright_rate,
            )
        )
    if held and len(roll):
        tasks.append(AtRest(name="trunk_roll", weight=d.trunk_weight, selects=eye[roll]))
    return tuple(tasks)


def _trunk(kin: Kinematics) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the joints that roll the trunk against the pelvis in the posture of `kin`, and those that pitch it.

    They belong to neither legs nor arms; the trunk is the heaviest body beyond the pelvis.
    """
    model, tree = kin.model, kin.tree
    pelvis, sole = (tree.frames[name].moves for name in (model.pelvis, kin.swing))
    legs = pelvis | sole
    mass = np.where((tree.moves & ~legs).any(axis=1), tree.links[:, 11], 0.0)
    between = tree.moves[int(np.argmax(mass))] & ~legs
    roll, pitch = (np.flatnonzero(between & (np.abs(kin.lines[:, axis]) > _ALONG)) for axis in (0, 1))
    return roll, pitch
