"""Whole-body walks: a hand that is led about, and a robot that is pushed meanwhile, section VII [Sherikov2014].

`follow` closes the loop over a `Scenario`, `retrace` does the same from what was recorded; both give a `Reaching`.
`exactness` checks the equations and the answers themselves, `pushes` looks for the hardest push that is survived.
"""

from __future__ import annotations

from dqwalk_ros.reach.loop import BodyPlant, follow, retrace
from dqwalk_ros.reach.record import BodyLog, Reaching, Reaction
from dqwalk_ros.reach.scenario import PAPER_TIMES, SCENARIOS, Scenario

__all__ = [
    "PAPER_TIMES",
    "SCENARIOS",
    "BodyLog",
    "BodyPlant",
    "Reaching",
    "Reaction",
    "Scenario",
    "follow",
    "retrace",
]
