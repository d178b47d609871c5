"""Tasks: errors that the objective of (6) drives to zero."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.kinematics import Kinematics, Point, pose_difference, pose_difference_jacobian

__all__ = ["ComOverFoot", "ComPath", "FramePose", "Posture", "SwingPath", "Task"]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Task(ABC):
    """An error e(q) with e' = J u; the objective has weight ||J u - wanted||^2.

    Attributes
    ----------
    name : str
    weight : float
    """

    name: str
    weight: float = 1.0

    @abstractmethod
    def error(self, kin: Kinematics) -> Array:
        """Error, shape (k,)."""

    @abstractmethod
    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian of `error`, shape (k, n)."""

    def wanted(self, kin: Kinematics, eta: float) -> Array:
        """Return the e' asked for, shape (k,): -eta e in (6); one on a path adds the path's velocity."""
        return -eta * self.error(kin)


@dataclass(frozen=True, kw_only=True)
class ComOverFoot(Task):
    """CoM projection over a point of a foot, section 4.1 [m].

    The foot may slide, so its Jacobian counts: e = (p_CoM - p_foot)_xy, J = (J_CoM - J_foot)_xy.
    """

    foot: Point

    def error(self, kin: Kinematics) -> Array:
        """Horizontal offset of the CoM from the point, shape (2,) [m]."""
        return kin.com[:2] - self.foot.position(kin)[:2]

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian of `error`, shape (2, n) [m/rad]."""
        return kin.com_jacobian[:2] - self.foot.jacobian(kin)[:2]


@dataclass(frozen=True, kw_only=True)
class FramePose(Task):
    """Pose of a frame, section 4.2: e = vec8(x - x_d), with the sign of x that is closer to x_d.

    Attributes
    ----------
    frame : str
    target : ndarray, shape (8,)
        x_d in the base frame.
    """

    frame: str
    target: Array

    def error(self, kin: Kinematics) -> Array:
        """Difference of the dual quaternions, shape (8,)."""
        x = kin.pose(self.frame)
        return self._sign(x) * x - self.target

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian of `error`, shape (8, n)."""
        return self._sign(kin.pose(self.frame)) * kin.pose_jacobian(self.frame)

    def _sign(self, x: Array) -> float:
        # x and -x are the same pose
        return 1.0 if x[:4] @ self.target[:4] >= 0.0 else -1.0


@dataclass(frozen=True, kw_only=True)
class Posture(Task):
    """All joints at a posture [rad]; not in the paper."""

    q_ref: Array

    def error(self, kin: Kinematics) -> Array:
        """Offset of every joint, shape (n,) [rad]."""
        return kin.q - self.q_ref

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian of `error`, shape (n, n)."""
        return np.eye(kin.q.shape[0])


def minimum_jerk(s: float) -> tuple[float, float]:
    """Return the place 0..1 and the slope at the fraction `s` of the time: at rest at both ends."""
    s = min(max(s, 0.0), 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2), 30.0 * (s * (1.0 - s)) ** 2


def _capped(v: Array, most: float) -> Array:
    size = float(np.sqrt(v @ v))
    return v if size <= most else v * (most / size)


@dataclass(frozen=True, kw_only=True)
class ComPath(Task):
    """The vertical through the CoM moves to the middle of some points and stays there [m].

    A step in CoM velocity tips a robot, so the target leaves `start` and arrives with no acceleration.

    Attributes
    ----------
    start : ndarray, shape (2,)
        Where the CoM began, in the base frame [m].
    over : tuple of Point
        Its goal is the mean of these.
    duration : float
        [s]
    saturation : float
        Larger errors are answered like this one [m].
    """

    start: Array
    over: tuple[Point, ...]
    duration: float
    saturation: float

    def reference(self, kin: Kinematics) -> tuple[Array, Array, Array]:
        """Return place [m], velocity [m/s] and acceleration [m/s^2] of the path, shape (2,) each."""
        s = min(max(kin.elapsed / self.duration, 0.0), 1.0)
        place, slope = minimum_jerk(s)
        bend = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)
        way = self.goal(kin) - self.start
        return self.start + place * way, slope / self.duration * way, bend / self.duration**2 * way

    def goal(self, kin: Kinematics) -> Array:
        """Where the CoM is to arrive, shape (2,) [m]."""
        total = np.zeros(2)
        for point in self.over:
            total += point.position(kin)[:2]
        return total / len(self.over)

    def error(self, kin: Kinematics) -> Array:
        """Error, shape (k,)."""
        return kin.com_on_ground - self.reference(kin)[0]

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian, shape (k, n)."""
        # feet that a phase holds do not move, and where they do the error follows them
        return kin.com_on_ground_jacobian

    def wanted(self, kin: Kinematics, eta: float) -> Array:
        """Return the e' asked for: the path's velocity and the way back to it."""
        place, velocity, _ = self.reference(kin)
        return velocity - eta * _capped(kin.com_on_ground - place, self.saturation)


@dataclass(frozen=True, kw_only=True)
class SwingPath(Task):
    """A sole lifts off, passes over a via point and lands: p - p_d [m], and the angle times `lever` [m].

    Attributes
    ----------
    frame : str
    start, goal : ndarray, shape (8,)
        Poses in the base frame.
    height : float
        Of the via point above both [m].
    duration : float
        [s]
    rate : float
        Convergence to the path [1/s].
    lever : float
        What an angle of 1 rad counts [m/rad].
    """

    frame: str
    start: Array
    goal: Array
    height: float
    duration: float
    rate: float
    lever: float

    @property
    def legs(self) -> tuple[DQ, Array, DQ]:
        """Pose at the start, way to the goal (3,) [m], and the logarithm of the turn."""
        a, b = DQ(self.start), DQ(self.goal)
        turn = b.P() * a.P().conj()
        return a, b.translation() - a.translation(), (turn if turn.vec4()[0] >= 0.0 else -turn).log()

    def at(self, elapsed: float) -> tuple[Array, Array]:
        """Pose (8,) and velocity, linear and angular, (6,) on the path."""
        s = min(max(elapsed / self.duration, 0.0), 1.0)
        # along the ground between lift-off and landing, which are upright
        place, slope = minimum_jerk((s - 0.1) / 0.8)
        a, way, half = self.legs
        bump, rise = 64.0 * (s * (1.0 - s)) ** 3, 192.0 * (s * (1.0 - s)) ** 2 * (1.0 - 2.0 * s)
        up = np.array([0.0, 0.0, self.height])
        r = (half * place).exp() * a.P()
        rate = slope / 0.8
        velocity = np.concatenate([way * rate + up * rise, 2.0 * half.vec3() * rate]) / self.duration
        return DQ.from_pose(a.translation() + place * way + bump * up, r.vec4()).vec8(), velocity

    def error(self, kin: Kinematics) -> Array:
        """Error, shape (k,)."""
        return self._scale() * pose_difference(kin.pose(self.frame), self.at(kin.elapsed)[0])

    def jacobian(self, kin: Kinematics) -> Array:
        """Jacobian, shape (k, n)."""
        return self._scale()[:, None] * pose_difference_jacobian(kin, self.frame, self.at(kin.elapsed)[0])

    def wanted(self, kin: Kinematics, eta: float) -> Array:
        """Return the e' asked for: the path's velocity and the way back to it."""
        target, velocity = self.at(kin.elapsed)
        return self._scale() * (velocity - self.rate * pose_difference(kin.pose(self.frame), target))

    def _scale(self) -> Array:
        return np.array([1.0, 1.0, 1.0, self.lever, self.lever, self.lever])
