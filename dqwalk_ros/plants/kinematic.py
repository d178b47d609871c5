"""The kinematic integrator: joints that move exactly as they are told."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqwalk_ros.controllers import Command, State
from dqwalk_ros.exceptions import PlantError
from dqwalk_ros.model import RobotModel

__all__ = ["KinematicPlant"]

Array = NDArray[np.float64]


class KinematicPlant:
    """Integrates joint velocities with Euler's method, as section 5 does.

    Parameters
    ----------
    model : RobotModel
    q0 : array_like, shape (n,), optional
        Where it begins [rad]; all zero without it.
    time0 : float
        [s]

    Raises
    ------
    PlantError
        If `q0` does not fit the model or is not finite.
    """

    def __init__(self, model: RobotModel, q0: ArrayLike | None = None, time0: float = 0.0) -> None:
        q = np.zeros(model.n) if q0 is None else np.array(q0, dtype=np.float64)
        if q.shape != (model.n,) or not np.isfinite(q).all():
            raise PlantError(f"the first state must have {model.n} finite angles, got {q}")
        self._least, self._most = -model.velocity_max, model.velocity_max
        self._time0, self._periods = time0, 0
        self._state = State(time0, q, np.zeros(model.n))

    @property
    def state(self) -> State:
        """The state now."""
        return self._state

    def step(self, command: Command, dt: float) -> State:
        """Return the state one period later; velocities beyond the joints' limits are clamped.

        Raises
        ------
        PlantError
            If the command is not finite or does not fit.
        """
        u = np.asarray(command.velocity, dtype=np.float64)
        # the sum is finite but for numbers that are not, or are beyond all measure: asked first, it is quick
        if u.shape != self._state.q.shape or not (math.isfinite(sum(u.tolist())) or np.isfinite(u).all()):
            raise PlantError(f"the command must have {self._state.q.size} finite velocities, got {u}")
        u = np.minimum(np.maximum(u, self._least), self._most)
        self._periods += 1
        # counted, not summed up: a million periods later the time is still exact
        self._state = State(self._time0 + self._periods * dt, self._state.q + dt * u, u)
        return self._state
