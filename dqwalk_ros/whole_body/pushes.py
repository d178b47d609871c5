"""How hard may the robot be hit? By bisection, in directions all around."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dqwalk_ros.config import Config
from dqwalk_ros.whole_body.batch import Walk, walk
from dqwalk_ros.whole_body.scenario import Scenario, Timed

__all__ = ["DIRECTIONS", "PushLimit", "limit"]

DIRECTIONS = {
    "ahead": 0.0,
    "ahead, left": 45.0,
    "left": 90.0,
    "back, left": 135.0,
    "back": 180.0,
    "back, right": 225.0,
    "right": 270.0,
    "ahead, right": 315.0,
}
"""Where the push sends the robot, as an angle from ahead to the left [deg]."""
_FIRST = 8.0
"""The first impulse that is tried [N s]."""
_MOST = 256.0
"""Harder is not tried [N s]."""


@dataclass(frozen=True)
class PushLimit:
    """The hardest push that was survived in one direction.

    Attributes
    ----------
    direction : float
        [deg]
    stood, fell : float
        The largest impulse that was survived, and the least one tried that was not [N s].
    tried : tuple of (float, bool)
        Every impulse, and whether the robot stood.
    """

    direction: float
    stood: float
    fell: float
    tried: tuple[tuple[float, bool], ...]


def limit(
    config: Config,
    direction: float,
    plant: str = "physics",
    when: float = 2.5,
    exact: float = 1.0,
    *,
    after: float = 4.0,
    targets: tuple[Timed, ...] = (),
) -> PushLimit:
    """Double an impulse until the robot falls, then bisect.

    Between the two impulses it is taken for granted that a robot which survives a push survives every lesser one.

    Parameters
    ----------
    config : Config
    direction : float
        [deg]
    plant : str
    when : float
        When the torso is hit [s].
    exact : float
        The two impulses are no further apart than this [N s].
    after : float
        How long the robot must stand after it is hit [s].
    targets : tuple
        Of the hand; without them the robot walks in place.
    """
    angle = math.radians(direction)
    tried: dict[float, bool] = {}

    def stands(impulse: float) -> bool:
        push = (when, (impulse * math.cos(angle), impulse * math.sin(angle), 0.0))
        scenario = Scenario(f"{impulse:g} N s", when + after, targets, (push,))
        tried[impulse] = walk(config, Walk(scenario, plant=plant))[0].stood
        return tried[impulse]

    stood, fell = 0.0, _FIRST
    while fell <= _MOST and stands(fell):
        stood, fell = fell, 2.0 * fell
    while fell - stood > exact:
        middle = 0.5 * (stood + fell)
        if stands(middle):
            stood = middle
        else:
            fell = middle
    return PushLimit(direction, stood, fell, tuple(sorted(tried.items())))
