"""Entries NAME=NUMBER of parameters that are lists of texts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from dqwalk_ros.support.errors import ConfigError


def numbers(entries: Iterable[str], key: str, form: str) -> Iterator[tuple[str, float]]:
    """Yield name and number of each entry of the parameter `key`, whose `form` is such as JOINT=RADIANS.

    Raises
    ------
    ConfigError
        If an entry has another form, or its number is not finite.
    """
    for entry in entries:
        name, _, text = (part.strip() for part in entry.partition("="))
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise ConfigError(f"{key} has '{entry}'; it must be {form}")
        yield name, number
