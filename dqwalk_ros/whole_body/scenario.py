"""What happens to the robot: Tests 1 and 2 of the paper, or anything else."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dqwalk_ros.errors import ConfigError

__all__ = ["PAPER_TIMES", "SCENARIOS", "Scenario", "Timed"]

Timed = tuple[float, tuple[float, float, float]]
"""When, and where to or how hard."""


@dataclass(frozen=True)
class Scenario:
    """What happens to the robot.

    Attributes
    ----------
    name : str
    duration : float
        [s]
    targets : tuple of (float, tuple)
        From when on the hand should be where [s, m].
    pushes : tuple of (float, tuple)
        When which impulse hits the torso [s, N s].
    """

    name: str
    duration: float
    targets: tuple[Timed, ...] = ()
    pushes: tuple[Timed, ...] = ()

    def __post_init__(self) -> None:
        """Refuse what never happens."""
        for when, what in (*self.targets, *self.pushes):
            if len(what) != 3 or not np.isfinite((when, *what)).all() or not when >= 0.0:
                raise ConfigError(f"'{self.name}': {what} at {when} s is no place or impulse at a time from 0 on")


_TARGETS = ((0.0, (1.2, -0.8, 0.9)), (4.6, (2.0, -0.8, 0.9)), (6.25, (2.0, -0.2, 0.9)), (8.0, (1.8, -0.4, 0.9)))
_PUSHES = ((2.5, (0.0, 15.0, 0.0)), (7.0, (-15.0, 0.0, 0.0)))
SCENARIOS = {
    "1": Scenario("Test 1", 14.0, _TARGETS),
    "2": Scenario("Test 2", 14.0, _TARGETS, _PUSHES),
}
"""The paper's tests, with the times of the thesis, where the target jumps in mid-swing."""
PAPER_TIMES = ((0.0, (1.2, -0.8, 0.9)), (4.0, (2.0, -0.8, 0.9)), (8.0, (1.8, -0.4, 0.9)))
"""The targets at the times that the paper's text has."""
