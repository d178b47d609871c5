"""How hard may the torso be hit while the whole-body controller walks in place? By bisection, all around."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dqwalk_ros.config import Config
from dqwalk_ros.studies.bisection import largest
from dqwalk_ros.studies.pushes import Limit, Outcome, every_limit
from dqwalk_ros.whole_body.experiments import Walk, walk
from dqwalk_ros.whole_body.scenario import Scenario

__all__ = ["DIRECTIONS", "limit", "limits"]

DIRECTIONS = ("ahead", "ahead, left", "left", "back, left", "back", "back, right", "right", "ahead, right")
"""Where the push sends the robot, every 45 degrees."""
_FIRST, _MOST = 8.0, 256.0
"""First and largest impulse that is tried [N s]."""
_AFTER = 4.0
"""How long the robot must stand after it is hit [s]."""


def limit(config: Config, when: float, exact: float, index: int, point: Mapping[str, Any]) -> Outcome:
    """Find the largest impulse that is survived in one direction.

    Parameters
    ----------
    config : Config
    when : float
        When the torso is hit [s].
    exact : float
        [N s]
    index : int
        Not used; what the runner passes.
    point : mapping
        ``moment``, the plant, and ``direction`` [rad].
    """
    x, y = math.cos(point["direction"]), math.sin(point["direction"])

    def fails(impulse: float) -> str:
        push = (when, (impulse * x, impulse * y, 0.0))
        return walk(config, Walk(Scenario(f"{impulse:g} N s", when + _AFTER, (), (push,)), plant=point["moment"])).note

    found = largest(fails, _FIRST, _MOST, exact)
    return Outcome(found.survived, found.failed, found.reason)


def limits(
    config: Config, out: Path, plants: Sequence[str], *, when: float, exact: float, **options: Any
) -> list[Limit]:
    """Find the limit in each of `DIRECTIONS` on each plant; see `studies.pushes.every_limit`."""
    task = functools.partial(limit, config, when, exact)
    return every_limit(task, (config, when, exact), out, plants, len(DIRECTIONS), **options)
