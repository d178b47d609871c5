"""The whole-body motion controller with long-term balance constraints [Sherikov2014], and its experiments.

`WholeBodyController` is the controller of the paper. `follow` runs the closed loop over a `Scenario`, `retrace` solves
a recorded walk again; both return a `WholeBodyTrace`.
"""

from __future__ import annotations

from dqwalk_ros.whole_body.controller import BodyCommand, BodyState, BodyTick, WholeBodyController
from dqwalk_ros.whole_body.experiments import follow, retrace
from dqwalk_ros.whole_body.rigid_plant import BodyPlant
from dqwalk_ros.whole_body.scenario import PAPER_TIMES, SCENARIOS, Scenario
from dqwalk_ros.whole_body.trace import BodyLog, Reaction, WholeBodyTrace

__all__ = [
    "PAPER_TIMES",
    "SCENARIOS",
    "BodyCommand",
    "BodyLog",
    "BodyPlant",
    "BodyState",
    "BodyTick",
    "Reaction",
    "Scenario",
    "WholeBodyController",
    "WholeBodyTrace",
    "follow",
    "retrace",
]
