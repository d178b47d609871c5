"""Limits of joints: which measured angles are possible, and which commands. Used by controllers and plants."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array, Mask

FASTEST = 100.0
"""Velocity of a joint without a limit, where a bound is needed [rad/s]."""


class JointLimits(NamedTuple):
    """Names and limits of n joints that are not those of a `RobotModel`, which has them too."""

    joint_names: tuple[str, ...]
    q_min: Array
    q_max: Array
    velocity_max: Array
    effort_max: Array
    """Shape (n,) [rad], [rad/s], [N m]."""


def outside_limits(q: Array, limits: JointLimits | RobotModel, slack: float) -> str:
    """Return the joints of `q` (n,) beyond their limits by more than `slack` [rad], and by how much, or ``""``."""
    beyond = np.maximum(limits.q_min - q, q - limits.q_max)
    return named_angles(limits, beyond, ~(beyond <= slack))


def unreachable(q: Array, before: Array, passed: Array | float, speed: Array, slack: Array | float) -> Mask:
    """Return which joints cannot have moved from one measured angle to the next; a value that is not a number cannot.

    Parameters
    ----------
    q, before : ndarray, shape (n,)
        Measured, and last accepted angles [rad]; or other quantities, with `speed` their largest rate.
    passed : float or ndarray, shape (n,)
        Time between them [s].
    speed : ndarray, shape (n,)
        Largest velocities of the joints [rad/s].
    slack : float or ndarray, shape (n,)
        Tolerance [rad].

    Notes
    -----
    The servos' law compiles it (jit); nodes that compile nothing use it as it is.
    """
    return ~(np.abs(q - before) <= speed * np.maximum(passed, 0.0) + slack)


def named_angles(limits: JointLimits | RobotModel, angles: Array, which: Mask) -> str:
    """Return the joints `which` (n,) by name, each with its angle of `angles` (n,): ``l_knee_y by 1.5 rad, ...``."""
    return ", ".join(f"{limits.joint_names[i]} by {angles[i]:.3g} rad" for i in np.flatnonzero(which))


def clamp_velocity(u: Array, q: Array, limits: JointLimits | RobotModel, dt: float) -> Array:
    """Return `u` within the velocity limits, and such that no joint leaves its range within `dt`.

    A joint outside its range may move back or stay, but not further out. Commands of this package's controllers are
    within these limits already.

    Parameters
    ----------
    u : ndarray, shape (n,)
        Commanded velocities [rad/s], finite.
    q : ndarray, shape (n,)
        [rad]
    dt : float
        Duration of the motion [s].
    """
    if dt <= 0.0:
        return np.zeros_like(u)
    high = np.minimum(np.maximum((limits.q_max - q) / dt, 0.0), limits.velocity_max)
    low = np.maximum(np.minimum((limits.q_min - q) / dt, 0.0), -limits.velocity_max)
    return np.clip(u, low, high)


def clamp_effort(effort: Array, limits: JointLimits | RobotModel) -> Array:
    """Return the torques (n,) [N m] within the effort limits of the joints."""
    return np.clip(effort, -limits.effort_max, limits.effort_max)
