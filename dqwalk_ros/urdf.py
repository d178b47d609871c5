"""A robot description (URDF): read, checked, repaired, and cut down to the joints that move.

The file is somebody else's. What every ROS tool accepts is accepted here; what a model of rigid bodies needs beyond that
is repaired and listed (`Urdf.repairs`); what nobody could guess is refused, with the element and its line. The file is
never changed, meshes are never opened, and the text that the model is made of (`Urdf.text`) is the one that physics and
dynamics get.

The reader is the standard library's: importing yourdfpy takes over a second, and it knows no lines.
"""

from __future__ import annotations

import fnmatch
import math
import os
import pathlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.errors import ModelError

__all__ = ["Joint", "Link", "Shape", "Urdf", "find_package_file", "without_shapes"]

Array = NDArray[np.float64]
Rgba = tuple[float, float, float, float]

_MOST_BYTES = 32 << 20
_DEEPEST = 64
"""Elements within elements; a URDF has six."""
_LARGEST = 1e6
"""No length [m], mass [kg] or inertia [kg m^2] of a robot is beyond this; a limit beyond it is no limit."""
_GREY: Rgba = (0.7, 0.72, 0.75, 1.0)
_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_LEAST_MASS = 1e-3
"""What a body that moves weighs at least [kg]."""
_GYRATION = 0.01
"""Radius of gyration of a body whose inertia is not known [m]."""
_ROUNDING = 1e-3
"""Relative: inertias are printed with few digits, and those of thin plates meet the triangle inequality exactly."""


@dataclass(frozen=True)
class Shape:
    """A visual or collision shape of a link.

    Attributes
    ----------
    kind : str
        ``box`` (size: x, y, z), ``cylinder`` or ``capsule`` (radius, length; along z), ``sphere`` (radius) or ``mesh``
        (size: the scale along x, y, z).
    size : tuple of float
        [m]
    origin : ndarray, shape (4, 4)
        In the frame of the link.
    color : tuple of four float
        Red, green, blue, opacity.
    mesh : str
        What the URDF calls the file.
    """

    kind: str
    size: tuple[float, ...]
    origin: Array
    color: Rgba
    mesh: str = ""


@dataclass(frozen=True)
class Link:
    """A link: mass [kg], CoM (3,) [m] and inertia (3, 3) about it [kg m^2] in the axes of the link, and its shapes."""

    name: str
    mass: float
    com: Array
    inertia: Array
    visuals: tuple[Shape, ...]
    collisions: tuple[Shape, ...]


@dataclass(frozen=True)
class Joint:
    """A joint: pose (4, 4) in the frame of the parent link, unit axis (3,) in its own, and limits.

    `lower` and `upper` [rad or m], `velocity` [rad/s or m/s] and `effort` [N m or N] are infinite where there are none.
    `mimic` is the joint that it follows, or empty: then it is at multiplier * (that one's angle) + offset.
    """

    name: str
    type: str
    parent: str
    child: str
    origin: Array
    axis: Array
    lower: float
    upper: float
    velocity: float
    effort: float
    mimic: str
    multiplier: float
    offset: float

    @property
    def moves(self) -> bool:
        """Whether it is not fixed."""
        return self.type != "fixed"


class _Element(ElementTree.Element):
    line = 0


