"""Words of messages: names and numbers that came from outside, messages of one kind, files that are missing."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

_PARTICULAR = re.compile(r"'[^']*'|[-+.\d]+(?:e[-+]?\d+)?")
"""What distinguishes messages of the same kind: names and numbers."""
_NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")


def listed(names: Collection[str]) -> str:
    """Return some names that came from outside, for a message that fits on a line and cannot act on a terminal."""
    some = [shown(name) for name in sorted(names)[:12]]
    return ", ".join([*some, f"and {len(names) - 12} more"] if len(names) > 12 else some) or "none"


def kinds(messages: Sequence[str]) -> list[str]:
    """Return the first message of each kind, with the number of others that differ only by names and numbers."""
    found: dict[str, list[str]] = {}
    for message in messages:
        found.setdefault(_PARTICULAR.sub("", message), []).append(message)
    return [same[0] + (f" ({len(same) - 1} more like this)" if len(same) > 1 else "") for same in found.values()]


def printable(text: str) -> str:
    """Return a text in one line: control characters are escaped, as names from outside may contain them."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def shown(name: str) -> str:
    """Return a name that came from outside, as `listed` does."""
    return printable(name)[:60]


def missing(what: str, path: Path) -> str:
    """Return why there is no file at a path; a pipe, as of ``<(...)``, cannot be read twice."""
    if path.is_dir():
        return f"'{path}' is a folder; name the {what}"
    if path.exists():
        return f"'{path}' is a pipe or a device: write its content into a file"
    if path.is_symlink():
        return f"no {what} '{path}': it is a link that leads nowhere"
    why = unexpanded(str(path))
    return f"no {what} '{path}'{why and f': {why}'}"


def unexpanded(path: str) -> str:
    """Return that a path begins with what a shell replaces at the beginning of a word only; or ""."""
    begins = path.startswith(("~", "$"))
    return f"no shell has replaced the '{path[0]}'; write the whole path" if begins else ""


def one_line(text: str) -> str:
    """Return a text that came from outside in one line of printable characters, at most 300."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())[:300]


def without_numbers(text: str) -> str:
    """Return a message with # for each number, to count messages that differ in numbers only."""
    return _NUMBER.sub("#", text)


def counted(texts: Iterable[str], most: int | None = None) -> list[str]:
    """Return a line for each text with the number of its copies, the most frequent first, at most `most` lines."""
    return [f"  {count:3d} x {text}" for text, count in Counter(texts).most_common(most)]
