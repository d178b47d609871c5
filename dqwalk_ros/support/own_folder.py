"""Folders and locks that no other user of the machine can have prepared, or can replace."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import stat
import tempfile
from pathlib import Path
from typing import IO


def own_folder(path: Path) -> Path:
    """Return a folder, made if it is missing, that only this user can fill or replace.

    It belongs to this user, is not a link, and nobody else can write to it. The folders above it belong to this user or
    to root; others can write to them only if they cannot rename there what is not theirs, as in /tmp, or if they are
    in this user's own group.

    Raises
    ------
    OSError
        If it cannot be made or written to, or another user can have prepared it.
    """
    if not path.is_absolute():
        raise FileNotFoundError(errno.ENOENT, "the path of this folder is not absolute", str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    path = path.parent.resolve() / path.name
    with contextlib.suppress(FileExistsError):
        path.mkdir(mode=0o700)
    user, group = os.getuid(), os.getgid()
    found = path.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != user or found.st_mode & 0o022:
        raise PermissionError(errno.EPERM, "others can have filled this folder, remove it", str(path))
    for above in path.parents:
        found = above.stat()
        others = 0o002 if found.st_gid == group else 0o022
        if found.st_uid not in (0, user) or (found.st_mode & others and not found.st_mode & stat.S_ISVTX):
            raise PermissionError(errno.EPERM, f"others can replace '{path.name}' in this folder", str(above))
    if not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, "this folder cannot be written to", str(path))
    return path


def temporary() -> Path:
    """Return the path of this user's folder in the temporary folder of the machine; see `own_folder`."""
    return Path(tempfile.gettempdir()) / f"dqwalk_ros-{os.getuid()}"


def lock(name: str) -> IO[str] | None:
    """Return a lock of this user on this machine, held until the file is closed; None if another process holds it.

    Raises
    ------
    OSError
        If there is no folder for it.
    """
    file = (own_folder(temporary()) / f"{name}.lock").open("a")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        return None
    return file
