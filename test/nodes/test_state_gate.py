"""Which states a controller accepts: every number is compared with what is possible, on a test clock."""

from __future__ import annotations

import contextlib
import dataclasses
import math

import numpy as np
import pytest
from gates import DT, PERIOD, at, gate_of
from stepped_time import SteppedTime

from dqwalk_ros.nodes.state_gate import StateGate
from dqwalk_ros.robot.limits import FASTEST, outside_limits
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.errors import StateError


def test_states_of_a_walk_are_accepted(model: RobotModel, clock: SteppedTime) -> None:
    gate = gate_of(model, clock)
    for k in range(100):
        assert gate.is_new(k * PERIOD)
        gate.accept(k * PERIOD, at(0.9 * DT * k * np.minimum(model.velocity_max, 0.5 * model.q_max / (100 * DT))))
        clock.now += DT
    assert gate.overtaken == 0


def test_a_spike_is_rejected_and_does_not_feed_the_watchdog(model: RobotModel, clock: SteppedTime) -> None:
    gate = gate_of(model, clock)
    zero = np.zeros(model.n)
    gate.accept(0, at(zero))
    clock.now += 0.06
    spike = zero.copy()
    spike[3] = 0.9
    with pytest.raises(StateError, match=rf"jump.*{model.joint_names[3]} by 0.9 rad"):
        gate.accept(PERIOD, at(spike))
    clock.now += 0.06
    assert gate.watchdog.silent
    gate.accept(2 * PERIOD, at(zero))  # valid; the spike had no effect
    assert not gate.watchdog.silent


def test_consecutive_jumps_latch_until_reset(model: RobotModel, clock: SteppedTime) -> None:
    gate = gate_of(model, clock, jumps=3)
    zero, far = np.zeros(model.n), 0.4 * np.eye(model.n)[1] * np.sign(model.q_max[1] + model.q_min[1])
    gate.accept(0, at(zero))
    for k in range(1, 4):
        clock.now += DT
        with pytest.raises(StateError, match="jump"):
            gate.accept(k * PERIOD, at(far))
    with pytest.raises(StateError, match="reset"):
        gate.accept(4 * PERIOD, at(zero))
    gate.reset()
    gate.accept(5 * PERIOD, at(far))


def test_a_persistent_jump_is_never_accepted(model: RobotModel, clock: SteppedTime) -> None:
    """The time during which it is rejected does not count as time in which the joint could move."""
    gate = gate_of(model, clock, jumps=1000)
    gate.accept(0, at(np.zeros(model.n)))
    for k in range(1, 100):
        clock.now += DT
        with pytest.raises(StateError, match="jump"):
            gate.accept(k * PERIOD, at(0.3 * np.eye(model.n)[0]))
    clock.now += DT
    gate.accept(100 * PERIOD, at(np.zeros(model.n)))


def test_a_stamp_in_the_future_does_not_allow_a_jump(model: RobotModel, clock: SteppedTime) -> None:
    gate = gate_of(model, clock)
    gate.accept(0, at(np.zeros(model.n)))
    clock.now += DT
    with pytest.raises(StateError, match="jump"):
        gate.accept(100_000_000_000, at(np.full(model.n, 0.05) + 0.95 * np.eye(model.n)[2]))


def test_after_a_long_silence_another_posture_is_accepted(model: RobotModel, clock: SteppedTime) -> None:
    gate = gate_of(model, clock)
    gate.accept(0, at(np.zeros(model.n)))
    clock.now += 1.0
    gate.accept(PERIOD, at(0.3 * np.eye(model.n)[0]))


def test_in_lockstep_jumps_are_judged_by_stamps_not_by_the_clock(model: RobotModel, clock: SteppedTime) -> None:
    gate = gate_of(model, clock, by_stamp=True)
    gate.accept(0, at(np.zeros(model.n)))
    clock.now += 100.0
    with pytest.raises(StateError, match="jump"):
        gate.accept(PERIOD, at(0.3 * np.eye(model.n)[0]))
    gate.reset()
    gate.accept(200 * PERIOD, at(np.zeros(model.n)))  # only the elapsed time counts, not the stamp itself
    with pytest.raises(StateError, match="jump"):
        gate.accept(201 * PERIOD, at(0.3 * np.eye(model.n)[0]))


