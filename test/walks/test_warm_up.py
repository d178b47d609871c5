"""No state is answered late: nothing is compiled or parsed in the middle of a walk."""

from __future__ import annotations

import pytest
from dynamic_poppy import MODEL

import dqwalk_ros as dq
from dqwalk_ros.config import overlaid
from dqwalk_ros.estimation.load import FootLoads
from dqwalk_ros.paper.phase import Phase, PhaseKind
from dqwalk_ros.paper.walk import Walk
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.simulation import closed_loop, warm_up
from dqwalk_ros.walks.table import make_controller


@pytest.mark.parametrize("name", ["poppy", "poppy_dynamic"])
def test_no_file_is_parsed_during_a_walk(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """To parse a URDF takes 60 ms, too long for a walk in real time."""
    config = overlaid(dq.load(name), "physics")
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)

    def parse(*_: object) -> None:
        pytest.fail("a file is parsed")

    for module in ("robot.urdf.Urdf.__init__", "walks.dynamic.recovery.load", "support.strict_yaml.read"):
        monkeypatch.setattr(f"dqwalk_ros.{module}", parse)
    for state, _ in closed_loop(controller, plant):
        if controller.phase.kind is PhaseKind.SINGLE_SUPPORT and state.time > controller.phase_began + 0.1:
            return
    pytest.fail("no single support began")


@pytest.mark.parametrize(
    ("name", "plant", "changes"),
    [
        *((name, "physics", {"gait.steps": steps}) for name in ("poppy", "poppy_dynamic") for steps in (20, 0)),
        ("poppy", "poppy", {}),  # without an inertial sensor
        ("paper", "integrator", {}),
    ],
)
def test_warming_up_evaluates_every_kind_of_phase(
    name: str, plant: str, changes: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is compiled in the middle of a step stops the robot for seconds."""
    evaluated, loads = [], []
    evaluate, update = Phase.evaluate, FootLoads.update
    monkeypatch.setattr(Phase, "evaluate", lambda one, *rest: evaluated.append(one.kind) or evaluate(one, *rest))
    monkeypatch.setattr(FootLoads, "update", lambda *given: loads.append(update(*given)) or loads[-1])
    warm_up(overlaid(dq.load(name), plant).updated(changes), MODEL)
    assert {PhaseKind.DOUBLE_SUPPORT, PhaseKind.SINGLE_SUPPORT} <= set(evaluated)
    assert loads[0] is not None


def test_warming_up_evaluates_a_walk_that_is_prepared(monkeypatch: pytest.MonkeyPatch) -> None:
    """A walk of its own, in whose `observe` an attribute is missing, would end the node before it begins."""
    monkeypatch.setattr(Walk, "prepare", lambda walk: setattr(walk, "known", None))
    monkeypatch.setattr(Walk, "observe", lambda walk, *_: walk.known)
    warm_up(dq.load("paper"), dq.load_model(dq.load("paper").robot))
