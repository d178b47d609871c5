"""The kinematic integrator: joints that move exactly as they are told."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqwalk_ros.controllers import Command, State
from dqwalk_ros.errors import PlantError
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
    compiled : bool
        Whether it takes the compiled step, for which numba must be there; the other takes twice as long.

    Raises
    ------
    PlantError
        If `q0` does not fit the model or is not finite.
    """

    def __init__(
        self, model: RobotModel, q0: ArrayLike | None = None, time0: float = 0.0, *, compiled: bool = True
    ) -> None:
        q = np.zeros(model.n) if q0 is None else np.array(q0, dtype=np.float64)
        if q.shape != (model.n,) or not np.isfinite(q).all():
            raise PlantError(f"the first state must have {model.n} finite angles, got {q}")
        self._limit = model.velocity_max
        self._integrate = _compiled() if compiled else _integrate
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
        wanted, before = np.asarray(command.velocity, dtype=np.float64), self._state.q
        q, u = np.empty(len(before)), np.empty(len(before))
        if wanted.shape != before.shape or not self._integrate(before, wanted, self._limit, dt, q, u):
            raise PlantError(f"the command must have {before.size} finite velocities, got {wanted}")
        self._periods += 1
        # counted, not summed up: a million periods later the time is still exact
        self._state = State(self._time0 + self._periods * dt, q, u)
        return self._state


def _compiled() -> Callable[[Array, Array, Array, float, Array, Array], bool]:
    from dqwalk_ros.kernels import integrate  # numba takes longer to import than everything else a plant needs

    step: Callable[[Array, Array, Array, float, Array, Array], bool] = integrate
    return step


def _integrate(q: Array, u: Array, limit: Array, dt: float, q_out: Array, u_out: Array) -> bool:
    """Do what `kernels.integrate` does."""
    np.minimum(np.maximum(u, -limit), limit, out=u_out)
    np.multiply(u_out, dt, out=q_out)
    q_out += q
    return bool(np.isfinite(u).all())