@pytest.mark.parametrize("beyond", [1e-9, 1e-4, 0.01, 0.0999])
def test_joints_slightly_outside_their_limits_are_accepted(
    model: RobotModel, clock: SteppedTime, beyond: float
) -> None:
    for i in range(model.n):
        q = np.zeros(model.n)
        q[i] = model.q_max[i] + beyond
        gate_of(model, clock).accept(0, at(q))
        q[i] = model.q_min[i] - beyond
        gate_of(model, clock).accept(0, at(q))


@pytest.mark.parametrize("beyond", [0.101, 0.5, 1e6])
def test_joints_far_outside_their_limits_are_rejected_by_name(
    model: RobotModel, clock: SteppedTime, beyond: float
) -> None:
    for i, name in enumerate(model.joint_names):
        for sign, limit in ((1.0, model.q_max[i]), (-1.0, model.q_min[i])):
            q = np.zeros(model.n)
            q[i] = limit + sign * beyond
            with pytest.raises(StateError, match=rf"outside the joint limits: {name} by"):
                gate_of(model, clock).accept(0, at(q))
            assert name in outside_limits(q, model, 0.1)


def test_states_out_of_order_are_dropped_until_the_watchdog_times_out(model: RobotModel, clock: SteppedTime) -> None:
    gate = gate_of(model, clock)
    gate.accept(10 * PERIOD, at(np.zeros(model.n)))
    assert not gate.is_new(10 * PERIOD)
    assert not gate.is_new(9 * PERIOD)
    assert gate.is_new(11 * PERIOD)
    assert gate.overtaken == 2
    clock.now += 0.11  # no newer state: the plant's clock was set back
    assert gate.is_new(3 * PERIOD)


@pytest.mark.parametrize("stamp", [0, 1000 * PERIOD])
def test_stamps_that_do_not_advance_are_not_a_clock_set_back(model: RobotModel, clock: SteppedTime, stamp: int) -> None:
    gate, zero = gate_of(model, clock), np.zeros(model.n)
    assert gate.is_new(stamp)
    gate.accept(stamp, at(zero))
    for k in range(1, 50):
        clock.now += DT
        assert not gate.is_new(stamp)
        assert bool(gate.stuck) == (k >= gate.repeats)
    assert gate.watchdog.silent
    assert f"the stamp {1e-9 * stamp:g}: set header.stamp" in gate.stuck
    assert gate.is_new(stamp + PERIOD)
    assert not gate.stuck
    assert gate.is_new(stamp - PERIOD)  # after the timeout


def test_states_that_arrive_twice_are_no_fault(model: RobotModel, clock: SteppedTime) -> None:
    gate, zero = gate_of(model, clock), np.zeros(model.n)
    for k in range(20):
        assert gate.is_new(k * PERIOD)
        gate.accept(k * PERIOD, at(zero))
        assert not gate.is_new(k * PERIOD)
        assert not gate.stuck


@pytest.mark.parametrize(("part", "possible"), [(0.99, True), (1.01, False)])
@pytest.mark.parametrize("periods", [1, 4])
def test_what_is_possible_follows_from_the_time_and_the_velocity_limits(
    model: RobotModel, clock: SteppedTime, periods: int, part: float, possible: bool
) -> None:
    """An angle by the time and one more period; a velocity by the mean one since the last state."""
    fastest = model.velocity_max * np.eye(model.n)[0]
    for angle, velocity in (
        (part * (periods + 1) * DT * fastest, None),
        (0.5 * periods * DT * fastest, (0.5 - part) * fastest),
        (0.5 * periods * DT * fastest, (0.5 + part) * fastest),
    ):
        gate = gate_of(model, clock, by_stamp=True)
        gate.accept(0, at(np.zeros(model.n)))
        expected = contextlib.nullcontext() if possible else pytest.raises(StateError, match=model.joint_names[0])
        with expected:
            gate.accept(periods * PERIOD, at(angle, velocity))


