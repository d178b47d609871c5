"""The two feet."""

from __future__ import annotations

import enum


class Foot(enum.Enum):
    """One of the two feet."""

    LEFT = "left"
    RIGHT = "right"

    @property
    def other(self) -> Foot:
        """The other foot."""
        return Foot.RIGHT if self is Foot.LEFT else Foot.LEFT
