"""A robot description (URDF): reading, checks, repairs, reduction to the joints that move, and writing.

The reader accepts what every ROS tool accepts. Data that a rigid-body model needs and the file lacks, or has wrong, is
repaired and listed in `Urdf.repairs`; an error that has no obvious repair is reported with the element and its line.
The file itself is not changed, and meshes are not opened. `Urdf.text` writes the repaired and reduced links, joints,
masses and shapes, so that the physics engine, the dynamics library and the model describe the same robot.

XML is parsed by the standard library: importing yourdfpy takes over a second, and it does not report line numbers.
"""

from __future__ import annotations

import fnmatch
import math
import os
import pathlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from dqwalk_ros.paper.dual_quaternions import DQ, qmul
from dqwalk_ros.robot.packages import expanded
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ModelError

__all__ = ["Joint", "Link", "Origin", "Shape", "Urdf"]

Triple = tuple[float, float, float]
Rgba = tuple[float, float, float, float]

_MOST_BYTES = 32 << 20
_DEEPEST = 64
"""Largest depth of nested elements; a valid URDF has six."""
_LARGEST = 1e6
"""Largest length [m], mass [kg] and inertia [kg m^2] accepted; a larger joint limit counts as unlimited."""
_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_SIZES = {"box": {"size": 3}, "cylinder": {"radius": 1, "length": 1}, "sphere": {"radius": 1}}
_SIZES["capsule"] = _SIZES["cylinder"]
_LEAST_MASS = 1e-3
"""Mass assumed for a moving body without mass [kg]."""
_GYRATION = 0.01
"""Radius of gyration assumed for a body without a valid inertia [m]."""
_LEAST_MOMENT = 1e-12
"""Least moment of inertia; physics engines treat a smaller one as zero [kg m^2]."""
_ROUNDING = 1e-3
"""Relative tolerance of the triangle inequality of the moments of inertia, which files give with few digits."""


@dataclass(frozen=True)
class Origin:
    """A pose as a URDF gives it: position [m], and roll, pitch and yaw about the fixed axes x, y and z [rad]."""

    xyz: Triple = (0.0, 0.0, 0.0)
    rpy: Triple = (0.0, 0.0, 0.0)

    @property
    def pose(self) -> DQ:
        """The pose; the real part of its rotation is not negative."""
        x, y, z = DQ.rotation_about(self.rpy, np.eye(3)).vec4()
        r = qmul(z, qmul(y, x))
        return DQ.from_pose(self.xyz, r if r[0] >= 0.0 else -r)

    @classmethod
    def of(cls, pose: DQ) -> Origin:
        """Return the origin of a pose."""
        R = pose.rotation_matrix()
        cos_pitch = math.hypot(R[0, 0], R[1, 0])
        regular = cos_pitch > 1e-9  # otherwise the axes of roll and yaw coincide
        roll = math.atan2(R[2, 1], R[2, 2]) if regular else math.atan2(-R[1, 2], R[1, 1])
        yaw = math.atan2(R[1, 0], R[0, 0]) if regular else 0.0
        x, y, z = pose.translation().tolist()
        return cls((x, y, z), (roll, math.atan2(-R[2, 0], cos_pitch), yaw))


@dataclass(frozen=True)
class Shape:
    """A visual or collision shape.

    Attributes
    ----------
    kind : str
        ``box`` (size: x, y, z), ``cylinder`` or ``capsule`` (radius, length; along z), ``sphere`` (radius) or ``mesh``
        (size: the scale along x, y, z).
    size : tuple of float
        [m]
    origin : Origin
        Pose in the frame of the link.
    color : tuple of four float, or None
        Red, green, blue, opacity.
    mesh : str
        File name or URI of the mesh, as the URDF gives it.
    """

    kind: str
    size: tuple[float, ...]
    origin: Origin
    color: Rgba | None = None
    mesh: str = ""


@dataclass(frozen=True)
class Link:
    """A link: mass [kg], CoM (3,) [m], inertia (3, 3) about the CoM in the link's axes [kg m^2], and shapes."""

    name: str
    mass: float = 0.0
    com: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))
    visuals: tuple[Shape, ...] = ()
    collisions: tuple[Shape, ...] = ()


