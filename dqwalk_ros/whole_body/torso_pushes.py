"""Finds the largest impulse on the torso that the whole-body controller survives while it walks in place."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dqwalk_ros.config import Config
from dqwalk_ros.studies.bisection import largest
from dqwalk_ros.studies.pushes import Limit, every_limit
from dqwalk_ros.whole_body.experiments import walk
from dqwalk_ros.whole_body.scenario import Scenario

DIRECTIONS = ("ahead", "ahead, left", "left", "back, left", "back", "back, right", "right", "ahead, right")
"""Names of the directions of the push, every 45 degrees."""
_FIRST, _MOST = 8.0, 256.0
"""First and largest impulse that are tried [N s]."""
_AFTER = 4.0
"""Time for which the robot must stand after the push [s]."""


def limit(config: Config, when: float, tolerance: float, index: int, point: Mapping[str, Any]) -> Limit:
    """Find the largest impulse that is survived at the time `when` [s] in the direction of `point`.

    The accuracy is `tolerance` [N s]; the moment of `point` is the name of the plant; the index is not used.
    """
    x, y = math.cos(point["direction"]), math.sin(point["direction"])

    def fails(impulse: float) -> str:
        push = (when, (impulse * x, impulse * y, 0.0))
        return walk(config, Scenario(f"{impulse:g} N s", when + _AFTER, (), (push,)), point["moment"]).note

    return Limit(**point, **largest(fails, _FIRST, _MOST, tolerance)._asdict())


def limits(
    config: Config, out: Path, plants: Sequence[str], *, when: float, tolerance: float, **options: Any
) -> list[Limit]:
    """Find the limit in each of `DIRECTIONS` on each plant; see `studies.pushes.every_limit`."""
    task = functools.partial(limit, config, when, tolerance)
    return every_limit(task, (config, when, tolerance), out, plants, len(DIRECTIONS), **options)
