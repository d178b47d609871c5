"""The whole-body motion controller with long-term balance constraints [Sherikov2014], and its experiments.

`WholeBodyController` is the controller of the paper; `follow` closes the loop over a `Scenario`, `retrace` recomputes
a recorded run; both return a `Reaching`.
"""

from __future__ import annotations

from dqwalk_ros.whole_body.controller import WholeBodyController
from dqwalk_ros.whole_body.loop import BodyPlant, follow, retrace
from dqwalk_ros.whole_body.records import BodyCommand, BodyState, BodyTick, Wrench
from dqwalk_ros.whole_body.scenario import PAPER_TIMES, SCENARIOS, Scenario
from dqwalk_ros.whole_body.trace import BodyLog, Reaching, Reaction

__all__ = [
    "PAPER_TIMES",
    "SCENARIOS",
    "BodyCommand",
    "BodyLog",
    "BodyPlant",
    "BodyState",
    "BodyTick",
    "Reaching",
    "Reaction",
    "Scenario",
    "WholeBodyController",
    "Wrench",
    "follow",
    "retrace",
]
