"""Links, joints and surfaces of a robot in the zero posture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.robot.shapes import Shapes
from dqwalk_ros.robot.urdf import Urdf, moves, pose_at
from dqwalk_ros.support.arrays import Array


@dataclass(frozen=True)
class Entry:
    """A value of the robot or of its configuration."""

    what: str
    """Name of a quantity, or of a parameter such as ``gait.step_length``."""
    value: Any
    source: str
    """How the value was found or why it was chosen; written as a comment beside a parameter."""
    confidence: str = "sure"
    """``sure``, ``likely``, ``guess``, or ``default`` for a value that does not depend on the robot."""


class Skeleton:
    """Links, joints and surfaces of a robot in the zero posture.

    Parameters
    ----------
    urdf : Urdf
    shapes : Shapes
        The shapes of its links.
    turn : ndarray, shape (3, 3), optional
        Rotation from the axes of the root link to the axes of all poses and points.
    angles : dict of str to float, optional
        Angles of joints that are not at zero [rad].

    Attributes
    ----------
    turn : ndarray, shape (3, 3)
    joints : dict of str to Joint
        Revolute joints that move independently of others.
    chain : dict of str to tuple of str
        The joints between the root and a link.
    bodies : dict of str to list of str
        Links that are rigidly connected, by the last joint that moves them; ``""`` for those of the root.
    """

    def __init__(
        self, urdf: Urdf, shapes: Shapes, turn: Array | None = None, angles: Mapping[str, float] | None = None
    ) -> None:
        self.urdf, self._shapes = urdf, shapes
        self.turn = np.eye(3) if turn is None else turn
        coupled = _coupled(urdf)
        self.joints = {
            joint.name: joint
            for joint in urdf.joints.values()
            if joint.type in ("revolute", "continuous") and not joint.mimic and joint.name not in coupled
        }
        self._pose = {urdf.root: DQ.from_matrix(self.turn)}
        self.chain: dict[str, tuple[str, ...]] = {urdf.root: ()}
        self.bodies: dict[str, list[str]] = {"": [urdf.root]}
        waiting = [urdf.root]
        for link in waiting:
            for joint in urdf.child_joints(link):
                angle = min(max(0.0, joint.limit.lower), joint.limit.upper) if moves(joint) else 0.0
                angle = (angles or {}).get(joint.name, angle)
                self._pose[joint.child] = self._pose[link] * pose_at(joint, angle)
                chain = self.chain[link] + ((joint.name,) if joint.name in self.joints else ())
                self.chain[joint.child] = chain
                self.bodies.setdefault(chain[-1] if chain else "", []).append(joint.child)
                waiting.append(joint.child)

    def turned(self, turn: Array) -> Skeleton:
        """Return the skeleton with the rotation `turn` (3, 3) from the axes of the root link."""
        return Skeleton(self.urdf, self._shapes, turn)

    def posed(self, angles: Mapping[str, float]) -> Skeleton:
        """Return the skeleton with some joints at `angles` [rad]."""
        return Skeleton(self.urdf, self._shapes, self.turn, angles)

    def pose(self, link: str) -> DQ:
        """Return the pose of a link."""
        return self._pose[link]

    def place(self, joint: str) -> Array:
        """Return the position of a joint, shape (3,) [m]."""
        return self._pose[self.joints[joint].child].translation()

    def axis(self, joint: str) -> Array:
        """Return the axis of a joint, shape (3,)."""
        return self._pose[self.joints[joint].child].Ad(DQ(self.joints[joint].axis)).vec3()

    def lines(self, joints: Sequence[str]) -> tuple[Array, Array]:
        """Return a point [m] and the unit vector of the axis of each joint, both of shape (k, 3)."""
        return np.array([self.place(joint) for joint in joints]), np.array([self.axis(joint) for joint in joints])

    def body(self, link: str) -> str:
        """Return the body of a link: the last joint that moves it."""
        return self.chain[link][-1] if self.chain[link] else ""

    def way(self, body: str) -> tuple[str, ...]:
        """Return the joints from the root to a body, including the joint of the body."""
        return self.chain[self.bodies[body][0]]

    def mass(self, body: str) -> float:
        """Return the mass of a body [kg]."""
        return float(sum(self.urdf.links[link].inertial.mass for link in self.bodies[body]))

    def heaviest(self, body: str) -> str:
        """Return the heaviest link of a body; the first one if all masses are equal."""
        return max(self.bodies[body], key=lambda link: self.urdf.links[link].inertial.mass)

    def com(self, bodies: Sequence[str]) -> Array:
        """Return the centre of mass of some bodies, shape (3,) [m]."""
        links = [(name, self.urdf.links[name].inertial) for body in bodies for name in self.bodies[body]]
        total = sum(inertial.mass for _, inertial in links)
        parts = [part.mass * self._pose[name].transform_point(part.origin[:3, 3]) for name, part in links]
        return sum(parts, np.zeros(3)) / total if total else np.zeros(3)

    def points(self, links: Sequence[str], which: str = "") -> tuple[Array | None, str]:
        """Return points (N, 3) [m] of some links, and whether of their ``collisions`` or else of their ``visuals``."""
        hulls, which = self._shapes.hulls(links, which)
        found = [self.pose(link).transform_point(corners) for link, corners in hulls.items()]
        return (np.concatenate(found) if found else None), which

    def lacking(self, links: Sequence[str] | None = None) -> str:
        """Return text for messages that names a mesh of some links that cannot be read; empty if all can."""
        missing = self._shapes.missing if links is None else self._shapes.unread(links)
        return f" (mesh '{next(iter(missing))}' {next(iter(missing.values()))})" if missing else ""

    def complete(self, feet: Sequence[Sequence[str]]) -> tuple[str, dict[str, str]]:
        """Return which shapes of the links of some feet can all be read; see `Shapes.complete`."""
        return self._shapes.complete(feet)


def _coupled(urdf: Urdf) -> set[str]:
    """Return the joints that another limb mimics, which cannot move independently of it."""
    joints = urdf.joints.values()
    carrier = {joint.child: joint for joint in joints}

    def above(link: str) -> set[str]:
        joint = carrier.get(link)
        return set() if joint is None else {joint.name} | above(joint.parent)

    moving = [above(joint.parent) for joint in joints if moves(joint) and not joint.mimic]
    return {
        joint.mimic.joint
        for joint in joints
        if joint.mimic and joint.mimic.joint not in above(joint.child) and sum(joint.name in way for way in moving) > 1
    }
