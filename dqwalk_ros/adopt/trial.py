"""The first walks of an adopted robot, and what is tried when it falls."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dqwalk_ros.adopt import Adoption, changed, write_yaml
from dqwalk_ros.adopt.parameters import Numbers, rounded
from dqwalk_ros.config import Config, find_share, from_yaml, load
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import DqwalkError
from dqwalk_ros.report.causes import causes
from dqwalk_ros.report.metrics import analyse
from dqwalk_ros.robot import RobotModel, load_model
from dqwalk_ros.simulation import Trace, make_controller, make_plant, simulate
from dqwalk_ros.stability import Finding

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
        How it ended before its end.
    causes : tuple of Finding
        Why it fell, what acted first at the front.
    """

    plant: str
    stood: bool
    distance: float
    note: str
    causes: tuple[Finding, ...] = ()

    def __str__(self) -> str:
        why = "".join(f"; it fell because: {cause}" for cause in self.causes[:1])
        return f"{self.plant}: " + (f"walked {self.distance:.3f} m" if self.stood else self.note + why)


def first_walks(
    found: Adoption, given: Mapping[str, Any], progress: Callable[[float, str], None] = lambda *_: None
) -> Iterator[tuple[Trial, str]]:
    """Walk in kinematics, then in physics; where it falls there, try the cures, and keep in ``robot.yaml`` what helped.

    Parameters
    ----------
    found : Adoption
    given : dict of str to value
        Parameters that no cure changes.
    progress : callable, optional
        Called with the fraction done of the walk under way, and a line of text.

    Yields
    ------
    Trial
        The walk as derived, and the one after each cure that was tried.
    str
        The cures it has; empty at first.
    """
    config, model, file = found.config, found.model, found.folder / "robot.yaml"
    for plant in ("kinematic", "physics"):
        first = walk(config, model, plant, _STEPS, progress)
        yield first, ""
        if first.stood:
            continue
        names: list[str] = []
        for what, values in cures(config, found.numbers, first.causes) if plant == "physics" else ():
            names.append(what)
            kept = {key: value for key, value in values.items() if key not in given}
            entries = changed(found.entries, kept, f"cured a fall: {', '.join(names)}")
            write_yaml(file, entries, f"{model.name}: the walk that stands, cured.")
            cured = load(file)
            again = walk(cured, load_model(cured.robot), plant, _STEPS, progress)
            yield again, ", ".join(names)
            if again.stood:
                break
        else:
            write_yaml(file, found.entries, f"{model.name}: the walk that stands.")
            return


def walk(config: Config, model: RobotModel, plant: str, steps: int, progress: Callable[[float, str], None]) -> Trial:
    """Walk some steps on a plant."""
    changed = config.updated({"gait.steps": steps} if config.gait.style == "standing" else {"gait.cycles": 1})
    if plant == "physics":
        changed = from_yaml(find_share("config/plants", "physics.yaml").read_text(encoding="utf-8"), onto=changed)
    try:
        controller, body = make_controller(changed, model), make_plant(plant, changed, model)
        trace = simulate(controller, body, progress=lambda done, text: progress(done, f"{plant}: {text}"))
    except DqwalkError as error:
        return Trial(plant, False, 0.0, str(error))
    why = () if trace.finished else tuple(causes(analyse(trace)))
    return Trial(plant, trace.finished, _distance(trace), "; ".join(trace.notes), why)


def _distance(trace: Trace) -> float:
    if trace.physics is not None and np.isfinite(trace.physics.pelvis).any():
        x = DQ(trace.physics.pelvis[np.isfinite(trace.physics.pelvis[:, 0])]).translation()[:, 0]
        return float(x[-1] - x[0])
    return trace.config.gait.step_length * max(0, sum(p.swing_target is not None for p in trace.phases) - 1)


def cures(config: Config, numbers: Numbers, found: Sequence[Finding]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield what may keep a robot from falling, one thing more each time: what it is, and the parameters.

    What answers the causes of the fall comes first, in their order.
    """
    servo, standing = config.servo, config.standing
    stiffness = rounded(8.0 * numbers.mgh)
    known: dict[str, tuple[str, dict[str, Any]]] = {
        "damping": ("a damping ratio of 0.8", {"servo.damping": numbers.damping(servo.stiffness, 0.8)}),
        "stiffness": (
            "a stiffness of 8 m g h, a damping ratio of 0.8",
            {
                "servo.stiffness": stiffness,
                "servo.assumed_stiffness": stiffness,
                "servo.damping": numbers.damping(stiffness, 0.8),
            },
        ),
        "pressure": (
            "a transfer 1.3 times as long",
            {"standing.transfer_duration": rounded(1.3 * standing.transfer_duration)},
        ),
        "step": ("steps of 0.7 times the length", {"gait.step_length": rounded(0.7 * config.gait.step_length)}),
    }
    order = [cause.what for cause in found if cause.what in known]
    changes: dict[str, Any] = {}
    for what in dict.fromkeys([*order, *known]):
        if what == "damping" and "servo.stiffness" in changes:
            continue  # that of stiffer servos
        changes |= known[what][1]
        yield known[what][0], dict(changes)
