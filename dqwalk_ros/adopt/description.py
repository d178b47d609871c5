"""The file of a robot description, of what a user gives: also a folder, an archive, or a web address."""

from __future__ import annotations

import pathlib
import re
import tarfile
import zipfile

from dqwalk_ros.adopt.mjcf import is_mjcf
from dqwalk_ros.support.errors import ModelError

__all__ = ["description_in"]


_KINDS = ("*.urdf", "*.urdf.xacro", "*.xacro", "*.xml")
"""Names of robot descriptions, the most likely first; parts that others include are named like these as well."""
_SHOWN = 8
"""Largest number of files in a message."""
_ADDRESS = re.compile(r"(https?|git|ssh):/|git@")


def description_in(path: pathlib.Path) -> pathlib.Path:
    """Return the robot description at `path`: this file, or the only one of its kind in a folder.

    Raises
    ------
    ModelError
        If a folder holds no description or several, or if it is an archive or a web address.
    """
    if path.is_dir():
        for kind in _KINDS:
            found = sorted(file for file in path.rglob(kind) if kind != "*.xml" or is_mjcf(file))
            if len(found) == 1:
                return found[0]
            if found:
                names = ", ".join(map(str, found[:_SHOWN])) + (", ..." if len(found) > _SHOWN else "")
                raise ModelError(f"'{path}' is a folder with {len(found)} robot descriptions; give one: {names}")
        raise ModelError(f"'{path}' is a folder without a robot description: no URDF, xacro or MJCF")
    if path.is_file() and (zipfile.is_zipfile(path) or tarfile.is_tarfile(path)):
        raise ModelError(f"'{path}' is an archive: unpack it, and give the robot description in it")
    if not path.exists() and _ADDRESS.match(str(path)):
        raise ModelError(
            f"'{path}' is a web address: download the robot description with its meshes, and give its file"
        )
    return path
