"""Which measurements of the inertial sensor a controller uses, and what instead of the others."""

from __future__ import annotations

import math

import numpy as np
import pytest
from gates import DT, MS, PERIOD, at, gate_of
from stepped_time import SteppedTime

from dqwalk_ros.nodes.inertial_gate import Felt, InertialGate
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.errors import StateError

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
