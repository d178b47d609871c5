"""A robot description (URDF) as yourdfpy's records: its repairs, its reduction to the joints that move, and its text.

What every ROS tool accepts is accepted. Data that a rigid-body model needs and the file lacks, or has wrong, is
repaired and listed in `Urdf.repairs`; an error that has no obvious repair is reported with the element and its line.
The file itself is not changed, and meshes are not opened. `Urdf.text` is the repaired and reduced description, so that
the physics engine, the dynamics library and the model describe the same robot.
"""

from __future__ import annotations

import fnmatch
import io
import math
import os
import pathlib
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.robot.packages import expanded
from dqwalk_ros.robot.urdf_file import LARGEST, MOST_BYTES, elements, place
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ModelError

if TYPE_CHECKING:
    from yourdfpy import Inertial, Joint, Limit, Link, Material

# yourdfpy is imported where a robot is read: it imports trimesh, which takes a second

__all__ = ["Urdf", "moves", "pose_at", "pose_of", "zero_pose"]

_XACRO = re.compile(rb"<xacro:|\$[({]")
"""What only xacro understands; exporters declare its namespace in files without any of it."""
_NO_LIMIT = 1e9
"""Number that is written for an infinite limit: the default of a URDF is zero."""
_DECIMALS = 14
"""Decimals of written angles [rad], by which a text that is read and written again is the same."""
_LEAST_MASS = 1e-3
"""Mass assumed for a moving body without mass [kg]."""
_GYRATION = 0.01
"""Radius of gyration assumed for a load, and for a body without a valid inertia [m]."""
_LEAST_MOMENT = 1e-12
"""Least moment of inertia; physics engines treat a smaller one as zero [kg m^2]."""
_TURN = 6.5
"""Angle of an origin above which it is not in radians, slightly more than a turn."""
_ROUNDING = 1e-3
"""Relative tolerance of the triangle inequality of the moments of inertia, which files give with few digits."""


