"""The file of a robot description, of what a user gives: also a folder, an archive, or a web address."""

from __future__ import annotations

import pathlib
import re
import tarfile
import zipfile

from dqwalk_ros.adopt.mjcf import is_mjcf
from dqwalk_ros.support.errors import ModelError

_KINDS = ("*.urdf", "*.urdf.xacro", "*.xacro", "*.xml")
"""Names of robot descriptions, the most likely first; parts that others include are named like these as well."""
_INCLUDED = re.compile(r"<(?:xacro:)?include\s[^>]*?file(?:name)?\s*=\s*[\"'][^\"']*?([^/\"']+)[\"']")
"""An element that includes a file, in xacro and in MJCF; the name of the file."""
_CONVERT = "convert it to URDF or MJCF"
_OTHERS = (
    (rb"(<\?xml[^>]*>\s*)?(<!--.*?-->\s*)*<sdf\b", "an SDF", f"{_CONVERT} (sdformat-mjcf on PyPI does)"),
    (rb"#usda|PXR-USDC", "a USD scene", f"{_CONVERT} (nvidia-srl-usd-to-urdf on PyPI does)"),
    (rb"#VRML", "VRML, as the files of Webots and OpenHRP", f"{_CONVERT} (Webots exports a URDF)"),
    (rb"format:\s*ChoreonoidBody", "a body of Choreonoid", f"{_CONVERT} (most of these robots have a URDF as well)"),
    (rb"\s*<(!DOCTYPE\s+)?(html|HTML)\b", "a web page", "download the file that it shows (raw), and its meshes"),
)
"""How files of other formats begin, what they are, and what to do."""
_SHOWN = 8
"""Largest number of files in a message."""
_BEGIN = 4096
"""Number of bytes in which the format of a file shows."""
_ADDRESS = re.compile(r"(https?|git|ssh):/|git@")


def description_in(path: pathlib.Path) -> pathlib.Path:
    """Return the robot description at `path`: this file, or the only one of its kind in a folder.

    Files that others of this kind include are parts of a description.

    Raises
    ------
    ModelError
        If a folder holds no description or several, or if it is an archive, a web address, or of another format.
    """
    if path.is_dir():
        for kind in _KINDS:
            found = _without_parts(
                sorted(file for file in path.rglob(kind) if file.is_file() and (kind != "*.xml" or is_mjcf(file)))
            )
            if len(found) == 1:
                return found[0]
            if found:
                names = ", ".join(map(str, found[:_SHOWN])) + (", ..." if len(found) > _SHOWN else "")
                raise ModelError(f"'{path}' is a folder with {len(found)} robot descriptions; give one: {names}")
        raise ModelError(f"'{path}' is a folder without a robot description: no URDF, xacro or MJCF")
    if path.is_file() and (zipfile.is_zipfile(path) or tarfile.is_tarfile(path)):
        raise ModelError(f"'{path}' is an archive: unpack it, and give the robot description in it")
    if path.is_file():
        with path.open("rb") as file:
            begin = file.read(_BEGIN)
        for begins, what, cure in _OTHERS:
            if re.match(begins, begin, re.DOTALL):
                raise ModelError(f"'{path}' is {what}, which is not read: {cure}")
    if not path.exists() and _ADDRESS.match(str(path)):
        raise ModelError(
            f"'{path}' is a web address: download the robot description with its meshes, and give its file"
        )
    return path


def _without_parts(files: list[pathlib.Path]) -> list[pathlib.Path]:
    """Return the files that no other includes; all of them if each is included."""
    parts = {name for file in files for name in _included(file) - {file.name}}
    return [file for file in files if file.name not in parts] or files


def part_of(path: pathlib.Path) -> str:
    """Return which files in the folder of this one, or above it, include it, as the end of a message; empty if none."""
    near = [file for folder in (path.parent, path.parent.parent) for kind in _KINDS for file in folder.glob(kind)]
    found = dict.fromkeys(file for file in near if file.is_file() and path.name in _included(file) - {file.name})
    names = ", ".join(str(file) for file in [*found][:_SHOWN])
    return f"; is it only a part of {names}, which includes it?" if found else ""


def _included(file: pathlib.Path) -> set[str]:
    """Return the names of the files that a file includes."""
    return set(_INCLUDED.findall(file.read_text(errors="replace")))
