"""Finds the largest impulse on the torso that the whole-body controller survives while it walks in place."""

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
"""Names of the directions of the push, every 45 degrees."""
_FIRST, _MOST = 8.0, 256.0
"""First and largest impulse that are tried [N s]."""
_AFTER = 4.0
"""Time for which the robot must stand after the push [s]."""


def limit(config: Config, when: float, exact: float, index: int, point: Mapping[str, Any]) -> Outcome:
    """Find the largest impulse that is survived in one direction.

    Parameters
    ----------
    config : Config
    when : float
        Time of the push [s].
    exact : float
        Accuracy of the limit [N s].
    index : int
        Not used; passed by the runner.
    point : mapping
        ``moment``, here the name of the plant, and ``direction`` [rad].
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