class Urdf:
    """A robot description in memory.

    Parameters
    ----------
    data : bytes or str
        Content of the file.
    source : str
        Name of the description in messages.

    Attributes
    ----------
    name : str
    links : dict of str to yourdfpy.Link
        Every link has an ``inertial``: mass [kg] (zero for a frame), CoM as the translation of its ``origin`` [m], and
        inertia (3, 3) about the CoM in axes of the link [kg m^2].
    joints : dict of str to yourdfpy.Joint
        A joint that moves has a unit ``axis`` and a ``limit`` whose values are infinite where the file has none.
        Links and joints are in the order of the file; their origins are matrices (4, 4).
    repairs : list of str
        Each invalid value of the file, and the value that replaces it.

    Raises
    ------
    ModelError
        If the description has errors that cannot be repaired; the message lists them with element and line.
    """

    def __init__(self, data: bytes | str, source: str) -> None:
        import yourdfpy

        self.source = source
        self.repairs: list[str] = []
        root = elements(data, source)
        self.name = root.get("name") or pathlib.Path(source).stem
        root.set("name", self.name)
        for capsule in [*root.iter("capsule")]:
            self.repairs.append(f"{place(capsule)} is taken as a cylinder of the same extent")
            length = float(capsule.get("length", "")) + 2.0 * float(capsule.get("radius", ""))
            capsule.tag, capsule.attrib["length"] = "cylinder", repr(length)
        for element in root.iter():
            angles = [float(word) for origin in element.findall("origin") for word in origin.get("rpy", "0").split()]
            if angles and max(map(abs, angles)) > _TURN:
                self.repairs.append(f"{place(element)} has rpy = '{angles}': taken as radians; are they degrees?")
        text = io.BytesIO(ElementTree.tostring(root))
        read = yourdfpy.URDF.load(text, build_scene_graph=False, load_meshes=False)
        places = {(element.tag, element.get("name")): place(element) for element in root}
        self.links: dict[str, Link] = read.link_map
        self.joints: dict[str, Joint] = read.joint_map
        materials = {material.name: material for material in read.robot.materials}
        for link in self.links.values():
            link.inertial = self._repair_inertial(link.inertial, places["link", link.name])
            for shape in (*link.visuals, *link.collisions):
                shape.name = None
            for visual in link.visuals:
                visual.material = _material(visual.material, materials)
        ranged = [joint.limit for joint in self.joints.values() if joint.type == "revolute" and joint.limit]
        if len(ranged) > 1 and not any(limit.lower or limit.upper for limit in ranged):
            self.repairs.append(
                f"all {len(ranged)} revolute joints have the limits 0 and 0, as exporters write them: taken as none"
            )
            for limit in ranged:
                limit.lower, limit.upper = -math.inf, math.inf
        for joint in self.joints.values():
            self._repair_joint(joint, places["joint", joint.name])
        self._remove_world()

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        packages: Sequence[str | os.PathLike[str]] = (),
        arguments: Mapping[str, str] | None = None,
    ) -> Urdf:
        """Read a URDF file, or a xacro file, which the Python package xacro expands with the given `arguments`.

        ROS packages that a xacro file includes are also searched in the folders `packages`.

        Raises
        ------
        ModelError
            If it cannot be read.
        """
        path = pathlib.Path(path)
        try:
            with path.open("rb") as file:
                data = file.read(MOST_BYTES + 1)
        except OSError as error:
            raise ModelError(f"cannot read '{path}': {error.strerror}") from error
        if path.suffix == ".xacro" or (b"ros.org/wiki/xacro" in data[:4000] and _XACRO.search(data)):
            data = expanded(path, packages, arguments or {})
        elif arguments:
            raise ModelError(f"'{path}' is not a xacro file, so it has no argument '{next(iter(arguments))}'")
        return cls(data, str(path))

    @property
    def root(self) -> str:
        """The link that is not the child of a joint."""
        children = {joint.child for joint in self.joints.values()}
        return next(name for name in self.links if name not in children)

    def child_joints(self, link: str) -> list[Joint]:
        """Return the joints whose parent is `link`."""
        return [joint for joint in self.joints.values() if joint.parent == link]

    def fixed_to(self, link: str) -> list[str]:
        """Return `link` and all links after it that only fixed joints connect to it."""
        found = [link]
        for name in found:
            found += [joint.child for joint in self.child_joints(name) if not moves(joint)]
        return found

    def after(self, link: str) -> list[str]:
        """Return `link` and all links after it."""
        found = [link]
        for name in found:
            found += [joint.child for joint in self.child_joints(name)]
        return found

    def matching(self, patterns: Sequence[str], key: str, *, strict: bool = True) -> list[str]:
        """Return the names of the joints that match one of `patterns`, in which '*' matches any text.

        Raises
        ------
        ModelError
            If `strict` is set and a pattern matches no joint; the message names the parameter `key`.
        """
        found: dict[str, None] = {}
        for pattern in patterns:
            hits = fnmatch.filter(self.joints, pattern)
            if strict and not hits:
                known = ", ".join(self.joints)
                raise ModelError(f"{self.source}: {key} names '{pattern}', and there is no such joint; it has {known}")
            found.update(dict.fromkeys(hits))
        return list(found)

    # ------------------------------------------------------------------ changes

    def cut(self, joints: Sequence[str]) -> None:
        """Remove joints together with all links and joints after them."""
        waiting = [self.joints[name] for name in joints]
        while waiting:
            joint = waiting.pop()
            if self.joints.pop(joint.name, None):
                del self.links[joint.child]
                waiting += self.child_joints(joint.child)

    def weld(self, angles: Mapping[str, float]) -> None:
        """Make joints fixed at the given positions [rad or m], clipped to their limits."""
        for name, wanted in angles.items():
            joint = self.joints[name]
            if moves(joint):
                angle = min(max(wanted, joint.limit.lower), joint.limit.upper)
                if angle != wanted:
                    self.repairs.append(f"joint '{name}' is locked at {angle:g}: {wanted:g} is beyond its limits")
                _fix(joint, angle)

    def add_frame(self, name: str, parent: str, pose: DQ) -> None:
        """Add a massless link `name` that is fixed to the link `parent` at a pose."""
        import yourdfpy

        self.links[name] = yourdfpy.Link(name, _inertial())
        joint = f"{name}_joint"
        self.joints[joint] = yourdfpy.Joint(joint, "fixed", parent, name, _origin(pose))

    def add_mass(self, name: str, parent: str, mass: float) -> None:
        """Add a small body `name` of a mass [kg] at the origin of the link `parent`."""
        self.add_frame(name, parent, DQ(1.0))
        self.links[name].inertial = _inertial(mass, np.eye(3) * mass * _GYRATION**2)

    def scale_mass(self, total: float) -> None:
        """Multiply masses and inertias by the same factor, such that the mass of all links is `total` [kg]."""
        factor = total / sum(link.inertial.mass for link in self.links.values())
        for link in self.links.values():
            link.inertial.mass *= factor
            link.inertial.inertia *= factor

    def give_mass(self) -> None:
        """Assume a small mass for every moving body without mass: physics engines require one."""
        for joint in self.joints.values():
            masses = (self.links[name].inertial.mass for name in self.fixed_to(joint.child))
            if moves(joint) and not sum(masses) > 0.0:
                self.links[joint.child].inertial = _inertial(_LEAST_MASS, np.eye(3) * _LEAST_MASS * _GYRATION**2)
                self.repairs.append(f"link '{joint.child}' moves and has no mass: {1e3 * _LEAST_MASS:g} g are assumed")

    def reroot(self, link: str) -> None:
        """Make `link` the root: the joints between it and the present root are reversed, with the same angles.

        The frame of a link is that of the joint that carries it, so the links on the way get other frames.
        """
        carrier = {joint.child: joint for joint in self.joints.values()}
        way = []
        while link in carrier:
            way.append(carrier[link])
            link = carrier[link].parent
        origin = np.eye(4)  # of the reversed joint in its new parent, the link of which it carried
        for joint in way:
            parent, to_joint = self.links[joint.parent], np.linalg.inv(joint.origin)
            R, part = to_joint[:3, :3], parent.inertial
            part.origin, part.inertia = to_joint @ part.origin, R @ part.inertia @ R.T
            part.origin[:3, :3] = np.eye(3)  # inertias are in axes of the link
            for other in self.child_joints(joint.parent):
                if other is not joint:
                    other.origin = to_joint @ other.origin
            for shape in (*parent.visuals, *parent.collisions):
                shape.origin = to_joint @ (np.eye(4) if shape.origin is None else shape.origin)
            joint.origin, origin = origin, to_joint
            joint.parent, joint.child = joint.child, joint.parent
            joint.axis = None if joint.axis is None else -joint.axis

    def _remove_world(self) -> None:
        """Remove an empty root link named world: physics engines would fix it, and the robot with it, to the ground."""
        if "world" not in self.links:
            return
        link, children = self.links["world"], self.child_joints("world")
        empty = not (link.inertial.mass or link.visuals or link.collisions)
        if self.root == "world" and empty and len(children) == 1 and not moves(children[0]):
            del self.links["world"], self.joints[children[0].name]
            self.repairs.append("link 'world' is no part of the robot: removed, the robot floats")
            return
        link.name = "world_link"
        self.links = {other.name: other for other in self.links.values()}
        for joint in self.joints.values():
            joint.parent, joint.child = (link.name if end == "world" else end for end in (joint.parent, joint.child))
        self.repairs.append(
            "link 'world' is a part of the robot: renamed 'world_link', physics engines reserve the name"
        )

    # ------------------------------------------------------------------ repairs

    def _repair_inertial(self, given: Inertial | None, where: str) -> Inertial:
        """Return mass, CoM and inertia in axes of the link `where`."""
        mass = (given.mass or 0.0) if given else 0.0
        if given is None or not mass > 1e-9:
            if given:
                self.repairs.append(f"{where} has the mass {mass:g} kg: taken as a frame without mass")
            return _inertial()
        inertia = np.zeros((3, 3)) if given.inertia is None else given.inertia
        (a, b, c), axes = np.linalg.eigh(inertia)
        if not (a > _LEAST_MOMENT and a + b >= c * (1.0 - _ROUNDING)):
            found = (
                [mass * _GYRATION**2] * 3
                if c < 1e3 * _LEAST_MOMENT
                else [max(a, 1e-3 * c, c - max(b, 1e-3 * c)), max(b, 1e-3 * c), c]
            )
            self.repairs.append(
                f"{where} has the principal moments {a:.2g}, {b:.2g}, {c:.2g} kg m^2, which no body has: "
                f"{', '.join(f'{x:.2g}' for x in sorted(found))} are assumed"
            )
            inertia = axes @ np.diag(found) @ axes.T
        R = given.origin[:3, :3]
        return _inertial(mass, R @ (0.5 * (inertia + inertia.T)) @ R.T, given.origin[:3, 3])

    def _repair_joint(self, joint: Joint, where: str) -> None:
        if joint.type in ("floating", "planar"):
            self.repairs.append(f"{where} is {joint.type}: taken as fixed")
        if joint.type in ("floating", "planar", "fixed"):
            _fix(joint)
            return
        length = float(np.linalg.norm(joint.axis))
        if abs(length - 1.0) > 1e-3:
            self.repairs.append(f"{where} has an axis of length {length:g}: made a unit vector")
        joint.axis = joint.axis if length == 1.0 else joint.axis / length
        joint.mimic = joint.mimic if joint.mimic and joint.mimic.joint else None
        joint.limit = self._repair_limit(joint.limit, joint.type != "continuous", where)
        if joint.limit.lower == joint.limit.upper:
            self.repairs.append(f"{where} has no range, lower and upper are {joint.limit.lower:g}: fixed there")
            _fix(joint, joint.limit.lower)

    def _repair_limit(self, given: Limit | None, ranged: bool, where: str) -> Limit:
        """Return the limits of the joint `where`; only if it is `ranged`, it has a lower and an upper one."""
        import yourdfpy

        limit = yourdfpy.Limit(effort=math.inf, velocity=math.inf, lower=-math.inf, upper=math.inf)
        if given is None:
            if ranged:
                self.repairs.append(f"{where} has no <limit>: it moves without one")
            return limit
        for what in ("velocity", "effort"):
            value = getattr(given, what)
            if value is not None and not value > 0.0:
                self.repairs.append(f"{where} has the {what} limit {value:g}: taken as none")
            elif value is not None and value <= LARGEST:
                setattr(limit, what, value)
        if ranged and given.lower is None and given.upper is None:
            self.repairs.append(f"{where} has a <limit> without lower and upper: it moves without them")
        elif ranged:
            lower, upper = given.lower or 0.0, given.upper or 0.0
            if lower > upper:
                self.repairs.append(f"{where} has lower {lower:g} above upper {upper:g}: exchanged")
                lower, upper = upper, lower
            limit.lower = lower if abs(lower) <= LARGEST else -math.inf
            limit.upper = upper if abs(upper) <= LARGEST else math.inf
        return limit

    # ------------------------------------------------------------------ writing

    def text(self) -> str:
        """Return the URDF as a text."""
        import yourdfpy

        links = []
        for link in self.links.values():
            inertial = link.inertial if link.inertial.mass else None
            links.append(yourdfpy.Link(link.name, inertial, link.visuals, link.collisions))
        robot = yourdfpy.Robot(self.name, links, list(self.joints.values()))
        names = yourdfpy.filename_handler_null
        plain = yourdfpy.URDF(robot, build_scene_graph=False, load_meshes=False, filename_handler=names)
        root = ElementTree.fromstring(plain.write_xml_string())
        for origin in root.iter("origin"):
            angles = [round(float(word), _DECIMALS) for word in origin.get("rpy", "").split()]
            origin.set("rpy", " ".join(map(repr, angles)))
        for element, joint in zip(root.findall("joint"), robot.joints, strict=True):
            for limit in element.iter("limit"):
                limit.attrib |= {key: word.replace("inf", repr(_NO_LIMIT)) for key, word in limit.items()}
                if joint.type == "continuous":
                    del limit.attrib["lower"], limit.attrib["upper"]
            if joint.mimic is not None:  # yourdfpy does not write it
                ElementTree.SubElement(element, "mimic", {key: str(word) for key, word in vars(joint.mimic).items()})
        ElementTree.indent(root)
        return ElementTree.tostring(root, encoding="unicode") + "\n"


