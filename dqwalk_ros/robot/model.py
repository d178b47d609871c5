"""The robot as a tree of rigid bodies, read from a URDF [Urban2020, section 3.4].

A `RobotModel` contains the joints that move, the masses of the bodies between them, and the soles. Locked joints are
fixed; dropped joints are removed with all links after them. Its attribute `urdf` describes the same reduced robot for
the physics engine and the dynamics library. Nothing in this file is specific to one robot.
"""

from __future__ import annotations

import contextlib
import fnmatch
import functools
import math
import pathlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from dqwalk_ros.config import RobotConfig, find_file
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.robot.urdf import Urdf, moves, pose_of
from dqwalk_ros.robot.urdf_file import LARGEST
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.cache import remembered
from dqwalk_ros.support.entries import numbers
from dqwalk_ros.support.errors import ConfigError, ModelError
from dqwalk_ros.support.wording import one_line

if TYPE_CHECKING:
    from yourdfpy import Joint, Link

    from dqwalk_ros.paper.geometry import ConvexPolygon

_REMEMBERED = 2**20
"""Largest description whose model is remembered [byte, characters]."""


@dataclass(frozen=True)
class Sole:
    """A rectangular sole; its points are in the frame of its link, x forward, z up, ground at z = 0."""

    frame: str
    """Name of the URDF link."""
    center: Array
    """Centre of the rectangle, shape (3,) [m]."""
    length: float
    width: float
    """Along x and y [m]."""

    @property
    def tip(self) -> Array:
        """Middle of the front edge, shape (3,) [m]."""
        tip: Array = self.center + np.array([0.5 * self.length, 0.0, 0.0])
        return tip

    @property
    def heel(self) -> Array:
        """Middle of the rear edge, shape (3,) [m]."""
        return self.center - [0.5 * self.length, 0.0, 0.0]

    @functools.cached_property
    def corners(self) -> Array:
        """The four corners, counter-clockwise from the front left, shape (4, 3) [m]."""
        half = 0.5 * np.array([self.length, self.width, 0.0])
        return self.center + half * [[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]

    @functools.cached_property
    def outline(self) -> ConvexPolygon:
        """The rectangle on the ground."""
        from dqwalk_ros.paper.geometry import ConvexPolygon  # with the compiler, which a node without a walk needs not

        return ConvexPolygon.hull(self.corners)


@dataclass(frozen=True)
class Body:
    """A rigid body: a link and all links that fixed or locked joints connect to it."""

    parent: int
    """Index of the parent body, -1 for the root."""
    joint: int
    """Index of the joint that moves it, -1 for the root."""
    origin: Array
    """Pose of the joint in the frame of the parent body, shape (8,)."""
    axis: Array
    """Unit vector of the joint axis in the joint's frame, which is also the body's frame, shape (3,)."""
    mass: float
    """[kg]"""
    com: Array
    """Centre of mass in the body's frame, shape (3,) [m]."""
    inertia: Array
    """About the centre of mass, in axes of the body's frame, shape (3, 3) [kg m^2]."""


@dataclass(frozen=True)
class Frame:
    """A frame fixed to a body: index of the body, and pose (8,) in the body's frame."""

    body: int
    pose: Array


@dataclass(frozen=True, eq=False)
class RobotModel:
    """The model of a biped; `load_model` reads it from a URDF."""

    name: str
    joint_names: tuple[str, ...]
    """Names of the n joints that move, parents before children."""
    q_min: Array
    q_max: Array
    velocity_max: Array
    effort_max: Array
    """Limits of joint angles [rad], velocities [rad/s] and torques [N m], each of shape (n,)."""
    bodies: tuple[Body, ...]
    """Parents before children; body 0 is the root."""
    frames: Mapping[str, Frame]
    """Frames of all remaining links of the URDF."""
    soles: Mapping[Foot, Sole]
    pelvis: str
    """Frame whose height (U11) bounds."""
    imu: str
    """Frame of the inertial sensor, as it is mounted."""
    imu_link: str
    """The link that its messages name."""
    urdf: str = field(repr=False)
    """URDF of the reduced robot: repaired, without dropped links, with locked joints as fixed joints."""
    repairs: tuple[str, ...] = ()
    """Each invalid value of the file, and the value that replaces it."""
    locked: Mapping[str, float] = field(default_factory=dict, repr=False)
    """Joints that are fixed instead of moving, and their angles [rad]."""

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def root(self) -> str:
        """Name of the URDF's root link, the floating base."""
        return self.links[0]

    @functools.cached_property
    def links(self) -> tuple[str, ...]:
        """Names of the links whose frames are those of the bodies."""
        first: dict[int, str] = {}
        for name, frame in self.frames.items():
            first.setdefault(frame.body, name)
        return tuple(first[body] for body in range(len(self.bodies)))

    @functools.cached_property
    def all_joints(self) -> frozenset[str]:
        """Names of all joints of the URDF, also of those that are locked."""
        return frozenset(joint.attrib["name"] for joint in ElementTree.fromstring(self.urdf).iterfind("joint"))

    @functools.cached_property
    def foot_of(self) -> dict[str, Foot]:
        """The foot of each sole, by the name of its link."""
        return {sole.frame: foot for foot, sole in self.soles.items()}

    def chain(self, body: int) -> list[int]:
        """Return the indices of the bodies from the root to `body`, both included."""
        chain = [body]
        while (body := self.bodies[body].parent) >= 0:
            chain.append(body)
        return chain[::-1]

    def joints_to_soles(self, link: str) -> tuple[int, int]:
        """Return the number of moving joints of the legs between a link and the left and the right sole.

        Joints of a waist or an arm are not counted; for a link of the body that carries both legs they are equal, also
        where a foot is the root.
        """
        left, right = (self.chain(self.frames[self.soles[foot].frame].body) for foot in (Foot.LEFT, Foot.RIGHT))
        above = set(self.chain(self.frames[link].body))
        legs = {*left} - {*right}, {*right} - {*left}
        within = [len(leg & above) for leg in legs]
        return len(legs[0]) - within[0] + within[1], len(legs[1]) - within[1] + within[0]

    def matching(self, pattern: str, key: str) -> list[int]:
        """Return the indices of the joints whose names match `pattern`, in which '*' matches any text.

        Raises
        ------
        ConfigError
            If no moving joint matches; the message names the parameter `key`.
        """
        found = [k for k, name in enumerate(self.joint_names) if fnmatch.fnmatchcase(name, pattern)]
        if not found:
            raise ConfigError(f"{key} names '{pattern}'; the joints are {', '.join(self.joint_names)}")
        return found

    def posture(self, entries: Sequence[str], key: str = "standing.posture") -> Array:
        """Return the joint angles of a posture, shape (n,) [rad]; joints without an entry are at zero.

        Parameters
        ----------
        entries : sequence of str
            JOINT=RADIANS, where '*' in JOINT matches any text.
        key : str
            Name of the parameter in error messages.

        Raises
        ------
        ConfigError
            If an entry has another form or matches no moving joint.
        """
        q = np.zeros(self.n)
        for name, angle in numbers(entries, key, "JOINT=RADIANS"):
            q[self.matching(name, key)] = angle
        return q

    @property
    def urdf_without_shapes(self) -> str:
        """`urdf` without visual and collision shapes."""
        root = ElementTree.fromstring(self.urdf)
        for link in root.iter("link"):
            for shape in [*link.iterfind("visual"), *link.iterfind("collision")]:
                link.remove(shape)
        return ElementTree.tostring(root, encoding="unicode")

    @property
    def mass(self) -> float:
        """Total mass M of (U4) [kg]."""
        return sum(body.mass for body in self.bodies)


def find_urdf(urdf: str) -> pathlib.Path:
    """Return the path of a URDF: `urdf` itself if it is a file, or the file of this name in urdf/.

    Raises
    ------
    ModelError
        If there is no such file.
    """
    if "://" in urdf or urdf.lstrip().startswith("<"):
        raise ModelError(
            f"robot.urdf is '{one_line(urdf)}'; it must be a path, such as one relative to the configuration"
        )
    try:
        return find_file("robot description", urdf, "urdf", ("poppy.urdf", "hrp2_like.urdf"))
    except ConfigError as error:
        raise ModelError(f"{error} (robot.urdf)") from error


def load_model(config: RobotConfig) -> RobotModel:
    """Read the robot that `config` describes.

    Raises
    ------
    ModelError
        If the URDF cannot be read or lacks a link or joint that `config` names; the message names it.
    """
    path = find_urdf(config.urdf)
    with contextlib.suppress(OSError):  # `Urdf.load` says why it cannot be read
        data = path.read_bytes() if path.stat().st_size <= _REMEMBERED else b"xacro"
        if b"xacro" not in data:  # which may include other files
            return _remembered(data, str(path), config, published=False)
    return _model(Urdf.load(path), config, published=False)


@functools.lru_cache(maxsize=16)
def _remembered(data: bytes | str, source: str, config: RobotConfig, *, published: bool) -> RobotModel:
    """Return the model of a description, which studies, nodes and reports ask for many times.

    It is remembered on disk, too: to import yourdfpy takes as long as everything else until a node starts.
    """
    code = [file.read_bytes() for file in sorted(pathlib.Path(__file__).parent.glob("*.py"))]
    key = repr((data, source, config, published, version("yourdfpy"))).encode()
    return remembered("models", b"".join([key, *code]), lambda: _model(Urdf(data, source), config, published=published))


def parse_model(text: str, config: RobotConfig) -> RobotModel:
    """Return the model of a URDF text that was published or recorded: of a full robot, or `RobotModel.urdf`.

    Joints that `config` drops or locks may already be removed or fixed in it.

    Raises
    ------
    ModelError
        As `load_model`.
    """
    if len(text) <= _REMEMBERED:
        return _remembered(text, "robot_description", config, published=True)
    return _model(Urdf(text, "robot_description"), config, published=True)


def _model(urdf: Urdf, config: RobotConfig, *, published: bool) -> RobotModel:
    """Return the model of a description, reduced as `config` says; see `parse_model` for `published`."""
    urdf.cut(urdf.matching(config.drop, "robot.drop", strict=not published))
    locked = urdf.weld(_locked(urdf, config, published))
    if not sum(link.inertial.mass for link in urdf.links.values()) > 0.0:
        raise ModelError(f"{urdf.source}: the robot has no mass, so it has no centre of mass")
    loads = _payload(config, urdf)
    if not loads.keys() & urdf.links.keys():  # a `RobotModel.urdf` has them already
        if config.mass > 0.0:
            urdf.scale_mass(config.mass)
        for name, (link, mass) in loads.items():
            urdf.add_mass(name, link, mass)
    urdf.give_mass()
    feet = {foot: _sole_frame(urdf, config, foot) for foot in Foot}
    imu = config.imu or config.pelvis
    named = {"pelvis": config.pelvis, "left_sole": feet[Foot.LEFT], "right_sole": feet[Foot.RIGHT], "imu": imu}
    for key, name in named.items():
        if name not in urdf.links:
            raise ModelError(f"{urdf.source}: robot.{key} names the link '{name}', which is missing or was dropped")
    tree = _tree(urdf)
    frames, mounted = tree["frames"], imu
    if any(config.imu_rpy):
        mounted, turn = f"{imu}_mounted", DQ.from_roll_pitch_yaw(config.imu_rpy)
        frames[mounted] = Frame(frames[imu].body, (DQ(frames[imu].pose) * turn).vec8())
    if len({frames[name].body for name in feet.values()}) == 1:
        raise ModelError(
            f"{urdf.source}: no joint moves the soles '{feet[Foot.LEFT]}' and '{feet[Foot.RIGHT]}' against each other; "
            "name two with robot.left_sole and robot.right_sole, and lock fewer joints"
        )
    return RobotModel(
        name=urdf.name,
        **tree,
        soles={foot: _sole(urdf, config, foot, name, tree) for foot, name in feet.items()},
        pelvis=config.pelvis,
        imu=mounted,
        imu_link=imu,
        urdf=urdf.text(),
        repairs=tuple(urdf.repairs),
        locked=locked,
    )


def _payload(config: RobotConfig, urdf: Urdf) -> dict[str, tuple[str, float]]:
    """Return the loads of ``robot.payload`` by the names of the links that represent them: link and mass [kg]."""
    loads = {}
    for link, mass in numbers(config.payload, "robot.payload", "LINK=MASS in kg"):
        if not 0.0 < mass < LARGEST:
            raise ModelError(f"robot.payload: the mass of '{link}' is {mass:g} kg")
        if link not in urdf.links:
            raise ModelError(f"{urdf.source}: robot.payload names the link '{link}', which is missing or was dropped")
        if f"{link}_payload" in loads:
            raise ModelError(f"robot.payload names the link '{link}' twice")
        loads[f"{link}_payload"] = link, mass
    return loads


def _sole_frame(urdf: Urdf, config: RobotConfig, foot: Foot) -> str:
    """Return the link of a sole, or the frame on it that the configuration describes, which is added."""
    name, xyz, rpy = (getattr(config, f"{foot.value}_sole{end}") for end in ("", "_xyz", "_rpy"))
    if name not in urdf.links or not any((*xyz, *rpy)):
        return str(name)
    placed = f"{name}_placed"
    if placed not in urdf.links:  # a `RobotModel.urdf` has it already
        urdf.add_frame(placed, name, DQ.from_roll_pitch_yaw(rpy, xyz))
    return placed


def _locked(urdf: Urdf, config: RobotConfig, published: bool) -> dict[str, float]:
    """Return the joints to be fixed, with their angles [rad]: those of ``robot.lock``, and joints with a mimic."""
    angles: dict[str, float] = {}
    at_zero = [(entry.strip(), 0.0) for entry in config.lock if "=" not in entry]
    at_angles = numbers((entry for entry in config.lock if "=" in entry), "robot.lock", "JOINT or JOINT=RADIANS")
    for pattern, angle in [*at_zero, *at_angles]:
        angles |= dict.fromkeys(urdf.matching([pattern], "robot.lock", strict=not published), angle)
    for joint in urdf.joints.values():
        led = joint.mimic
        if led and joint.name not in angles:
            angles[joint.name] = led.multiplier * angles.get(led.joint, 0.0) + led.offset
            urdf.repairs.append(f"joint '{joint.name}' mimics '{led.joint}': locked at {angles[joint.name]:g}")
    return angles


def _tree(urdf: Urdf) -> dict[str, Any]:
    """Return bodies, frames and joints of a reduced description, as arguments of `RobotModel`."""
    links = urdf.links
    moving: list[Joint] = []
    frames: dict[str, Frame] = {}
    parts: list[list[tuple[float, Array, Array]]] = [[]]  # mass, CoM, inertia about it, in axes of the body
    tree: list[tuple[int, int, DQ, Array]] = [(-1, -1, DQ(1.0), np.zeros(3))]

    def attach(link: Link, body: int, pose: DQ) -> None:
        frames[link.name] = Frame(body, pose.vec8())
        if link.inertial.mass:
            R = pose.rotation_matrix()
            inertia = R @ link.inertial.inertia @ R.T
            parts[body].append((link.inertial.mass, pose.transform_point(link.inertial.origin[:3, 3]), inertia))

    attach(links[urdf.root], 0, DQ(1.0))
    waiting = [(joint, 0, DQ(1.0)) for joint in reversed(urdf.child_joints(urdf.root))]
    while waiting:
        joint, body, pose = waiting.pop()  # body of the joint's parent link, and pose of that link in the body
        origin = pose * pose_of(joint.origin)
        if moves(joint):
            if joint.type not in ("revolute", "continuous"):
                raise ModelError(
                    f"{urdf.source}: joint '{joint.name}' is {joint.type}; lock or drop it, only revolute ones move"
                )
            tree.append((body, len(moving), origin, joint.axis))
            moving.append(joint)
            parts.append([])
            body, origin = len(tree) - 1, DQ(1.0)
        attach(links[joint.child], body, origin)
        waiting += [(child, body, origin) for child in reversed(urdf.child_joints(joint.child))]

    bodies = []
    for (parent, index, origin, axis), masses in zip(tree, parts, strict=True):
        mass = sum(m for m, _, _ in masses)
        com = sum((m * c for m, c, _ in masses), np.zeros(3)) / mass if mass else np.zeros(3)
        inertia = np.zeros((3, 3))
        for m, c, own in masses:
            arm = c - com
            inertia += own + m * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        bodies.append(Body(parent, index, origin.vec8(), axis, mass, com, inertia))
    limits = [_range(joint.limit.lower, joint.limit.upper) for joint in moving]
    return {
        "joint_names": tuple(joint.name for joint in moving),
        "q_min": np.array([lower for lower, _ in limits]),
        "q_max": np.array([upper for _, upper in limits]),
        "velocity_max": np.array([joint.limit.velocity for joint in moving]),
        "effort_max": np.array([joint.limit.effort for joint in moving]),
        "bodies": tuple(bodies),
        "frames": frames,
    }


def _range(lower: float, upper: float) -> tuple[float, float]:
    """Return finite limits [rad]: -pi and pi without limits, a range of 2 pi with only one limit."""
    if math.isinf(lower) and math.isinf(upper):
        return -math.pi, math.pi
    return (upper - math.tau if math.isinf(lower) else lower), (lower + math.tau if math.isinf(upper) else upper)


def _sole(urdf: Urdf, config: RobotConfig, foot: Foot, name: str, tree: Mapping[str, Any]) -> Sole:
    """Return the sole with the frame `name`; the default of its size is the collision box of its link."""
    link, frame = urdf.links[getattr(config, f"{foot.value}_sole")], tree["frames"][name]
    center = np.zeros(3)
    length, width = config.sole_length, config.sole_width
    box = next((shape for shape in link.collisions if shape.geometry.box is not None), None)
    if not (length and width):
        if box is None:
            raise ModelError(
                f"{urdf.source}: link '{link.name}' has no collision box; give robot.sole_length and sole_width"
            )
        length, width = length or box.geometry.box.size[0], width or box.geometry.box.size[1]
    if box is not None and name == link.name:
        center[:2] = box.origin[:2, 3]
    if config.sole_center == "foot_com":
        center[:2] = DQ(frame.pose).conj().transform_point(tree["bodies"][frame.body].com)[:2]
    return Sole(name, center, length, width)