class Urdf:
    """The robot description of a file; `cut`, `weld` and `add_frame` change what is in memory.

    Parameters
    ----------
    data : bytes
    source : str
        Its name in messages.

    Attributes
    ----------
    repairs : list of str
        What the file says that no rigid body can be, and what was taken instead.

    Raises
    ------
    ModelError
        With everything that is wrong with it, if it cannot be used; a message names the element and its line.
    """

    def __init__(self, data: bytes, source: str) -> None:
        self.source = source
        self.repairs: list[str] = []
        self._root = _parsed(data, source)
        self._wrong: list[str] = []
        self._check()
        if not self._wrong:
            self._repair()
        self._complain()

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Urdf:
        """Read a file; a xacro file is expanded by the package xacro.

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
        if path.suffix == ".xacro" or b"www.ros.org/wiki/xacro" in data[:4000] or b"ros.org/xacro" in data[:4000]:
            data = _expanded(path)
        return cls(data, str(path))

    @property
    def name(self) -> str:
        """Name of the robot."""
        return self._root.get("name") or pathlib.Path(self.source).stem

    @property
    def root(self) -> str:
        """The link that no joint carries."""
        carried = {_end(joint, "child") for joint in self._root.findall("joint")}
        return next(name for name in map(_name, self._root.findall("link")) if name not in carried)

    @property
    def links(self) -> dict[str, Link]:
        """Every link by its name."""
        colors = {_name(m): _rgba(m, {}) for m in self._root.findall("material")}
        return {_name(element): _link(element, colors) for element in self._root.findall("link")}

    @property
    def joints(self) -> dict[str, Joint]:
        """Every joint by its name."""
        return {_name(element): _joint(element) for element in self._root.findall("joint")}

    def text(self) -> str:
        """Return it as it is now, as a URDF."""
        return ElementTree.tostring(self._root, encoding="unicode")

    # ------------------------------------------------------------------ changes

    def matching(self, patterns: Sequence[str], key: str, *, strict: bool = True) -> list[str]:
        """Return the joints that some of `patterns` match, '*' being any text.

        Raises
        ------
        ModelError
            If one matches no joint and `strict` is set; `key` is the parameter that the message names.
        """
        names = [_name(joint) for joint in self._root.findall("joint")]
        found: dict[str, None] = {}
        for pattern in patterns:
            hits = fnmatch.filter(names, pattern)
            if strict and not hits:
                raise ModelError(
                    f"{self.source}: {key} names '{pattern}', and there is no such joint; it has {', '.join(names)}"
                )
            found.update(dict.fromkeys(hits))
        return list(found)

    def cut(self, joints: Sequence[str]) -> None:
        """Remove joints together with all they carry."""
        gone = set()
        elements = {_name(joint): joint for joint in self._root.findall("joint")}
        waiting = [elements[name] for name in joints]
        while waiting:
            joint = waiting.pop()
            if _name(joint) not in gone:
                gone.add(_name(joint))
                child = _end(joint, "child")
                self._root.remove(joint)
                self._root.remove(next(link for link in self._root.findall("link") if _name(link) == child))
                waiting += [other for other in elements.values() if _end(other, "parent") == child]

    def weld(self, angles: Mapping[str, float]) -> None:
        """Fix joints at angles [rad] (slides: [m]); one outside its limits is fixed at the nearest limit."""
        for element in self._root.findall("joint"):
            name = _name(element)
            joint = _joint(element)
            if name not in angles or not joint.moves:
                continue
            angle = min(max(angles[name], joint.lower), joint.upper)
            if angle != angles[name]:
                self.repairs.append(f"joint '{name}' is locked at {angle:g}: {angles[name]:g} is beyond its limits")
            for child in list(element):
                if child.tag not in ("parent", "child", "origin"):
                    element.remove(child)
            element.set("type", "fixed")
            if angle:
                _set_origin(element, joint.origin @ _motion(joint, angle))

    def add_frame(self, name: str, parent: str, xyz: Sequence[float], rpy: Sequence[float]) -> None:
        """Add a link without mass, fixed to another at an offset [m] and roll, pitch, yaw [rad].

        Raises
        ------
        ModelError
            If there is no link `parent`.
        """
        known = {_name(link) for link in self._root.findall("link")}
        if parent not in known:
            raise ModelError(f"{self.source}: there is no link '{parent}'")
        if name in known:
            return
        ElementTree.SubElement(self._root, "link", name=name)
        joint = ElementTree.SubElement(self._root, "joint", name=f"{name}_joint", type="fixed")
        ElementTree.SubElement(joint, "parent", link=parent)
        ElementTree.SubElement(joint, "child", link=name)
        ElementTree.SubElement(joint, "origin", xyz=_words(xyz), rpy=_words(rpy))

    def give_mass(self) -> None:
        """Give mass to every body that moves and has none: no engine moves a body without inertia."""
        links, joints = self.links, self.joints
        fixed: dict[str, list[str]] = {}
        for joint in joints.values():
            if not joint.moves:
                fixed.setdefault(joint.parent, []).append(joint.child)
        elements = {_name(link): link for link in self._root.findall("link")}
        for joint in joints.values():
            if joint.moves:
                body = [joint.child]
                for name in body:
                    body += fixed.get(name, [])
                if not sum(links[name].mass for name in body) > 0.0:
                    self.repairs.append(
                        f"link '{joint.child}' moves and has no mass: {1e3 * _LEAST_MASS:g} g are assumed"
                    )
                    for old in elements[joint.child].findall("inertial"):
                        elements[joint.child].remove(old)
                    inertial = ElementTree.SubElement(elements[joint.child], "inertial")
                    ElementTree.SubElement(inertial, "mass", value=repr(_LEAST_MASS))
                    _set_inertia(inertial, np.eye(3) * _LEAST_MASS * _GYRATION**2)

    def map_meshes(self, rename: Callable[[str], str]) -> None:
        """Replace the file name of every mesh."""
        for mesh in self._root.iter("mesh"):
            mesh.set("filename", rename(mesh.get("filename", "")))

    # ------------------------------------------------------------------ what is wrong

    def _note(self, element: ElementTree.Element, what: str) -> None:
        self._wrong.append(f"{self._place(element)} {what}")

    def _place(self, element: ElementTree.Element) -> str:
        name = element.get("name")
        line = getattr(element, "line", 0)
        return f"{f'line {line}: ' if line else ''}<{element.tag}>" + (f" '{name[:80]}'" if name else "")

    def _complain(self) -> None:
        if self._wrong:
            shown = self._wrong[:8] + [f"and {len(self._wrong) - 8} more"] * (len(self._wrong) > 8)
            raise ModelError(f"{self.source}, " + "; ".join(shown))

    def _check(self) -> None:
        root = self._root
        if root.tag != "robot":
            raise ModelError(f"{self.source}, {self._place(root)}: not a URDF, whose root is <robot>")
        if not root.findall("link"):
            raise ModelError(f"{self.source}: not a URDF: it has no links")
        for tag in ("link", "joint"):
            seen: dict[str, ElementTree.Element] = {}
            for element in root.findall(tag):
                name = element.get("name")
                if not name:
                    self._note(element, "has no name")
                elif name in seen:
                    self._note(element, f"has the name of the one in line {getattr(seen[name], 'line', 0)}")
                else:
                    seen[name] = element
        self._complain()
        self._check_tree()
        self._complain()
        for element in (*root.findall("link"), *root.findall("joint")):
            try:
                _link(element, {}) if element.tag == "link" else _joint(element)
            except _Unreadable as error:
                self._note(error.element, f"of {element.tag} '{_name(element)[:80]}' {error}")

    def _check_tree(self) -> None:
        known = {_name(link): link for link in self._root.findall("link")}
        parent: dict[str, str] = {}
        for joint in self._root.findall("joint"):
            if joint.get("type") not in _TYPES:
                self._note(joint, f"has the type {joint.get('type')!r:.80}; a joint is one of {', '.join(_TYPES)}")
            ends = {end: _end(joint, end) for end in ("parent", "child")}
            for end, name in ends.items():
                if not name:
                    self._note(joint, f'must have one <{end} link="..."/>')
                elif name not in known:
                    self._note(joint, f"names the {end} '{name[:80]}', and there is no such link")
            if ends["child"] in parent:
                self._note(joint, f"is the second joint that carries the link '{ends['child'][:80]}'")
            parent[ends["child"]] = ends["parent"]
        roots = [name for name in known if name not in parent]
        reached = set(roots)
        children: dict[str, list[str]] = {}
        for child, carrier in parent.items():
            children.setdefault(carrier, []).append(child)
        waiting = list(roots)
        while waiting:
            found = children.get(waiting.pop(), [])
            reached.update(found)
            waiting += found
        loop = [name for name in known if name not in reached]
        if loop:
            self._note(known[loop[0]], "is part of a loop of joints")
        elif len(roots) != 1:
            self._wrong.append(f"a robot has one root link, this has {len(roots)}: {', '.join(sorted(roots)[:5])}")

    # ------------------------------------------------------------------ repairs

    def _repair(self) -> None:
        links = {_name(link): link for link in self._root.findall("link")}
        for link in links.values():
            self._repair_inertial(link)
        for joint in self._root.findall("joint"):
            self._repair_joint(joint)
        self._repair_root(links)
        if not self._root.get("name"):
            self._root.set("name", self.name)

    def _repair_inertial(self, link: ElementTree.Element) -> None:
        inertial = link.find("inertial")
        if inertial is None:
            return
        body, where = _link(link, {}), self._place(link)
        if not body.mass > 1e-9:
            link.remove(inertial)
            self.repairs.append(f"{where} has the mass {body.mass:g} kg: taken as a frame without mass")
            return
        moments, axes = np.linalg.eigh(body.inertia)
        a, b, c = moments
        if a > 0.0 and a + b >= c * (1.0 - _ROUNDING):
            return
        if c <= 0.0:
            moments = np.full(3, body.mass * _GYRATION**2)
        else:
            b = max(b, 1e-3 * c)
            moments = np.array([max(a, 1e-3 * c, c - b), b, c])
        _set_inertia(inertial, axes @ np.diag(moments) @ axes.T)
        origin = inertial.find("origin")
        if origin is not None:
            origin.set("rpy", "0 0 0")  # what is written is in the axes of the link
        self.repairs.append(
            f"{where} has principal moments of {a:.2g}, {b:.2g}, {c:.2g} kg m^2, which no body has: "
            f"{', '.join(f'{x:.2g}' for x in sorted(moments))} are assumed"
        )

    def _repair_joint(self, element: ElementTree.Element) -> None:
        kind, where = element.get("type", ""), self._place(element)
        if kind in ("floating", "planar"):
            element.set("type", "fixed")
            self.repairs.append(f"{where} is {kind}: taken as fixed")
            return
        if kind == "fixed":
            return
        joint = _joint(element)
        limit = element.find("limit")
        if kind in ("revolute", "prismatic"):
            if limit is None:
                self.repairs.append(f"{where} has no <limit>: it moves without one")
            elif joint.lower > joint.upper:
                limit.set("lower", repr(joint.upper))
                limit.set("upper", repr(joint.lower))
                self.repairs.append(f"{where} has lower {joint.lower:g} above upper {joint.upper:g}: exchanged")
            elif joint.lower == joint.upper:
                self.repairs.append(f"{where} has no range, lower and upper are {joint.lower:g}: fixed there")
                self.weld({joint.name: joint.lower})
                return
        for what in ("effort", "velocity"):
            if limit is not None and limit.get(what) is not None and not _float(limit, what) > 0.0:
                del limit.attrib[what]
                self.repairs.append(f"{where} has the {what} limit 0: taken as none")
        axis = element.find("axis")
        length = 1.0 if axis is None else float(np.linalg.norm(_floats(axis, "xyz", 3)))
        if axis is not None and abs(length - 1.0) > 1e-3:
            self.repairs.append(f"{where} has an axis of length {length:g}: made a unit vector")
        if axis is not None and length != 1.0:
            axis.set("xyz", _words(joint.axis))

    def _repair_root(self, links: Mapping[str, ElementTree.Element]) -> None:
        """Remove a root called world: it is no part of the robot, and engines take it for the ground."""
        name = self.root
        carried = [joint for joint in self._root.findall("joint") if _end(joint, "parent") == name]
        link = links[name]
        if name == "world" and len(carried) == 1 and not len(link) and carried[0].get("type") == "fixed":
            self._root.remove(link)
            self._root.remove(carried[0])
            self.repairs.append("link 'world' is no part of the robot: removed, the robot floats")


def without_shapes(text: str) -> str:
    """Return a URDF of links, joints and masses only, for engines that need no shapes or bring their own."""
    root = ElementTree.fromstring(text)
    for link in root.findall("link"):
        for element in (*link.findall("visual"), *link.findall("collision")):
            link.remove(element)
    for element in list(root):
        if element.tag not in ("link", "joint"):
            root.remove(element)
    return ElementTree.tostring(root, encoding="unicode")


# ---------------------------------------------------------------------- files


def _parsed(data: bytes, source: str) -> ElementTree.Element:
    """Return the elements of a file, each with its line."""
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
    except (expat.ExpatError, AssertionError, ValueError, LookupError) as error:
        raise ModelError(f"{source}: not XML: {error}") from error


def _expanded(path: pathlib.Path) -> bytes:
    try:
        import xacro
    except ImportError as error:
        raise ModelError(
            f"'{path}' is a xacro file: pip install xacro, or expand it (xacro {path.name} > robot.urdf)"
        ) from error
    found = xacro.substitution_args
    known = found._eval_find
    found._eval_find = lambda package: str(_package(package, path)) if _package(package, path) else known(package)
    try:
        return str(xacro.process_file(str(path)).toxml()).encode()
    except Exception as error:  # xacro has many of its own, and lets those of XML and of Python pass
        raise ModelError(f"xacro refuses '{path}': {' '.join(str(error).split())[:300]}") from error
    finally:
        found._eval_find = known


def _package(name: str, near: pathlib.Path) -> pathlib.Path | None:
    """Return the folder of a ROS package: an installed one, or a folder of that name around the file `near`."""
    prefixes = [p for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    places = [pathlib.Path(p) / "share" / name for p in prefixes]
    for folder in near.resolve().parents:
        places += [folder] if folder.name == name else []
        places += [folder / name]
    extra = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    places += [pathlib.Path(p) / name for p in extra if p]
    return next((place for place in places if place.is_dir()), None)


def find_package_file(uri: str, near: str | os.PathLike[str]) -> pathlib.Path | None:
    """Return the file that a URDF names, or None.

    Parameters
    ----------
    uri : str
        ``package://PACKAGE/...``, ``file://...``, or a path, which is relative to the URDF.
    near : path
        The URDF. A package is an installed one, or a folder of that name around the URDF.
    """
    near = pathlib.Path(near)
    scheme, separator, rest = uri.partition("://")
    if not separator:
        places = [near.parent / uri]
    elif scheme in ("package", "model"):
        package, _, inside = rest.partition("/")
        folder = _package(package, near)
        places = [folder / inside] if folder else []
        # a package that was copied under another name
        places += [above / inside for above in near.resolve().parents[:4]]
    else:
        places = [pathlib.Path(rest)]
    return next((place for place in places if _is_file(place)), None)


def _is_file(place: pathlib.Path) -> bool:
    """Tell whether there is a regular file."""
    try:
        return place.is_file()
    except (OSError, ValueError):
        return False


# ---------------------------------------------------------------------- elements


class _Unreadable(Exception):
    def __init__(self, element: ElementTree.Element, what: str) -> None:
        super().__init__(what)
        self.element = element


def _name(element: ElementTree.Element) -> str:
    return element.get("name", "")


def _end(joint: ElementTree.Element, end: str) -> str:
    found = joint.findall(end)
    return found[0].get("link", "") if len(found) == 1 else ""


def _link(element: ElementTree.Element, colors: Mapping[str, Rgba]) -> Link:
    inertial = element.find("inertial")
    mass, com, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
    if inertial is not None:
        weight = inertial.find("mass")
        mass = 0.0 if weight is None else _float(weight, "value")
        if mass < 0.0:
            raise _Unreadable(inertial, f"has a negative mass, {mass:g} kg")
        origin = _origin(inertial)
        com = origin[:3, 3]
        moments = inertial.find("inertia")
        if moments is not None:
            keys = ("xx", "xy", "xz", "yy", "yz", "zz")
            xx, xy, xz, yy, yz, zz = (_float(moments, f"i{key}", 0.0) for key in keys)
            R = origin[:3, :3]
            inertia = R @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ R.T
    visuals, collisions = (
        tuple(shape for part in element.findall(tag) if (shape := _shape(part, colors)) is not None)
        for tag in ("visual", "collision")
    )
    return Link(_name(element), mass, com, inertia, visuals, collisions)


def _shape(part: ElementTree.Element, colors: Mapping[str, Rgba]) -> Shape | None:
    geometry = part.find("geometry")
    keys = {"box": ("size",), "cylinder": ("radius", "length"), "capsule": ("radius", "length"), "sphere": ("radius",)}
    for shape in geometry if geometry is not None else ():
        origin, color = _origin(part), _rgba(part.find("material"), colors)
        if shape.tag == "mesh":
            scale = shape.get("scale", "1 1 1").split()
            sizes = _floats(shape, "scale", 3) if len(scale) == 3 else [_float(shape, "scale", 1.0)] * 3
            return Shape("mesh", tuple(sizes), origin, color, shape.get("filename", ""))
        if shape.tag in keys:
            size = tuple(x for key in keys[shape.tag] for x in _floats(shape, key, 3 if key == "size" else 1))
            if not all(x >= 0.0 for x in size):
                raise _Unreadable(shape, "has a negative size")
            return Shape(shape.tag, size, origin, color)
    return None


def _rgba(material: ElementTree.Element | None, named: Mapping[str, Rgba]) -> Rgba:
    color = material.find("color") if material is not None else None
    if color is None:
        return named.get(_name(material), _GREY) if material is not None else _GREY
    try:
        r, g, b, a = _floats(color, "rgba", 4)
    except _Unreadable:
        return _GREY
    return r, g, b, a


def _joint(element: ElementTree.Element) -> Joint:
    limit, kind = element.find("limit"), element.get("type", "")
    bounds = {"lower": -math.inf, "upper": math.inf, "velocity": math.inf, "effort": math.inf}
    if limit is not None:
        for key in bounds:
            if key in ("velocity", "effort") or kind not in ("continuous", "fixed"):
                absent = 0.0 if key in ("lower", "upper") else math.inf
                value = _float(limit, key, absent, unbounded=True)
                bounds[key] = abs(value) if key in ("velocity", "effort") else value
    mimic, axis = element.find("mimic"), element.find("axis")
    vector = np.array([1.0, 0.0, 0.0]) if axis is None else np.array(_floats(axis, "xyz", 3))
    length = float(np.linalg.norm(vector))
    if not length > 1e-6:
        if kind not in ("fixed", "floating") and axis is not None:
            raise _Unreadable(axis, "has no direction")
        vector, length = np.array([1.0, 0.0, 0.0]), 1.0
    return Joint(
        name=_name(element),
        type=kind,
        parent=_end(element, "parent"),
        child=_end(element, "child"),
        origin=_origin(element),
        axis=vector / length,
        mimic=mimic.get("joint", "") if mimic is not None else "",
        multiplier=_float(mimic, "multiplier", 1.0) if mimic is not None else 1.0,
        offset=_float(mimic, "offset", 0.0) if mimic is not None else 0.0,
        **bounds,
    )


def _origin(element: ElementTree.Element) -> Array:
    """Return the pose (4, 4) of an element: its angles turn about the fixed axes x, y, z one after the other."""
    pose = np.eye(4)
    origin = element.find("origin")
    if origin is not None:
        pose[:3, 3] = _floats(origin, "xyz", 3, "0 0 0")
        roll, pitch, yaw = _floats(origin, "rpy", 3, "0 0 0")
        pose[:3, :3] = _about([0, 0, 1], yaw) @ _about([0, 1, 0], pitch) @ _about([1, 0, 0], roll)
    return pose


def _motion(joint: Joint, angle: float) -> Array:
    pose = np.eye(4)
    if joint.type == "prismatic":
        pose[:3, 3] = angle * joint.axis
    else:
        pose[:3, :3] = _about(joint.axis, angle)
    return pose


def _about(axis: Sequence[float] | Array, angle: float) -> Array:
    """Return the rotation (3, 3) about a unit vector [Rodrigues]."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    R: Array = np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * K @ K
    return R


