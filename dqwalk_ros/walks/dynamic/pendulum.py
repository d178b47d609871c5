"""Linear inverted pendulum model of a robot: its frequencies, and the effect of the swing leg.

With the angular momentum L about the CoM, the condition that the ground exerts no horizontal moment about the
zero-moment point z is c - z = (h/g) c'' + (L' x ez) / (M g) along the ground. L is proportional to the velocities of
the CoM and of the swing foot, by the joint velocities that the quadratic program of the controller gives for them. So a
robot that tilts sideways instead of shifting its hips is a slower pendulum than a point mass at the same height.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import Phase
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.robot.model import Body
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.by_address import FLOAT, MATRIX, VECTOR, Record
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.walks.footprint import Footprint

_SMOOTH = 0.02
"""Time constant of the filter of the measured xi [s]."""


def angular_momentum(kin: Kinematics) -> Array:
    """Return L_u with the angular momentum L = L_u u about the CoM, shape (3, n) [kg m^2]; the base sole is at rest."""
    model, J_com = kin.model, kin.com_jacobian
    L = np.zeros(J_com.shape)
    for name, body in zip(model.links, model.bodies, strict=True):
        arm, J = kin.point(name, body.com) - kin.com, kin.point_jacobian(name, body.com)
        L += body.mass * np.cross(arm, (J - J_com).T).T + _inertia(kin, name, body) @ kin.angular_jacobian(name)
    return L


def swing_inertia(kin: Kinematics) -> Array:
    """Return the inertia matrix of the swing leg's joints, with the pelvis at rest, shape (n, n) [kg m^2].

    It is zero for all other joints, and does not include the rotors of the servos.
    """
    model = kin.model
    moved, above = (kin.tree.frames[frame].moves for frame in (kin.swing, model.pelvis))
    leg, M = moved & ~above, np.zeros((model.n, model.n))
    for name, body in zip(model.links, model.bodies, strict=True):
        J, turning = kin.point_jacobian(name, body.com) * leg, kin.angular_jacobian(name) * leg
        M += body.mass * J.T @ J + turning.T @ _inertia(kin, name, body) @ turning
    return M


def _inertia(kin: Kinematics, frame: str, body: Body) -> Array:
    """Return the inertia of a body about its CoM in axes of the base frame, shape (3, 3) [kg m^2]."""
    R = np.column_stack([kin.direction(frame, axis) for axis in np.eye(3)])
    inertia: Array = R @ body.inertia @ R.T
    return inertia


@dataclass(frozen=True)
class InvertedPendulum:
    """Constants of the pendulum."""

    height: float
    """Height of the CoM, h [m]."""
    omega: Array
    """Frequencies along x and y, shape (2,) [1/s]."""
    swing: float
    """Displacement of the zero-moment point along x per acceleration of the swing foot [s^2]."""

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


class Pendulum:
    """State of the pendulum along the ground, in the axes of the base sole, of a robot that answers with a delay.

    Parameters
    ----------
    omega : ndarray, shape (2,)
        Frequencies along x and y [1/s].
    delay : float
        T, the time from a measurement to the middle of the period in which its command acts [s].
    period : float
        Control period [s].

    Attributes
    ----------
    c, xi : ndarray, shape (2,)
        Reference of the CoM, and planned divergent component [m].
    smooth : ndarray, shape (2,)
        Filtered measured divergent component [m].
    pressure : ndarray, shape (2,)
        Last commanded zero-moment point [m].
    delay, wait : float
        T, and the time until the period begins in which a command acts [s].
    """

    def __init__(self, omega: Array, delay: float, period: float) -> None:
        self._omega, self._period = omega, period
        self.c, self.xi, self.smooth, self.pressure = np.zeros((4, 2))
        # commanded zero-moment points, the last ones, and since when each one acts
        self._points, self._begins = np.zeros((3, 2)), np.full(3, -math.inf)
        self.use(delay)

    def use(self, delay: float) -> None:
        """Use another delay T [s] from the next command on."""
        self.delay, self.wait = delay, max(delay - 0.5 * self._period, 0.0)
        if (more := math.ceil(delay / self._period) + 3 - len(self._points)) > 0:
            self._points = np.concatenate([np.repeat(self._points[:1], more, axis=0), self._points])
            self._begins = np.concatenate([np.full(more, -math.inf), self._begins])

    def reset(self, c: Array, xi: Array, planned: Array) -> None:
        """Begin at the measured c and xi (2,) with the divergent component `planned` (2,) [m]; nothing is under way."""
        self.c[:], self.xi[:], self.smooth[:] = c, planned, xi
        self._points[:], self._begins[:] = c, -math.inf

    @property
    def compiled(self) -> Moving:
        """What compiled code updates, in the same memory until the next `use`."""
        arrays = self.c, self.xi, self.smooth, self.pressure, self._begins, self._points
        return Moving(self._omega, self.delay, self.wait, *arrays)

    def change_base(self, other: Footprint) -> None:
        """Change to the axes of the other sole; `other` is the footprint of the previous one in these axes."""
        for p in (self.c, self.xi, self.smooth, self.pressure, self._points):
            p[:] = other.points(p)


class Moving(NamedTuple):
    """A `Pendulum` in the form that compiled code updates: its attributes, and the zero-moment points under way."""

    omega: Array
    delay: float
    wait: float
    """Time from a measurement to the beginning of the period in which its command acts [s]."""
    c: Array
    xi: Array
    smooth: Array
    pressure: Array
    begins: Array
    """Times since when the points act, shape (m,) [s]."""
    points: Array
    """Shape (m, 2) [m]."""


MOVING = Record(Moving, VECTOR, FLOAT, FLOAT, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, MATRIX)


@jit
def advance(now: Moving, dt: float) -> None:
    """Move the reference of the CoM by `dt` [s], c' = w (xi - c)."""
    c = now.c
    c += dt * now.omega * (now.xi - c)


