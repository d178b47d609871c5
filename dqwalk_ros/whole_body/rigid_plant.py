"""A robot of rigid bodies on rigid ground: the simulation of section VII [Sherikov2014].

Model and contacts are ideal: a standing foot does not move, whatever contact force this requires. Forces and motion
follow from the joint torques only. The contact forces are in `wrenches`, which show if a foot would have to pull or to
exceed the friction.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import PlantError
from dqwalk_ros.whole_body.controller import BodyCommand, BodyState
from dqwalk_ros.whole_body.dynamics import Dynamics, Multibody


class BodyPlant(ABC):
    """A plant that executes joint torques and pushes.

    Parameters
    ----------
    state : BodyState
        Initial state.

    Attributes
    ----------
    state : BodyState
        The present state, without measurement errors.
    effort : ndarray, shape (n,)
        Joint torques of the last period [N m].
    wrenches : mapping of Foot to ndarray, shape (6,)
        Force and moment of the ground on each standing foot in the last period, about its sole link's origin, in world
        axes [N, N m]; empty if the plant does not compute them.
    fallen : bool
        False: the controller finds out whether the robot has fallen.
    """

    fallen = False

    def __init__(self, state: BodyState) -> None:
        self.state, self.effort = state, np.zeros(len(state.q))
        self.wrenches: Mapping[Foot, Array] = {}
        self._begin, self._periods = state.time, 0

    def step(self, command: BodyCommand, dt: float) -> BodyState:
        """Return the state after one period.

        Raises
        ------
        PlantError
            If the command is not finite or has a wrong size, or the simulation has diverged.
        """
        if command.effort.shape != self.effort.shape or not np.isfinite(command.effort).all():
            raise PlantError(f"the command must have {self.effort.size} finite torques, got {command.effort}")
        self.effort = command.effort
        self._periods += 1
        self._move(command, self._begin + self._periods * dt, dt)
        return self.state

    def push(self, impulse: ArrayLike) -> None:
        """Apply an impulse (3,) [N s] to the pushed link.

        Raises
        ------
        PlantError
            If the impulse is not three finite numbers, or the resulting velocities are not finite.
        """
        r = np.asarray(impulse, dtype=np.float64)
        if r.shape != (3,) or not np.isfinite(r).all():
            raise PlantError(f"an impulse is three finite numbers [N s], got {impulse!r}")
        self._hit(r)

    @abstractmethod
    def _move(self, command: BodyCommand, time: float, dt: float) -> None:
        """Set the state at `time` [s], after one period `dt` with a command."""

    @abstractmethod
    def _hit(self, impulse: Array) -> None:
        """Change the velocities by an impulse (3,) [N s]."""


class RigidPlant(BodyPlant):
    """Integrates (S1) under (S8); a push acts at the origin of its link.

    Parameters
    ----------
    state : BodyState
        Initial state.
    pushed : str
        The link that pushes act on.
    damping : float
        Rate at which a residual velocity of a standing foot, an integration error, decays [1/s].
    """

    def __init__(self, model: RobotModel, state: BodyState, *, pushed: str, damping: float = 10.0) -> None:
        super().__init__(state)
        self._soles = {foot: model.soles[foot].frame for foot in Foot}
        self._body = Multibody(model, (*self._soles.values(), pushed))
        self._pushed, self._damping = pushed, damping
        self._stance: tuple[Foot, ...] = tuple(Foot)

    def _move(self, command: BodyCommand, time: float, dt: float) -> None:
        s, self._stance = self.state, command.stance
        d = self._body.at(s.x_base, s.q, s.v)
        J, soles = self._contact_jacobian(d), [d.frames[self._soles[foot]] for foot in self._stance]
        drift = np.concatenate([sole.drift + self._damping * sole.velocity for sole in soles])
        effort = np.concatenate([np.zeros(6), command.effort])
        acceleration, force = _constrained(d.H, J, effort - d.h, -drift)  # H v' + h = S'tau + J'f, J v' + J'v = 0
        self.wrenches = dict(zip(self._stance, force.reshape(-1, 6), strict=True))
        x_base, q = self._body.integrate(s.x_base, s.q, dt * s.v + 0.5 * dt**2 * acceleration)
        self._set(time, x_base, q, s.v + dt * acceleration)
        if command.landing is not None:
            self._stance = (*command.stance, command.landing)
            self._hit(np.zeros(3))

    def _hit(self, impulse: Array) -> None:
        """Change the velocities instantaneously by an impulse and by the impact of the standing feet."""
        s = self.state
        d = self._body.at(s.x_base, s.q, s.v)
        J = self._contact_jacobian(d)
        momentum = d.H @ s.v + d.frames[self._pushed].jacobian[:3].T @ impulse  # (S23) H (v+ - v-) = J_c'r_c + J_d'r_d
        after, _ = _constrained(d.H, J, momentum, np.zeros(len(J)))  # (S24) J_c v+ = 0
        self._set(s.time, s.x_base, s.q, after)

    def _contact_jacobian(self, dynamics: Dynamics) -> Array:
        return np.vstack([dynamics.frames[self._soles[foot]].jacobian for foot in self._stance])

    def _set(self, time: float, x_base: Array, q: Array, v: Array) -> None:
        if not np.isfinite(v).all():
            raise PlantError(f"the motion is not finite at {time:.3f} s")
        self.state = BodyState(time, q, dq=v[6:], x_base=x_base, v_base=v[:6])


def _constrained(H: Array, J: Array, right: Array, held: Array) -> tuple[Array, Array]:
    """Return a and f of H a = right + J' f, J a = held; with redundant contacts f has the least norm."""
    inverse = np.linalg.solve(H, np.column_stack([J.T, right]))
    G, free = inverse[:, :-1], inverse[:, -1]
    f = np.asarray(np.linalg.lstsq(J @ G, held - J @ free, rcond=1e-10)[0], dtype=np.float64)
    return free + G @ f, f