@pytest.mark.parametrize("speed", [100.0, -15.0, 1e300])
@pytest.mark.parametrize("known", [True, False])
def test_a_velocity_that_is_not_that_of_the_angle_is_rejected_by_name(
    model: RobotModel, clock: SteppedTime, known: bool, speed: float
) -> None:
    gate, zero = gate_of(model, clock, jumps=3), np.zeros(model.n)
    if known:
        gate.accept(0, at(zero, zero))
    for k in range(1, 4):
        clock.now += DT
        with pytest.raises(
            StateError, match=rf"not those of the angles: {model.joint_names[2]} {speed:.3g}".replace("+", r"\+")
        ):
            gate.accept(k * PERIOD, at(zero, speed * np.eye(model.n)[2]))
    assert bool(gate.fault) == known  # before the first state nothing moves
    if not known:
        gate.accept(4 * PERIOD, at(zero, zero))


def test_velocities_of_moving_joints_are_accepted(model: RobotModel, clock: SteppedTime) -> None:
    """Also where they are filtered, late or noisy, and where states are lost."""
    gate, speed = gate_of(model, clock), 0.9 * model.velocity_max
    gate.accept(0, at(np.zeros(model.n), speed))
    for k, velocity in ((1, speed), (2, 0.2 * speed), (3, 1.05 * speed), (6, speed), (7, 0.0 * speed)):
        gate.accept(k * PERIOD, at(0.2 * k * DT * speed, velocity))
    assert not gate.impossible.count


WRONG = {
    "zero": lambda k, dq, before: 0.0 * dq,
    "in rpm": lambda k, dq, before: 60.0 / (2.0 * math.pi) * dq,
    "of the other sign": lambda k, dq, before: -dq,
    "constant": lambda k, dq, before: 0.0 * dq + 0.7,
    "constant, of one joint": lambda k, dq, before: dq + np.eye(len(dq))[3],
    "too small": lambda k, dq, before: 0.1 * dq,
    "too large": lambda k, dq, before: 5.0 * dq,
}


RIGHT = {
    "exact": lambda k, dq, before: dq,
    "rather small": lambda k, dq, before: 0.4 * dq,
    "rather large": lambda k, dq, before: 3.2 * dq,
    "late by 30 ms": lambda k, dq, before: before(0.03),
    "noisy": lambda k, dq, before: dq + 0.3 * math.sin(k**2),
    "wrong once in 0.2 s": lambda k, dq, before: dq if k % 40 != 10 else 0.0 * dq + 6.0,
    "in steps of 0.1 rad/s": lambda k, dq, before: np.round(dq, 1),
}


@pytest.mark.parametrize("kind", [*WRONG, *RIGHT])
def test_velocities_that_are_not_the_rates_of_the_angles_are_not_used(
    model: RobotModel, clock: SteppedTime, kind: str
) -> None:
    """Such as in another unit: the robot would lose its balance; without velocities it walks as well."""
    gate, amplitude, used = gate_of(model, clock), 0.1 * np.cos(np.arange(model.n)), []

    def rate(t: float) -> np.ndarray:
        return amplitude * 6.0 * math.cos(6.0 * t) if t > 1.0 else np.zeros(model.n)  # as a leg that swings

    for k in range(400):
        t = DT * k
        given = (WRONG | RIGHT)[kind](k, rate(t), lambda late: rate(t - late))  # noqa: B023
        q = amplitude * (math.sin(6.0 * t) - math.sin(6.0)) * (t > 1.0)
        used.append(gate.accept(k * PERIOD, at(q, given)).dq is not None)
        clock.now += DT
    if kind in RIGHT:
        assert all(used) or kind == "wrong once in 0.2 s"
        assert not gate.velocities.wrong
        assert any(used[-round(0.2 / DT) :])
        return
    if kind.startswith("constant"):  # from the first state on: a robot that is balanced by them falls within 0.3 s
        assert sum(used) * DT < 0.08
    assert not any(used[round(1.8 / DT) :])
    assert used == sorted(used, reverse=True)  # never again
    assert "the velocities of joint_states are not those of the angles" in gate.velocities.wrong.reason
    gate.reset()
    assert gate.accept(0, at(q, 0.0 * q)).dq is not None


