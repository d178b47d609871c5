"""The elements of a URDF file: bounds against hostile files, and what is wrong in which line.

A robot description may come from anywhere, and yourdfpy neither bounds a file nor names a line. `elements` refuses what
no robot has, and returns what yourdfpy reads without an error.
"""

from __future__ import annotations

import graphlib
import math
import re
from collections.abc import Iterator
from xml.etree import ElementTree
from xml.parsers import expat

from dqwalk_ros.robot.packages import POINTER, decoded
from dqwalk_ros.support.errors import ModelError
from dqwalk_ros.support.wording import kinds

MOST_BYTES = 32 << 20
_DEEPEST = 64
"""Largest depth of nested elements; a valid URDF has six."""
_LONGEST = 1 << 16
"""Largest number of characters in an attribute."""
_LONGEST_PREFACE = 4096
"""Largest number of bytes before an XML declaration."""
LARGEST = 1e6
"""Largest length [m], mass [kg] and inertia [kg m^2] accepted; a larger joint limit counts as unlimited."""
_MOST_ERRORS = 8
_COMMAS = re.compile(r"[^\s,]+(\s*,\s*[^\s,]+)+,?")
"""Numbers with a comma between each two; other commas may be those of decimals."""
_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_PARTS = {
    "robot": ("link", "joint", "material"),
    "link": ("inertial", "visual", "collision"),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry", "material"),
    "collision": ("origin", "geometry"),
    "geometry": ("box", "cylinder", "capsule", "sphere", "mesh"),
    "material": ("color",),
    "joint": ("parent", "child", "origin", "axis", "limit", "mimic"),
}
"""The elements that are read, by the element that contains them."""
_WORDS = ("name", "type", "link", "joint", "filename")
"""The attributes that are read and are no numbers."""
_NUMBERS: dict[str, dict[str, tuple[int, str | None]]] = {
    "origin": {"xyz": (3, "0 0 0"), "rpy": (3, "0 0 0")},
    "mass": {"value": (1, None)},
    "inertia": {f"i{axes}": (1, "0") for axes in ("xx", "xy", "xz", "yy", "yz", "zz")},
    "axis": {"xyz": (3, None)},
    "limit": dict.fromkeys(("lower", "upper", "velocity", "effort"), (1, "")),
    "mimic": {"multiplier": (1, "1"), "offset": (1, "0")},
    "box": {"size": (3, None)},
    "cylinder": {"radius": (1, None), "length": (1, None)},
    "capsule": {"radius": (1, None), "length": (1, None)},
    "sphere": {"radius": (1, None)},
    "mesh": {"scale": (3, "1 1 1")},
    "color": {"rgba": (4, None)},
}
"""The attributes that are numbers, with their count and default; without a default (None) they are required."""


class _Element(ElementTree.Element):
    """An XML element with the number of its line, and whether commas between numbers were left out."""

    line = 0
    commas = False


def elements(data: bytes | str, source: str) -> ElementTree.Element:
    """Return the root of a URDF: its links, joints and materials, each with an origin, without an error.

    Parameters
    ----------
    data : bytes or str
        Content of the file.
    source : str
        Name of the description in messages.

    Raises
    ------
    ModelError
        If it is no URDF or has errors; the message lists them with element and line.
    """
    root = _parsed(data, source)
    for material in root.iter("material"):
        material[:] = [color for color in material if not [*_wrong_numbers(color)]]
    for tag in ("inertial", "visual", "collision", "joint"):
        for element in root.iter(tag):
            if element.find("origin") is None:
                ElementTree.SubElement(element, "origin")
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            if shape.find("geometry/*") is None:
                link.remove(shape)
    known: dict[str, ElementTree.Element] = {}
    wrong = [error for element in root.iter() for error in _wrong(element, known)]
    if not wrong:
        root.left_out = _leave_out(root)  # type: ignore[attr-defined]
        wrong = _not_a_tree(root)
    if wrong:
        texts = kinds(wrong)
        more = [f"and {len(texts) - _MOST_ERRORS} more"] if len(texts) > _MOST_ERRORS else []
        raise ModelError(f"{source}, " + "; ".join([*texts[:_MOST_ERRORS], *more]))
    return root


def place(element: ElementTree.Element) -> str:
    """Return line, tag and name of an element, for messages."""
    name = element.get("name")
    return f"line {getattr(element, 'line', 0)}: <{element.tag}>" + (f" '{name[:80]}'" if name else "")


