"""Whether hands and joints arrive where they were sent."""

from __future__ import annotations

import math
from dataclasses import dataclass

PATIENCE = 2.0
"""Time without progress after which a hand or joint has stopped short of where it was sent [s]."""
OF_HAND, OF_JOINT = 0.005, 0.02
"""Least progress of a hand [m] and of a joint [rad] towards where it was sent (`Approach.enough`)."""


@dataclass
class Approach:
    """Whether something comes closer to where it was sent."""

    enough: float
    """Least progress within `PATIENCE`, and half of the distance that counts as arrived [m, rad]."""
    least: float = math.inf
    since: float = math.nan
    told: bool = False

    def stops(self, time: float, distance: float) -> bool:
        """Return True once, at the first state at which it has stopped at a distance [m, rad]."""
        if distance < self.least - self.enough:
            self.least, self.since = distance, time
        stopped = distance > 2.0 * self.enough and time - self.since > PATIENCE and not self.told
        self.told |= stopped
        return stopped
