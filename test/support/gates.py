"""What the tests of gates share: states of a robot, and a gate on a test clock."""

from __future__ import annotations

import numpy as np
from stepped_time import SteppedTime

from dqwalk_ros.nodes.state_gate import StateGate
from dqwalk_ros.paper.state import State
from dqwalk_ros.robot.model import RobotModel

DT = 0.005
MS = 1_000_000
PERIOD = 5 * MS


def at(q: np.ndarray, dq: np.ndarray | None = None) -> State:
    return State(0.0, q, dq)


def gate_of(model: RobotModel, clock: SteppedTime, **options: object) -> StateGate:
    return StateGate(model, DT, lambda: 0.1, clock=clock, **options)  # type: ignore[arg-type]
