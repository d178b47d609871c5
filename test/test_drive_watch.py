"""Monitoring of the drive: differences from the assumed parameters are found during a walk, with their size."""

from __future__ import annotations

import math

import numpy as np
import pytest

import dqwalk_ros as dq
from dqwalk_ros.estimation.drive import DriveWatch
from dqwalk_ros.servos import Drive
from dqwalk_ros.simulation import closed_loop, make_controller, make_plant

N, TOLD, LATE = 4, 50.0, 0.05


def walked(
    watch: DriveWatch, *, more: float = 0.0, stiffness: float = TOLD, begin: float = 0.0, seconds: float = 20.0
) -> DriveWatch:
    """Move joints that obey after a delay, sag under their load, and are read in steps of an encoder."""
    dt, phase, K = 0.005, np.arange(N), np.full(N, stiffness)

    def path(t: float) -> np.ndarray:
        return 0.2 * np.sin(1.1 * t + phase) + 0.05 * np.sin(3.0 * t)

    def load(t: float) -> np.ndarray:
        return 0.5 + 0.4 * np.cos(0.7 * t + phase) + 0.1 * np.sin(4.0 * t)

    for k in range(round(seconds / dt)):
        t = begin + dt * k
        then = t - LATE - more
        q = path(then) + (1.0 / TOLD - 1.0 / K) * load(then)
        q = np.rint(q / 0.001534) * 0.001534
        watch.add(t, q, (path(t + dt) - path(t)) / dt, load(t))
    return watch


def watch() -> DriveWatch:
    return DriveWatch(Drive(np.full(N, TOLD), np.zeros(N), np.zeros(N), LATE))


def test_a_drive_that_is_as_told_is_worth_no_word() -> None:
    found = walked(watch())
    assert found.delay == pytest.approx(0.0, abs=0.003)
    assert found.stiffness == pytest.approx(1.0, abs=0.1)
    assert found.warnings() == []


@pytest.mark.parametrize("more", [0.02, 0.04, -0.02])
def test_a_delay_that_is_not_as_told_is_measured(more: float) -> None:
    found = walked(watch(), more=more)
    assert found.delay == pytest.approx(more, abs=0.003)
    assert bool(found.warnings()) is (more > 0.0)
    assert all(f"{1e3 * found.delay:.0f} ms" in text for text in found.warnings())


def test_servos_that_sag_in_the_middle_of_a_walk_are_noticed() -> None:
    found = walked(watch())
    assert found.warnings() == []
    walked(found, stiffness=0.6 * TOLD, begin=20.0, seconds=40.0)
    assert found.stiffness == pytest.approx(0.6, rel=0.1)
    (text,) = found.warnings()
    assert text.endswith("% of the stiffness of the beginning")


def test_nothing_is_said_before_it_is_known_and_a_silence_does_no_harm() -> None:
    found = walked(watch(), seconds=5.0)
    assert math.isnan(found.delay)
    walked(found, begin=30.0)
    assert found.delay == pytest.approx(0.0, abs=0.003)


@pytest.mark.long
@pytest.mark.parametrize(("latency", "stiffness"), [(0.0, 60.0), (0.03, 60.0), (0.0, 40.0)])
def test_a_walk_in_physics_tells_what_its_drive_is(latency: float, stiffness: float) -> None:
    """The controller is told a latency of 0 and 60 N m/rad; three steps are enough."""
    told = dq.load("poppy").updated({
        "gait.steps": 3, "qp.solver": "daqp", "servo.assumed_damping": 0.02, "servo.assumed_rate": 200.0,
    })  # fmt: skip
    model = dq.load_model(told.robot)
    plant = make_plant("physics", told.updated({"servo.latency": latency, "servo.stiffness": stiffness}), model)
    found = DriveWatch(Drive.of(told, model))
    for state, command in closed_loop(make_controller(told, model), plant):
        if command.effort is not None:
            found.add(state.time, state.q, command.velocity, command.effort)
    assert found.delay == pytest.approx(latency, abs=0.01)
    if not latency:
        assert found.stiffness == pytest.approx(stiffness / 60.0, rel=0.15)
