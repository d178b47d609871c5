"""Writes results: complete or not at all, never through a link, and over what exists only where that is allowed."""

from __future__ import annotations

import contextlib
import filecmp
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from dqwalk_ros.support.errors import ConfigError, OutputError


def make_folder(folder: Path) -> None:
    """Create a folder of results unless it exists.

    Raises
    ------
    OutputError
        If it cannot be created.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise OutputError(f"'{folder}' is a file, not a folder") from None
    except OSError as error:
        raise OutputError(f"cannot create the folder '{folder}': {error.strerror}") from error


@contextlib.contextmanager
def written(path: str | os.PathLike[str], *, overwrite: bool = False) -> Iterator[Path]:
    """Yield the path at which to write a file or folder, which gets the name `path` when the context ends well.

    Until then it is in a scratch folder beside `path`, whose folder is made if it is missing. A link at `path` is
    replaced, not followed. A file with the same content is left as it is.

    Parameters
    ----------
    overwrite : bool
        Replace what exists at `path`: a link, or a file by a file, or a folder by a folder.

    Raises
    ------
    OutputError
        If something else exists at `path` and is not to be replaced, or its folder cannot be made.
    OSError
        If nothing can be written there; it names `path` if it names no other file.
    """
    path = Path(path)
    make_folder(path.parent)
    try:
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name[:100]}-") as scratch:
            new = Path(scratch) / path.name
            yield new
            if _same(new, path):
                return
            if not overwrite:
                refuse_existing([path])
            _remove(path, folder=new.is_dir())
            new.rename(path)
    except OSError as error:  # a full disk has no name
        if error.errno and not error.filename:
            error.filename = str(path)
        raise


def write_text(path: str | os.PathLike[str], text: str, *, overwrite: bool = False) -> None:
    """Write a text as UTF-8; parameters and errors are those of `written`."""
    with written(path, overwrite=overwrite) as new:
        new.write_text(text, encoding="utf-8")


def unwritable(path: Path) -> str:
    """Return why nothing can be created at a path, by the rights of the nearest folder that exists; "" if it can."""
    folder = next(folder for folder in (path, *path.absolute().parents) if os.path.isdir(folder))
    return "" if os.access(folder, os.W_OK | os.X_OK) else f"'{folder}' is read-only, or not writable for this user"


def refuse_existing(paths: Iterable[Path]) -> None:
    """Raise OutputError if something exists at one of the paths, be it a link that leads nowhere."""
    for path in paths:
        if os.path.lexists(path):
            raise OutputError(f"'{path}' exists already; choose another --out, or replace it with --force")


def refuse_inside(bag: Path, out: Path) -> None:
    """Raise ConfigError if a result `out` would be in the folder of a bag, or replace the bag."""
    if bag.resolve() in (out.resolve(), *out.resolve().parents):
        raise ConfigError(f"--out {out} is in the bag, which is not changed")


def _same(new: Path, path: Path) -> bool:
    """Return whether there is a file at `path`, not a link, with the content of `new`."""
    return new.is_file() and path.is_file() and not path.is_symlink() and filecmp.cmp(new, path, shallow=False)


def _remove(path: Path, *, folder: bool) -> None:
    """Remove a link, or what a file or a folder may replace."""
    if path.is_symlink() or (path.is_file() and not folder):
        path.unlink()
    elif path.is_dir() and folder:
        shutil.rmtree(path)
    elif path.exists():
        raise OutputError(f"'{path}' is not a {'folder' if folder else 'file'}, and is not replaced")
