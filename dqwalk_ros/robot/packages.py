"""Files of other ROS packages: resolution of ``package://`` names, and expansion of xacro files that include them.

A package is searched among the installed ones, and among the folders around the file that refers to it. So a robot
description that was cloned or unpacked, also under another name, can be used without installing it.
"""

from __future__ import annotations

import codecs
import glob
import io
import os
import pathlib
import re
import urllib.parse
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple
from xml.dom import minidom

from dqwalk_ros.support.errors import ModelError

POINTER = b"version https://git-lfs"
"""Beginning of the file that Git has in place of a large one which it has not fetched."""
_EAST_ASIAN = ("gb2312", "gbk", "gb18030", "big5", "shift_jis", "euc-jp", "euc-kr")
"""Encodings of text that the XML parser does not know."""
_OLD = "property", "macro", "include", "if", "unless", "insert_block"
"""Elements that xacro knew without its prefix before ROS Kinetic, as it did macros."""
_ARGUMENT = re.compile(r"\$\(arg\s+(\w+)\s*\)")
"""The name of an argument that a xacro file uses."""
_UNDEFINED = re.compile(r"Undefined substitution argument (\w+)")
"""The error of xacro for an argument that has no value."""
_NAME = re.compile(rb"<name>\s*([^<\s]+)\s*</name>")
"""The name of a package in its package.xml."""
_ABOVE = 6
"""Number of folders above a file that are searched for what it refers to."""
_UNKNOWN = "/package-that-is-not-found/"
"""Begin of the folder of a package that is not found: a file of it may be near under another name of the package."""


def decoded(content: bytes) -> bytes | str:
    """Return the text of an XML file whose encoding the XML parser does not know or that is not the one it declares.

    Other files are returned as they are.
    """
    declared = re.match(rb"<\?xml[^>]{0,80}?encoding\s*=\s*[\"']([\w.:-]{1,40})", content)
    name = declared[1].decode().lower() if declared else ""
    if name in _EAST_ASIAN:
        return content.decode(name, "replace")
    if name in ("", "utf-8") and not content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        try:
            content.decode()
        except UnicodeDecodeError:  # a file saved on Windows, whose names and comments are in its encoding
            return content.decode("iso-8859-1")
    return content


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
    missing, lost, assumed = list[str](), list[str](), list[str]()
    old, conditions = _Old(), dict[str, bool]()  # whether an argument is only that of conditions

    def find(package: str) -> str:
        folder = _package(package, path, places)
        if folder is None:
            missing.append(package)
        return str(folder or f"{_UNKNOWN}{package}")

    def parse(content: Any, filename: str | None = None) -> Any:
        if filename and filename.startswith(_UNKNOWN):  # its package has been renamed
            filename = str(find_package_file(f"package://{filename[len(_UNKNOWN) :]}", path, places) or filename)
        if content is None and filename and not _is_file(pathlib.Path(filename)):
            lost.append(filename.removeprefix(_UNKNOWN))
            content = "<robot/>"
        elif content is None and filename:
            content = decoded(pathlib.Path(filename).read_bytes())
            content = content if isinstance(content, str) else io.BytesIO(content)
        document = originals[1](content, filename)
        old.add_prefixes(document)
        for element in document.getElementsByTagName("*"):
            for name in _ARGUMENT.findall(" ".join(value for _, value in element.attributes.items())):
                conditions[name] = conditions.get(name, True) and element.tagName in ("xacro:if", "xacro:unless")
        return document

    def process(given: dict[str, str]) -> str:
        missing.clear()
        lost.clear()
        assumed[:] = [name for name in given if name not in (arguments or {})]
        try:
            return str(xacro.process_file(str(path), mappings=dict(given)).toxml())
        except Exception as error:
            undefined = _UNDEFINED.search(str(error))
            if not undefined or undefined[1] in given or not conditions.get(undefined[1]):
                raise
            return process({**given, undefined[1]: "false"})

    substitution_args._eval_find, xacro.parse = find, parse
    try:
        given = dict(arguments or {})
        try:
            text = process(given)
        except Exception:
            if not old.found:
                raise
        text = process(given) if old.found else text  # calls of macros are known only now
        return Expansion(text.encode(), lost, assumed)
    except (Exception, SystemExit) as error:  # xacro raises errors of its own, of XML parsing and of Python
        if missing or lost:
            raise ModelError(needed(path, (missing or lost)[0])) from error
        why = " ".join(str(error).split())[:300]
        why += "; give it by --xacro NAME=VALUE" if "substitution argument" in why else ""
        raise ModelError(f"xacro refuses '{path}': {why}") from error
    finally:
        substitution_args._eval_find, xacro.parse = originals