@dataclass(frozen=True)
class Joint:
    """A joint: its pose in the parent link, its unit axis (3,), and its limits.

    The limits `lower` and `upper` [rad or m], `velocity` [rad/s or m/s] and `effort` [N m or N] are infinite where the
    file has none. The position of a joint with a `mimic` is multiplier * (position of the joint `mimic`) + offset.
    """

    name: str
    type: str
    parent: str
    child: str
    origin: Origin
    axis: Array
    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    effort: float = math.inf
    mimic: str = ""
    multiplier: float = 1.0
    offset: float = 0.0

    @property
    def moves(self) -> bool:
        """Whether the joint is not fixed."""
        return self.type != "fixed"

    def at(self, angle: float) -> Origin:
        """Return the pose of the child link in the parent link at a joint position `angle` [rad or m]."""
        if not angle:
            return self.origin
        slides = self.type == "prismatic"
        return Origin.of(
            self.origin.pose * (DQ.from_pose(angle * self.axis) if slides else DQ.rotation_about(angle, self.axis))
        )


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
    links : dict of str to Link
    joints : dict of str to Joint
        Both in the order of the file.
    repairs : list of str
        Each invalid value of the file, and the value that replaces it.

    Raises
    ------
    ModelError
        If the description has errors that cannot be repaired; the message lists them with element and line.
    """

    def __init__(self, data: bytes | str, source: str) -> None:
        self.source = source
        self.repairs: list[str] = []
        root = _parsed(data.encode() if isinstance(data, str) else data, source)
        if root.tag != "robot":
            raise ModelError(f"{source}, {_place(root)}: not a URDF, whose root is <robot>")
        self.name = root.get("name") or pathlib.Path(source).stem
        read = _Reader(root, self.repairs)
        self.links, self.joints = read.links, read.joints
        if not read.wrong and not self.links:
            read.wrong.append("not a URDF: it has no links")
        if not read.wrong:
            read.wrong += _not_a_tree(self.links, self.joints, read.lines)
        if read.wrong:
            more = len(read.wrong) - 8
            raise ModelError(f"{source}, " + "; ".join([*read.wrong[:8], *([f"and {more} more"] if more > 0 else [])]))
        self._remove_world()

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Urdf:
        """Read a URDF file, or a xacro file, which the Python package xacro expands.

        Raises
        ------
        ModelError
            If it cannot be read.
        """
        path = pathlib.Path(path)
        try:
            with path.open("rb") as file:
                data = file.read(_MOST_BYTES + 1)
        except OSError as error:
            raise ModelError(f"cannot read '{path}': {error.strerror}") from error
        return cls(
            expanded(path) if path.suffix == ".xacro" or b"ros.org/wiki/xacro" in data[:4000] else data, str(path)
        )

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
            found += [joint.child for joint in self.child_joints(name) if not joint.moves]
        return found

    # ------------------------------------------------------------------ changes

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
            if joint.moves:
                angle = min(max(wanted, joint.lower), joint.upper)
                if angle != wanted:
                    self.repairs.append(f"joint '{name}' is locked at {angle:g}: {wanted:g} is beyond its limits")
                self.joints[name] = Joint(name, "fixed", joint.parent, joint.child, joint.at(angle), joint.axis)

    def add_frame(self, name: str, parent: str, origin: Origin) -> None:
        """Add a massless link `name` that is fixed to the link `parent` at the pose `origin`."""
        self.links[name] = Link(name)
        self.joints[f"{name}_joint"] = Joint(f"{name}_joint", "fixed", parent, name, origin, np.array([1.0, 0.0, 0.0]))

    def scale_mass(self, total: float) -> None:
        """Multiply masses and inertias by the same factor, such that the mass of all links is `total` [kg]."""
        factor = total / sum(link.mass for link in self.links.values())
        for name, link in self.links.items():
            self.links[name] = replace(link, mass=factor * link.mass, inertia=factor * link.inertia)

    def give_mass(self) -> None:
        """Assume a small mass for every moving body without mass: physics engines require one."""
        for joint in self.joints.values():
            if joint.moves and not sum(self.links[name].mass for name in self.fixed_to(joint.child)) > 0.0:
                inertia = np.eye(3) * _LEAST_MASS * _GYRATION**2
                self.links[joint.child] = replace(self.links[joint.child], mass=_LEAST_MASS, inertia=inertia)
                self.repairs.append(f"link '{joint.child}' moves and has no mass: {1e3 * _LEAST_MASS:g} g are assumed")

    def _remove_world(self) -> None:
        """Remove an empty root link named world: physics engines would fix it, and the robot with it, to the ground."""
        link, children = self.links[self.root], self.child_joints(self.root)
        empty = not (link.mass or link.visuals or link.collisions)
        if link.name == "world" and empty and len(children) == 1 and not children[0].moves:
            del self.links["world"], self.joints[children[0].name]
            self.repairs.append("link 'world' is no part of the robot: removed, the robot floats")

    # ------------------------------------------------------------------ writing

    def text(self, *, shapes: bool = True) -> str:
        """Return the URDF as a text, with or without the shapes of the links."""
        robot = ElementTree.Element("robot", name=self.name)
        for link in self.links.values():
            element = ElementTree.SubElement(robot, "link", name=link.name)
            if link.mass:
                inertial = ElementTree.SubElement(element, "inertial")
                ElementTree.SubElement(inertial, "origin", xyz=_words(link.com), rpy="0 0 0")
                ElementTree.SubElement(inertial, "mass", value=repr(float(link.mass)))
                upper = [(i, j) for i in range(3) for j in range(i, 3)]
                moments = {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(link.inertia[i, j])) for i, j in upper}
                ElementTree.SubElement(inertial, "inertia", moments)
            for tag, parts in (("visual", link.visuals), ("collision", link.collisions)):
                for shape in parts if shapes else ():
                    _write_shape(ElementTree.SubElement(element, tag), shape)
        for joint in self.joints.values():
            element = ElementTree.SubElement(robot, "joint", name=joint.name, type=joint.type)
            ElementTree.SubElement(element, "parent", link=joint.parent)
            ElementTree.SubElement(element, "child", link=joint.child)
            _write_origin(element, joint.origin)
            if joint.moves:
                ElementTree.SubElement(element, "axis", xyz=_words(joint.axis))
                given = {key: getattr(joint, key) for key in ("lower", "upper", "velocity", "effort")}
                # an absent limit is written as a large number: the default of a URDF is zero
                limit = {key: repr(min(max(float(value), -_NO_LIMIT), _NO_LIMIT)) for key, value in given.items()}
                if joint.type == "continuous":
                    del limit["lower"], limit["upper"]
                ElementTree.SubElement(element, "limit", limit)
            if joint.mimic and joint.moves:
                factors = {"multiplier": repr(joint.multiplier), "offset": repr(joint.offset)}
                ElementTree.SubElement(element, "mimic", {"joint": joint.mimic, **factors})
        ElementTree.indent(robot)
        return ElementTree.tostring(robot, encoding="unicode") + "\n"


_NO_LIMIT = 1e9
"""Number that is written for an infinite limit."""


def _write_shape(element: ElementTree.Element, shape: Shape) -> None:
    _write_origin(element, shape.origin)
    geometry = ElementTree.SubElement(element, "geometry")
    if shape.kind == "mesh":
        ElementTree.SubElement(geometry, "mesh", filename=shape.mesh, scale=_words(shape.size))
    else:
        sizes = iter(shape.size)
        words = {key: _words([next(sizes) for _ in range(count)]) for key, count in _SIZES[shape.kind].items()}
        ElementTree.SubElement(geometry, shape.kind, words)
    if element.tag == "visual" and shape.color is not None:
        material = ElementTree.SubElement(element, "material", name="rgba " + _words(shape.color))
        ElementTree.SubElement(material, "color", rgba=_words(shape.color))


def _write_origin(element: ElementTree.Element, origin: Origin) -> None:
    if any((*origin.xyz, *origin.rpy)):
        ElementTree.SubElement(element, "origin", xyz=_words(origin.xyz), rpy=_words(origin.rpy))


def _words(numbers: Sequence[float] | Array) -> str:
    return " ".join(repr(float(x)) for x in numbers)


# ---------------------------------------------------------------------- reading


class _Element(ElementTree.Element):
    """An XML element with the number of its line."""

    line = 0


class _Unreadable(Exception):
    """An error in an element that cannot be repaired."""


def _parsed(data: bytes, source: str) -> ElementTree.Element:
    """Return the root element of a file; each element has the attribute `line`."""
    if len(data) > _MOST_BYTES:
        raise ModelError(f"{source}: not a robot description: more than {_MOST_BYTES >> 20} MiB")
    builder = ElementTree.TreeBuilder(element_factory=_Element)
    parser = expat.ParserCreate()
    depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > _DEEPEST:
            raise ModelError(f"{source}, line {parser.CurrentLineNumber}: <{tag[:80]}> lies too deep for a URDF")
        element = builder.start(tag, attributes)
        element.line = parser.CurrentLineNumber  # type: ignore[attr-defined]

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def doctype(*_: object) -> None:
        raise ModelError(f"{source}, line {parser.CurrentLineNumber}: <!DOCTYPE is not allowed in a robot description")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(data, True)
        return builder.close()
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise ModelError(f"{source}: not XML: {error}") from error


class _Reader:
    """Reads links and joints; adds repairs to `repairs` and errors that cannot be repaired to `wrong`."""

    def __init__(self, root: ElementTree.Element, repairs: list[str]) -> None:
        self.wrong: list[str] = []
        self.links: dict[str, Link] = {}
        self.joints: dict[str, Joint] = {}
        self.lines: dict[str, str] = {}  # line of each link and joint
        self._repairs = repairs
        self._colors = {material.get("name", ""): _color(material, {}) for material in root.findall("material")}
        for element in (*root.findall("link"), *root.findall("joint")):
            name, known = element.get("name"), self.links if element.tag == "link" else self.joints
            if not name or name in known:
                first = self.lines.get(f"{element.tag} {name}", "").partition(":")[0]
                self.wrong.append(
                    f"{_place(element)} " + (f"has the name of the one in {first}" if name else "has no name")
                )
                continue
            self.lines[f"{element.tag} {name}"] = _place(element)
            try:
                if element.tag == "link":
                    self.links[name] = self._link(element, name)
                else:
                    self.joints[name] = self._joint(element, name)
            except _Unreadable as error:
                self.wrong.append(str(error))

    def _link(self, element: ElementTree.Element, name: str) -> Link:
        mass, com, inertia = self._inertial(element, element.find("inertial"))
        visuals, collisions = (
            tuple(shape for part in element.findall(tag) if (shape := _shape(part, self._colors)) is not None)
            for tag in ("visual", "collision")
        )
        return Link(name, mass, com, inertia, visuals, collisions)

    def _inertial(self, link: ElementTree.Element, element: ElementTree.Element | None) -> tuple[float, Array, Array]:
        """Return mass [kg], CoM (3,) [m] and inertia (3, 3) [kg m^2] of an <inertial> element."""
        given = element.find("mass") if element is not None else None
        mass = _float(given, "value") if given is not None else 0.0
        if mass < 0.0:
            raise _Unreadable(f"{_place(link)} has a negative mass, {mass:g} kg")
        if element is None or not mass > 1e-9:
            if element is not None:
                self._repairs.append(f"{_place(link)} has the mass {mass:g} kg: taken as a frame without mass")
            return 0.0, np.zeros(3), np.zeros((3, 3))
        pose = _origin(element).pose
        moments = element.find("inertia")
        keys = ("xx", "xy", "xz", "yy", "yz", "zz")
        xx, xy, xz, yy, yz, zz = (_float(moments, f"i{key}", 0.0) for key in keys)
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        (a, b, c), axes = np.linalg.eigh(inertia)
        if not (a > _LEAST_MOMENT and a + b >= c * (1.0 - _ROUNDING)):
            found = (
                [mass * _GYRATION**2] * 3
                if c < 1e3 * _LEAST_MOMENT
                else [max(a, 1e-3 * c, c - max(b, 1e-3 * c)), max(b, 1e-3 * c), c]
            )
            self._repairs.append(
                f"{_place(link)} has the principal moments {a:.2g}, {b:.2g}, {c:.2g} kg m^2, which no body has: "
                f"{', '.join(f'{x:.2g}' for x in sorted(found))} are assumed"
            )
            inertia = axes @ np.diag(found) @ axes.T
        R = pose.rotation_matrix()
        return mass, pose.translation(), R @ (0.5 * (inertia + inertia.T)) @ R.T

    def _joint(self, element: ElementTree.Element, name: str) -> Joint:
        kind, where = element.get("type", ""), _place(element)
        if kind not in _TYPES:
            raise _Unreadable(f"{where} has the type {kind!r:.80}; a joint is one of {', '.join(_TYPES)}")
        ends = {}
        for end in ("parent", "child"):
            found = element.findall(end)
            if len(found) != 1 or not found[0].get("link"):
                raise _Unreadable(f'{where} must have one <{end} link="..."/>')
            ends[end] = found[0].get("link", "")
        if kind in ("floating", "planar"):
            self._repairs.append(f"{where} is {kind}: taken as fixed")
            kind = "fixed"
        plain = Joint(name, kind, ends["parent"], ends["child"], _origin(element), np.array([1.0, 0.0, 0.0]))
        if kind == "fixed":
            return plain
        axis = element.find("axis")
        vector = np.array(_floats(axis, "xyz", 3)) if axis is not None else plain.axis
        length = float(np.linalg.norm(vector))
        if not length > 1e-6:
            raise _Unreadable(f"{where} has an axis without direction")
        if abs(length - 1.0) > 1e-3:
            self._repairs.append(f"{where} has an axis of length {length:g}: made a unit vector")
        mimic = element.find("mimic")
        joint = replace(
            plain,
            axis=vector if length == 1.0 else vector / length,
            mimic=mimic.get("joint", "") if mimic is not None else "",
            multiplier=_float(mimic, "multiplier", 1.0),
            offset=_float(mimic, "offset", 0.0),
        )
        return self._limited(joint, element.find("limit"), where)

    def _limited(self, joint: Joint, limit: ElementTree.Element | None, where: str) -> Joint:
        """Return the joint with the limits of its <limit> element."""
        ranged = joint.type != "continuous"
        if limit is None:
            if ranged:
                self._repairs.append(f"{where} has no <limit>: it moves without one")
            return joint
        highest = {what: _float(limit, what, math.inf, unbounded=True) for what in ("velocity", "effort")}
        for what, value in highest.items():
            if not value > 0.0:
                self._repairs.append(f"{where} has the {what} limit {value:g}: taken as none")
                highest[what] = math.inf
        joint = replace(joint, velocity=highest["velocity"], effort=highest["effort"])
        if not ranged:
            return joint
        if limit.get("lower") is None and limit.get("upper") is None:
            self._repairs.append(f"{where} has a <limit> without lower and upper: it moves without them")
            return joint
        lower, upper = (_float(limit, what, 0.0, unbounded=True) for what in ("lower", "upper"))
        if lower == upper:
            self._repairs.append(f"{where} has no range, lower and upper are {lower:g}: fixed there")
            return Joint(joint.name, "fixed", joint.parent, joint.child, joint.at(lower), joint.axis)
        if lower > upper:
            self._repairs.append(f"{where} has lower {lower:g} above upper {upper:g}: exchanged")
            lower, upper = upper, lower
        return replace(joint, lower=lower, upper=upper)


def _not_a_tree(links: Mapping[str, Link], joints: Mapping[str, Joint], lines: Mapping[str, str]) -> list[str]:
    """Return the errors because of which links and joints are not one tree."""
    wrong = []
    parents: dict[str, str] = {}
    for joint in joints.values():
        where = lines[f"joint {joint.name}"]
        for end, name in (("parent", joint.parent), ("child", joint.child)):
            if name not in links:
                wrong.append(f"{where} names the {end} '{name[:80]}', and there is no such link")
        if joint.child in parents:
            wrong.append(f"{where} is the second joint that carries the link '{joint.child[:80]}'")
        parents[joint.child] = joint.parent
    if wrong:
        return wrong
    roots = [name for name in links if name not in parents]
    reached = list(roots)
    for name in reached:
        reached += [child for child, parent in parents.items() if parent == name]
    loop = set(links) - set(reached)
    if loop:
        name = next(name for name in links if name in loop)
        return [f"{lines[f'link {name}']} is part of a loop of joints"]
    if len(roots) > 1:
        return [f"a robot has one root link, this has {len(roots)}: {', '.join(sorted(roots)[:5])}"]
    return []


def _place(element: ElementTree.Element) -> str:
    """Return line, tag and name of an element, for messages."""
    name = element.get("name")
    return f"line {getattr(element, 'line', 0)}: <{element.tag}>" + (f" '{name[:80]}'" if name else "")


def _shape(part: ElementTree.Element, colors: Mapping[str, Rgba | None]) -> Shape | None:
    """Return the shape of a <visual> or <collision> element; None if its geometry is missing or not known."""
    geometry = part.find("geometry")
    for shape in geometry if geometry is not None else ():
        origin, color = _origin(part), _color(part.find("material"), colors)
        if shape.tag == "mesh":
            scale = shape.get("scale", "1 1 1").split()
            sizes = _floats(shape, "scale", len(scale) if len(scale) in (1, 3) else 3, "1 1 1")
            return Shape("mesh", tuple(sizes * (3 // len(sizes))), origin, color, shape.get("filename", ""))
        if shape.tag in _SIZES:
            sizes = [x for key, count in _SIZES[shape.tag].items() for x in _floats(shape, key, count)]
            if not min(sizes) >= 0.0:
                raise _Unreadable(f"{_place(shape)} has a negative size")
            return Shape(shape.tag, tuple(sizes), origin, color)
    return None


def _color(material: ElementTree.Element | None, named: Mapping[str, Rgba | None]) -> Rgba | None:
    color = material.find("color") if material is not None else None
    if color is None:
        return named.get(material.get("name", "")) if material is not None else None
    try:
        r, g, b, a = _floats(color, "rgba", 4)
    except _Unreadable:
        return None
    return r, g, b, a


def _origin(element: ElementTree.Element) -> Origin:
    origin = element.find("origin")
    if origin is None:
        return Origin()
    (x, y, z), (roll, pitch, yaw) = (_floats(origin, key, 3, "0 0 0") for key in ("xyz", "rpy"))
    return Origin((x, y, z), (roll, pitch, yaw))


def _float(
    element: ElementTree.Element | None, key: str, absent: float | None = None, *, unbounded: bool = False
) -> float:
    """Return the number in the attribute `key`, or `absent` if there is no such element or attribute."""
    word = element.get(key, "").strip() if element is not None else ""
    if not word and absent is not None:
        return absent
    return _number(element, key, word, unbounded)


def _floats(element: ElementTree.Element, key: str, count: int, absent: str = "") -> list[float]:
    """Return the `count` numbers in the attribute `key`, or those in `absent` if there is no such attribute."""
    words = (element.get(key) or absent).split()
    if len(words) != count:
        raise _Unreadable(
            f'{_place(element)} must have {count} numbers in {key}="...", got {element.get(key, "")[:80]!r}'
        )
    return [_number(element, key, word, False) for word in words]


def _number(element: ElementTree.Element | None, key: str, word: str, unbounded: bool) -> float:
    """Return a word as a number; larger than `_LARGEST` it is infinite if `unbounded`, else an error."""
    try:
        value = math.nan if "_" in word else float(word)
    except ValueError:
        value = math.nan
    if unbounded and abs(value) > _LARGEST:
        return math.copysign(math.inf, value)
    if not abs(value) <= _LARGEST:
        where = _place(element) if element is not None else ""
        raise _Unreadable(f"{where} has {key} = '{word[:80]}', which is no number that a robot has")
    return value
