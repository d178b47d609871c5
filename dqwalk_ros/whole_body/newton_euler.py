"""The laws of Newton and Euler summed link by link from the URDF: what H v' + h of (1) must be.

Written without pinocchio and without the package's own kinematics, to hold both to it; far too slow for a controller.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.model import RobotModel

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
    robot = ElementTree.fromstring(model.urdf)
    w = rotation @ v[3:6]
    # v is in axes that turn: its derivative in the world has w x v besides R v'
    p_dotdot = rotation @ (a[:3] + np.cross(v[3:6], v[:3])) + [0.0, 0.0, gravity]
    root = _Link(position, rotation, w, p_dotdot, rotation @ a[3:6], ())
    force = np.zeros(6 + model.n)
    for name, link in _links(robot, model, root, q, v[6:], a[6:]):
        found = _inertia(robot, name)
        if found is None:
            continue
        mass, com, axes, inertia = found
        arm = link.R @ com
        place = link.p + arm
        f = mass * (link.p_dotdot + np.cross(link.w_dot, arm) + np.cross(link.w, np.cross(link.w, arm)))
        I_world = link.R @ axes @ inertia @ axes.T @ link.R.T
        n = I_world @ link.w_dot + np.cross(link.w, I_world @ link.w)
        force[:3] += rotation.T @ f
        force[3:6] += rotation.T @ (n + np.cross(place - position, f))
        for index, axis, at in link.joints:
            force[6 + index] += axis @ (n + np.cross(place - at, f))
    return force


def _links(
    robot: ElementTree.Element, model: RobotModel, root: _Link, q: Array, dq: Array, ddq: Array
) -> Iterator[tuple[str, _Link]]:
    """Yield every link of the model in motion, the root first."""
    children: dict[str, list[ElementTree.Element]] = {}
    for joint in robot.findall("joint"):
        children.setdefault(_of(joint, "parent"), []).append(joint)
    waiting = [(model.root, root)]
    while waiting:
        name, link = waiting.pop()
        yield name, link
        for joint in children.get(name, ()):
            if _of(joint, "child") in model.frames:
                waiting.append((_of(joint, "child"), _next(link, joint, model, q, dq, ddq)))


def _next(link: _Link, joint: ElementTree.Element, model: RobotModel, q: Array, dq: Array, ddq: Array) -> _Link:
    """Return the link behind a joint."""
    offset, turned = _pose(joint.find("origin"))
    r = link.R @ offset
    R = link.R @ turned
    at = link.p + r
    p_dotdot = link.p_dotdot + np.cross(link.w_dot, r) + np.cross(link.w, np.cross(link.w, r))
    name = joint.get("name", "")
    if name not in model.joint_names:  # fixed, or locked at zero
        return _Link(at, R, link.w, p_dotdot, link.w_dot, link.joints)
    i = model.joint_names.index(name)
    element = joint.find("axis")
    axis = _numbers(element.get("xyz", "1 0 0") if element is not None else "1 0 0")
    axis = axis / np.linalg.norm(axis)
    z = R @ axis
    w_dot = link.w_dot + ddq[i] * z + np.cross(link.w, dq[i] * z)
    return _Link(at, R @ _about(axis, q[i]), link.w + dq[i] * z, p_dotdot, w_dot, (*link.joints, (i, z, at)))


def _inertia(robot: ElementTree.Element, name: str) -> tuple[float, Array, Array, Array] | None:
    """Return mass, CoM, axes and inertia of a link in its frame, None where it has no mass."""
    found = robot.find(f"link[@name='{name}']/inertial")
    mass, inertia = (found.find("mass"), found.find("inertia")) if found is not None else (None, None)
    if found is None or mass is None or inertia is None:
        return None
    com, axes = _pose(found.find("origin"))
    xx, xy, xz, yy, yz, zz = (float(inertia.get(f"i{key}", "0")) for key in ("xx", "xy", "xz", "yy", "yz", "zz"))
    return float(mass.get("value", "0")), com, axes, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _pose(origin: ElementTree.Element | None) -> tuple[Array, Array]:
    if origin is None:
        return np.zeros(3), np.eye(3)
    x, y, z = (_about(axis, angle) for axis, angle in zip(np.eye(3), _numbers(origin.get("rpy", "0 0 0")), strict=True))
    return _numbers(origin.get("xyz", "0 0 0")), z @ y @ x


def _about(axis: Array, angle: float) -> Array:
    """Return the rotation about a unit vector [Rodrigues]."""
    K = np.cross(np.eye(3), axis)
    turned: Array = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
    return turned


def _of(joint: ElementTree.Element, end: str) -> str:
    element = joint.find(end)
    return element.get("link", "") if element is not None else ""


def _numbers(text: str) -> Array:
    return np.array([float(word) for word in text.split()])
