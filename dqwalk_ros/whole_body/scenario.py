"""Scenarios of targets and pushes: Tests 1 and 2 of section VII [Sherikov2014], and any others."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.whole_body.controller import WholeBodyController

Timed = tuple[float, tuple[float, float, float]]
"""A time [s], and a position [m] or an impulse [N s]."""


_LARGEST = 1e6
"""Largest number of a target or a push [m, N s, s]."""


@dataclass(frozen=True)
class Scenario:
    """A sequence of targets of the hand and of pushes.

    Raises
    ------
    ConfigError
        If a target or a push is not three numbers, one is larger than a million, or its time is negative.
    """

    name: str
    duration: float
    """[s]"""
    targets: tuple[Timed, ...] = ()
    """Time from which a target applies, and position of the target [s, m]."""
    pushes: tuple[Timed, ...] = ()
    """Time and impulse of each push of the torso [s, N s]."""
    size: float = 1.0
    """Size of the robot relative to that of the paper; required lengths scale with it."""
    slow: float = 1.0
    """Duration of the steps relative to that of the paper; times scale with it."""

    def __post_init__(self) -> None:
        """Check times and numbers."""
        for when, what in (*self.targets, *self.pushes):
            if len(what) != 3 or not np.abs((when, *what)).max() <= _LARGEST or when < 0.0:
                raise ConfigError(f"'{self.name}': {what} at {when} s is not a place or an impulse at a time from 0 on")


_TARGETS = ((0.0, (1.2, -0.8, 0.9)), (4.6, (2.0, -0.8, 0.9)), (6.25, (2.0, -0.2, 0.9)), (8.0, (1.8, -0.4, 0.9)))
_PUSHES = ((2.5, (0.0, 15.0, 0.0)), (7.0, (-15.0, 0.0, 0.0)))
SCENARIOS = {
    "1": Scenario("Test 1", 14.0, _TARGETS),
    "2": Scenario("Test 2", 14.0, _TARGETS, _PUSHES),
}
"""The paper's tests, with the times of Sherikov's thesis, at which the target jumps during a swing."""
PAPER_TIMES = ((0.0, (1.2, -0.8, 0.9)), (4.0, (2.0, -0.8, 0.9)), (8.0, (1.8, -0.4, 0.9)))
"""The targets at the times given in the text of the paper."""
_HEIGHT, _MASS, _STEP = 0.73, 58.0, 0.8
"""CoM height, mass and duration of a step of the robot in the paper [m, kg, s]."""


def fitted(scenario: Scenario, controller: WholeBodyController) -> Scenario:
    """Return a scenario scaled to a robot: positions with its CoM height h, impulses with m sqrt(h).

    Times are scaled with the duration of its steps. If all factors are within 2 % of one, the scenario is not changed.
    """
    size = controller.point_mass.height / _HEIGHT
    impulse = controller.weight / (_MASS * GRAVITY) * math.sqrt(size)
    slow = controller.stepping.period / _STEP
    if max(abs(size - 1.0), abs(impulse - 1.0), abs(slow - 1.0)) < 0.02:
        return scenario
    targets = tuple((slow * when, (size * x, size * y, size * z)) for when, (x, y, z) in scenario.targets)
    pushes = tuple((slow * when, (impulse * x, impulse * y, impulse * z)) for when, (x, y, z) in scenario.pushes)
    return replace(scenario, duration=slow * scenario.duration, targets=targets, pushes=pushes, size=size, slow=slow)
