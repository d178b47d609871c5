"""Linear inverted pendulum model of a robot: its frequencies, and the effect of the swing leg.

With the angular momentum L about the CoM, the condition that the ground exerts no horizontal moment about the
zero-moment point z is c - z = (h/g) c'' + (L' x ez) / (M g) along the ground. L is proportional to the velocities of
the CoM and of the swing foot, by the joint velocities that the quadratic program of the controller gives for them. So a
robot that tilts sideways instead of shifting its hips is a slower pendulum than a point mass at the same height.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import Phase
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.urdf import Urdf
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.walks.footprint import Footprint

if TYPE_CHECKING:
    from yourdfpy import Link

__all__ = ["InvertedPendulum", "Pendulum", "angular_momentum", "swing_inertia"]


_SMOOTH = 0.02
"""Time constant of the filter of the measured xi [s]."""


def angular_momentum(kin: Kinematics) -> Array:
    """Return L_u with the angular momentum L = L_u u about the CoM, shape (3, n) [kg m^2]; the base sole is at rest."""
    model, J_com = kin.model, kin.com_jacobian
    L = np.zeros(J_com.shape)
    for link in _links(model):
        mass, com = link.inertial.mass, link.inertial.origin[:3, 3]
        arm, J = kin.point(link.name, com) - kin.com, kin.point_jacobian(link.name, com)
        L += mass * np.cross(arm, (J - J_com).T).T + _inertia(kin, link) @ kin.angular_jacobian(link.name)
    return L


def swing_inertia(kin: Kinematics) -> Array:
    """Return the inertia matrix of the swing leg's joints, with the pelvis at rest, shape (n, n) [kg m^2].

    It is zero for all other joints, and does not include the rotors of the servos.
    """
    model, tree = kin.model, kin.tree
    moved, above = (tree.moves[tree.frames[frame][0]] for frame in (kin.swing, model.pelvis))
    leg, M = moved & ~above, np.zeros((model.n, model.n))
    for link in _links(model):
        mass, com = link.inertial.mass, link.inertial.origin[:3, 3]
        J, turning = kin.point_jacobian(link.name, com) * leg, kin.angular_jacobian(link.name) * leg
        M += mass * J.T @ J + turning.T @ _inertia(kin, link) @ turning
    return M


@functools.lru_cache(maxsize=16)
def _links(model: RobotModel) -> tuple[Link, ...]:
    """Return the links that have a mass; computed once per model, because the URDF is parsed."""
    links = Urdf(model.urdf, model.name).links.values()
    return tuple(link for link in links if link.inertial.mass > 0.0 and link.name in model.frames)


def _inertia(kin: Kinematics, link: Link) -> Array:
    """Return the inertia of a link about its CoM in axes of the base frame, shape (3, 3) [kg m^2]."""
    R = np.column_stack([kin.direction(link.name, axis) for axis in np.eye(3)])
    inertia: Array = R @ link.inertial.inertia @ R.T
    return inertia


@dataclass(frozen=True)
class InvertedPendulum:
    """Constants of the pendulum.

    Attributes
    ----------
    height : float
        Height of the CoM, h [m].
    omega : ndarray, shape (2,)
        Frequencies along x and y [1/s].
    swing : float
        Displacement of the zero-moment point along x per acceleration of the swing foot [s^2].
    """

    height: float
    omega: Array
    swing: float

    @classmethod
    def of(cls, phase: Phase, kin: Kinematics) -> Self:
        """Return the pendulum model of a single support in a posture.

        Parameters
        ----------
        phase : Phase
            A single support with the tasks ``com`` and ``swing``.
        kin : Kinematics
            Kinematics of the posture.
        """
        now = phase.evaluate(kin.q, kin.up)
        root = now.assembly.sqrt_weights
        J = root[:, None] * now.J[: len(root)]
        H, L_u = J.T @ J + phase.damping**2 * np.eye(J.shape[1]), angular_momentum(kin)

        def response(task: str, axis: int) -> Array:
            """Return L (3,) [kg m^2/s] if the velocity of a task is 1 m/s along an axis and all others are zero."""
            rate = np.zeros(len(root))
            rate[now.assembly.task_spans[task].start + axis] = 1.0
            L: Array = L_u @ np.linalg.solve(H, J.T @ (root * rate))
            return L

        mass, height = kin.model.mass, float(kin.com[2])
        turning = np.array([response("com", 0)[1], -response("com", 1)[0]]) / mass
        omega = np.sqrt(GRAVITY / np.maximum(height + turning, 0.5 * height))
        return cls(height, omega, -response("swing", 0)[1] / (mass * GRAVITY))


@dataclass
class Pendulum:
    """State of the pendulum along the ground, in the axes of the base sole.

    Attributes
    ----------
    c, xi : ndarray, shape (2,)
        Reference of the CoM, and planned divergent component [m].
    smooth : ndarray, shape (2,)
        Filtered measured divergent component [m].
    pressure : ndarray, shape (2,)
        Commanded zero-moment point [m].
    """

    c: Array
    xi: Array
    smooth: Array
    pressure: Array

    def reset(self, c: Array, xi: Array, smooth: Array) -> None:
        """Set the reference to c and xi, and the measured divergent component to `smooth`, shape (2,) each [m]."""
        self.c, self.xi, self.smooth = c, xi, smooth

    def advance(self, dt: float, omega: Array) -> None:
        """Move the reference of the CoM by `dt` [s], c' = w (xi - c)."""
        self.c = self.c + dt * omega * (self.xi - self.c)

    def measure(self, xi: Array, dt: float, omega: Array) -> None:
        """Include the divergent component xi (2,) [m] that is measured `dt` [s] after the last one."""
        self.smooth = _filtered(self.smooth, self.pressure, xi, omega, dt)

    def change_base(self, other: Footprint) -> None:
        """Change to the axes of the other sole; `other` is the footprint of the previous one in these axes."""
        self.c, self.xi, self.smooth, self.pressure = (
            other.points(p) for p in (self.c, self.xi, self.smooth, self.pressure)
        )


@jit
def _filtered(smooth, pressure, xi, omega, dt):  # type: ignore[no-untyped-def]
    """Return the filtered xi (2,): that of `dt` [s] ago, moved as the pendulum, approaches the measured one."""
    moved = smooth + dt * omega * (smooth - pressure)  # xi' = w (xi - z)
    return moved + dt / (_SMOOTH + dt) * (xi - moved)
