"""A single support of the dynamic walk, whose landing may be adjusted."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.phase import Phase, Timed
from dqwalk_ros.paper.walk import Change
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.walks.dynamic.adjust import Step
from dqwalk_ros.walks.dynamic.swing import Swing


@dataclass(eq=False)
class Flight:
    """The motion of the swing foot, and what its landing was adjusted for."""

    rule: Timed
    step: Step
    swing: Swing
    goal: Array
    """Planned landing position, shape (2,) [m]."""
    up: float
    """Its height over the sole that stands [m]."""
    shift: Array = field(default_factory=lambda: np.zeros(2))
    """Displacement of the landing position, shape (2,) [m]."""
    lost: int = 0
    """Number of consecutive states whose error exceeds the threshold."""
    most: float = 0.0
    """Largest error that the ankle cannot compensate [m]."""
    outwards: float = 0.0
    """Largest such error away from the swing foot [m]."""

    def landing(self, phase: Phase) -> Change:
        """Return the final position, to which the phase `phase` has moved its landing, and a text that explains it."""
        late, ahead = self.rule.duration - self.step.duration, float(self.shift[0])
        when, where = "later" if late > 0.0 else "earlier", "forward" if ahead > 0.0 else "back"
        text = (
            f"the step lands {1e3 * abs(late):.0f} ms {when} and {1e3 * abs(ahead):.0f} mm further {where}: "
            f"an error of {1e3 * self.most:.0f} mm that the ankle cannot compensate"
        )
        assert phase.swing_target is not None
        moved = DQ.from_pose([*self.shift, 0.0]) * DQ(phase.swing_target)
        return Change(text, moved.vec8())
