"""The cache on disk, of what takes long to compute again.

What is in the cache is executed, so it is in a folder that no other user can have filled, or nowhere.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pathlib
import pickle
from collections.abc import Callable
from typing import TypeVar

from dqwalk_ros.support.own_folder import own_folder, temporary

T = TypeVar("T")
_MOST = 50
"""Number of results of a kind that are kept."""


def cache_folder() -> pathlib.Path:
    """Return the folder of the caches: in the user's cache folder, or in the temporary one where that is read-only.

    Raises
    ------
    OSError
        If neither can be used.
    """
    caches = pathlib.Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    try:
        return own_folder(caches / "dqwalk_ros")
    except OSError:
        return own_folder(temporary())


def remembered(kind: str, key: bytes, make: Callable[[], T]) -> T:
    """Return the result of `make`, or what it returned earlier, in any process of this user, for the same key.

    Parameters
    ----------
    kind : str
        Name of a folder; the results of a kind that were used last are kept.
    key : bytes
        Everything on which the result depends, such as the content of files, of the program's own as well.
    make : callable
        Its result can be pickled.
    """
    try:
        folder = own_folder(cache_folder() / kind)
    except OSError:
        return make()
    file = folder / hashlib.sha256(key).hexdigest()
    with contextlib.suppress(Exception):  # missing, cut off, or of another version of a class: it is made again
        made: T = pickle.loads(file.read_bytes())
        with contextlib.suppress(OSError):
            file.touch()
        return made
    made = make()
    with contextlib.suppress(OSError):
        new = folder / f"{file.name}.{os.getpid()}"
        new.write_bytes(pickle.dumps(made))
        new.replace(file)  # another process never reads half of it
        for old in sorted(folder.iterdir(), key=lambda each: each.stat().st_mtime)[:-_MOST]:
            old.unlink()
    return made
