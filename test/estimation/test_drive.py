"""Monitoring of the drive: differences from the assumed parameters are identified during a walk."""

from __future__ import annotations

import math

import numpy as np
import pytest

import dqwalk_ros as dq
from dqwalk_ros.config import overlaid
from dqwalk_ros.estimation.drive import DriveWatch
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.report import analyse, report
from dqwalk_ros.report.binding import acting
from dqwalk_ros.robot.servos import Drive
from dqwalk_ros.simulation import closed_loop, simulate
from dqwalk_ros.walks.dynamic.walk import DynamicWalk
from dqwalk_ros.walks.table import make_controller

N, STIFFNESS, DELAY = 4, 50.0, 0.05


def simulated(
    watch: DriveWatch, *, extra: float = 0.0, stiffness: float = STIFFNESS, begin: float = 0.0, seconds: float = 20.0,
    one_later: float = 0.0,
) -> DriveWatch:  # fmt: skip
    """Simulate joints whose goals are held for a period, with a delay, compliance under load, and encoders.

    The middle of a period is `DELAY` and `extra` after the state that its command answers [s], that of one joint even
    later.
    """
    dt, phase, K, late = 0.005, np.arange(N), np.full(N, stiffness), np.append(np.zeros(N - 1), one_later)

    def path(t: float | np.ndarray) -> np.ndarray:
        return 0.2 * np.sin(2.3 * t + phase) + 0.08 * np.sin(6.0 * t)

    def load(t: float) -> np.ndarray:
        return 0.5 + 0.4 * np.cos(0.7 * t + phase) + 0.1 * np.sin(4.0 * t)

    for k in range(round(seconds / dt)):
        t = begin + dt * k
        answered = begin + dt * math.floor((t - begin - DELAY + 0.5 * dt - extra) / dt + 1e-6)
        q = path(answered + dt - late) + (1.0 / STIFFNESS - 1.0 / K) * load(answered)
        q = np.rint(q / 0.001534) * 0.001534
        watch.add(t, q, path(t), load(t), dt)
    return watch


def watch() -> DriveWatch:
    return DriveWatch(Drive(np.full(N, STIFFNESS), *np.zeros((3, N)), DELAY))


def test_a_drive_as_assumed_gives_no_warning() -> None:
    found = simulated(watch())
    assert found.delay == pytest.approx(0.0, abs=0.003)
    assert found.stiffness == pytest.approx(1.0, abs=0.1)
    assert found.warnings() == []
    assert found.drive.delay == DELAY


@pytest.mark.parametrize("one_later", [0.0, 0.06])
@pytest.mark.parametrize("extra", [0.02, 0.04, -0.02])
def test_a_deviating_delay_is_measured_and_used(extra: float, one_later: float) -> None:
    """It is that of most joints."""
    found = simulated(watch(), extra=extra, seconds=60.0, one_later=one_later)
    assert found.delay == pytest.approx(extra, abs=0.004)
    assert found.drive.delay == pytest.approx(DELAY + extra, abs=0.005)
    assert bool(found.warnings()) is (extra > 0.0)
    assert all(f"{1e3 * found.delay:.0f} ms" in text for text in found.warnings())


def test_a_loss_of_stiffness_during_a_walk_is_detected() -> None:
    found = simulated(watch())
    assert found.warnings() == []
    simulated(found, stiffness=0.6 * STIFFNESS, begin=20.0, seconds=40.0)
    assert found.stiffness == pytest.approx(0.6, rel=0.1)
    (text,) = found.warnings()
    assert text.endswith("% of the stiffness of the beginning")


def test_no_estimate_without_enough_data_and_gaps_are_tolerated() -> None:
    found = simulated(watch(), seconds=5.0)
    assert math.isnan(found.delay)
    simulated(found, begin=30.0)
    assert found.delay == pytest.approx(0.0, abs=0.003)


@pytest.mark.long
@pytest.mark.parametrize(("latency", "stiffness"), [(0.0, 60.0), (0.03, 60.0), (0.0, 40.0)])
def test_delay_and_stiffness_are_identified_in_physics(latency: float, stiffness: float) -> None:
    """The controller assumes a latency of 0 and a stiffness of 60 N m/rad."""
    assumed = dq.load("poppy").updated({
        "gait.steps": 6, "qp.solver": "daqp", "servo.assumed_damping": 0.02, "servo.assumed_rate": 200.0,
    })  # fmt: skip
    model = dq.load_model(assumed.robot)
    plant = make_plant("physics", assumed.updated({"servo.latency": latency, "servo.stiffness": stiffness}), model)
    controller = make_controller(assumed, model)
    for _ in closed_loop(controller, plant):
        pass
    found = controller.predictor.watch
    print(
        f"{1e3 * found.delay:.1f} of {1e3 * latency:.0f} ms, {100.0 * found.stiffness:.0f} % of the stiffness assumed"
    )
    assert found.delay == pytest.approx(latency, abs=0.01)
    if not latency:
        assert found.stiffness == pytest.approx(stiffness / 60.0, rel=0.15)


def test_a_walk_corrects_a_delay_that_was_assumed_too_long_by_20_ms(monkeypatch: pytest.MonkeyPatch) -> None:
    """The report repeats what the controller has learned from the recorded angles and commands."""
    config = overlaid(dq.load("poppy_dynamic_50hz"), "poppy_as_built").updated({
        "gait.steps": 12, "qp.solver": "daqp", "servo.latency": 0.01, "servo.p_gain": 127,
    })  # fmt: skip
    model = dq.load_model(config.robot)
    controller, used = make_controller(config, model), list[Drive]()
    monkeypatch.setattr(
        DynamicWalk, "use", lambda walk, drive, use=DynamicWalk.use: (used.append(drive), use(walk, drive))
    )
    trace = simulate(controller, make_plant("poppy_as_built", config, model))
    assumed = Drive.of(config, model).delay
    walk = report(analyse(trace))
    assert walk["ok"], walk["violations"]
    assert controller.predictor.watch.drive.delay == pytest.approx(assumed - 0.02, abs=0.01)
    assert controller.predictor.watch.drive is used[-1]
    assert controller.predictor.watch.warnings() == []
    _, delay = acting(trace)
    assert (delay[0], delay[-1]) == (assumed, controller.predictor.watch.drive.delay)
    assert np.abs(np.diff(delay)).max() > 0.005
