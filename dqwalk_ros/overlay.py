"""What the file of a plant replaces in a configuration."""

from __future__ import annotations

from dqwalk_ros.config import Config, Value, overlaid

__all__ = ["replaced"]


def replaced(own: Config, plant: str, used: Config, how: str) -> str:
    """Return a warning that names the values of a configuration which ``config/plants/NAME.yaml`` replaces; or "".

    Values that are the default, and ``monitor.*``, are replaced without a warning.

    Parameters
    ----------
    own : Config
        The configuration without the plant's file.
    used : Config
        The configuration with the plant's file and with all that is applied after it.
    how : str
        How to apply a value after the plant's file.
    """
    given, of_plant, last = own.flat(), overlaid(own, plant).flat(), used.flat()
    changes = [
        f"{spec.name} {_shown(given[spec.name])} by {_shown(of_plant[spec.name])}"
        for spec in Config.specs()
        if not spec.name.startswith("monitor.")
        and given[spec.name] not in (spec.default, of_plant[spec.name])
        and last[spec.name] == of_plant[spec.name]
    ]
    if not changes:
        return ""
    return f"config/plants/{plant}.yaml replaces values of the configuration: {', '.join(changes)}; to keep one: {how}"


def _shown(value: Value) -> str:
    return str(value).lower() if isinstance(value, bool) else str(list(value) if isinstance(value, tuple) else value)
