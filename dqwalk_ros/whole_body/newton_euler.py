"""The laws of Newton and Euler summed link by link from the URDF: what H v' + h of (1) must be.

Written without pinocchio and without the package's own kinematics, to hold both to it; far too slow for a controller.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.robot import RobotModel
from dqwalk_ros.urdf import Joint, Urdf

__all__ = ["inverse_dynamics"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Link:
    """A link in motion: its place and axes, velocity and acceleration, in the world."""

    p: Array
    R: Array
    w: Array
    p_dotdot: Array
    w_dot: Array
    joints: tuple[tuple[int, Array, Array], ...]  # index, axis and place of each joint on the way to the root


def inverse_dynamics(
    model: RobotModel, position: Array, rotation: Array, q: Array, v: Array, a: Array, gravity: float = 9.81
) -> Array:
    """Return the generalized forces H a + h of a motion, shape (6 + n,).

    Parameters
    ----------
    model : RobotModel
    position, rotation : ndarray, shapes (3,), (3, 3)
        Of the root link in the world.
    q : ndarray, shape (n,)
        [rad]
    v, a : ndarray, shape (6 + n,)
        Velocity and acceleration, of the base in its own axes first.
    gravity : float
        [m/s^2]
    """
    robot = Urdf(model.urdf, model.name)
    links = robot.links
    w = rotation @ v[3:6]
    # v is in axes that turn: its derivative in the world has w x v besides R v'
    p_dotdot = rotation @ (a[:3] + np.cross(v[3:6], v[:3])) + [0.0, 0.0, gravity]
    root = _Link(position, rotation, w, p_dotdot, rotation @ a[3:6], ())
    force = np.zeros(6 + model.n)
    for name, link in _links(robot, model, root, q, v[6:], a[6:]):
        mass = links[name].mass
        arm = link.R @ links[name].com
        place = link.p + arm
        f = mass * (link.p_dotdot + np.cross(link.w_dot, arm) + np.cross(link.w, np.cross(link.w, arm)))
        I_world = link.R @ links[name].inertia @ link.R.T
        n = I_world @ link.w_dot + np.cross(link.w, I_world @ link.w)
        force[:3] += rotation.T @ f
        force[3:6] += rotation.T @ (n + np.cross(place - position, f))
        for index, axis, at in link.joints:
            force[6 + index] += axis @ (n + np.cross(place - at, f))
    return force


def _links(robot: Urdf, model: RobotModel, root: _Link, q: Array, dq: Array, ddq: Array) -> Iterator[tuple[str, _Link]]:
    """Yield every link of the model in motion, the root first."""
    waiting = [(model.root, root)]
    while waiting:
        name, link = waiting.pop()
        yield name, link
        for joint in robot.joints.values():
            if joint.parent == name:
                waiting.append((joint.child, _next(link, joint, model, q, dq, ddq)))


def _next(link: _Link, joint: Joint, model: RobotModel, q: Array, dq: Array, ddq: Array) -> _Link:
    """Return the link behind a joint."""
    origin = joint.origin.matrix
    r = link.R @ origin[:3, 3]
    R = link.R @ origin[:3, :3]
    at = link.p + r
    p_dotdot = link.p_dotdot + np.cross(link.w_dot, r) + np.cross(link.w, np.cross(link.w, r))
    if not joint.moves:
        return _Link(at, R, link.w, p_dotdot, link.w_dot, link.joints)
    i = model.joint_names.index(joint.name)
    z = R @ joint.axis
    w_dot = link.w_dot + ddq[i] * z + np.cross(link.w, dq[i] * z)
    return _Link(at, R @ _about(joint.axis, q[i]), link.w + dq[i] * z, p_dotdot, w_dot, (*link.joints, (i, z, at)))


def _about(axis: Array, angle: float) -> Array:
    """Return the rotation about a unit vector [Rodrigues]."""
    K = np.cross(np.eye(3), axis)
    turned: Array = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
    return turned
