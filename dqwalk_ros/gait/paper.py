"""The walking cycle of Fig. 1: which phase follows which, where the feet go, and the rules that end a phase."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import PhaseError
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.model import Foot, RobotModel
from dqwalk_ros.phases import Phase, PhaseKind

__all__ = ["PHASES_PER_CYCLE", "EndRule", "PaperGait", "footstep", "phase_at"]

Array = NDArray[np.float64]

PHASES_PER_CYCLE = 4
_STALLED_WINDOWS = 10
"""So many windows in a row without hope, and a phase has stalled for good."""


def phase_at(config: Config, index: int) -> tuple[PhaseKind, Foot] | None:
    """Return kind and support foot of the phase `index` (0, 1, ...), or None after the last one.

    Double support to the first support foot, single support on it, and the same with the other foot.
    """
    if index >= PHASES_PER_CYCLE * config.gait.cycles:
        return None
    first = Foot(config.gait.first_support)
    support = first if index % PHASES_PER_CYCLE < 2 else first.other
    return (PhaseKind.SINGLE_SUPPORT if index % 2 else PhaseKind.DOUBLE_SUPPORT), support


def footstep(config: Config, model: RobotModel, support: Foot) -> Array:
    """Return x_d of the swinging sole in the support sole's frame, shape (8,): ahead, and flat."""
    width = config.gait.step_width
    if width == 0.0:
        kin = Kinematics(model, np.zeros(model.n), support)
        width = abs(float(kin.point(kin.swing)[1]))
    y = -width if support is Foot.LEFT else width
    return DQ.from_pose([config.gait.step_length, y, 0.0]).vec8()


class PaperGait:
    """The cycle of Fig. 1, ``gait.cycles`` times.

    Parameters
    ----------
    config : Config
    model : RobotModel
    """

    def __init__(self, config: Config, model: RobotModel) -> None:
        self._config, self._model = config, model
        self._index = -1

    def following(self, phase: Phase | None) -> tuple[PhaseKind, Foot, Array | None] | None:
        """Return kind, support foot and swing target of the phase after `phase`; None after the last one."""
        self._index += 1
        at = phase_at(self._config, self._index)
        if at is None:
            return None
        kind, support = at
        single = kind is PhaseKind.SINGLE_SUPPORT
        return kind, support, footstep(self._config, self._model, support) if single else None


class EndRule:
    """Decides, state by state, whether a phase is over.

    A double support is over when its error has stopped falling and the CoM projection is inside the cylinder of
    the end foot as it then stands; a single support when its error is below the threshold (section 5).
    """

    def __init__(self, config: Config, model: RobotModel, phase: Phase) -> None:
        self._phase = phase
        window = max(1, round(config.dsp.stall_window / config.dt))
        self._errors: deque[float] = deque(maxlen=window + 1)
        self._window = window * config.dt
        self._double = phase.kind is PhaseKind.DOUBLE_SUPPORT
        # the error of the double support is the distance of the CoM from the end foot's centre
        self._goal = config.ssp.com_radius if self._double else config.ssp.threshold
        self._hopeless = 0
        self._stall, self._timeout, self._dt = config.dsp.stall_rate, config.gait.phase_timeout, config.dt

    def over(self, error: float, elapsed: float, active: tuple[str, ...] = ()) -> bool:
        """Return whether the phase ends at the state with this error.

        Parameters
        ----------
        error : float
            `Phase.error` of the state.
        elapsed : float
            Time since the phase began [s].
        active : tuple of str
            Rows that held the last command back, for the message.

        Raises
        ------
        PhaseError
            If it cannot end any more, or takes longer than ``gait.phase_timeout``.
        """
        errors = self._errors
        errors.append(error)
        full = len(errors) == errors.maxlen
        fall = errors[0] - error
        if self._double:
            if full and fall < self._stall and error < self._goal:
                return True
        elif error < self._goal:
            return True
        timeout = self._timeout
        if elapsed > timeout:
            raise self._failed(f"is not over after {timeout:g} s", error, active)
        if full:
            # at the rate of the last window the goal is further away than the time limit
            hopeless = fall * timeout < (error - self._goal) * self._window
            self._hopeless = self._hopeless + 1 if hopeless else 0
            if self._hopeless * self._dt > _STALLED_WINDOWS * self._window:
                raise self._failed("has stalled", error, active)
        return False

    def _failed(self, what: str, error: float, active: tuple[str, ...]) -> PhaseError:
        rows = f"; active: {', '.join(active)}" if active else "; no constraint is active: a local minimum of the task"
        unit = " m" if self._double else ""
        return PhaseError(
            f"{self._phase.name} {what} at an error of {error:.4g}{unit} (it ends below {self._goal:.4g}{unit}){rows}",
            phase=self._phase.name,
            error=error,
            active=active,
        )
