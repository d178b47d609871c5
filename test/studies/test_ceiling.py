"""What the robot itself allows: pushes that a pendulum on the soles catches, and speeds of the servos."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dqwalk_ros.config import Config, load
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.studies import ceiling
from dqwalk_ros.studies.ceiling import PushCeiling, caught
from dqwalk_ros.studies.evidence import Row, ceilings
from dqwalk_ros.studies.pushes import Push
from dqwalk_ros.studies.servo_choice import Gait

CONFIG = load("poppy_dynamic")
MODEL = load_model(CONFIG.robot)


def walked(xi: float, half: float, landings: tuple[float, float], growth: float, left: float) -> float:
    """Return the largest distance of xi from the middle of the sole in 40 steps of a pendulum, pressed at an edge."""
    farthest = xi
    for k in range(40):
        if abs(xi) <= half:  # the pressure stops it, no step is needed
            break
        xi = half + (xi - half) * (growth if k else left) - landings[k % 2]
        farthest = max(farthest, xi)
    return farthest


@pytest.mark.parametrize(("first", "then"), [(0.15, 0.15), (-0.095, 0.095), (0.095, -0.095), (-0.2, -0.1)])
@pytest.mark.parametrize("left", [1.0, 1.4])
def test_what_is_caught_comes_to_rest_and_no_more(first: float, then: float, left: float) -> None:
    """By a simulation: a pendulum just below the limit stays near its soles, above it diverges."""
    half, growth = 0.03, 1.8
    limit = caught(half, first, then, growth, left)
    assert limit >= half - 1e-12
    if limit > half + 1e-6:  # where steps help
        assert walked(limit - 1e-3, half, (first, then), growth, left) < 1.0
        assert walked(limit + 1e-3, half, (first, then), growth, left) > 1.0


def test_steps_that_may_be_longer_or_quicker_catch_more() -> None:
    """A push outwards is caught by the sole alone, one ahead by steps."""
    longer = CONFIG.updated({"dynamic.catch_length": 0.15})
    slower = CONFIG.updated({"dynamic.shortest_step": 0.3})
    without = CONFIG.updated({"dynamic.catch": False})
    ahead, outwards = Push("left", 0.0, 1.0), Push("left", 0.5 * math.pi, 1.0)

    def of(config: Config, push: Push) -> float:
        return PushCeiling(config, MODEL).of(push)

    assert of(longer, ahead) > of(CONFIG, ahead) > of(slower, ahead) > of(without, ahead)
    assert of(without, outwards) == pytest.approx(of(CONFIG, outwards))
    assert of(CONFIG, Push("left", 0.5 * math.pi, 1.0, part=0.1)) < of(CONFIG, outwards)  # xi is still near the sole
    assert of(CONFIG, Push("right", -0.5 * math.pi, 1.0)) == pytest.approx(of(CONFIG, outwards))


def test_feet_land_in_turn_on_either_side() -> None:
    """A push towards the swing foot is caught by it, and then by the other foot, which lands on its own side."""
    found, d = PushCeiling(CONFIG, MODEL), CONFIG.dynamic
    omega, gait = float(found._omega[1]), Gait.of(CONFIG)
    half, apart = 0.5 * MODEL.soles[Foot.LEFT].width, found._apart
    xi = apart / (math.exp(omega * gait.duration) + 1.0) * math.exp(omega * (0.5 * gait.double + 0.5 * gait.single))
    left = math.exp(omega * max(d.shortest_step - 0.5 * gait.single, 0.0))
    room = caught(half, apart + d.catch_side, d.catch_side - apart, math.exp(omega * d.shortest_step), left) - xi
    assert found.of(Push("left", -0.5 * math.pi, 1.0)) == pytest.approx(MODEL.mass * omega * room)


def test_a_stance_is_as_wide_as_both_soles() -> None:
    """J = M w d for the distance d of the edge, the textbook's limit without a step."""
    found = PushCeiling(CONFIG, MODEL)
    omega, sole = found._omega, MODEL.soles[Foot.LEFT]
    for axis, edge in enumerate((0.5 * sole.length, 0.5 * (sole.width + found._apart))):
        of = found.of(Push("standing", 0.5 * math.pi * axis, 1.0))
        assert of == pytest.approx(MODEL.mass * omega[axis] * edge)


def test_rows_of_the_same_servos_are_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A row of pushes has an impulse, a dynamic walk a speed, a standing walk and a random course neither."""
    made, choose = [], ceiling.choose
    monkeypatch.setattr(ceiling, "choose", lambda *given: made.append(given) or choose(*given))
    monkeypatch.setattr("dqwalk_ros.studies.servo_choice._SPEEDS", np.array([0.05, 0.15, 0.3]))
    monkeypatch.setattr("dqwalk_ros.studies.servo_choice._LOWER", (0.0, 0.03))
    rows = {
        "a": Row("a", "poppy_dynamic", set={"servo.latency": 0.02}),
        "b": Row("b", "poppy_dynamic", set={"gait.steps": 3}),
        "pushes": Row("pushes", "poppy_dynamic", push=0.5),
        "standing": Row("standing", "poppy"),
        "course": Row("course", "poppy_dynamic", set={"gait.steps": 0}, course=20.0),
    }
    found = ceilings(rows)
    assert list(found) == ["a", "b", "pushes"]
    assert found["a"] == found["b"]
    assert found["a"].endswith(" m/s")
    assert found["pushes"].endswith(" N s")
    assert len(made) == 1
