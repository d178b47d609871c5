"""The tasks that all phases of the dynamic walk have: CoM and pelvis follow targets, the trunk does not turn."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config.sections import DynamicConfig
from dqwalk_ros.paper.assembly import DEPENDENT
from dqwalk_ros.paper.features import CenterOfMass, CenterOfMassOnGround, Direction, JointAngles
from dqwalk_ros.paper.geometry import X, Y, Z
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.tasks import Task
from dqwalk_ros.walks.following import AtRest, Follow, Target

FOLLOWED = {"com": 2, "height": 1, "upright": 2}
"""Number of coordinates of the targets that all phases have."""
_ALONG = 0.9
"""Least part along x or y of the axis of a joint that rolls or pitches the trunk."""

_SIDEWAYS = 0.1
"""Least velocity of the pelvis sideways per joint velocity, as a part of its height, that counts as possible."""


def upright_tasks(d: DynamicConfig, kin: Kinematics, at: Mapping[str, Target]) -> tuple[Task, ...]:
    """Return the tasks of CoM and pelvis, and those that keep the trunk from turning against the pelvis.

    A trunk that rolls moves the CoM sideways with little motion of the legs. While a push outwards is caught, it
    would be thrown against the push and tip the sole further. `kin` is that of the posture, `at` the targets.
    """
    model, (roll, pitch), leaning = kin.model, _trunk(kin), leans(kin)
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
            selects=np.diag([1.0, 0.0 if leaning else 1.0]) @ np.eye(2, 3),
            target=at["upright"],
            eta=d.upright_rate,
        ),
    ]
    if leaning:
        tasks.append(
            Follow(
                name="heading",
                weight=d.upright_weight,
                feature=Direction(model.pelvis, X),
                selects=Y[None],
                target=Target(np.zeros(1), np.zeros(1)),
                eta=d.upright_rate,
            )
        )
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


def leans(kin: Kinematics) -> bool:
    """Return whether only a pelvis that leans moves the CoM sideways over both flat soles, in the posture of `kin`.

    Between ankles that do not roll, a level pelvis cannot move sideways, and no joint rolls the trunk against it.
    """
    model = kin.model
    if len(_trunk(kin)[0]):
        return False
    held = [kin.point_jacobian(kin.swing), kin.angular_jacobian(kin.swing), kin.angular_jacobian(model.pelvis)]
    _, s, V = np.linalg.svd(np.concatenate(held))
    free = V[np.count_nonzero(s > DEPENDENT * s[0]) :]
    sideways = float(np.linalg.norm(free @ kin.point_jacobian(model.pelvis)[1]))
    return sideways < _SIDEWAYS * float(kin.point(model.pelvis)[2])


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
