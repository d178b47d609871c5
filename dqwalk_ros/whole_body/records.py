"""What goes into the whole-body controller and what comes out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.robot import Foot
from dqwalk_ros.state import Command, State

__all__ = ["BodyCommand", "BodyState", "BodyTick", "Wrench"]

Array = NDArray[np.float64]


@dataclass(slots=True, eq=False, kw_only=True)
class BodyState(State):
    """A state of the whole body: the joints, and the root link in the world.

    Attributes
    ----------
    dq : ndarray, shape (n,)
        Joint velocities [rad/s].
    x_base : ndarray, shape (8,)
        Pose of the root link.
    v_base : ndarray, shape (6,)
        Its linear and angular velocity in its own axes [m/s, rad/s].
    """

    dq: Array = field()  # of a body it is always measured
    x_base: Array
    v_base: Array

    @property
    def v(self) -> Array:
        """Generalized velocity, shape (6 + n,)."""
        return np.concatenate([self.v_base, self.dq])


@dataclass(slots=True, eq=False, kw_only=True)
class BodyCommand(Command):
    """Joint torques for the next period, and the motion they are expected to make.

    Attributes
    ----------
    velocity : ndarray, shape (n,)
        Joint velocities expected at the end of the period [rad/s].
    acceleration : ndarray, shape (6 + n,)
        Generalized acceleration expected.
    effort : ndarray, shape (n,)
        tau of (1) [N m].
    stance : tuple of Foot
        Feet on the ground.
    landing : Foot or None
        The foot that touches down at the end of the period.
    """

    acceleration: Array
    effort: Array
    stance: tuple[Foot, ...]
    landing: Foot | None = None


@dataclass(frozen=True)
class Wrench:
    """What the ground does to a foot, at the origin of its sole's link, in world axes: force [N], moment [N m]."""

    force: Array
    moment: Array

    @property
    def cop(self) -> Array:
        """Centre of pressure from that origin, (x, y) [m]."""
        cop: Array = np.array([-self.moment[1], self.moment[0]]) / self.force[2]
        return cop


@dataclass(frozen=True)
class BodyTick:
    """What the controller has to say about its last step.

    Attributes
    ----------
    com, com_velocity : ndarray, shape (3,)
        [m, m/s]
    hand : ndarray, shape (3,)
        [m]
    wrenches : mapping of Foot to Wrench
    cop : ndarray, shape (2,)
        Of all contacts together, in the world [m].
    cop_preview : ndarray, shape (2,)
        z_0 of the point mass, in the world [m].
    support : ndarray, shape (2,)
        The foot that landed last [m].
    footsteps : ndarray, shape (K, 2)
        The landing places previewed [m].
    height_error, tilt : float
        Of the CoM [m] and of the torso [rad].
    capturability : float
        By how much (14) is missed [m].
    violation : float
        By how much level 1 had to give way (0: not at all).
    method : str
        How the hierarchy was solved, see `Answer`.
    iterations : int
    times : tuple of float
        For model, assembly and solution [s].
    """

    com: Array
    com_velocity: Array
    hand: Array
    wrenches: Mapping[Foot, Wrench]
    cop: Array
    cop_preview: Array
    support: Array
    footsteps: Array
    height_error: float
    tilt: float
    capturability: float
    violation: float
    method: str
    iterations: int
    times: tuple[float, float, float]