class _Old:
    """Gives elements of files for an old version of xacro their prefix, and calls of macros once one was `found`."""

    def __init__(self) -> None:
        self.found = False
        self._macros = set[str]()

    def add_prefixes(self, document: minidom.Document) -> None:
        elements = [one for one in document.getElementsByTagName("*") if not _in_gazebo(one)]
        for element in elements:
            unusable = element.tagName == "property" and not element.getAttribute("name").isidentifier()
            if (element.tagName in _OLD and not unusable) or (self.found and element.tagName in self._macros):
                element.tagName = element.nodeName = f"xacro:{element.tagName}"
                self.found = True
            if element.tagName == "xacro:macro":
                self._macros.add(element.getAttribute("name").removeprefix("xacro:"))


def _in_gazebo(element: minidom.Node) -> bool:
    """Return whether an element is a part of what Gazebo reads, which has elements of these names as well."""
    above = element.parentNode
    return above is not None and (above.nodeName == "gazebo" or _in_gazebo(above))


def needed(path: pathlib.Path, lost: str) -> str:
    """Return the error of a xacro file that needs a package or a file of it (PACKAGE/...), or the file `lost`."""
    if not os.path.isabs(lost):
        package = lost.partition("/")[0]
        why = f"the ROS package '{package}', which is not installed: give --package-path of the folder that contains it"
    else:
        why = f"the file '{lost}', which is not there"
    return f"'{path}' needs {why}"


def _package(name: str, near: pathlib.Path, places: Sequence[str | os.PathLike[str]] = ()) -> pathlib.Path | None:
    """Return the folder of a ROS package: in one of `places`, an installed one, or one around the file `near`."""
    paths = {key: os.environ.get(key, "").split(os.pathsep) for key in ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH")}
    installed = [pathlib.Path(prefix) / "share" for prefix in paths["AMENT_PREFIX_PATH"] if prefix]
    around = [*near.resolve().parents]
    sources = [pathlib.Path(path) for path in paths["ROS_PACKAGE_PATH"] if path]

    def candidates() -> Iterator[pathlib.Path]:
        for place in map(pathlib.Path, places):
            yield from (place / name, place, *_inside(place))
        yield from (folder / name for folder in installed)
        for level, folder in enumerate(around):
            yield from (folder, folder / name, *(_inside(folder) if level < _ABOVE else ()))
        yield from (folder / name for folder in sources)

    return next((folder for folder in candidates() if _is_package(folder, name)), None)


def _inside(folder: pathlib.Path) -> list[pathlib.Path]:
    """Return the folders in a folder that are packages."""
    return sorted(manifest.parent for manifest in folder.glob("*/package.xml"))


def _is_package(folder: pathlib.Path, name: str) -> bool:
    """Return whether a folder is the package of that name, by its package.xml or by the folder's own name."""
    try:
        declared = _NAME.search((folder / "package.xml").read_bytes())
    except OSError:
        declared = None
    names = [folder.resolve().name, *([declared[1].decode(errors="replace")] if declared else [])]
    return name in names and folder.is_dir()


def find_package_file(
    uri: str, near: str | os.PathLike[str], places: Sequence[str | os.PathLike[str]] = ()
) -> pathlib.Path | None:
    """Return the path of a file that a URDF refers to; None if it does not exist.

    Parameters
    ----------
    uri : str
        ``package://PACKAGE/...``, ``file://...``, or a path relative to the URDF.
    near : path
        Path of the URDF. A package is an installed one, or a folder of that name around the URDF.
    places : sequence of path
        Additional folders that contain packages; they are searched first.
    """
    near = pathlib.Path(near)
    scheme, separator, rest = uri.partition("://")
    if not separator:
        rest, found = uri, [near.parent / uri]
    elif scheme in ("package", "model"):
        package, _, inside = rest.partition("/")
        folder = _package(package, near, places)
        found = [folder / inside] if folder else []
        found += [pathlib.Path(place) / inside for place in places]
    else:
        rest = urllib.parse.unquote(rest)
        found = [pathlib.Path(uri.partition("://")[2]), pathlib.Path(rest)]
    # a package that was copied under another name or in part, and the path of another machine
    parts = pathlib.PurePosixPath(rest.replace("\\", "/").lstrip("/")).parts
    tails = [pathlib.PurePosixPath(*parts[k:]) for k in range(len(parts) - 1) if ".." not in parts[k:]]
    found += [above / tail for tail in tails for above in near.resolve().parents[:_ABOVE]]
    if parts:
        tails.append(pathlib.PurePosixPath(parts[-1]))
        found += [pathlib.Path(place) / tail for place in places for tail in tails]
        # the only file of this name near the URDF, whose folders have other names
        folder, name = near.resolve().parent, glob.escape(parts[-1])
        alike = [*folder.glob(name), *folder.glob(f"*/{name}"), *folder.parent.glob(f"*/{name}")]
        found += alike if len(set(alike)) == 1 else []
    return next((place for place in found if _is_file(place)), None)


def is_pointer(file: str | os.PathLike[str]) -> bool:
    """Return whether a file is a pointer of Git LFS instead of what it is to contain."""
    with pathlib.Path(file).open("rb") as begin:
        return begin.read(len(POINTER)) == POINTER


def _is_file(place: pathlib.Path) -> bool:
    try:
        return place.is_file()
    except (OSError, ValueError):
        return False
