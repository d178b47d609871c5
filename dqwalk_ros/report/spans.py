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
    """Quantities at the end of a phase, which is the first state of the next phase.

    Attributes
    ----------
    error : float
        Norm of the task error, as in `metrics.Series.error`.
    com_to_axis : float
        Horizontal distance of the CoM from the centre of the next support foot [m].
    end : ndarray, shape (8,)
        Pose of the other sole in the base sole's frame.
    """

    error: float
    com_to_axis: float
    end: Array

    @classmethod
    def at(cls, model: RobotModel, phase: Phase, q: Array) -> Ending:
        """Return the end of a phase at joint angles `q` (n,)."""
        kin = Kinematics(model, q, phase.base)
        center = kin.point(model.soles[phase.support].frame, model.soles[phase.support].center)
        return cls(phase.evaluate(kin.q).error, float(np.linalg.norm((kin.com - center)[:2])), kin.pose(kin.swing))


@dataclass(frozen=True)
class Span:
    """One phase of the walk.

    Attributes
    ----------
    record : PhaseRecord
        The recorded start of the phase.
    phase : Phase
        The rebuilt phase.
    start, end : int
        Its ticks, ``start <= tick < end``.
    ending : Ending or None
        None if the walk stopped before the end of the phase, or the phase was interrupted.
    """

    record: PhaseRecord
    phase: Phase
    start: int
    end: int
    ending: Ending | None

    @property
    def ticks(self) -> slice:
        """The ticks of the phase."""
        return slice(self.start, self.end)

    @property
    def double(self) -> bool:
        """Whether both feet are on the ground."""
        return self.phase.double
