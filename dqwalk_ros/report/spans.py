"""The phases of a recorded walk: each one rebuilt, with its ticks and its end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import Phase
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.trace import PhaseRecord


@dataclass(frozen=True)
class Ending:
    """Quantities at the end of a phase, which is the first state of the next phase."""

    error: float
    """Norm of the task error, as in `metrics.Series.error`."""
    com_to_axis: float
    """Horizontal distance of the CoM from the centre of the next support foot [m]."""
    end: Array
    """Pose of the other sole in the base sole's frame, shape (8,)."""

    @classmethod
    def at(cls, model: RobotModel, phase: Phase, q: Array) -> Ending:
        """Return the end of a phase at joint angles `q` (n,)."""
        kin = Kinematics(model, q, phase.base)
        center = kin.point(model.soles[phase.support].frame, model.soles[phase.support].center)
        return cls(phase.evaluate(kin.q).error, float(np.linalg.norm((kin.com - center)[:2])), kin.pose(kin.swing))


@dataclass(frozen=True)
class Span:
    """One phase of the walk."""

    record: PhaseRecord
    """The recorded start of the phase."""
    phase: Phase
    """The rebuilt phase."""
    start: int
    end: int
    """Its ticks, ``start <= tick < end``."""
    ending: Ending | None
    """None if the walk stopped before the end of the phase, or the phase was interrupted."""

    @property
    def ticks(self) -> slice:
        """The ticks of the phase."""
        return slice(self.start, self.end)

    @property
    def double(self) -> bool:
        """Whether both feet are on the ground."""
        return self.phase.double
