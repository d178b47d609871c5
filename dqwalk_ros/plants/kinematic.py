"""The kinematic plant: joints that follow commanded velocities exactly."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dqwalk_ros.config import Config
from dqwalk_ros.paper.state import Command, State
from dqwalk_ros.plants.base import Plant, checked
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import PlantError


class KinematicPlant(Plant):
    """Integrates joint velocities with Euler's method, as section 5 does.

    Parameters
    ----------
    q0 : array_like, shape (n,), optional
        Initial joint angles [rad]; zero by default.

    Raises
    ------
    PlantError
        If `q0` does not fit the model or is not finite.
    """

    def __init__(self, model: RobotModel, q0: ArrayLike | None = None) -> None:
        q = np.zeros(model.n) if q0 is None else np.array(q0, dtype=np.float64)
        if q.shape != (model.n,) or not np.isfinite(q).all():
            raise PlantError(f"the first state must have {model.n} finite angles, got {q}")
        self._limit = model.velocity_max
        self._periods = 0
        self._state = State(0.0, q, np.zeros(model.n))

    @classmethod
    def of(cls, config: Config, model: RobotModel, q0: Array) -> KinematicPlant:
        """Return the plant with the joints at `q0` (n,) [rad]."""
        return cls(model, q0)

    @property
    def state(self) -> State:
        """The present state."""
        return self._state

    def step(self, command: Command, dt: float) -> State:
        """Return the state after a period `dt` [s]; velocities are clipped to the joints' limits.

        Raises
        ------
        PlantError
            If the command is not finite or does not fit.
        """
        q = self._state.q
        u = checked(command.velocity, q.size, "velocities")
        u = np.minimum(np.maximum(u, -self._limit), self._limit)
        self._periods += 1
        # time is computed from the number of periods: a sum would accumulate rounding errors
        self._state = State(self._periods * dt, q + dt * u, u)
        return self._state