def _no_xml(content: bytes) -> str:
    """Return what a file is that version control has written in place of a description; empty if it is none."""
    if content.startswith(POINTER):
        return "a Git LFS pointer instead of a robot description: run 'git lfs pull' in its repository"
    if re.fullmatch(rb"[^<\s]+\.(urdf|xacro|xml|mjcf)", content):
        target = content.decode(errors="replace")
        return f"a symbolic link that was not made: it contains only '{target}'; name that file"
    return ""


def _parsed(data: bytes | str, source: str) -> ElementTree.Element:
    """Return the root element of a file, with only those elements and attributes that are read."""
    content, encoding = (data.encode(), "utf-8") if isinstance(data, str) else (data, None)
    if len(content) > MOST_BYTES:
        raise ModelError(f"{source}: not a robot description: more than {MOST_BYTES >> 20} MiB")
    content = _declared_first(content)
    if encoding is None and isinstance(text := decoded(content), str):
        content, encoding = text.encode(), "utf-8"
    parser = expat.ParserCreate(encoding)
    document = _Element("")
    stack: list[_Element | None] = [document]
    unprefixed = ""

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal unprefixed
        line, parent, element = parser.CurrentLineNumber, stack[-1], None
        where = f"{source}, line {line}: <{tag[:80]}>"
        if len(stack) > _DEEPEST:
            raise ModelError(f"{where} is nested too deeply for a URDF")
        if any(len(word) > _LONGEST for word in attributes.values()):
            raise ModelError(f"{where} has an attribute of more than {_LONGEST} characters")
        if parent is document and tag != "robot":
            raise ModelError(f"{where}: not a URDF, whose root is <robot>")
        if len(stack) == 2 and tag in ("include", "macro", "property"):
            unprefixed = unprefixed or where
        if parent is not None and tag in _PARTS.get(parent.tag, ("robot",)):
            keys = (*_WORDS, *_NUMBERS.get(tag, ()))
            element = _Element(tag, {key: word for key, word in attributes.items() if key in keys})
            element.line = line
            parent.append(element)
        stack.append(element)

    def doctype(*_: object) -> None:
        raise ModelError(f"{source}, line {parser.CurrentLineNumber}: <!DOCTYPE is not allowed in a robot description")

    parser.StartElementHandler, parser.EndElementHandler = start, lambda _: stack.pop()
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise ModelError(f"{source}: {_no_xml(content) or f'not XML: {error}'}") from error
    except (ValueError, LookupError) as error:
        raise ModelError(f"{source}: {error}; save it as UTF-8") from error
    root = document[0]
    if unprefixed and root.find("link") is None:
        raise ModelError(
            f"{unprefixed} is xacro without its prefix, which xacro no longer expands: write <xacro:include>, "
            "<xacro:macro>, <xacro:property> and so on"
        )
    return root


def _declared_first(content: bytes) -> bytes:
    """Return a file with its XML declaration first: ROS tools skip blanks and comments before it."""
    start = content.find(b"<?xml ", 0, _LONGEST_PREFACE)
    preface, end = content[: max(start, 0)], content.find(b"?>", start) + 2
    if start <= 0 or end < 2 or re.sub(b"<!--.*?-->", b"", preface, flags=re.DOTALL).strip():
        return content
    return content[start:end] + preface + content[end:]


def _wrong(element: ElementTree.Element, known: dict[str, ElementTree.Element]) -> Iterator[str]:
    """Yield what is wrong with an element; `known` holds the links and joints before it."""
    yield from _wrong_numbers(element)
    name, where = element.get("name"), place(element)
    if element.tag in ("link", "joint"):
        first = known.setdefault(f"{element.tag} {name}", element)
        if not name:
            yield f"{where} has no name"
        elif first is not element:
            yield f"{where} has the name of the one in {place(first).partition(':')[0]}"
    if element.tag == "link":
        for mass in element.findall("inertial/mass"):
            if not [*_wrong_numbers(mass)] and float(mass.get("value", "")) < 0.0:
                yield f"{where} has a negative mass, {mass.get('value')} kg"
    if element.tag == "joint":
        kind = element.get("type", "")
        if kind not in _TYPES:
            yield f"{where} has the type {kind!r:.80}; a joint is one of {', '.join(_TYPES)}"
        for end in ("parent", "child"):
            if [bool(part.get("link")) for part in element.findall(end)] != [True]:
                yield f'{where} must have one <{end} link="..."/>'
        for axis in element.findall("axis") if kind in _TYPES[:3] else ():
            if not [*_wrong_numbers(axis)] and not math.hypot(*map(float, axis.get("xyz", "").split())) > 1e-6:
                yield f"{where} has an axis without direction"


