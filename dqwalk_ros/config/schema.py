"""What a parameter is: its default, unit, meaning and bounds, and the check of a value."""

from __future__ import annotations

import dataclasses
import difflib
import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import msgspec

from dqwalk_ros.support.errors import ConfigError

Value = bool | int | float | str | tuple[str, ...] | tuple[float, ...]


def parameter(
    default: Value,
    meaning: str,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    *,
    live: bool = False,
) -> Any:
    """Declare a parameter: default, meaning, unit, closed bounds, and whether it may be set during a walk (live)."""
    return dataclasses.field(
        default=default, metadata={"meaning": meaning, "unit": unit, "low": low, "high": high, "live": live}
    )


@dataclass(frozen=True)
class Spec:
    """One parameter as the nodes, the command line and the documentation see it."""

    name: str
    """Dotted name, such as ``"ssp.com_radius"``."""
    hint: Any
    """Type annotation with bounds, by which msgspec checks a value."""
    type: type
    """``bool``, ``int``, ``float``, ``str`` or ``tuple``."""
    default: Value
    unit: str
    meaning: str
    low: float | None
    high: float | None
    """Closed bounds."""
    live: bool
    """Whether it may be set during a standing walk; it takes effect at the next phase."""
    choices: tuple[str, ...]
    """The values allowed; empty for any value within the bounds."""

    @property
    def expects(self) -> str:
        """Description of the values allowed, such as ``a number in [0, 1]``."""
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        if self.type is tuple and self.low is None:
            return "a list of texts"
        numbers = isinstance(self.default, tuple) and f"a list of {len(self.default)} numbers"
        kind = numbers or {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}[self.type]
        return kind if self.low is None else f"{kind} in [{self.low:g}, {self.high:g}]"


@functools.cache
def specs_of(section: Any) -> dict[str, Spec]:
    """Return every parameter of a section and of its subsections, by its dotted name."""
    return {spec.name: spec for spec in _specs(section, "")}


def _specs(section: Any, prefix: str) -> Iterator[Spec]:
    """Yield the parameters of a section and of its subsections, with `prefix` before each name."""
    hints = get_type_hints(section)
    for field in dataclasses.fields(section):
        hint, meta = hints[field.name], field.metadata
        if dataclasses.is_dataclass(hint):
            yield from _specs(hint, f"{prefix}{field.name}.")
            continue
        choices = get_args(hint) if get_origin(hint) is Literal else ()
        yield Spec(
            name=prefix + field.name,
            hint=_bounded(hint, meta["low"], meta["high"]),
            type=str if choices else get_origin(hint) or hint,
            default=getattr(section, field.name),
            choices=choices,
            **meta,
        )


def _bounded(hint: Any, low: float | None, high: float | None) -> Any:
    """Return a type annotation with bounds; those of a list are the bounds of each number in it."""
    bounds = msgspec.Meta(ge=low, le=high)
    if get_origin(hint) is tuple and low is not None:
        parts: Any = tuple(Annotated[part, bounds] for part in get_args(hint))
        return tuple.__class_getitem__(parts)
    return Annotated[hint, bounds]


def checked(specs: Mapping[str, Spec], name: str, value: Any) -> Value:
    """Return a value converted to the type of the parameter `name` in `specs`.

    Raises
    ------
    ConfigError
        If there is no such parameter, or the value has another type or is out of bounds.
    """
    if name not in specs:
        raise ConfigError(f"unknown parameter {name[:80]!r}{_suggestion(name, specs)}")
    spec = specs[name]
    if hasattr(value, "tolist"):  # a number or an array of numpy
        value = value.tolist()
    if spec.type is tuple and isinstance(value, list | tuple):
        value = [item for item in value if item != ""]  # ROS has no empty list: it is written as one empty text
    try:
        out: Value = msgspec.convert(value, spec.hint)
    except msgspec.ValidationError:
        unit = f" [{spec.unit}]" if spec.unit else ""
        raise ConfigError(f"'{name}' must be {spec.expects}, got {value!r:.80} ({spec.meaning}{unit})") from None
    return out


def _suggestion(name: str, known: Mapping[str, Any]) -> str:
    """Return the names most similar to an unknown one, as the end of an error message."""
    if inside := [one for one in known if one.startswith(f"{name}.")]:
        return f"; it is a section, whose parameters are named such as {inside[0]!r}"
    close = difflib.get_close_matches(name[:100], known, n=3, cutoff=0.6)
    if not close:
        key = name.rpartition(".")[2]
        close = [k for k in known if k.rpartition(".")[2] == key][:3]
    return f"; did you mean {' or '.join(map(repr, close))}?" if close else "; `dqwalk config` lists them all"
