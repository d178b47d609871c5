"""The decisions of the fall watch at their limits: a lean, a contradiction of joints or of the inertial sensor."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from dqwalk_ros.config import load
from dqwalk_ros.nodes.fall_watch import Contradictions, FallWatch
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.state import State
from dqwalk_ros.robot.model import load_model

CONFIG = load("poppy").updated({"dt": 0.01, "servo.assumed_latency": 0.0, "plant.imu": True})
MODEL = load_model(CONFIG.robot)
KNEE = MODEL.joint_names.index("l_knee_y")
LIMIT, DT, TIMEOUT = CONFIG.safety.contradiction, CONFIG.dt, 0.1
STILL = np.zeros(MODEL.n)
UP = np.array([0.0, 0.0, 1.0])


def watch(**keywords: Any) -> FallWatch:
    return FallWatch(CONFIG, MODEL, lambda: TIMEOUT, **{"lockstep": False, **keywords})


def leaning(watch: FallWatch, angle: float) -> np.ndarray:
    """Return the vertical in the sensor of a robot whose pelvis leans forward by an angle [rad]."""
    up = watch._upright
    across = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    out: np.ndarray = math.cos(angle) * up + math.sin(angle) * across / np.linalg.norm(across)
    return out


def state(k: int, knee: float = 0.0, **fields: Any) -> State:
    return State(k * DT, knee * np.eye(MODEL.n)[KNEE], **fields)


@pytest.mark.parametrize("factor", [1.0, 1.0 + 1e-9])
def test_a_pelvis_lies_above_its_limit(factor: float) -> None:
    one, limit = watch(), CONFIG.safety.tilt
    assert not one.look(None)
    assert not one.look(factor * one._upright)  # the norm of a vertical is not exactly one
    assert not one.look(leaning(one, limit - 1e-6))
    found = one.look(leaning(one, limit + 1e-6))
    assert f"leans by {math.degrees(limit):.0f} deg" in found
    assert FallWatch.other_frame not in found
    assert one.lying == found
    assert FallWatch.other_frame not in one.look(leaning(one, FallWatch.upside_down - 1e-6))
    assert one.look(leaning(one, FallWatch.upside_down + 1e-6)).endswith(FallWatch.other_frame)
    assert one.look(-factor * one._upright)
    assert not one.look(one._upright)


def test_a_sole_tips_above_its_limit() -> None:
    assert not watch().tips(Foot.LEFT, CONFIG.safety.sole_tilt - 1e-9)
    assert "its left sole leans" in watch().tips(Foot.LEFT, CONFIG.safety.sole_tilt + 1e-9)


def until_suspected(one: FallWatch, *, lean: float = 0.0) -> int:
    """Let the knee drift by 0.02 rad per state against commands to stay; return the number of states."""
    for k in range(1, 60):
        one.compare(state(k, 0.02 * k), STILL, lean)
        if one.suspected:
            return k
    raise AssertionError


def test_a_drift_is_suspected_at_the_limit_and_at_half_of_it_if_a_sole_leans() -> None:
    sole = CONFIG.safety.sole_tilt
    level, leaning = until_suspected(watch(), lean=0.5 * sole - 1e-9), until_suspected(watch(), lean=0.5 * sole + 1e-9)
    assert level == pytest.approx(LIMIT / 0.02, abs=3)
    assert leaning == pytest.approx(0.5 * LIMIT / 0.02, abs=3)


def test_a_joint_that_is_off_against_the_sum_of_its_limits_is_off_by_their_difference() -> None:
    """A plant that was late has moved between two limits; what is beyond them counts, on either side."""
    for sign in (1.0, -1.0):
        one, moves = Contradictions(CONFIG, MODEL, lambda: 10.0), sign * 0.5 * np.eye(MODEL.n)[KNEE]
        one.judge(state(0), STILL)
        assert not one.judge(state(40), moves)  # it held all the time but for two periods, or ...
        one.forget()
        one.judge(state(0), STILL)
        assert not one.judge(state(40, sign * 0.2), moves)  # ... it moved all the time
        one.forget()
        one.judge(state(0), STILL)
        assert "l_knee_y does not follow" in one.judge(state(40, sign * (0.21 + LIMIT + 0.05)), moves)


def test_a_gap_above_the_timeout_clears_the_sums() -> None:
    one, late = Contradictions(CONFIG, MODEL, lambda: TIMEOUT), round(TIMEOUT / DT)
    one.judge(state(0), STILL)
    assert one.judge(state(late, LIMIT + 0.05), STILL)  # exactly the timeout
    one.forget()
    one.judge(state(0), STILL)
    assert not one.judge(state(late + 1, LIMIT + 0.05), STILL)
    assert not one.judge(state(late + 1, 9.0), STILL), "no time has passed"


@pytest.mark.parametrize("lockstep", [False, True])
def test_a_contradiction_is_confirmed_after_the_time_in_which_a_plant_says_that_it_holds(lockstep: bool) -> None:
    one = watch(lockstep=lockstep)
    k = until_suspected(one)
    waits = 0.0 if lockstep else TIMEOUT + FallWatch.ready_delay
    for n in range(1, 100):
        if confirmed := one.compare(state(k + n, 0.02 * k), STILL, 0.0):
            break
    assert n * DT == pytest.approx(max(waits, DT))
    assert "l_knee_y" in confirmed


@pytest.mark.parametrize("may_hold", [False, True])
def test_a_joint_is_given_up_at_once_unless_the_robot_may_hold(may_hold: bool) -> None:
    """Then the plant may hold, too, which it says later."""
    one, given, at = watch(may_hold=lambda: may_hold), [], []
    one.gives_up = lambda joint: given.append(joint) or np.array([KNEE])  # type: ignore[func-returns-value]
    for k in range(1, 100):
        one.compare(state(k, min(0.02 * k, 0.4)), STILL, 0.0)
        at.append(len(given))
    assert given == [KNEE]
    first = at.index(1) + 1
    early = LIMIT / 0.02
    assert first == pytest.approx(early + may_hold * (TIMEOUT + FallWatch.ready_delay) / DT, abs=4)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_vertical_that_turns_without_its_gyroscope_contradicts_it(sign: float) -> None:
    one = Contradictions(CONFIG, MODEL, lambda: TIMEOUT)

    def turned(k: int, rate: float) -> State:
        angle = sign * 1.0 * k * DT
        up = np.array([math.sin(angle), 0.0, math.cos(angle)])
        return state(k, up=up, gyro=np.array([0.0, -rate, 0.0]))

    for k in range(200):  # up' = up x omega
        assert not one.judge(turned(k, sign * 1.0), STILL)
    assert one.largest < 0.05
    one.forget()
    found = [one.judge(turned(k, 0.0), STILL) for k in range(60)]
    first = next(k for k, text in enumerate(found) if text)
    memory = Contradictions.memory[2]
    least = -memory * math.log(1.0 - LIMIT / memory)  # of a sum that grows at 1 rad/s and decays
    assert first * DT == pytest.approx(least, abs=0.02)
    assert "the inertial sensor contradicts itself" in found[first]
    assert one.joint == -1
    one.forget()
    for k in range(60):  # without one of the two measurements there is nothing to compare
        missing = turned(k, 0.0)
        missing.gyro, missing.up = (None, missing.up) if sign > 0.0 else (missing.gyro, None)
        assert not one.judge(missing, STILL)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_fall_names_an_inertial_sensor_that_contradicts_itself(sign: float) -> None:
    """A robot whose gyroscope is inverted falls before the contradiction is confirmed."""
    one = watch()
    for k in range(200):
        up = np.array([math.sin(k * DT), 0.0, math.cos(k * DT)])
        if fall := one.look(up):
            break
        one.compare(state(k, up=up, gyro=np.array([0.0, -sign, 0.0])), STILL, 0.0)
    assert "its pelvis leans by" in fall
    assert ("the inertial sensor contradicts itself" in fall) == (sign < 0.0)
    assert ("dqwalk doctor" in one.tips(Foot.LEFT, 1.0)) == (sign < 0.0)


@pytest.mark.parametrize("noise", [1e-9, 0.0])
def test_a_fall_names_an_inertial_sensor_that_measures_nothing_new(noise: float) -> None:
    """Its vertical and its angular velocity do not contradict each other."""
    one = watch()
    for k in range(40):
        one.compare(state(k, 0.001 * k, up=UP, gyro=np.array([0.0, 0.0, noise * k])), STILL, 0.0)
    fall = one.tips(Foot.LEFT, 1.0)
    assert ("exactly the same for 0.39 s: its driver repeats an old measurement" in fall) == (noise == 0.0)
