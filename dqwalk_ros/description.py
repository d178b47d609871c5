"""A robot description is somebody else's file: it is checked before anything else reads it.

`checked` knows the part of URDF that this package uses, and refuses what would make a model wrong, endless or huge:
entities, loops, several roots, limits that are none, masses and inertias that no body has. Every message names the
element and its line. Meshes are never opened.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
from lxml import etree

from dqwalk_ros.errors import ModelError

__all__ = ["MAX_BYTES", "MAX_LINKS", "checked"]

MAX_BYTES = 1 << 20
MAX_LINKS = 200

_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\Z")
_LARGEST = 1e6
"""No length [m], mass [kg] or inertia [kg m^2] of a robot is beyond this."""
_UNIT = 1e-3
"""An axis may be this far from a unit vector, as files print three digits."""
_ROUNDING = 1e-3
"""Relative: inertias are printed with few digits, and those of thin plates meet the triangle inequality exactly."""


def checked(data: bytes, source: str) -> bytes:
    """Return a URDF's bytes if they are fit to be read as a robot.

    Parameters
    ----------
    data : bytes
    source : str
        Its name in messages.

    Raises
    ------
    ModelError
        If they are not; the message names the element and the line.
    """
    try:
        _Check(source).robot(data)
    except etree.XMLSyntaxError as error:
        raise ModelError(f"{source}: not XML: {error}") from error
    return data


class _Check:
    def __init__(self, source: str) -> None:
        self._source = source

    def _bad(self, element: Any, what: str) -> ModelError:
        name = element.get("name")
        named = f" '{name[:80]}'" if name else ""
        return ModelError(f"{self._source}, line {element.sourceline}: <{element.tag}>{named} {what}")

    def robot(self, data: bytes) -> None:
        """Check a whole file."""
        if len(data) > MAX_BYTES:
            raise ModelError(
                f"{self._source}: not a robot description: {len(data)} bytes, at most {MAX_BYTES} are read"
            )
        try:
            text = data.decode("utf-8")
        except UnicodeDecodeError as error:
            raise ModelError(f"{self._source}: a robot description is text in UTF-8: {error.reason}") from error
        if match := re.search(r"<!(DOCTYPE|ENTITY)", text, re.IGNORECASE):
            line = text.count("\n", 0, match.start()) + 1
            raise ModelError(f"{self._source}, line {line}: {match[0]} is not allowed in a robot description")
        declared = re.match(r"\ufeff?\s*<\?xml[^>]*?encoding\s*=\s*['\"]([^'\"]*)", text)
        if declared and declared[1].lower() not in ("utf-8", "utf8", "us-ascii", "ascii"):
            raise ModelError(
                f"{self._source}, line 1: the encoding {declared[1]!r:.40}; a robot description is in UTF-8"
            )
        parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
        root = etree.fromstring(data, parser)
        if root.getroottree().docinfo.doctype:
            raise ModelError(f"{self._source}: a DOCTYPE is not allowed in a robot description")
        if root.tag != "robot":
            raise ModelError(f"{self._source}, line {root.sourceline}: not a URDF: <{root.tag}>, not <robot>")
        if not root.get("name"):
            raise self._bad(root, "has no name")
        links, joints = root.findall("link"), root.findall("joint")
        if not links:
            raise ModelError(f"{self._source}: not a URDF: it has no links")
        if len(links) > MAX_LINKS:
            raise self._bad(links[MAX_LINKS], f"is one too many: at most {MAX_LINKS} links are read")
        self._unique(links)
        self._unique(joints)
        for link in links:
            self._link(link)
        for joint in joints:
            self._joint(joint)
        self._tree(links, joints)

    def _unique(self, elements: list[Any]) -> None:
        seen: dict[str, Any] = {}
        for element in elements:
            name = element.get("name")
            if not name:
                raise self._bad(element, "has no name")
            if name in seen:
                raise self._bad(element, f"has the name of the one in line {seen[name].sourceline}")
            seen[name] = element

    # ------------------------------------------------------------------ the tree

    def _tree(self, links: list[Any], joints: list[Any]) -> None:
        known = {link.get("name"): link for link in links}
        parent: dict[str, str] = {}
        for joint in joints:
            for end in ("parent", "child"):
                if self._end(joint, end) not in known:
                    raise self._bad(joint, f"names the {end} '{self._end(joint, end)[:80]}', and there is no such link")
            child = self._end(joint, "child")
            if child in parent:
                raise self._bad(joint, f"is the second joint that carries the link '{child}'")
            parent[child] = self._end(joint, "parent")
        roots = [name for name in known if name not in parent]
        if len(roots) != 1:
            found = ", ".join(sorted(roots)[:5]) or "none: the joints form a loop"
            raise ModelError(f"{self._source}: a robot has one root link, this has {len(roots)}: {found}")
        for name in known:  # one root and one parent each: who does not come to the root is in a loop
            seen = set()
            while name in parent:
                if name in seen:
                    raise self._bad(known[name], "is part of a loop of joints")
                seen.add(name)
                name = parent[name]

    def _end(self, joint: Any, end: str) -> str:
        elements = joint.findall(end)
        if len(elements) != 1 or not elements[0].get("link"):
            raise self._bad(joint, f'must have one <{end} link="..."/>')
        return str(elements[0].get("link"))

    # ------------------------------------------------------------------ elements

    def _joint(self, joint: Any) -> None:
        kind = joint.get("type")
        if kind not in _TYPES:
            raise self._bad(joint, f"has the type {kind!r:.80}; a joint is one of {', '.join(_TYPES)}")
        self._pose(joint)
        limit = self._only(joint, "limit")
        if limit is not None:
            values = {
                key: self._number(limit, key) for key in ("lower", "upper", "velocity", "effort") if limit.get(key)
            }
            for key in ("velocity", "effort"):
                if values.get(key, 0.0) < 0.0:
                    raise self._bad(limit, f"of joint '{joint.get('name')}' has a negative {key}")
            if kind in ("revolute", "prismatic") and not values.get("lower", 0.0) < values.get("upper", 0.0):
                raise self._bad(
                    limit,
                    f"of joint '{joint.get('name')}' has lower {values.get('lower', 0.0):g} "
                    f"and upper {values.get('upper', 0.0):g}: lower must be less than upper",
                )
        elif kind in ("revolute", "prismatic"):
            raise self._bad(joint, "has no <limit>")
        axis = self._only(joint, "axis")
        if axis is not None:
            length = math.hypot(*self._numbers(axis, "xyz", 3))
            if kind not in ("fixed", "floating") and abs(length - 1.0) > _UNIT:
                raise self._bad(axis, f"of joint '{joint.get('name')}' has the length {length:g}, not 1")
        mimic = self._only(joint, "mimic")
        if mimic is not None:
            for key in ("multiplier", "offset"):
                if mimic.get(key) is not None:
                    self._number(mimic, key)

    def _link(self, link: Any) -> None:
        inertial = self._only(link, "inertial")
        if inertial is not None:
            self._inertial(link, inertial)
        for part in (*link.findall("visual"), *link.findall("collision")):
            self._pose(part)
            for shape in self._elements(part.find("geometry")):
                self._shape(link, shape)

    def _shape(self, link: Any, shape: Any) -> None:
        sizes: list[float] = []
        if shape.tag == "box":
            sizes = self._numbers(shape, "size", 3)
        elif shape.tag in ("cylinder", "capsule"):
            sizes = [self._number(shape, "radius"), self._number(shape, "length")]
        elif shape.tag == "sphere":
            sizes = [self._number(shape, "radius")]
        elif shape.tag == "mesh" and shape.get("scale") is not None:
            self._numbers(shape, "scale", 3)
        if not all(size > 0.0 for size in sizes):
            raise self._bad(shape, f"of link '{link.get('name')}' must have sizes above zero")

    def _inertial(self, link: Any, inertial: Any) -> None:
        self._pose(inertial)
        of = f"of link '{link.get('name')}'"
        mass = self._only(inertial, "mass")
        if mass is not None and not self._number(mass, "value") > 0.0:
            raise self._bad(mass, f"{of} must be above zero, got {mass.get('value')}")
        inertia = self._only(inertial, "inertia")
        if inertia is None:
            return
        xx, xy, xz, yy, yz, zz = (self._number(inertia, f"i{key}") for key in ("xx", "xy", "xz", "yy", "yz", "zz"))
        a, b, c = np.linalg.eigvalsh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
        if not a > 0.0:
            raise self._bad(inertia, f"{of} is not positive definite: its least principal moment is {a:.3g}")
        if not a + b >= c * (1.0 - _ROUNDING):
            raise self._bad(inertia, f"{of} is of no body: principal moments {a:.3g} + {b:.3g} < {c:.3g}")

    def _pose(self, element: Any) -> None:
        origin = self._only(element, "origin")
        if origin is not None:
            for key in ("xyz", "rpy"):
                if origin.get(key) is not None:
                    self._numbers(origin, key, 3)

    # ------------------------------------------------------------------ parts

    def _only(self, element: Any, tag: str) -> Any:
        found = element.findall(tag)
        if len(found) > 1:
            raise self._bad(element, f"has {len(found)} <{tag}>, at most one is meant")
        return found[0] if found else None

    def _elements(self, element: Any) -> Iterator[Any]:
        if element is not None:
            counts = Counter(child.tag for child in element if isinstance(child.tag, str))
            if sum(counts.values()) > 1:
                raise self._bad(element, f"has {sum(counts.values())} shapes, one is meant")
            yield from (child for child in element if isinstance(child.tag, str))

    def _number(self, element: Any, key: str) -> float:
        return self._parsed(element, key, [element.get(key, "")])[0]

    def _numbers(self, element: Any, key: str, count: int) -> list[float]:
        words = element.get(key, "").split()
        if len(words) != count:
            raise self._bad(
                element, f'must have {count} numbers in {key}="...", got {element.get(key, "nothing")[:80]!r}'
            )
        return self._parsed(element, key, words)

    def _parsed(self, element: Any, key: str, words: list[str]) -> list[float]:
        out = []
        for word in words:
            value = float(word) if _NUMBER.match(word.strip()) else math.nan
            if not abs(value) <= _LARGEST:
                raise self._bad(element, f"has {key} = '{word[:80]}', which is no number that a robot has")
            out.append(value)
        return out
