"""Which states of the whole body a controller accepts."""

from __future__ import annotations

import contextlib
import math

import numpy as np
import pytest
from gates import DT, PERIOD, at
from stepped_time import SteppedTime

from dqwalk_ros.config import load
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.errors import StateError
from dqwalk_ros.whole_body.nodes.body_gate import BodyGate


def take(gate: BodyGate, stamp: int, q: np.ndarray, dq: np.ndarray, place: np.ndarray, v_base: np.ndarray) -> None:
    gate.accept_body(stamp, at(q, dq), place, v_base)


def accepted_body() -> tuple[BodyGate, dict[str, np.ndarray]]:
    """Return a gate that has accepted a state, and that state."""
    body = load_model(load("whole_body").robot)
    gate = BodyGate(body, DT, lambda: 0.5)
    q = np.clip(np.zeros(body.n), body.q_min, body.q_max)
    state = {"q": q, "dq": np.zeros(body.n), "place": np.array([0.0, 0.0, 0.7]), "v_base": np.zeros(6)}
    take(gate, 0, **state)
    return gate, state


@pytest.mark.parametrize(
    ("what", "value", "why"),
    [
        ("q", 0.5, "a jump that the velocity limits do not allow"),
        ("q", 9.0, "outside the joint limits"),
        ("dq", 1000.0, "not those of the angles: R_gripper_joint 1e\\+03 rad/s"),
        ("dq", 1e300, "R_gripper_joint 1e\\+300 rad/s"),
        ("dq", np.nan, "not finite"),
        ("v_base", 1e200, "the base turns at 1e\\+200 rad/s"),
        ("v_base", 31.0, "the base turns at 31 rad/s"),
        ("v_base", np.inf, "not finite"),
        ("place", 1.0, "the base jumped by"),
    ],
)
def test_an_invalid_body_state_is_rejected_and_changes_nothing(what: str, value: float, why: str) -> None:
    gate, state = accepted_body()
    wrong = {**state, what: state[what].copy()}
    wrong[what][-1] += value
    with pytest.raises(StateError, match=why):
        take(gate, PERIOD, **wrong)
    take(gate, 2 * PERIOD, **state)


def test_velocity_changes_by_a_push_are_accepted() -> None:
    """A push changes velocities instantly, also beyond a joint's velocity limit; both are accepted."""
    gate, state = accepted_body()
    pushed = {**state, "dq": state["dq"] + 13.0, "v_base": np.array([0.0, 1.0, 0.0, 2.0, 0.0, 0.0])}
    take(gate, PERIOD, **pushed)
    take(gate, 2 * PERIOD, **{**pushed, "q": state["q"] + 13.0 * DT})


@pytest.mark.parametrize(("part", "possible"), [(0.98, True), (1.02, False)])
@pytest.mark.parametrize("what", ["dq", "v_base", "turn", "place"])
def test_a_body_moves_no_faster_than_its_bounds(what: str, part: float, possible: bool) -> None:
    """Joints at three times their limits, a base at 10 m/s and 30 rad/s, and by one period more than the time."""
    gate, state = accepted_body()
    fastest = load_model(load("whole_body").robot).velocity_max[0]
    most = {"dq": 3.0 * fastest, "v_base": 10.0, "turn": 30.0, "place": 10.0 * 2 * DT}[what]
    key = "v_base" if what == "turn" else what
    moved = {**state, key: state[key].copy()}
    moved[key][3 if what == "turn" else 0] += part * most
    with contextlib.nullcontext() if possible else pytest.raises(StateError):
        take(gate, PERIOD, **moved)


def test_the_time_of_a_body_is_that_of_its_stamps_and_a_repeated_state_is_no_fault(clock: SteppedTime) -> None:
    body = load_model(load("whole_body").robot)
    gate, q = BodyGate(body, DT, lambda: 0.5, clock=clock), np.clip(np.zeros(body.n), body.q_min, body.q_max)
    place, still = np.array([0.0, 0.0, 0.7]), np.zeros(6)
    take(gate, 0, q, np.zeros(body.n), place, still)
    for _ in range(2 * gate.repeats):
        gate.is_new(0)
    assert not gate.stuck
    clock.now += 100.0
    with pytest.raises(StateError, match="a jump"):
        take(gate, PERIOD, q + 0.5 * np.eye(body.n)[-1], np.zeros(body.n), place, still)


def test_a_base_that_moves_too_fast_is_rejected_at_any_time() -> None:
    gate, state = accepted_body()
    late = 1000 * PERIOD
    take(gate, late, **state)
    with pytest.raises(StateError, match="the base jumped by"):
        take(gate, late + PERIOD, **{**state, "place": state["place"] + [1.0, 0.0, 0.0]})
    take(gate, late + PERIOD, **{**state, "place": state["place"] + [0.09, 0.0, 0.0]})


def test_a_body_whose_velocities_are_not_the_rates_of_its_angles_is_a_fault() -> None:
    gate, state = accepted_body()
    moves = np.clip(0.1 - state["q"], -0.1, 0.1)
    for k in range(1, 400):
        if gate.fault:
            break
        with contextlib.suppress(StateError):
            take(gate, k * PERIOD, **{**state, "q": state["q"] + moves * math.sin(0.01 * k)})
    assert "are not those of the angles" in gate.fault


def test_consecutive_jumps_of_the_base_latch() -> None:
    gate, state = accepted_body()
    for k in range(5):
        far = {**state, "place": state["place"] + [5.0 + k, 0.0, 0.0]}
        with pytest.raises(StateError, match="jump"):
            take(gate, (k + 1) * PERIOD, **far)
    with pytest.raises(StateError, match="in a row"):
        take(gate, 9 * PERIOD, **state)
