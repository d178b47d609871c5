"""The order of the phases, where the feet go, and the rules that end a phase, for each style of walking."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.gait.paper import PHASES_PER_CYCLE, EndRule, PaperGait, footstep, phase_at
from dqwalk_ros.model import Foot, RobotModel
from dqwalk_ros.phases import Phase, PhaseKind
from dqwalk_ros.standing.gait import StandingEnd, StandingGait

__all__ = [
    "PHASES_PER_CYCLE",
    "EndRule",
    "Gait",
    "PaperGait",
    "StandingEnd",
    "StandingGait",
    "footstep",
    "make_gait",
    "make_rule",
    "phase_at",
    "phase_count",
    "way",
]

Array = NDArray[np.float64]


class Gait(Protocol):
    """The order of the phases of one walk."""

    def following(self, phase: Phase | None) -> tuple[PhaseKind, Foot, Array | None] | None:
        """Return kind, support foot and swing target of the phase after `phase`; None after the last one."""


def make_gait(config: Config, model: RobotModel) -> PaperGait | StandingGait:
    """Return the gait of a new walk."""
    return StandingGait(config, model) if config.gait.style == "standing" else PaperGait(config, model)


def make_rule(config: Config, model: RobotModel, phase: Phase) -> EndRule | StandingEnd:
    """Return what decides when `phase` is over."""
    return (StandingEnd if config.gait.style == "standing" else EndRule)(config, model, phase)


def phase_count(config: Config) -> int:
    """Return how many phases a walk has; 0 where it is steered and has no end."""
    if config.gait.style == "standing":
        return 2 * config.gait.steps + 3 if config.gait.steps else 0
    return PHASES_PER_CYCLE * config.gait.cycles


def way(config: Config) -> str:
    """Return in words how far a walk goes."""
    gait = config.gait
    if gait.style != "standing":
        return f"{gait.cycles} cycle{'s' if gait.cycles > 1 else ''}"
    return f"{gait.steps} step{'s' if gait.steps > 1 else ''}" if gait.steps else "steered by cmd_vel"
