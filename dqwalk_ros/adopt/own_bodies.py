"""Which links of a robot the arms can meet, and the capsules around them, for the section ``collision``."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.robot.clearance import Capsules
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.shapes import capsule_around
from dqwalk_ros.support.arrays import Array

_POSTURES = 1000
"""Number of random postures of the arms that are tried."""
_NEARLY = 0.02
"""Distance above ``collision.margin`` that counts as met [m]: a pair may meet between the postures that are tried."""


def pairs_of_arms(config: Config, model: RobotModel, hulls: Mapping[str, Array]) -> dict[str, float]:
    """Return the pairs LINK=LINK of arms and other links that meet in some posture, or nearly so.

    The other joints are in ``standing.posture``. Links of one body or that a joint connects are left out, and pairs
    that are as near in the posture: capsules of angular links may overlap.

    Parameters
    ----------
    hulls : dict of str to ndarray, shape (N, 3)
        Corners of the links in their frames [m].

    Returns
    -------
    dict of str to float
        With the part of the postures in which they are too near.
    """
    standing, margin = model.posture(config.standing.posture), config.collision.margin
    joints = sorted({k for pattern in config.arms.joints for k in model.matching(pattern, "arms.joints")})
    body = {link: model.frames[link].body for link in hulls}
    moved = {link: any(model.bodies[b].joint in joints for b in model.chain(body[link])) for link in hulls}
    links = sorted(hulls, key=lambda link: (not moved[link], link))
    capsules = Capsules(model, {link: capsule_around(hulls[link]) for link in links})
    found = [
        (i, j)
        for i, one in enumerate(links)
        for j, other in enumerate(links[i + 1 :], start=i + 1)
        if moved[one]
        and body[one] != body[other]
        and model.bodies[body[one]].parent != body[other]
        and model.bodies[body[other]].parent != body[one]
    ]
    pairs = np.array(found, dtype=np.int64).reshape(-1, 2)
    rng = np.random.default_rng(0)
    met = np.zeros(len(pairs))
    nearly, beside = np.zeros((2, len(pairs)), dtype=bool)
    for k in range(_POSTURES):
        q = standing.copy()
        if k:
            q[joints] = rng.uniform(model.q_min[joints], model.q_max[joints])
        apart = capsules.distances(q, pairs)
        if not k:
            beside = apart < margin
        nearly |= (apart < margin + _NEARLY) & ~beside
        met += apart < margin
    parts = zip(found, met.tolist(), nearly.tolist(), strict=True)
    return {f"{links[i]}={links[j]}": count / _POSTURES for (i, j), count, kept in parts if kept}
