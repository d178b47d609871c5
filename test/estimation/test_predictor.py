"""Angles at which commands act, by a delay that the joints may correct."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dqwalk_ros.estimation.predictor import Predictor
from dqwalk_ros.robot.servos import Drive

N, DT, TRUE = 4, 0.01, 0.03


def walked(assumed: float, effort: np.ndarray | None, seconds: float = 10.0) -> tuple[Predictor, float]:
    """Return a predictor and its last error, if goals are held for a period whose middle is `TRUE` after the state."""
    predictor, time, error = Predictor(Drive(np.full(N, 50.0), *np.zeros((3, N)), assumed)), 0.0, np.inf
    phase = np.arange(N)

    def path(t: float) -> np.ndarray:
        return 0.3 * np.sin(5.0 * t + phase)

    for tick in range(round(seconds / DT)):
        time = tick * DT
        answered = DT * math.floor((time - TRUE + 0.5 * DT) / DT + 1e-6)
        error = float(np.abs(predictor.acting(time, path(answered + DT)) - path(time)).max())
        predictor.add(time, path(answered + DT), (path(time + DT) - path(time)) / DT, effort, DT)
    return predictor, error


def test_the_angles_are_those_at_which_the_command_acts() -> None:
    _, error = walked(TRUE, None)
    assert error < 0.02  # a held goal is ahead by up to a period, 0.015 rad; the delay is 0.045 rad


@pytest.mark.parametrize("effort", [np.zeros(N), None])
def test_a_wrong_delay_is_corrected_where_torques_are_fed_forward(effort: np.ndarray | None) -> None:
    predictor, error = walked(TRUE + 0.02, effort)
    learned = effort is not None
    assert predictor.drive.delay == pytest.approx(TRUE + 0.02 * (not learned), abs=0.004)
    assert (error < 0.02) == learned
    assert predictor.watch.drive is predictor.drive


def test_an_interruption_forgets_the_commands_and_keeps_the_delay() -> None:
    predictor, _ = walked(TRUE + 0.02, np.zeros(N))
    delay, q = predictor.drive.delay, np.ones(N)
    predictor.interrupt()
    assert np.array_equal(predictor.acting(10.0, q), q)
    assert predictor.drive.delay == delay
