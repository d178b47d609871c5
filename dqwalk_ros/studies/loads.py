"""What pushes the robot: a constant force, or a bottle on a rope, as in the RoboCup Humanoid League."""

from __future__ import annotations

import math
from typing import Protocol

from dqwalk_ros.paper.statics import GRAVITY

ROPE = 1.75
"""Length of the rope [m]; the rules allow 1.5 to 2 m."""
_FARTHEST = 0.75
"""Largest distance of the release, in lengths of the rope."""
_CONTACT = 0.05
"""Duration of the contact of an elastic bottle [s], from which its stiffness follows."""
_SUBSTEPS = 20
"""Steps of the bottle in a control period."""


class Load(Protocol):
    """Something that pushes in one direction, from its first period on."""

    def force(self, ahead: float, dt: float) -> float:
        """Return the force [N] of the next period `dt` [s] on a pelvis displaced by `ahead` in its direction [m]."""


class ConstantForce:
    """An impulse [N s], spread evenly over a number of periods."""

    def __init__(self, impulse: float, periods: int) -> None:
        self._impulse, self._periods, self._left = impulse, periods, periods

    def force(self, ahead: float, dt: float) -> float:
        """Return the force of the next period [N]."""
        if not self._left:
            return 0.0
        self._left -= 1
        return self._impulse / (self._periods * dt)


class Bottle:
    """A pendulum that hits the pelvis at the lowest point of its path, nearly inelastically, and is caught afterwards.

    Spring and damper of the contact, critically damped, act between the bottle and the pelvis, and on both alike: the
    robot receives exactly the momentum that the bottle loses. The same bottle so hits the robot in every engine.

    Parameters
    ----------
    mass : float
        [kg]
    momentum : float
        When it hits [N s].
    robot_mass : float
        [kg]
    """

    def __init__(self, mass: float, momentum: float, robot_mass: float) -> None:
        self._mass, self._robot_mass, reduced = mass, robot_mass, mass * robot_mass / (mass + robot_mass)
        rate = math.pi / _CONTACT
        self._stiffness, self._damping = reduced * rate**2, 2.0 * reduced * rate
        self._x, self._v = 0.0, momentum / mass
        self._begin = self._before = math.nan

    def force(self, ahead: float, dt: float) -> float:
        """Return the mean force of the next period [N], in which the robot is taken to move as a free point mass."""
        if math.isnan(self._begin):
            self._begin = self._before = ahead
        v, p, h, impulse = (ahead - self._before) / dt, ahead - self._begin, dt / _SUBSTEPS, 0.0
        self._before = ahead
        if self._v < min(v, 0.0) and self._x < p:
            return 0.0  # it swings back, and is caught
        for _ in range(_SUBSTEPS):
            depth = self._x - p
            f = max(self._stiffness * depth + self._damping * (self._v - v), 0.0) if depth >= 0.0 else 0.0
            self._v -= h * (f / self._mass + GRAVITY * self._x / ROPE)
            self._x += h * self._v
            v += h * f / self._robot_mass
            p += h * v
            impulse += h * f
        return impulse / dt


def drop(mass: float, momentum: float) -> float:
    """Return the height [m] from which a bottle of a mass [kg] swings to a momentum [N s]."""
    return (momentum / mass) ** 2 / (2.0 * GRAVITY)


def release_distance(mass: float, momentum: float) -> float:
    """Return the horizontal distance [m] at which a bottle of a mass [kg] is released for a momentum [N s]."""
    height = drop(mass, momentum)
    return math.sqrt(2.0 * ROPE * height - height**2)


def farthest_momentum(mass: float) -> float:
    """Return the momentum [N s] of a bottle of a mass [kg] that is released at the largest distance allowed."""
    height = ROPE * (1.0 - math.sqrt(1.0 - _FARTHEST**2))
    return mass * math.sqrt(2.0 * GRAVITY * height)
