"""Which states a controller accepts: every number is compared with what is possible, on a test clock."""

from __future__ import annotations

import contextlib
import dataclasses
import math

import numpy as np
import pytest
from stepped_time import SteppedTime

from dqwalk_ros.config import load
from dqwalk_ros.nodes.state_gate import BodyGate, Felt, InertialGate, StateGate
from dqwalk_ros.paper.state import State
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.robot.limits import FASTEST, outside_limits
from dqwalk_ros.robot.model import RobotModel, load_model
from dqwalk_ros.support.errors import StateError

DT = 0.005
MS = 1_000_000
PERIOD = 5 * MS


def at(q: np.ndarray, dq: np.ndarray | None = None) -> State:
    return State(0.0, q, dq)


# ---------------------------------------------------------------------- states


def gate_of(model: RobotModel, clock: SteppedTime, **options: object) -> StateGate:
    return StateGate(model, DT, lambda: 0.1, clock=clock, **options)  # type: ignore[arg-type]


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


# ---------------------------------------------------------------------- velocities


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


# ---------------------------------------------------------------------- clocks that are set


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


# ---------------------------------------------------------------------- inertial sensor

TURNING = np.array([0.7, -0.4, 0.3])


def felt(time: float, *, tilt: float = 0.0, **other: object) -> Felt:
    """Return the measurement of a sensor that turns by `TURNING`, after a time [s], with an error [rad]."""
    angle = time * float(np.linalg.norm(TURNING))
    axis = TURNING / np.linalg.norm(TURNING)
    up = np.array([0.0, 0.0, 1.0])
    up = (
        math.cos(angle) * up - math.sin(angle) * np.cross(axis, up) + (1.0 - math.cos(angle)) * (axis @ up) * axis
    )  # Rodrigues, of a vector that is fixed in the world
    if tilt:
        side = np.cross(up, [1.0, 0.0, 0.0])
        up = math.cos(tilt) * up + math.sin(tilt) * side / np.linalg.norm(side)
    return Felt(up, TURNING.copy(), GRAVITY * up)._replace(**other)


def inertial(count: int = 10) -> InertialGate:
    """Return a gate that has accepted measurements in some periods."""
    gate = InertialGate(3, lambda: 0.1)
    for k in range(count):
        given = felt(k * DT)
        assert gate.use(k * PERIOD, given).up is given.up
    assert not gate.rejected
    return gate


GLITCHES = {
    "vertical": felt(10 * DT, tilt=math.radians(20.0)),
    "a little": felt(10 * DT, tilt=0.16),
    "upside down": felt(10 * DT, tilt=math.pi),
    "gyro": felt(10 * DT, gyro=np.array([0.0, 100.0, 0.0])),
    "possible gyro": felt(10 * DT, gyro=TURNING + 8.0 * np.eye(3)[2]),
    "absurd": felt(10 * DT, gyro=np.full(3, 1e300), acceleration=np.full(3, 1e30)),
    "invalid": StateError("imu: not a unit quaternion"),
}


@pytest.mark.parametrize("glitch", GLITCHES.values(), ids=list(GLITCHES))
def test_an_impossible_inertial_measurement_is_replaced_by_the_last_one_turned(glitch: Felt | StateError) -> None:
    gate = inertial()
    used = gate.use(10 * PERIOD, glitch)
    np.testing.assert_allclose(used.up, felt(10 * DT).up, atol=1e-4)  # 0.006 degrees
    np.testing.assert_array_equal(used.gyro, TURNING)
    assert gate.rejected == 1 + (
        not isinstance(glitch, StateError) and glitch.acceleration is not None and glitch.acceleration[0] > 1e3
    )
    assert gate.reason
    assert gate.use(10 * PERIOD, glitch) is used  # given again with another state: counted once
    given = felt(11 * DT)
    assert gate.use(11 * PERIOD, given).up is given.up
    assert not gate.reason
    assert not gate.impossible.count


