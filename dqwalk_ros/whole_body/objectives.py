"""Objectives of section V [Sherikov2014], and vector-field inequalities of second order.

An `Objective` is the second-order counterpart of a `Task`: ||J v' + J' v - pi||^2 instead of ||J u + eta e||^2. A
`Distance` is a vector-field inequality of second order. To add your own, write a frozen dataclass with its two or three
methods and pass it to the controller::

    WholeBodyController(config, model, objectives=[...], distances=[...])
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from dqwalk_ros.support.arrays import Array
from dqwalk_ros.whole_body.dynamics import Dynamics, rotation_error


@dataclass(frozen=True, kw_only=True)
class Objective(ABC):
    """An objective with the cost 1/2 weight ||J v' + J' v - pi||^2, where pi is a desired acceleration."""

    name: str
    weight: float = 1.0

    @property
    def frames(self) -> tuple[str, ...]:
        """Links whose pose the task needs."""
        return ()

    @abstractmethod
    def jacobian(self, dynamics: Dynamics) -> Array:
        """J, shape (k, nv)."""

    @abstractmethod
    def acceleration(self, dynamics: Dynamics) -> Array:
        """Return the desired value of J v', pi - J' v, shape (k,)."""


@dataclass(frozen=True, kw_only=True)
class FrameObjective(Objective):
    """An objective of one link, by a PD controller."""

    frame: str
    """The link."""
    kp: float = 100.0
    """Stiffness [1/s^2]; the damping is critical, 2 sqrt(kp)."""

    @property
    def kd(self) -> float:
        """Critical damping [1/s]."""
        return 2.0 * math.sqrt(self.kp)

    @property
    def frames(self) -> tuple[str, ...]:
        """The link."""
        return (self.frame,)


@dataclass(frozen=True, kw_only=True)
class FramePosition(FrameObjective):
    """Moves a link's origin to a target by a saturated PD controller (S17)."""

    target: Array
    """Position in the world, shape (3,) [m]."""
    saturation: float = math.inf
    """Largest acceleration by the position error along each axis [m/s^2]."""

    def jacobian(self, dynamics: Dynamics) -> Array:
        """Jacobian of the position, shape (3, nv)."""
        return dynamics.frames[self.frame].jacobian[:3]

    def acceleration(self, dynamics: Dynamics) -> Array:
        """Return clip(kp (p* - p)) - kd p' - J' v, shape (3,) [m/s^2]."""
        motion = dynamics.frames[self.frame]
        pull = np.clip(self.kp * (self.target - motion.position), -self.saturation, self.saturation)
        return pull - self.kd * motion.velocity[:3] - motion.drift[:3]  # (S17) pi_hand - J' v


@dataclass(frozen=True, kw_only=True)
class FrameOrientation(FrameObjective):
    """Turns a link to a target orientation by a PD controller (S18)."""

    target: Array | None = None
    """Rotation matrix in the world, shape (3, 3); by default the identity."""

    def jacobian(self, dynamics: Dynamics) -> Array:
        """Jacobian of the angular velocity, shape (3, nv)."""
        return dynamics.frames[self.frame].jacobian[3:]

    def acceleration(self, dynamics: Dynamics) -> Array:
        """Return -kp log(R R*^T) - kd w - J' v, shape (3,) [rad/s^2]."""
        motion = dynamics.frames[self.frame]
        error = rotation_error(motion.rotation, self.target)
        return -self.kp * error - self.kd * motion.velocity[3:] - motion.drift[3:]  # (S18) pi_torso - J' v


@dataclass(frozen=True, kw_only=True)
class JointPosture(Objective):
    """Moves the joints to a posture by PD controllers (S19); joints with zero stiffness are only damped."""

    reference: Array
    stiffness: Array
    damping: Array
    """Shape (n,) [rad, 1/s^2, 1/s]."""

    def jacobian(self, dynamics: Dynamics) -> Array:
        """Jacobian of the joints, shape (n, nv)."""
        return np.eye(dynamics.nv)[6:]

    def acceleration(self, dynamics: Dynamics) -> Array:
        """Return kp (q* - q) - kd q', shape (n,) [rad/s^2]."""
        return self.stiffness * (self.reference - dynamics.q) - self.damping * dynamics.v[6:]  # (S19)


@dataclass(frozen=True, kw_only=True)
class Distance(ABC):
    """Keep a signed distance d at or above zero by d'' >= -2 eta d' - eta^2 d.

    This is the inequality d' >= -eta d applied twice: with e = d' + eta d it is e' >= -eta e. If d and e are not
    negative at the beginning, they stay so.
    """

    name: str
    eta: float = 10.0
    """[1/s]"""

    @property
    def frames(self) -> tuple[str, ...]:
        """Links whose pose the task needs."""
        return ()

    @abstractmethod
    def distance(self, dynamics: Dynamics) -> Array:
        """Return d, shape (k,)."""

    @abstractmethod
    def jacobian(self, dynamics: Dynamics) -> Array:
        """Return J of d' = J v, shape (k, nv)."""

    @abstractmethod
    def drift(self, dynamics: Dynamics) -> Array:
        """Return J' v of d'' = J v' + J' v, shape (k,)."""

    def rows(self, dynamics: Dynamics) -> tuple[Array, Array]:
        """Return G (k, nv) and h (k,) of G v' >= h."""
        J = self.jacobian(dynamics)
        return J, -2.0 * self.eta * (J @ dynamics.v) - self.eta**2 * self.distance(dynamics) - self.drift(dynamics)


@dataclass(frozen=True, kw_only=True)
class FrameOutsideSphere(Distance):
    """Keep a link's origin outside a fixed sphere [m]: obstacle avoidance."""

    frame: str
    center: Array
    """Centre in the world, shape (3,) [m]."""
    radius: float
    """[m]"""

    @property
    def frames(self) -> tuple[str, ...]:
        """The link."""
        return (self.frame,)

    def distance(self, dynamics: Dynamics) -> Array:
        """Distance from the centre minus the radius, shape (1,) [m]."""
        return np.array([np.linalg.norm(dynamics.frames[self.frame].position - self.center) - self.radius])

    def jacobian(self, dynamics: Dynamics) -> Array:
        """Jacobian of `distance`, shape (1, nv)."""
        motion = dynamics.frames[self.frame]
        return (self._normal(motion.position) @ motion.jacobian[:3])[None]

    def drift(self, dynamics: Dynamics) -> Array:
        """Return n J' v + (|p'|^2 - (n p')^2) / |p - c|, shape (1,) [m/s^2]."""
        motion = dynamics.frames[self.frame]
        n, speed = self._normal(motion.position), motion.velocity[:3]
        away = np.linalg.norm(motion.position - self.center)
        return np.array([n @ motion.drift[:3] + (speed @ speed - (n @ speed) ** 2) / away])

    def _normal(self, position: Array) -> Array:
        away: Array = position - self.center
        return away / np.linalg.norm(away)