# ---------------------------------------------------------------------- records


def moves(joint: Joint) -> bool:
    """Return whether a joint is not fixed."""
    return bool(joint.type != "fixed")


def pose_of(origin: Array) -> DQ:
    """Return the pose of an origin, shape (4, 4)."""
    return DQ.from_matrix(origin[:3, :3], origin[:3, 3])


def pose_at(joint: Joint, angle: float) -> DQ:
    """Return the pose of the child link in the parent link at a joint position `angle` [rad or m]."""
    pose = pose_of(joint.origin)
    if not angle:
        return pose
    slides = joint.type == "prismatic"
    return pose * (DQ.from_pose(angle * joint.axis) if slides else DQ.rotation_about(angle, joint.axis))


def zero_pose(urdf: Urdf, link: str) -> DQ:
    """Return the pose of a link in the root link, with all joints at zero, or at the limit nearest to it."""
    carrier = {joint.child: joint for joint in urdf.joints.values()}
    pose = DQ(1.0)
    while link in carrier:
        joint = carrier[link]
        angle = min(max(0.0, joint.limit.lower), joint.limit.upper) if moves(joint) else 0.0
        pose, link = pose_at(joint, angle) * pose, joint.parent
    return pose


def _origin(pose: DQ) -> Array:
    """Return the origin (4, 4) of a pose, from the angles: those of its matrix are inaccurate at a pitch of 90 deg."""
    from trimesh.transformations import compose_matrix

    origin: Array = compose_matrix(  # type: ignore[no-untyped-call]
        translate=pose.translation(), angles=pose.roll_pitch_yaw()
    )
    return origin


def _inertial(
    mass: float = 0.0, inertia: Array | None = None, com: Sequence[float] | Array = (0.0, 0.0, 0.0)
) -> Inertial:
    """Return mass [kg], inertia (3, 3) [kg m^2] and CoM (3,) [m] of a link, or those of a frame."""
    import yourdfpy

    origin = np.eye(4)
    origin[:3, 3] = com
    return yourdfpy.Inertial(origin, mass, np.zeros((3, 3)) if inertia is None else inertia)


def _fix(joint: Joint, angle: float = 0.0) -> None:
    """Make a joint fixed at a position [rad or m]."""
    if angle:
        joint.origin = _origin(pose_at(joint, angle))
    joint.type, joint.axis, joint.limit, joint.mimic = "fixed", None, None, None


def _material(given: Material | None, named: Mapping[str, Material]) -> Material | None:
    """Return the color of a visual shape under a name of its own, or None if it has none."""
    import yourdfpy

    found = given if given is None or given.color else named.get(given.name)
    if found is None or not found.color:
        return None
    return yourdfpy.Material("rgba " + " ".join(map(str, found.color.rgba)), found.color)
