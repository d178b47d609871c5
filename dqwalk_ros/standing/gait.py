"""The standing walk: steps ahead, sideways and round, counted or steered; it begins and ends with the feet together."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.errors import PhaseError
from dqwalk_ros.model import Foot, RobotModel
from dqwalk_ros.phases import Phase, PhaseKind
from dqwalk_ros.standing.footsteps import Footsteps

__all__ = ["StandingEnd", "StandingGait"]

Array = NDArray[np.float64]


class StandingGait:
    """Which phase follows which.

    Double support to a foot, single support on it, and so on; at last the feet are put together and the CoM between
    them. With ``gait.steps: 0`` the walk waits in a stance for `steer`.

    Parameters
    ----------
    config : Config
    model : RobotModel
    """

    def __init__(self, config: Config, model: RobotModel) -> None:
        self._config, self._model = config, model
        self.footsteps = Footsteps(config, model)
        self._twist = (0.0, 0.0, 0.0)
        self._stopping = False
        self._together = False
        self._done = 0
        self._first = Foot(config.gait.first_support)

    @property
    def count(self) -> int:
        """Number of phases of the whole walk; 0 where it is steered and has no end."""
        steps = self._config.gait.steps
        return 2 * steps + 3 if steps else 0

    def steer(self, forward: float, left: float, turn: float) -> tuple[float, float, float]:
        """Set the velocity of a steered walk [m/s, m/s, rad/s]; zero puts the feet together and waits.

        Returns
        -------
        tuple of float
            What it walks with: all three made smaller alike until a step keeps within ``gait.most_length``,
            ``gait.most_side`` and ``gait.most_turn`` together.
        """
        gait, period = self._config.gait, self._period
        asked = (forward * period, left * period, turn * period)
        most = (gait.most_length, gait.most_side, gait.most_turn)
        # a direction the legs cannot go is left out; the others share the step
        parts = [a / m if m else 0.0 for a, m in zip(asked, most, strict=True)]
        size = max(1.0, math.sqrt(sum(part**2 for part in parts)))
        x, y, z = (part * m / (size * period) for part, m in zip(parts, most, strict=True))
        self._twist = (x, y, z)
        return self._twist

    def stop(self) -> None:
        """Put the feet together after the step under way, and end the walk."""
        self._stopping = True

    @property
    def waiting(self) -> bool:
        """Whether a stance has nothing to do but wait."""
        return not (self._config.gait.steps or self._stopping or any(self._twist))

    @property
    def _period(self) -> float:
        """Time of a step [s]."""
        s = self._config.standing
        return s.transfer_duration + s.swing_duration

    def following(self, phase: Phase | None) -> tuple[PhaseKind, Foot, Array | None] | None:
        """Return kind, support foot and swing target of the phase after `phase`; None after the last one."""
        steps = self._config.gait.steps
        if phase is None:
            return (PhaseKind.DOUBLE_SUPPORT, self._first, None) if steps else (PhaseKind.STANCE, self._first, None)
        if phase.kind is PhaseKind.STANCE:
            return None if steps or self._stopping else (PhaseKind.DOUBLE_SUPPORT, self._leading(), None)
        if phase.kind is PhaseKind.DOUBLE_SUPPORT:
            step = self._step()
            self._together = step is None
            target = self.footsteps.beside(phase.support) if step is None else self.footsteps.step(phase.support, *step)
            self._done += 1
            return PhaseKind.SINGLE_SUPPORT, phase.support, target
        if self._together:
            return PhaseKind.STANCE, phase.support.other, None
        return PhaseKind.DOUBLE_SUPPORT, phase.support.other, None

    def _step(self) -> tuple[float, float, float] | None:
        gait = self._config.gait
        if self._stopping:
            return None
        if gait.steps:
            return None if self._done >= gait.steps else (gait.step_length, gait.step_side, gait.step_turn)
        if not any(self._twist):
            return None
        forward, left, turn = (v * self._period for v in self._twist)
        return forward, left, turn

    def _leading(self) -> Foot:
        """Return the foot to stand on first: the one on the side the robot turns away from or leaves."""
        _, left, turn = self._twist
        sideways = turn if turn else left
        return self._first if not sideways else Foot.RIGHT if sideways > 0.0 else Foot.LEFT


class StandingEnd:
    """Decides, state by state, whether a phase of a standing walk is over: its path done, its error below a threshold.

    Parameters
    ----------
    config : Config
    model : RobotModel
    phase : Phase
    """

    def __init__(self, config: Config, model: RobotModel, phase: Phase) -> None:
        s = config.standing
        self._phase = phase
        swing = phase.kind is PhaseKind.SINGLE_SUPPORT
        self._duration = s.swing_duration if swing else s.transfer_duration
        self._goal = s.swing_threshold if swing else s.com_threshold
        self._timeout = config.gait.phase_timeout

    def over(self, error: float, elapsed: float, active: tuple[str, ...] = ()) -> bool:
        """Return whether the phase ends at the state with this error, as `gait.paper.EndRule.over`.

        Raises
        ------
        PhaseError
            If it takes longer than ``gait.phase_timeout``.
        """
        if elapsed >= self._duration - 1e-9 and error < self._goal:
            return True
        if elapsed > self._timeout:
            rows = f"; active: {', '.join(active)}" if active else ""
            raise PhaseError(
                f"{self._phase.name} is not over after {self._timeout:g} s at an error of {error:.4g} m "
                f"(it ends below {self._goal:.4g} m){rows}",
                phase=self._phase.name,
                error=error,
                active=active,
            )
        return False
