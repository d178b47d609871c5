"""The files that adoption writes."""

from __future__ import annotations

import json
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

from dqwalk_ros.adopt.parameters import Numbers, dynamic_parameters
from dqwalk_ros.adopt.skeleton import Entry
from dqwalk_ros.support import strict_yaml
from dqwalk_ros.support.errors import OutputError
from dqwalk_ros.support.output import refuse_existing, write_text
from dqwalk_ros.support.wording import printable

FILES = (
    "robot.urdf", "robot.yaml", "dynamic.yaml", "climb.yaml", "paper.yaml", "whole_body.yaml", "robot.png", "adopt.json"
)  # fmt: skip
"""Names of the files that `adoption.adopt`, `picture.draw` and `trial.climb` write."""


def check_places(path: pathlib.Path, folder: pathlib.Path, *, overwrite: bool) -> None:
    """Raise OutputError if a file of `FILES` may not be written to a folder."""
    source = {path.resolve(), path.parent.resolve() / path.name}
    if mine := source & {folder.resolve() / name for name in FILES}:
        raise OutputError(f"'{min(mine)}' is the robot description itself; choose another folder with --out")
    if not overwrite:
        refuse_existing(folder / name for name in FILES)


def write_yaml(path: pathlib.Path, entries: Sequence[Entry], title: str, *, overwrite: bool) -> None:
    """Write parameters as a ROS parameter file, with the reason for each value in a comment beside it."""
    lines = [f"# {printable(title)} `dqwalk config` explains each key.", "/**:", "  ros__parameters:"]
    sections: dict[str, list[Entry]] = {}
    for entry in entries:
        sections.setdefault(entry.what.rpartition(".")[0], []).append(entry)
    for section, members in sections.items():
        indent = "    "
        if section:
            lines.append(f"    {section}:")
            indent = "      "
        for entry in members:
            text = f"{indent}{entry.what.rpartition('.')[2]}: {yaml_value(entry.value)}"
            note = entry.source + ("" if entry.confidence == "sure" else f" ({entry.confidence})")
            lines.append(f"{text:<44}  # {printable(note)}")
    write_text(path, "\n".join(lines) + "\n", overwrite=overwrite)


def write_dynamic(
    folder: pathlib.Path,
    numbers: Numbers,
    entries: Sequence[Entry],
    given: Mapping[str, Any],
    cured: Mapping[str, Any] | None = None,
    *,
    overwrite: bool,
) -> None:
    """Write ``dynamic.yaml``, the configuration of the dynamic walk, from the `entries` of the standing walk.

    Of the parameters `given` by the user, those of the standing walk's own steps and durations are not used; those of
    `cured` were changed after a dynamic walk.
    """
    damping, stiffness = (
        next(entry.value for entry in entries if entry.what == what) for what in ("servo.damping", "servo.stiffness")
    )
    new = {entry.what: entry for entry in dynamic_parameters(numbers, damping, stiffness)}
    common = ("dynamic.", "servo.", "qp.")
    only = "gait.recover"  # of the standing walk
    own = {k: v for k, v in given.items() if (k not in new or k.startswith(common)) and k != only}
    merged = [new.pop(entry.what, entry) for entry in entries if entry.what != only] + list(new.values())
    title = f"{numbers.model.name}: the dynamic walk (docs/dynamic.md)."
    merged = changed(changed(merged, own, "given by --set"), cured or {}, "changed after a walk that was not OK")
    write_yaml(folder / "dynamic.yaml", merged, title, overwrite=overwrite)


def changed(entries: Sequence[Entry], changes: Mapping[str, Any], reason: str) -> list[Entry]:
    """Return the entries with the values of `changes`, which may add keys, and with `reason` for these."""
    known = {entry.what for entry in entries}
    kept = [Entry(e.what, changes[e.what], reason) if e.what in changes else e for e in entries]
    return kept + [Entry(key, value, reason) for key, value in changes.items() if key not in known]


def yaml_value(value: Any) -> str:
    """Return a value of a parameter in YAML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_quoted, value)) + "]"
    if isinstance(value, str):
        plain = value.replace("_", "").replace(".", "").isalnum() and strict_yaml.read(value) == value
        return value if plain else _quoted(value)
    return repr(value)


def _quoted(value: Any) -> str:
    """Return a string or number in YAML, whatever characters a name of the robot has."""
    return json.dumps(value, ensure_ascii=False) if printable(str(value)) == str(value) else json.dumps(value)
