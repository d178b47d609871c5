"""The robot as a tree of rigid bodies, read from a URDF [Urban2020, section 3.4].

A `RobotModel` knows the joints that move, the masses they carry and where the soles are; joints that are locked
are rigid, joints that are dropped are cut off with all they carry. Nothing here is specific to one robot.
"""

from __future__ import annotations

import enum
import fnmatch
import pathlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import RobotConfig, find_share
from dqwalk_ros.description import MAX_BYTES, checked
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import ConfigError, ModelError
from dqwalk_ros.parsed import Joint, Link, Robot, parse

__all__ = ["Body", "Foot", "Frame", "RobotModel", "Sole", "find_urdf", "load_model"]

Array = NDArray[np.float64]


class Foot(enum.Enum):
    """One of the two feet."""

    LEFT = "left"
    RIGHT = "right"

    @property
    def other(self) -> Foot:
        """The other foot."""
        return Foot.RIGHT if self is Foot.LEFT else Foot.LEFT


@dataclass(frozen=True)
class Sole:
    """A rectangular sole; all points in the frame of its link, x forward, z up, ground at z = 0.

    Attributes
    ----------
    frame : str
        The URDF link.
    center : ndarray, shape (3,)
        Centre of the rectangle [m].
    length, width : float
        Along x and y [m].
    """

    frame: str
    center: Array
    length: float
    width: float

    @property
    def tip(self) -> Array:
        """Middle of the front edge, shape (3,) [m]."""
        tip: Array = self.center + np.array([0.5 * self.length, 0.0, 0.0])
        return tip

    @property
    def heel(self) -> Array:
        """Middle of the rear edge, shape (3,) [m]."""
        return self.center - [0.5 * self.length, 0.0, 0.0]

    @property
    def corners(self) -> Array:
        """The four corners, counter-clockwise from the front left, shape (4, 3) [m]."""
        half = 0.5 * np.array([self.length, self.width, 0.0])
        return self.center + half * [[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]


@dataclass(frozen=True)
class Body:
    """A rigid body: one link with everything locked or fixed to it.

    Attributes
    ----------
    parent : int
        Index of the parent body, -1 for the root.
    joint : int
        Index of the joint that moves it, -1 for the root.
    origin : ndarray, shape (8,)
        Pose of the joint in the parent body.
    axis : ndarray, shape (3,)
        Unit vector of the joint in its own frame, which is the body's.
    mass : float
        [kg]
    com : ndarray, shape (3,)
        Centre of mass in the body's frame [m].
    """

    parent: int
    joint: int
    origin: Array
    axis: Array
    mass: float
    com: Array


@dataclass(frozen=True)
class Frame:
    """A place on a body: the body's index and the pose (8,) in its frame."""

    body: int
    pose: Array


@dataclass(frozen=True)
class RobotModel:
    """A biped; make one with `load_model`.

    Attributes
    ----------
    name : str
    joint_names : tuple of str
        The joints that move, parents before children.
    q_min, q_max, velocity_max, effort_max : ndarray, shape (n,)
        Limits [rad, rad/s, N m].
    bodies : tuple of Body
        Parents before children; body 0 is the root.
    frames : mapping of str to Frame
        Every link of the URDF that is left.
    soles : mapping of Foot to Sole
    pelvis : str
        Frame whose height (11) watches.
    urdf : str
        The text of the robot description.
    """

    name: str
    joint_names: tuple[str, ...]
    q_min: Array
    q_max: Array
    velocity_max: Array
    effort_max: Array
    bodies: tuple[Body, ...]
    frames: Mapping[str, Frame]
    soles: Mapping[Foot, Sole]
    pelvis: str
    urdf: str = field(repr=False)

    def __reduce__(self) -> tuple[Any, ...]:
        """Let it be sent to another process; views of mappings cannot be."""
        return _sent, (vars(self) | {"frames": dict(self.frames), "soles": dict(self.soles)},)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def root(self) -> str:
        """The root link of the URDF, which floats."""
        return next(iter(self.frames))

    @property
    def mass(self) -> float:
        """Total mass M of (4) [kg]."""
        return sum(body.mass for body in self.bodies)


def _sent(values: dict[str, Any]) -> RobotModel:
    views = {name: MappingProxyType(values[name]) for name in ("frames", "soles")}
    return RobotModel(**(values | views))


def find_urdf(urdf: str) -> pathlib.Path:
    """Return the path of a URDF: itself, or one shipped in urdf/.

    Raises
    ------
    ModelError
        If there is no such file.
    """
    path = pathlib.Path(urdf)
    if path.is_file():
        return path
    try:
        return find_share("urdf", urdf)
    except ConfigError as error:
        raise ModelError(str(error)) from error


def load_model(config: RobotConfig) -> RobotModel:
    """Read the robot that `config` describes.

    Raises
    ------
    ModelError
        If the URDF cannot be read or lacks a link or joint that `config` names; the message names it.
    """
    path = find_urdf(config.urdf)
    robot, text = _parse(path)
    links = {link.name: link for link in robot.links}
    joints = {joint.name: joint for joint in robot.joints}
    dropped = _matching(config.drop, joints, "robot.drop", path)
    locked = _matching(config.lock, joints, "robot.lock", path)

    children: dict[str, list[Joint]] = {}
    for joint in robot.joints:
        children.setdefault(joint.parent, []).append(joint)
    roots = set(links) - {joint.child for joint in robot.joints}
    tree = _Tree(path)
    tree.add_root(links[roots.pop()])
    stack = [(joint, 0, _IDENTITY) for joint in reversed(children.get(next(iter(tree.frames)), []))]
    while stack:
        joint, body, pose = stack.pop()  # of the joint's parent link: its body, and its pose there
        if joint.name in dropped:
            continue
        origin = pose * _pose(joint.origin)
        if joint.type == "fixed" or joint.name in locked:
            tree.attach(links[joint.child], body, origin)
            after = body, origin
        else:
            after = tree.add(links[joint.child], body, origin, joint), _IDENTITY
        stack += [(child, *after) for child in reversed(children.get(joint.child, []))]
    return tree.model(robot.name, config, links, text)


_IDENTITY = DQ(1.0)


def _parse(path: pathlib.Path) -> tuple[Robot, str]:
    """Return the robot of a file, and its text, both from the same bytes."""
    try:
        with path.open("rb") as file:
            data = checked(file.read(MAX_BYTES + 1), str(path))
    except OSError as error:
        raise ModelError(f"cannot read '{path}': {error.strerror}") from error
    return parse(data, str(path)), data.decode("utf-8")


def _matching(patterns: Sequence[str], joints: Mapping[str, Joint], key: str, path: pathlib.Path) -> set[str]:
    found: set[str] = set()
    for pattern in patterns:
        hits = fnmatch.filter(joints, pattern)
        if not hits:
            raise ModelError(f"{path}: {key} names '{pattern}', and there is no such joint; it has {', '.join(joints)}")
        found.update(hits)
    return found


def _pose(matrix: Array) -> DQ:
    return DQ.from_matrix(matrix[:3, :3], matrix[:3, 3])


class _Tree:
    """Collects bodies while the URDF is walked from the root."""

    def __init__(self, path: pathlib.Path) -> None:
        self.path = path
        self.bodies: list[dict[str, Any]] = []
        self.frames: dict[str, Frame] = {}
        self.joints: list[Joint] = []

    def add_root(self, link: Link) -> None:
        root = {"parent": -1, "joint": -1, "origin": _IDENTITY.vec8(), "axis": np.zeros(3), "parts": []}
        self.bodies.append(root)
        self.attach(link, 0, _IDENTITY)

    def add(self, link: Link, parent: int, origin: DQ, joint: Joint) -> int:
        if joint.type not in ("revolute", "continuous"):
            raise ModelError(
                f"{self.path}: joint '{joint.name}' is {joint.type}; lock or drop it, only revolute ones move"
            )
        if joint.mimic:
            raise ModelError(f"{self.path}: joint '{joint.name}' mimics '{joint.mimic}'; lock or drop it")
        length = np.linalg.norm(joint.axis)
        if not np.isclose(length, 1.0, atol=1e-3):
            raise ModelError(f"{self.path}: joint '{joint.name}' has the axis {joint.axis}, not a unit vector")
        axis = joint.axis / length
        body = {"parent": parent, "joint": len(self.joints), "origin": origin.vec8(), "axis": axis, "parts": []}
        self.bodies.append(body)
        self.joints.append(joint)
        self.attach(link, len(self.bodies) - 1, _IDENTITY)
        return len(self.bodies) - 1

    def attach(self, link: Link, body: int, pose: DQ) -> None:
        self.frames[link.name] = Frame(body, pose.vec8())
        if link.mass:
            self.bodies[body]["parts"].append((link.mass, pose.transform_point(link.com)))

    def model(self, name: str, config: RobotConfig, links: Mapping[str, Link], urdf: str) -> RobotModel:
        for key in ("pelvis", "left_sole", "right_sole"):
            link = getattr(config, key)
            if link not in self.frames:
                raise ModelError(f"{self.path}: robot.{key} names the link '{link}', which is not there or was dropped")
        bodies = []
        for entry in self.bodies:
            parts = entry.pop("parts")
            mass = sum(m for m, _ in parts)
            com = sum((m * c for m, c in parts), np.zeros(3)) / mass if mass else np.zeros(3)
            bodies.append(Body(mass=mass, com=com, **entry))
        if not sum(body.mass for body in bodies) > 0.0:
            raise ModelError(f"{self.path}: the robot has no mass, so it has no centre of mass")
        feet = {Foot.LEFT: config.left_sole, Foot.RIGHT: config.right_sole}
        return RobotModel(
            name=name,
            joint_names=tuple(joint.name for joint in self.joints),
            q_min=np.array([self._limit(joint, "lower", -np.pi) for joint in self.joints]),
            q_max=np.array([self._limit(joint, "upper", np.pi) for joint in self.joints]),
            velocity_max=np.array([self._limit(joint, "velocity", np.inf) for joint in self.joints]),
            effort_max=np.array([self._limit(joint, "effort", np.inf) for joint in self.joints]),
            bodies=tuple(bodies),
            frames=MappingProxyType(self.frames),
            soles=MappingProxyType({foot: self._sole(config, links[name], bodies) for foot, name in feet.items()}),
            pelvis=config.pelvis,
            urdf=urdf,
        )

    def _limit(self, joint: Joint, what: str, default: float) -> float:
        value = joint.limits.get(what)
        if value is None or (joint.type == "continuous" and what in ("lower", "upper")):
            return default
        if not np.isfinite(value):
            raise ModelError(f"{self.path}: joint '{joint.name}' has the {what} limit {value}")
        return value

    def _sole(self, config: RobotConfig, link: Link, bodies: Sequence[Body]) -> Sole:
        frame = self.frames[link.name]
        center = np.zeros(3)
        length, width = config.sole_length, config.sole_width
        if not (length and width):
            if not link.boxes:
                raise ModelError(
                    f"{self.path}: link '{link.name}' has no collision box; give robot.sole_length and sole_width"
                )
            length, width = length or float(link.boxes[0].size[0]), width or float(link.boxes[0].size[1])
        if link.boxes:
            center[:2] = link.boxes[0].origin[:2, 3]
        if config.sole_center == "foot_com":
            center[:2] = DQ(frame.pose).conj().transform_point(bodies[frame.body].com)[:2]
        return Sole(link.name, center, length, width)