@jit
def _in_effect(begins: Array, points: Array, time: float) -> Array:
    """Return the zero-moment point (2,) in effect at `time` [s]; `points` (m, 2) act from `begins` (m,) on [s]."""
    z: Array = points[0]
    for k in range(1, begins.shape[0]):
        if begins[k] <= time:
            z = points[k]
    return z


@jit
def command(now: Moving, time: float, z: Array) -> None:
    """Note the zero-moment point z (2,) [m] that is commanded for the state at `time` [s], in place of the oldest."""
    for k in range(now.begins.shape[0] - 1):
        now.begins[k], now.points[k] = now.begins[k + 1], now.points[k + 1]
    now.begins[-1], now.points[-1] = time + now.wait, z
    now.pressure[:] = z


@jit
def when_acting(now: Moving, time: float, c: Array, xi: Array) -> tuple[Array, Array]:
    """Return c and xi (2,) [m] when the command for the state at `time` [s] acts, from those at `time`.

    The points under way act one after the other. For each, in closed form, xi' = w (xi - z), and
    zeta' = -w (zeta - z) of its stable counterpart zeta = 2 c - xi.
    """
    zeta, last, end = 2.0 * c - xi, now.begins.shape[0] - 1, time + now.delay
    for k in range(last + 1):
        until = end if k == last else min(now.begins[k + 1], end)
        if until > time:
            z, e = now.points[k], np.exp(now.omega * (until - time))
            xi, zeta, time = z + e * (xi - z), z + (zeta - z) / e, until
    return 0.5 * (xi + zeta), xi


@jit
def measure(now: Moving, time: float, dt: float, xi: Array) -> None:
    """Include xi (2,) [m], measured at `time`, `dt` after the last one [s], in the filtered one."""
    smooth, z = now.smooth, _in_effect(now.begins, now.points, time - 0.5 * dt)
    smooth += dt * now.omega * (smooth - z)  # xi' = w (xi - z)
    smooth += dt / (_SMOOTH + dt) * (xi - smooth)
