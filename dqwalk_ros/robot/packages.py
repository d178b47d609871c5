"""Files of other ROS packages: resolution of ``package://`` names, and expansion of xacro files that include them.

A package is searched among the installed ones, and among the folders around the file that refers to it. So a robot
description that was cloned or unpacked can be used without installing it.
"""

from __future__ import annotations

import glob
import os
import pathlib
import urllib.parse
from collections.abc import Mapping, Sequence

from dqwalk_ros.support.errors import ModelError

__all__ = ["expanded", "find_package_file", "is_pointer"]


POINTER = b"version https://git-lfs"
"""Beginning of the file that Git has in place of a large one which it has not fetched."""


def expanded(
    path: pathlib.Path, places: Sequence[str | os.PathLike[str]] = (), arguments: Mapping[str, str] | None = None
) -> bytes:
    """Return the URDF of a xacro file; `arguments` are the values of its xacro arguments.

    ROS packages are also searched in the folders `places`, first.

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
    original = substitution_args._eval_find
    missing: list[str] = []

    def find(package: str) -> str:
        near = [pathlib.Path(place) / package for place in places]
        near += [pathlib.Path(place) for place in places if pathlib.Path(place).resolve().name == package]
        folder = next((place for place in near if place.is_dir()), None) or _package(package, path)
        if folder is None:
            missing.append(package)
            raise LookupError(package)
        return str(folder)

    substitution_args._eval_find = find
    try:
        return str(xacro.process_file(str(path), mappings=dict(arguments or {})).toxml()).encode()
    except (Exception, SystemExit) as error:  # xacro raises errors of its own, of XML parsing and of Python
        if missing:
            raise ModelError(
                f"'{path}' needs the ROS package '{missing[0]}', which is not installed: give --package-path of the "
                "folder that contains it"
            ) from error
        why = " ".join(str(error).split())[:300]
        why += "; give it by --xacro NAME=VALUE" if "substitution argument" in why else ""
        why += "; save it, and the files that it includes, as UTF-8" if isinstance(error, UnicodeError) else ""
        raise ModelError(f"xacro refuses '{path}': {why}") from error
    finally:
        substitution_args._eval_find = original


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
        more = [pathlib.Path(place) for place in places]
        folder = _package(package, near)
        found = [*(place / package / inside for place in more), *(place / inside for place in more)]
        found += [folder / inside] if folder else []
    else:
        rest = urllib.parse.unquote(rest)
        found = [pathlib.Path(uri.partition("://")[2]), pathlib.Path(rest)]
    # a package that was copied under another name or in part, and the path of another machine
    parts = pathlib.PurePosixPath(rest.replace("\\", "/").lstrip("/")).parts
    tails = [pathlib.PurePosixPath(*parts[k:]) for k in range(len(parts) - 1) if ".." not in parts[k:]]
    found += [above / tail for tail in tails for above in near.resolve().parents[:6]]
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