def _set_origin(element: ElementTree.Element, pose: Array) -> None:
    origin = element.find("origin")
    if origin is None:
        origin = ElementTree.SubElement(element, "origin")
    R = pose[:3, :3]
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    if math.hypot(R[0, 0], R[1, 0]) > 1e-9:
        roll, yaw = math.atan2(R[2, 1], R[2, 2]), math.atan2(R[1, 0], R[0, 0])
    else:
        roll, yaw = math.atan2(-R[1, 2], R[1, 1]), 0.0
    origin.set("xyz", _words(pose[:3, 3]))
    origin.set("rpy", _words([roll, pitch, yaw]))


def _set_inertia(inertial: ElementTree.Element, inertia: Array) -> None:
    for old in inertial.findall("inertia"):
        inertial.remove(old)
    values = {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(inertia[i, j])) for i in range(3) for j in range(i, 3)}
    ElementTree.SubElement(inertial, "inertia", values)


def _words(numbers: Sequence[float] | Array) -> str:
    return " ".join(repr(float(x)) for x in numbers)


def _float(element: ElementTree.Element, key: str, absent: float | None = None, *, unbounded: bool = False) -> float:
    word = element.get(key)
    if (word is None or not word.strip()) and absent is not None:
        return absent
    return _number(element, key, (word or "").strip(), unbounded)


def _floats(element: ElementTree.Element, key: str, count: int, absent: str | None = None) -> list[float]:
    words = (element.get(key) or absent or "").split()
    if len(words) != count:
        raise _Unreadable(element, f'must have {count} numbers in {key}="...", got {element.get(key, "")[:80]!r}')
    return [_number(element, key, word, False) for word in words]


def _number(element: ElementTree.Element, key: str, word: str, unbounded: bool) -> float:
    try:
        value = math.nan if "_" in word else float(word)
    except ValueError:
        value = math.nan
    if unbounded and abs(value) > _LARGEST:
        return math.copysign(math.inf, value)
    if not abs(value) <= _LARGEST:
        raise _Unreadable(element, f"has {key} = '{word[:80]}', which is no number that a robot has")
    return value