@pytest.mark.parametrize("glitch", GLITCHES.values(), ids=list(GLITCHES))
def test_three_impossible_inertial_measurements_in_a_row_are_a_fault_with_its_name(glitch: Felt | StateError) -> None:
    gate = inertial()
    for k in (10, 11):
        np.testing.assert_allclose(gate.use(k * PERIOD, glitch).up, felt(k * DT).up, atol=1e-3)
    with pytest.raises(StateError, match="3 in a row") as error:
        gate.use(12 * PERIOD, glitch)
    names = (
        "the vertical of the inertial sensor jumped by",
        "the angular velocity of the inertial sensor jumped by",
        "the inertial sensor turns at",
        "imu: not a unit quaternion",
    )
    assert str(error.value).startswith(names)
    assert gate.impossible
    if isinstance(glitch, Felt):  # whether the robot lies can still be seen
        assert gate.use(13 * PERIOD, glitch).up is glitch.up
        np.testing.assert_array_equal(gate.use(13 * PERIOD, glitch).gyro, np.zeros(3))
    gate.reset()
    given = felt(14 * DT)
    assert gate.use(14 * PERIOD, given).up is given.up


@pytest.mark.parametrize("off", [-90 * MS, -15 * MS, -1 * MS, 20 * MS, 85 * MS])
@pytest.mark.parametrize("name", ["vertical", "upside down", "gyro", "possible gyro"])
def test_a_wrong_stamp_makes_no_inertial_measurement_possible(
    model: RobotModel, clock: SteppedTime, name: str, off: int
) -> None:
    """One that is out of order is compared with the last one, too; a stamp ahead allows no more change."""
    gate = gate_of(model, clock)
    for k in range(10):
        gate.inertial.use(k * PERIOD, felt(k * DT))
        gate.accept(k * PERIOD, at(np.zeros(model.n)))
        clock.now += DT
    used = gate.inertial.use(9 * PERIOD + off, GLITCHES[name])
    assert gate.inertial.rejected == 1
    np.testing.assert_allclose(used.up, felt(10 * DT).up, atol=0.02)
    for k in (10, 11):
        given = felt(k * DT)
        assert gate.inertial.use(k * PERIOD, given).up is given.up


@pytest.mark.parametrize("off", [-90 * MS, -15 * MS, 0, 85 * MS])
def test_a_measurement_that_is_late_or_early_is_used(model: RobotModel, clock: SteppedTime, off: int) -> None:
    gate = gate_of(model, clock)
    for k in range(10):
        gate.inertial.use(k * PERIOD, felt(k * DT))
        gate.accept(k * PERIOD, at(np.zeros(model.n)))
        clock.now += DT
    for stamp in (9 * PERIOD + off, 11 * PERIOD):
        given = felt(1e-9 * stamp)
        assert gate.inertial.use(stamp, given).up is given.up or stamp == 9 * PERIOD


def test_a_fault_of_the_inertial_sensor_is_one_of_the_states(model: RobotModel, clock: SteppedTime) -> None:
    gate = gate_of(model, clock, jumps=1)
    assert not gate.fault
    gate.inertial.use(0, felt(0.0))
    with pytest.raises(StateError, match="1 in a row"):
        gate.inertial.use(PERIOD, felt(DT, tilt=1.0))
    assert gate.fault.startswith("the vertical")
    gate.reset()
    assert not gate.fault


def test_before_the_first_inertial_measurement_nothing_can_replace_one() -> None:
    gate = InertialGate(3, lambda: 0.1)
    for k in range(5):
        with pytest.raises(StateError, match="turns at 100 rad/s, beyond 35 rad/s"):
            gate.use(k * PERIOD, felt(0.0, gyro=np.array([100.0, 0.0, 0.0])))
    assert not gate.impossible
    gate.use(6 * PERIOD, felt(0.0, gyro=np.array([34.0, 0.0, 0.0])))


