"""The colours of the page: those of the figures."""

from __future__ import annotations

from dqwalk_ros.robot import Foot

__all__ = ["BAD", "COM", "COM_SOFT", "FOOT", "GOOD", "INK", "TIGHT", "hexed", "of_region"]

Rgb = tuple[int, int, int]

INK: Rgb = (36, 41, 47)
COM: Rgb = (209, 36, 47)
COM_SOFT: Rgb = (240, 160, 160)
BAD: Rgb = (209, 36, 47)
GOOD: Rgb = (29, 154, 78)
TIGHT: Rgb = (230, 126, 0)
FOOT: dict[Foot, Rgb] = {Foot.LEFT: (31, 95, 180), Foot.RIGHT: (29, 154, 78)}
_REGIONS: dict[str, Rgb] = {
    "tip_plane": (31, 95, 180),
    "back_plane": (120, 80, 190),
    "pelvis": (110, 119, 129),
    "com_cylinder": (29, 154, 78),
    "sliding": (0, 140, 150),
}


def of_region(name: str) -> Rgb:
    """Return the colour of a constraint's shape."""
    return _REGIONS.get(name, (90, 100, 160))


def hexed(color: Rgb) -> str:
    """Return a colour as HTML writes it."""
    return "#{:02x}{:02x}{:02x}".format(*color)
