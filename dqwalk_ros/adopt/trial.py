"""The first walks of an adopted robot, and what is tried when it falls."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from dqwalk_ros.adopt.parameters import Numbers, rounded
from dqwalk_ros.config import Config, find_share, from_yaml
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import DqwalkError
from dqwalk_ros.robot import RobotModel
from dqwalk_ros.simulation import Trace, make_controller, make_plant, simulate

__all__ = ["Trial", "cures", "walk"]


@dataclass(frozen=True)
class Trial:
    """A walk that was tried.

    Attributes
    ----------
    plant : str
    stood : bool
        Whether it walked to its end.
    distance : float
        That the pelvis came on, along x [m].
    note : str
        Why it did not walk to its end.
    """

    plant: str
    stood: bool
    distance: float
    note: str

    def __str__(self) -> str:
        return f"{self.plant}: " + (f"walked {self.distance:.3f} m" if self.stood else self.note)


def walk(config: Config, model: RobotModel, plant: str, steps: int, progress: Callable[[str], None]) -> Trial:
    """Walk some steps on a plant."""
    changed = config.updated({"gait.steps": steps} if config.gait.style == "standing" else {"gait.cycles": 1})
    if plant == "physics":
        changed = from_yaml(find_share("config/plants", "physics.yaml").read_text(encoding="utf-8"), onto=changed)
    try:
        controller, body = make_controller(changed, model), make_plant(plant, changed, model)
        trace = simulate(controller, body, progress=lambda _, text: progress(f"{plant}: {text}"))
    except DqwalkError as error:
        return Trial(plant, False, 0.0, str(error))
    return Trial(plant, trace.finished, _distance(trace), "; ".join(trace.notes))


def _distance(trace: Trace) -> float:
    if trace.physics is not None and np.isfinite(trace.physics.pelvis).any():
        x = DQ(trace.physics.pelvis[np.isfinite(trace.physics.pelvis[:, 0])]).translation()[:, 0]
        return float(x[-1] - x[0])
    return trace.config.gait.step_length * max(0, sum(p.swing_target is not None for p in trace.phases) - 1)


def cures(config: Config, numbers: Numbers) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield what may keep a robot from falling, one thing more each time: what it is, and the parameters."""
    servo, standing = config.servo, config.standing
    changes: dict[str, Any] = {"servo.damping": numbers.damping(servo.stiffness, 0.8)}
    yield "a damping ratio of 0.8", dict(changes)
    stiffness = rounded(8.0 * numbers.mgh)
    changes |= {
        "servo.stiffness": stiffness,
        "servo.assumed_stiffness": stiffness,
        "servo.damping": numbers.damping(stiffness, 0.8),
    }
    yield "a stiffness of 8 m g h", dict(changes)
    changes["standing.transfer_duration"] = rounded(1.3 * standing.transfer_duration)
    yield "a transfer 1.3 times as long", dict(changes)
    changes["gait.step_length"] = rounded(0.7 * config.gait.step_length)
    yield "steps of 0.7 times the length", dict(changes)
