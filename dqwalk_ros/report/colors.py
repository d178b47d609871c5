"""The colours of all pictures: figures, pages, markers, replay."""

from __future__ import annotations

from dqwalk_ros.paper.foot import Foot

Rgb = tuple[int, int, int]

BLUE: Rgb = (31, 95, 180)
GREEN: Rgb = (29, 154, 78)
RED: Rgb = (209, 36, 47)
ORANGE: Rgb = (179, 89, 0)
INK: Rgb = (36, 41, 47)
GREY: Rgb = (140, 149, 159)
MUTED: Rgb = (87, 96, 106)
"""Of texts that are less important."""

COM = RED
DIVERGENT: Rgb = (230, 130, 0)
TIGHT: Rgb = (230, 126, 0)
"""Of the tightest margin and of its shape."""
FOOT: dict[Foot, Rgb] = {Foot.LEFT: BLUE, Foot.RIGHT: GREEN}


def hexed(color: Rgb) -> str:
    """Return a colour in HTML notation."""
    return "#{:02x}{:02x}{:02x}".format(*color)


def css() -> str:
    """Return the colours as variables of a style sheet, which `replay.js` reads, too."""
    named = {"ink": INK, "muted": MUTED, "good": GREEN, "bad": RED, "blue": BLUE, "warn": ORANGE, "tight": TIGHT}
    named |= {"com": COM, "divergent": DIVERGENT} | {foot.value: color for foot, color in FOOT.items()}
    return f":root {{ {' '.join(f'--{name}: {hexed(color)};' for name, color in named.items())} }}\n"
