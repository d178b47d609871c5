"""A course: a sequence of velocity commands for a steered walk."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from dqwalk_ros.support.errors import ConfigError

if TYPE_CHECKING:  # the node pilot only publishes velocities
    from dqwalk_ros.controller import VelocityController
    from dqwalk_ros.paper.walk import Walk

_LONGEST = 86_400.0
"""Longest duration of a leg [s]."""
_TOO_FAST = 1e3
"""A velocity beyond the limits of any walk [m/s, rad/s]."""
_LEG = 0.5, 4.0
"""Shortest and longest leg of a random course [s]."""
_ASKED = 1.5
"""Largest velocity of a random course, in units of the largest one of the walk."""


@dataclass(frozen=True)
class Leg:
    """One part of a course: a constant velocity for a given time."""

    forward: float
    left: float
    """Linear velocity [m/s]."""
    turn: float
    """Angular velocity, positive to the left [rad/s]."""
    duration: float
    """[s]"""


@dataclass(frozen=True)
class Course:
    """The legs of a course, in their order."""

    legs: tuple[Leg, ...]

    @classmethod
    def parse(cls, texts: Sequence[str]) -> Self:
        """Read legs such as ``"0.01,0,0.02,30"``: forward, left [m/s], turn [rad/s], duration [s].

        Raises
        ------
        ConfigError
            If a text has another form.
        """
        legs = []
        for text in texts:
            try:
                numbers = [float(part) for part in text.split(",")]
            except ValueError:
                numbers = []
            if len(numbers) != 4 or not all(map(math.isfinite, numbers)) or not 0.0 < numbers[3] <= _LONGEST:
                raise ConfigError(
                    "--cmd-vel needs FORWARD,LEFT,TURN,SECONDS [m/s, m/s, rad/s, s], "
                    f"such as 0.01,0,0.02,30, for at most a day, not '{text[:80]}'"
                )
            legs.append(Leg(*numbers))
        return cls(tuple(legs))

    @classmethod
    def random(cls, duration: float, most: Sequence[float], seed: int) -> Self:
        """Return legs of random lengths and velocities for at least a duration [s].

        Each velocity is zero in a third of the legs, else up to `_ASKED` times that in `most`, as `speeds` returns it.
        """
        rng, legs = np.random.default_rng(seed), list[Leg]()
        while sum(leg.duration for leg in legs) < duration:
            forward, left, turn = (rng.uniform(-_ASKED, _ASKED, 3) * most * (rng.random(3) > 1.0 / 3.0)).tolist()
            legs.append(Leg(forward, left, turn, rng.uniform(*_LEG)))
        return cls(tuple(legs))

    @property
    def duration(self) -> float:
        """Total duration of the legs [s]."""
        return sum(leg.duration for leg in self.legs)

    def at(self, time: float) -> tuple[float, float, float] | None:
        """Return forward, left [m/s] and turn [rad/s] at a time since the start [s]; None after the last leg."""
        for leg in self.legs:
            if time < leg.duration:
                return leg.forward, leg.left, leg.turn
            time -= leg.duration
        return None

    def steering(self, controller: VelocityController) -> Callable[[float], None]:
        """Return what steers a walk at a time since its start [s] and stops it after the last leg.

        It is the ``before_step`` of `simulation.simulate`.
        """

        def steer(time: float) -> None:
            velocity = self.at(time)
            if velocity is None:
                controller.stop()
            else:
                controller.steer(*velocity)

        return steer


def speeds(walk: Walk) -> tuple[float, float, float]:
    """Return the largest velocity of a steered walk ahead, to the left [m/s] and about the vertical [rad/s].

    Each is that without the others.

    Raises
    ------
    ConfigError
        If the walk cannot be steered.
    """
    forward, left, turn = (walk.steer(*(_TOO_FAST * (k == axis) for k in range(3)))[axis] for axis in range(3))
    walk.steer(0.0, 0.0, 0.0)
    return forward, left, turn
