"""The first walks of an adopted robot, and what is tried when it falls."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dqwalk_ros.adopt import Adoption, changed, write_yaml
from dqwalk_ros.adopt.parameters import Numbers, rounded
from dqwalk_ros.config import Config, find_share, from_yaml, load
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import DqwalkError
from dqwalk_ros.robot import RobotModel, load_model
from dqwalk_ros.simulation import Trace, make_controller, make_plant, simulate

__all__ = ["Trial", "cures", "first_walks", "walk"]

_STEPS = 4


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


def first_walks(
    found: Adoption, given: Mapping[str, Any], progress: Callable[[str], None] = lambda _: None
) -> Iterator[tuple[Trial, str]]:
    """Walk in kinematics, then in physics; where it falls there, try the cures, and keep in ``robot.yaml`` what helped.

    Parameters
    ----------
    found : Adoption
    given : dict of str to value
        Parameters that no cure changes.
    progress : callable, optional
        Called with a line of text.

    Yields
    ------
    Trial
        The walk as derived; after a cure that helped the cured one. The last one that did not stand ends them.
    str
        The cure; empty where none was needed or none helped.
    """
    config, model, file = found.config, found.model, found.folder / "robot.yaml"
    for plant in ("kinematic", "physics"):
        first = walk(config, model, plant, _STEPS, progress)
        yield first, ""
        if first.stood:
            continue
        for what, values in cures(config, found.numbers) if plant == "physics" else ():
            kept = {key: value for key, value in values.items() if key not in given}
            entries = changed(found.entries, kept, f"cured a fall: {what}")
            write_yaml(file, entries, f"{model.name}: the walk that stands, cured.")
            cured = load(file)
            again = walk(cured, load_model(cured.robot), plant, _STEPS, progress)
            if again.stood:
                yield again, what
                break
        else:
            write_yaml(file, found.entries, f"{model.name}: the walk that stands.")
            return


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
