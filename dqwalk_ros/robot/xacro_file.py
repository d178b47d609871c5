"""Expansion of xacro files by the Python package xacro, also where a part of what they refer to is missing."""

from __future__ import annotations

import io
import os
import pathlib
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple
from xml.dom import minidom

from dqwalk_ros.robot.packages import decoded, find_package_file, is_file, package_folder
from dqwalk_ros.support.errors import ModelError

_OLD = "property", "macro", "include", "if", "unless", "insert_block"
"""Elements that xacro knew without its prefix before ROS Kinetic, as it did calls of macros."""
_ARGUMENT = re.compile(r"\$\(arg\s+(\w+)\s*\)")
"""The name of an argument that a xacro file uses."""
_UNDEFINED = re.compile(r"Undefined substitution argument (\w+)")
"""The error of xacro for an argument that has no value."""
_UNKNOWN = "/package-that-is-not-found/"
"""Begin of the folder of a package that is not found: a file of it may be near under another name of the package."""


class Expansion(NamedTuple):
    """The URDF of a xacro file, files that it includes and that are left out, and arguments that are taken as false."""

    text: bytes
    lost: list[str]
    assumed: list[str]


def expanded(
    path: pathlib.Path, places: Sequence[str | os.PathLike[str]] = (), arguments: Mapping[str, str] | None = None
) -> Expansion:
    """Return the URDF of a xacro file; `arguments` are the values of its xacro arguments.

    Files that it includes and that are not found are left out: they often have only colours, plugins of a simulator, or
    transmissions. An argument without a value that only conditions use, such as DEBUG of a launch file, is false. ROS
    packages are also searched in the folders `places`, first. Files for old versions of xacro are read.

    Raises
    ------
    ModelError
        If the Python package xacro is not installed, the file needs a ROS package that is not found, or xacro reports
        an error.
    """
    try:
        import xacro
        from xacro import substitution_args
    except ImportError as error:
        raise ModelError(
            f"'{path}' is a xacro file: pip install xacro, or expand it (xacro {path.name} > robot.urdf)"
        ) from error
    originals = substitution_args._eval_find, xacro.parse
    reader, given = _Reader(path, places, xacro.parse), dict(arguments or {})
    substitution_args._eval_find, xacro.parse = reader.find, reader.parse
    try:
        while True:
            old = reader.old
            try:
                text = str(xacro.process_file(str(path), mappings=dict(given)).toxml())
            except Exception as error:
                undefined = _UNDEFINED.search(str(error))
                if undefined and undefined[1] not in given and reader.conditions.get(undefined[1]):
                    given[undefined[1]] = "false"
                elif reader.old == old:
                    raise
                continue
            if reader.old == old:  # otherwise calls of macros without prefix are known only now
                return Expansion(text.encode(), [*dict.fromkeys(reader.lost)], [*given][len(arguments or {}) :])
    except (Exception, SystemExit) as error:  # xacro raises errors of its own, of XML parsing and of Python
        if lost := reader.missing or reader.lost:
            raise ModelError(needed(path, lost[0])) from error
        why = " ".join(str(error).split())[:300]
        why += "; give it by --xacro NAME=VALUE" if "substitution argument" in why else ""
        raise ModelError(f"xacro refuses '{path}': {why}") from error
    finally:
        substitution_args._eval_find, xacro.parse = originals


def needed(path: pathlib.Path, lost: str) -> str:
    """Return the error of a xacro file that needs a package or a file of it (PACKAGE/...), or the file `lost`."""
    if not os.path.isabs(lost):
        package = lost.partition("/")[0]
        why = f"the ROS package '{package}', which is not installed: give --package-path of the folder that contains it"
    else:
        why = f"the file '{lost}', which is not there"
    return f"'{path}' needs {why}"


class _Reader:
    """Finds packages and files for xacro.

    Attributes
    ----------
    missing, lost : list of str
        Packages and included files that were not found.
    old : bool
        Whether a file has elements of xacro without prefix, as before ROS Kinetic.
    conditions : dict of str to bool
        Whether only conditions use an argument, by its name.
    """

    def __init__(self, path: pathlib.Path, places: Sequence[str | os.PathLike[str]], parse: Any) -> None:
        self._path, self._places, self._parse = path, places, parse
        self.missing, self.lost = list[str](), list[str]()
        self.old, self.conditions, self._macros = False, dict[str, bool](), set[str]()

    def find(self, package: str) -> str:
        """Return the folder of a package, for ``$(find PACKAGE)``."""
        folder = package_folder(package, self._path, self._places)
        if folder is None:
            self.missing.append(package)
        return str(folder or f"{_UNKNOWN}{package}")

    def parse(self, content: Any, filename: str | None = None) -> Any:
        """Return the document of a file, an empty one if it is not found."""
        if filename and filename.startswith(_UNKNOWN):  # its package has been renamed
            uri = f"package://{filename[len(_UNKNOWN) :]}"
            filename = str(find_package_file(uri, self._path, self._places) or filename)
        if content is None and filename and not is_file(pathlib.Path(filename)):
            self.lost.append(filename.removeprefix(_UNKNOWN))
            content = "<robot/>"
        elif content is None and filename:
            content = decoded(pathlib.Path(filename).read_bytes())
            content = content if isinstance(content, str) else io.BytesIO(content)
        document = self._parse(content, filename)
        for element in document.getElementsByTagName("*"):
            if not _in_gazebo(element):
                self._add_prefix(element)
            for name in _ARGUMENT.findall(" ".join(value for _, value in element.attributes.items())):
                condition = element.tagName in ("xacro:if", "xacro:unless")
                self.conditions[name] = condition and self.conditions.get(name, True)
        return document

    def _add_prefix(self, element: minidom.Element) -> None:
        """Give an element of an old file the prefix of xacro."""
        unusable = element.tagName == "property" and not element.getAttribute("name").isidentifier()
        if (element.tagName in _OLD and not unusable) or (self.old and element.tagName in self._macros):
            element.tagName = element.nodeName = f"xacro:{element.tagName}"
            self.old = True
        if element.tagName == "xacro:macro":
            self._macros.add(element.getAttribute("name").removeprefix("xacro:"))


def _in_gazebo(element: minidom.Node) -> bool:
    """Return whether an element is a part of what Gazebo reads, which has elements of these names as well."""
    above = element.parentNode
    return above is not None and (above.nodeName == "gazebo" or _in_gazebo(above))