def test_a_joint_without_a_velocity_limit_has_one(model: RobotModel, clock: SteppedTime) -> None:
    free, zero = dataclasses.replace(model, velocity_max=np.full(model.n, np.inf)), np.zeros(model.n)
    gate = gate_of(free, clock)
    gate.accept(0, at(zero, np.full(model.n, 0.99 * FASTEST)))
    with pytest.raises(StateError, match="not those of the angles"):
        gate.accept(PERIOD, at(zero, np.full(model.n, 1.01 * FASTEST)))


def test_a_state_that_follows_too_soon_is_ignored(model: RobotModel, clock: SteppedTime) -> None:
    """Velocities are differences: one step of an encoder in 2 us would be 750 rad/s."""
    gate = gate_of(model, clock)
    gate.accept(0, at(np.zeros(model.n)))
    assert not gate.is_new(2000)
    assert not gate.is_new(round(0.24 * PERIOD))
    assert gate.overtaken == 2
    assert gate.is_new(round(0.26 * PERIOD))
    clock.now += 1.0
    assert gate.is_new(2000)  # the first one after a timeout


def test_angles_outside_their_limits_latch_once_the_walk_is_under_way(model: RobotModel, clock: SteppedTime) -> None:
    gate, far = gate_of(model, clock, jumps=2), at(model.q_max + 1.0)
    for _ in range(5):
        with pytest.raises(StateError, match="outside the joint limits"):
            gate.accept(0, far)
    gate.accept(PERIOD, at(np.zeros(model.n)))
    for why in ("tolerated", "2 in a row", "2 in a row"):
        with pytest.raises(StateError, match=why):
            gate.accept(2 * PERIOD, far)


def times_of(gate: StateGate, clock: SteppedTime, n: int, stamps: list[int]) -> list[float]:
    """Return the times of the walk of those states that are accepted."""
    times = []
    for stamp in stamps:
        clock.now += DT
        if gate.is_new(stamp):
            times.append(gate.accept(stamp, at(np.zeros(n))).time)
    return times


@pytest.mark.parametrize("step", [3600.0, -3600.0, 1.8e9, -0.06, 0.2, -2.0])
@pytest.mark.parametrize("epoch", [4000, 1_800_000_000])
def test_a_clock_that_is_set_neither_stops_nor_jumps_the_time_of_the_walk(
    model: RobotModel, clock: SteppedTime, epoch: int, step: float
) -> None:
    gate = gate_of(model, clock)
    first = epoch * 1_000_000_000
    stamps = [first + k * PERIOD for k in range(20)] + [first + round(step * 1e9) + k * PERIOD for k in range(20, 40)]
    times = times_of(gate, clock, model.n, stamps)
    assert len(times) == 38
    assert gate.overtaken == 2
    np.testing.assert_allclose(np.diff(times), np.where(np.arange(37) == 19, 3 * DT, DT), atol=1e-6)
    assert gate.stepped == 0.0  # of the last state


def test_the_step_of_a_clock_is_measured(model: RobotModel, clock: SteppedTime) -> None:
    gate = gate_of(model, clock)
    times_of(gate, clock, model.n, [k * PERIOD for k in range(5)])
    assert gate.stepped == 0.0
    times_of(gate, clock, model.n, [10_000_000_000 + k * PERIOD for k in range(5, 8)])
    assert gate.stepped == pytest.approx(10.0)


@pytest.mark.parametrize("wrong", [0, 1, 10**18, 2**62])
def test_a_single_wrong_stamp_costs_one_state(model: RobotModel, clock: SteppedTime, wrong: int) -> None:
    gate = gate_of(model, clock)
    first = 1_000_000_000_000
    stamps = [wrong if k in (10, 12) else first + k * PERIOD for k in range(30)]
    times = times_of(gate, clock, model.n, stamps)
    np.testing.assert_allclose(times, [1e-9 * stamp for stamp in stamps if stamp != wrong])


def test_states_that_overtake_each_other_are_no_step_of_a_clock(model: RobotModel, clock: SteppedTime) -> None:
    gate = gate_of(model, clock)
    order = [0, 1, 4, 2, 3, 5, 9, 8, 7, 6, 10, 14, 13, 12, 11, 15]
    times = times_of(gate, clock, model.n, [10_000_000_000 + k * PERIOD for k in order])
    np.testing.assert_allclose(np.array(times) - 10.0, [DT * k for k in (0, 1, 4, 5, 9, 10, 14, 15)], atol=1e-9)
