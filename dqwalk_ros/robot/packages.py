"""Files of ROS packages that a robot description refers to, and their encodings.

A package is searched among the installed ones, and among the folders around the file that refers to it. So a robot
description that was cloned or unpacked, also under another name, can be used without installing it.
"""

from __future__ import annotations

import codecs
import glob
import os
import pathlib
import re
import urllib.parse
from collections.abc import Iterator, Sequence

POINTER = b"version https://git-lfs"
"""Beginning of the file that Git has in place of a large one which it has not fetched."""
_EAST_ASIAN = ("gb2312", "gbk", "gb18030", "big5", "shift_jis", "euc-jp", "euc-kr")
"""Encodings of text that the XML parser does not know."""
_NAME = re.compile(rb"<name>\s*([^<\s]+)\s*</name>")
"""The name of a package in its package.xml."""
_ABOVE = 6
"""Number of folders above a file that are searched for what it refers to."""


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


def package_folder(name: str, near: pathlib.Path, places: Sequence[str | os.PathLike[str]] = ()) -> pathlib.Path | None:
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
        folder = package_folder(package, near, places)
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
    return next((place for place in found if is_file(place)), None)


def is_pointer(file: str | os.PathLike[str]) -> bool:
    """Return whether a file is a pointer of Git LFS instead of what it is to contain."""
    with pathlib.Path(file).open("rb") as begin:
        return begin.read(len(POINTER)) == POINTER


def is_file(place: pathlib.Path) -> bool:
    """Return whether a path is that of a file; one that no system allows is not."""
    try:
        return place.is_file()
    except (OSError, ValueError):
        return False