def _wrong_numbers(element: ElementTree.Element) -> Iterator[str]:
    """Yield what is wrong with the numbers of an element; missing ones are set to their default."""
    where = place(element)
    for key, (count, default) in _NUMBERS.get(element.tag, {}).items():
        text = element.get(key, "").strip() or default or ""
        element.set(key, text)
        if not text and default is not None:
            del element.attrib[key]
            continue
        words = text.split() if count > 1 else [text]
        if count > 1 and _COMMAS.fullmatch(text):
            words = text.replace(",", " ").split()
            element.set(key, " ".join(words))
            element.commas = True  # type: ignore[attr-defined]
        if len(words) != count and (element.tag, len(words)) != ("mesh", 1):
            yield f'{where} must have {count} numbers in {key}="...", got {text[:80]!r}'
        for word in words:
            try:
                value = math.nan if "_" in word else float(word)
            except ValueError:
                value = math.nan
            if math.isnan(value) or (abs(value) > LARGEST and element.tag != "limit"):
                yield f"{where} has {key} = '{word[:80]}', which is no number that a robot has"
            elif value < 0.0 and key in ("size", "radius"):
                yield f"{where} has a negative size"


def _leave_out(root: ElementTree.Element) -> list[str]:
    """Leave out joints that name a link that is not there, and parts that no joint carries; return what is said of it.

    What is left is the largest part. Nothing is left out if it has less than half of the links.
    """
    links = {link.get("name", ""): link for link in root.findall("link")}
    ends = {
        joint: {part.tag: part.get("link", "") for part in joint if part.tag in ("parent", "child")}
        for joint in root.findall("joint")
    }
    wrong = {joint: [end for end in pair.values() if end not in links] for joint, pair in ends.items()}
    parents = {pair["child"]: pair["parent"] for joint, pair in ends.items() if not wrong[joint]}
    tops = {name: name for name in links}
    for name in links:
        for _ in parents:  # as often as there are joints, if they are a loop
            tops[name] = parents.get(tops[name], tops[name])
    parts = dict.fromkeys(tops.values())
    if not any(wrong.values()) and (len(parts) < 2 or any(top in parents for top in parts)):
        return []
    kept, count = max(((top, [*tops.values()].count(top)) for top in parts), key=lambda one: one[1])
    if 2 * count <= len(links):
        return []
    for joint, pair in ends.items():
        if wrong[joint] or tops[pair["child"]] != kept:
            root.remove(joint)
    for name in [name for name, top in tops.items() if top != kept]:
        root.remove(links[name])
    more = f", with {len(links) - count} of {len(links)} links that it carries" if count < len(links) else ""
    lost = {joint: names[0] for joint, names in wrong.items() if names}
    return [
        f"{place(joint)} names '{name[:80]}', and there is no such link: left out{more}" for joint, name in lost.items()
    ] or [
        f"{place(links[top])} is carried by no joint: left out with what it carries, as the robot is '{kept[:80]}'"
        for top in parts
        if top != kept
    ]


def _not_a_tree(root: ElementTree.Element) -> list[str]:
    """Return the errors because of which links and joints are not one tree."""
    places = {link.get("name", ""): place(link) for link in root.findall("link")}
    parents: dict[str, str] = {}
    wrong = []
    for joint in root.findall("joint"):
        ends = {part.tag: part.get("link", "") for part in joint if part.tag in ("parent", "child")}
        for end, name in ends.items():
            if name not in places:
                wrong.append(f"{place(joint)} names the {end} '{name[:80]}', and there is no such link")
        if ends["child"] in parents:
            wrong.append(f"{place(joint)} is the second joint that carries the link '{ends['child'][:80]}'")
        parents[ends["child"]] = ends["parent"]
    if wrong or not places:
        return wrong or ["not a URDF: it has no links"]
    roots = [name for name in places if name not in parents]
    try:
        graphlib.TopologicalSorter({child: [parent] for child, parent in parents.items()}).prepare()
    except graphlib.CycleError as error:
        loop = error.args[1]
        return [f"{next(where for name, where in places.items() if name in loop)} is part of a loop of joints"]
    more = f"a robot has one root link, this has {len(roots)}: {', '.join(sorted(roots)[:5])}"
    return [more] if len(roots) > 1 else []
