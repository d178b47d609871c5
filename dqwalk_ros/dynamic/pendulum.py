"""The pendulum that a robot is when it walks: its frequencies, and what the swinging leg does to it.

With the angular momentum L about the CoM, that the ground's moment about the zero-moment point z has no horizontal
part reads c - z = (h/g) c'' + (ex x L') / (M g) along the ground. The motions by which the robot moves its CoM, and its
swing foot, are those of its own quadratic program, and L is in proportion to them: a robot that tilts sideways instead
of shifting its hips is a slower pendulum than its height tells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.statics import GRAVITY
from dqwalk_ros.urdf import Urdf
from dqwalk_ros.walk import Phase

__all__ = ["Pendulum", "angular_momentum"]

Array = NDArray[np.float64]


def angular_momentum(kin: Kinematics) -> Array:
    """Return L_u with L = L_u u about the CoM at joint velocities u, shape (3, n) [kg m^2/s]; a sole stands."""
    model, J_com = kin.model, kin.com_jacobian
    L = np.zeros(J_com.shape)
    for link in Urdf(model.urdf, model.name).links.values():
        if link.mass > 0.0 and link.name in model.frames:
            arm, J = kin.point(link.name, link.com) - kin.com, kin.point_jacobian(link.name, link.com)
            R = np.column_stack([kin.direction(link.name, axis) for axis in np.eye(3)])
            L += link.mass * np.cross(arm, (J - J_com).T).T + R @ link.inertia @ R.T @ kin.angular_jacobian(link.name)
    return L


@dataclass(frozen=True)
class Pendulum:
    """Constants of the pendulum.

    Attributes
    ----------
    height : float
        Of the CoM [m].
    omega : ndarray, shape (2,)
        Frequencies ahead and to the side [1/s].
    swing : float
        How far the zero-moment point goes ahead, for the acceleration of the swing foot [s^2].
    """

    height: float
    omega: Array
    swing: float

    @classmethod
    def of(cls, phase: Phase, kin: Kinematics) -> Self:
        """Return the pendulum of a single support with the tasks ``com`` and ``swing``, in a posture."""
        now = phase.evaluate(kin)
        rows, at = {}, 0
        for task in phase.tasks:
            size = len(task.error(kin))
            rows[task.name] = slice(at, at + size)
            at += size
        root = now.assembly.sqrt_weights
        J = root[:, None] * (now.gradients @ now.J_features)[:at]
        H, L_u = J.T @ J + phase.damping**2 * np.eye(J.shape[1]), angular_momentum(kin)

        def response(task: str, axis: int) -> Array:
            """Return the angular momentum when the first rows of a task are asked for 1 m/s along an axis."""
            rate = np.zeros(at)
            rate[rows[task].start + axis] = 1.0
            L: Array = L_u @ np.linalg.solve(H, J.T @ (root * rate))
            return L

        mass, height = kin.model.mass, float(kin.com[2])
        turning = np.array([response("com", 0)[1], -response("com", 1)[0]]) / mass
        omega = np.sqrt(GRAVITY / np.maximum(height + turning, 0.5 * height))
        return cls(height, omega, -response("swing", 0)[1] / (mass * GRAVITY))