def test_a_slow_inertial_sensor_and_a_fall_are_possible() -> None:
    gate, up = InertialGate(3, lambda: 0.1), np.array([0.0, 0.0, 1.0])
    for k in range(40):  # it falls, ever faster, with noise
        rate, angle = 0.2 * k, 0.1 * k * k * 0.02
        up = np.array([0.0, math.sin(angle), math.cos(angle)])
        noise = 0.02 * np.array([0.0, (-1.0) ** k, 0.0])
        gate.use(4 * k * PERIOD, Felt(up + noise, np.array([rate, 0.0, 0.0]), None))
    assert not gate.rejected


@pytest.mark.parametrize(("part", "possible"), [(0.98, True), (1.02, False)])
def test_inertial_measurements_change_as_time_allows_whatever_the_stamps_say(
    model: RobotModel, clock: SteppedTime, part: float, possible: bool
) -> None:
    """The time is that between the stamps, at most that since the last state and two periods."""
    most = 3 * DT  # the stamps say four periods
    faster = TURNING + part * (3.0 + 200.0 * most) * np.eye(3)[1]
    up = turned(felt(0.0).up, 0.5 * (TURNING + faster), 4 * DT)
    leaning = felt(4 * DT, tilt=2.0 * math.asin(0.5 * part * (0.1 + 2.0 * most)))
    for given in (Felt(up, faster, None), leaning):
        gate = gate_of(model, clock)
        gate.inertial.use(0, felt(0.0))
        gate.accept(0, at(np.zeros(model.n)))
        clock.now += DT
        gate.inertial.use(4 * PERIOD, given)
        assert (gate.inertial.reason == "") == possible, gate.inertial.reason


def turned(up: np.ndarray, omega: np.ndarray, time: float) -> np.ndarray:
    """Return a vertical that has turned in a frame with an angular velocity, to first order, as a unit vector."""
    out = up + time * np.cross(up, omega)
    return out / np.linalg.norm(out)


def test_a_vertical_is_turned_about_any_axis_and_remains_a_unit_vector() -> None:
    omega, up = np.array([5.0, -7.0, 11.0]), np.array([0.48, -0.6, 0.64])
    gate = InertialGate(3, lambda: 0.1)
    gate.use(0, Felt(up, omega, None))
    np.testing.assert_allclose(gate.use(80 * MS, GLITCHES["invalid"]).up, turned(up, omega, 0.08), atol=1e-12)


def test_after_a_gap_any_vertical_is_possible() -> None:
    gate = inertial()
    given = felt(10 * DT, tilt=1.0)
    assert gate.use(9 * PERIOD + 101 * MS, given).up is given.up
    gate = inertial()
    with pytest.raises(StateError, match="not a unit"):  # nothing to replace it by
        gate.use(9 * PERIOD + 101 * MS, GLITCHES["invalid"])


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_one_impossible_acceleration_is_replaced_and_more_are_left_out(axis: int, sign: float) -> None:
    """The walk does not use it."""
    gate = inertial()
    strong = sign * 1e4 * np.eye(3)[axis]
    for k, expected in ((10, felt(9 * DT).acceleration), (11, felt(9 * DT).acceleration), (12, None), (13, None)):
        used = gate.use(k * PERIOD, felt(k * DT, acceleration=strong))
        np.testing.assert_allclose(used.up, felt(k * DT).up)
        if expected is None:
            assert used.acceleration is None
        else:
            np.testing.assert_allclose(used.acceleration, expected)
        assert bool(gate.warning) == (k >= 12)
    assert "an acceleration of 1e+04 m/s^2" in gate.warning
    assert not gate.impossible
    beyond = felt(10 * DT, acceleration=1.01 * sign * 16 * GRAVITY * np.eye(3)[axis])
    assert inertial().use(10 * PERIOD, beyond).acceleration is not beyond.acceleration
    bearable = felt(14 * DT, acceleration=0.99 * 16 * GRAVITY * np.ones(3))
    assert inertial().use(10 * PERIOD, bearable).acceleration is bearable.acceleration
    assert gate.use(14 * PERIOD, felt(14 * DT, acceleration=None)).acceleration is None


# ---------------------------------------------------------------------- whole bodies


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
