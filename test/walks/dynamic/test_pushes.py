"""Pushes, and a hand that holds the robot."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from dynamic_poppy import CONFIG, MODEL

from dqwalk_ros.config import overlaid
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.report import bag
from dqwalk_ros.simulation import closed_loop, simulate
from dqwalk_ros.studies.pushes import Push, pushed
from dqwalk_ros.walks.dynamic.walk import DynamicWalk
from dqwalk_ros.walks.table import make_controller


def test_a_robot_that_is_held_does_not_wait_for_ever() -> None:
    """In a double support a hand stops the robot, so the divergent component never arrives."""
    config = CONFIG.updated({"gait.steps": 6})
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)
    held = next(state for state, _ in closed_loop(controller, plant) if controller.phase_index == 5)
    assert controller.phase.kind is PhaseKind.DOUBLE_SUPPORT
    held, begun = dataclasses.replace(held, dq=np.zeros(MODEL.n), gyro=np.zeros(3)), held.time
    while controller.phase_index == 5 and held.time - begun < 6.0:
        held = dataclasses.replace(held, time=held.time + config.dt)
        controller.step(held, config.dt)
    assert 0.2 < held.time - begun < 4.0


def test_a_push_towards_the_swing_foot_is_caught_on_the_spot() -> None:
    """The foot lands early and throws the robot back; a longer double support catches it."""
    config = overlaid(CONFIG, "physics").updated({"gait.step_length": 0.0, "gait.steps": 4})
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)

    def push(time: float) -> None:  # in the middle of the second step, in support on the right foot
        due = controller.phase_index == 4 and 0.2 <= time + begin - controller.phase_began < 0.3
        plant.push(np.array([0.0, 6.0 if due else 0.0, 0.0]))

    begin = plant.state.time
    trace = simulate(controller, plant, before_step=push)
    assert trace.finished, trace.notes
    assert any(record.decision.startswith("the double support lasts") for record in trace.phases)
    assert all(record.decision == "" for record in trace.phases[:4])


@pytest.mark.parametrize(
    ("length", "impulse", "part"), [(0.0, 0.4, 0.5), (0.0, 0.6, 0.1), (0.05, 0.75, 0.5), (0.05, 0.7, 0.1)]
)
def test_a_push_that_tips_the_sole_outwards_is_caught(length: float, impulse: float, part: float) -> None:
    """A swing foot that lands, or is held, in the plane of the tipped sole carries no weight.

    The trunk must not be thrown against the largest one of these pushes, and the sole that the last one tips must
    not be taken for uneven ground.
    """
    config = overlaid(CONFIG, "physics").updated({"gait.step_length": length, "qp.solver": "daqp"})
    assert not pushed(config, Push("left", 0.5 * math.pi, impulse, part=part))


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    ("length", "latency", "falls"),
    [
        (0.0, 0.0, {0.4: 0, 0.45: 0, 0.55: 0, 0.6: 0}),
        (0.05, 0.0, {0.3: 0, 0.5: 0, 0.7: 0}),
        (0.05, 0.02, {0.25: 0, 0.3: 0}),
    ],
)
def test_pushes_of_every_direction_at_every_part_of_a_step(
    length: float, latency: float, falls: dict[float, int]
) -> None:
    """Several impulses, because their limits are not monotone; `falls` is the number of falls allowed at each."""
    changes = {"gait.step_length": length, "servo.latency": latency, "servo.assumed_latency": latency}
    config = overlaid(CONFIG, "physics").updated({**changes, "qp.solver": "daqp"})
    parts, angles = (0.1, 0.25, 0.5, 0.75), 0.25 * math.pi * np.arange(8)
    points = [(foot, part, float(angle)) for foot in ("left", "right") for part in parts for angle in angles]
    for impulse, allowed in falls.items():
        fell = [p for p in points if pushed(config, Push(p[0], p[2], impulse, part=p[1]))]
        stood = len(points) - len(fell)
        print(f"\n{2.0 * length:g} m/s, {1e3 * latency:g} ms, {impulse} N s: {stood} of {len(points)} stood")
        assert len(fell) <= allowed


def test_a_push_is_confirmed_for_a_time_and_by_two_states() -> None:
    found = [DynamicWalk(CONFIG.updated({"dt": dt}), MODEL)._confirmed for dt in (0.0025, 0.005, 0.02)]
    assert found == [6, 3, 2]


def test_poppy_walks_in_physics_and_recovers_from_a_push(tmp_path: Path) -> None:
    config = CONFIG.updated({"gait.steps": 4, "dynamic.stop_duration": 0.6})
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)

    def push(time: float) -> None:  # outward, in the middle of the second step, in support on the right foot
        due = controller.phase_index == 4 and 0.2 <= time + begin - controller.phase_began < 0.3
        plant.push(np.array([0.0, -4.0 if due else 0.0, 0.0]))

    begin = plant.state.time
    trace = simulate(controller, plant, before_step=push)
    assert trace.finished, trace.notes
    # step lengths 25, 50, 50 and 25 mm
    assert trace.physics is not None
    pelvis = DQ(trace.physics.pelvis[[0, -1]]).translation()
    assert pelvis[1, 0] - pelvis[0, 0] == pytest.approx(0.15, abs=0.04)
    assert trace.phases[2].decision == ""  # before the push
    pushed = [record for record in trace.phases[4:] if record.decision]
    assert pushed
    bag.write(trace, tmp_path / "bag")
    again = bag.read(tmp_path / "bag")
    assert [record.name for record in again.phases] == [record.name for record in trace.phases]
    for record, read in zip(trace.phases, again.phases, strict=True):
        if record.swing_target is not None:
            assert read.swing_target == pytest.approx(record.swing_target, abs=1e-12)
