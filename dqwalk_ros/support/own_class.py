"""The class of a user, such as a walk or a plant, by MODULE:CLASS."""

from __future__ import annotations

import importlib
from typing import TypeVar

T = TypeVar("T")


def own_class(name: str, base: type[T]) -> type[T]:
    """Return the class that is called MODULE:CLASS, a subclass of `base` that defines all its members.

    Raises
    ------
    ImportError
        If there is none; the text says why, and the cause is the error of the module, which may be any.
    """
    module, _, kind = name.partition(":")
    if not (module and kind):
        raise ImportError("it must be MODULE:CLASS")
    try:
        found = getattr(importlib.import_module(module), kind)
    except Exception as error:
        raise ImportError(f"the class cannot be imported: {error}") from error
    if not (isinstance(found, type) and issubclass(found, base)):
        raise ImportError(f"it must be a subclass of {base.__module__}.{base.__name__}")
    if lacks := sorted(getattr(found, "__abstractmethods__", ())):
        raise ImportError(f"the class does not define {', '.join(lacks)}")
    return found
