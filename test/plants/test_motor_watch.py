"""Limits of the motor watch: each fault begins and ends exactly at the configured value."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from dqwalk_ros.config import PoppyConfig
from dqwalk_ros.plants.poppy.dynamixel import Registers
from dqwalk_ros.plants.poppy.motor_watch import Measured, MotorWatch, Part, _joined
from dqwalk_ros.plants.servo_goals import JUMPS

NAMES = ("hip", "knee", "ankle")
MAX_AGE = 0.125
HOT, LOW, LOAD, LEAD, BLOCKED = 64.0, 10.0, 96.0, 0.25, 1.0
GAIN = 127
BEYOND_LEAD = 0.95 * LEAD + 1e-9
LEADS = np.array([1.0, LEAD, 1.0])


class Motors:
    """Three motors on one bus, whose measurements and registers a test sets; now is the time of their clock [s]."""

    def __init__(self) -> None:
        self.now = 1.0
        self.bus = SimpleNamespace(
            name="lower", ids=[1, 2, 3], lost="", cause=["does not answer"] * 3, error=[0] * 3, registers=[None] * 3
        )
        config = PoppyConfig(hot=HOT, low_voltage=LOW, max_load=LOAD, blocked_after=BLOCKED)
        self.watch = MotorWatch(NAMES, [Part(self.bus, np.arange(3))], config, MAX_AGE)
        self.measured = Measured(
            np.zeros(3), np.zeros(3), np.full(3, self.now), np.zeros(3, np.intp), np.zeros(3), np.zeros(3, np.bool_)
        )
        self.goal = np.zeros(3)
        for i in range(3):
            self.read(i)

    def read(self, i: int, **changed: object) -> None:
        """Read the registers of a motor now."""
        values = {"torque": True, "gain": GAIN, "goal": 0, "torque_limit": 1023, "voltage": 12.0, "temperature": 40.0}
        self.bus.registers[i] = Registers(**{**values, **changed}, at=self.now)

    def look(self, seconds: float = 0.0, *, on: bool = True, fresh: bool = True) -> dict[str, str]:
        """Let time pass, look at the motors, and return the faults."""
        self.now += seconds
        if fresh:
            self.measured.at[:] = self.now
        self.watch.look(self.now, self.measured, self.goal if on else None, LEADS, np.full(3, GAIN))
        return self.watch.faults

    def look_after(self, i: int, **changed: object) -> dict[str, str]:
        """Read a motor's registers a little later, look, and return the faults."""
        self.now += 0.25
        self.read(i, **changed)
        return self.look()


@pytest.fixture
def motors() -> Motors:
    motors = Motors()
    assert not motors.look()
    return motors


def test_an_angle_is_old_above_its_maximum_age(motors: Motors) -> None:
    assert not motors.look(MAX_AGE, fresh=False)
    assert "every motor does not answer" in motors.look(2.0**-20, fresh=False)["silent/lower"]
    motors.bus.cause = [""] * 3  # each reply was good, the last one long ago
    assert "not read for 0.25 s; is this computer too busy" in motors.look(0.125, fresh=False)["silent/lower"]
    motors.measured.jumps[:] = 1
    assert "sends implausible angles" in motors.look(fresh=False)["silent/hip"]


def test_motors_with_different_causes_are_named_one_by_one(motors: Motors) -> None:
    motors.bus.cause = ["does not answer", "sends a damaged reply", ""]
    faults = motors.look(0.25, fresh=False)
    assert "hip (motor 1, lower bus) does not answer" in faults["silent/hip"]
    assert "knee (motor 2, lower bus) sends a damaged reply" in faults["silent/knee"]
    assert "ankle (motor 3, lower bus) sends implausible angles" in faults["silent/ankle"]


def test_one_silent_motor_is_named_although_its_cause_is_the_only_one(motors: Motors) -> None:
    motors.measured.at[1] = motors.now - 1.0
    assert list(motors.look(fresh=False)) == ["silent/knee"]


def test_a_timeout_lasts_after_one_second(motors: Motors) -> None:
    motors.look(0.25, fresh=False)
    assert not motors.look(1.0, fresh=False).keys() & motors.watch.lasting.keys()
    assert motors.look(2.0**-20, fresh=False)["silent/lower"].endswith("then ~/activate")
    motors.look()
    assert "silent/lower" in motors.watch.faults, "only an activation ends it"
    motors.watch.forget()
    assert not motors.watch.lasting


def test_a_timeout_without_torque_does_not_last(motors: Motors) -> None:
    for _ in range(10):
        motors.look(0.5, on=False, fresh=False)
    assert motors.watch.passing
    assert not motors.watch.lasting


def test_the_time_of_a_timeout_starts_anew_after_an_answer(motors: Motors) -> None:
    for _ in range(5):
        motors.look(0.75, fresh=False)
        motors.look()
    assert not motors.watch.lasting


def test_a_port_that_is_gone_requires_an_activation_at_once(motors: Motors) -> None:
    motors.bus.lost = "the port is gone: x"
    assert "plug it in" in motors.look()["silent/lower"]
    assert "silent/lower" in motors.watch.lasting


def test_after_a_timeout_only_the_motors_concerned_are_read_before_motion(motors: Motors) -> None:
    motors.measured.at[1] = motors.now - 1.0
    motors.look(fresh=False)
    assert motors.watch.unsure.tolist() == [False, True, False]
    assert motors.look() == {"silent": "knee: being checked after a timeout"}
    assert motors.look_after(0) == {"silent": "knee: being checked after a timeout"}
    assert not motors.look_after(1)
    assert not motors.watch.unsure.any()


def test_a_motor_is_unsure_while_another_is_silent(motors: Motors) -> None:
    """A second timeout does not clear the first."""
    motors.measured.at[1] = motors.now - 1.0
    motors.look(fresh=False)
    motors.measured.at[:] = motors.now, motors.now, motors.now - 1.0
    motors.look(fresh=False)
    assert motors.watch.unsure.tolist() == [False, True, True]


def test_registers_that_were_read_before_the_timeout_confirm_nothing(motors: Motors) -> None:
    motors.measured.at[1] = motors.now - 1.0
    motors.look(fresh=False)
    for _ in range(3):
        motors.look()
    assert motors.watch.unsure[1]


def test_the_first_registers_of_a_motor_confirm_it() -> None:
    motors = Motors()
    motors.watch.unsure[:] = True
    assert not motors.look()


def test_a_joint_has_jumped_after_the_configured_number_of_angles(motors: Motors) -> None:
    motors.measured.jumps[2] = JUMPS - 1
    assert not motors.look()
    motors.measured.jumps[2] = JUMPS
    assert "ankle has jumped" in motors.look()["jump/ankle"]


def test_a_joint_without_torque_may_be_turned_by_hand(motors: Motors) -> None:
    motors.measured.jumps[2] = JUMPS
    assert not motors.look(on=False)


@pytest.mark.parametrize("bits", [4, 32, 4 | 32, 4 | 64])
def test_a_torque_that_a_motor_switched_off_is_a_fault_only_if_it_was_on(motors: Motors, bits: int) -> None:
    motors.bus.error[0] = bits
    assert not motors.look(on=False)
    assert "hip reports" in motors.look()["error/hip"]


@pytest.mark.parametrize("bits", [2, 8, 16, 64])
def test_other_error_bits_do_not_mean_lost_torque(motors: Motors, bits: int) -> None:
    motors.bus.error[0] = bits
    assert not motors.look()


@pytest.mark.parametrize("changed", [{"torque": False}, {"torque_limit": 0}, {"gain": 32}])
def test_one_reading_of_lost_torque_or_gain_is_a_fault(motors: Motors, changed: dict[str, int]) -> None:
    motors.now += 0.25
    motors.read(1, **changed)
    assert not motors.look(on=False)
    assert "knee has lost its torque" in motors.look_after(1, **changed)["torque/knee"]


def test_any_gain_is_accepted_from_a_motor_whose_gain_is_not_set(motors: Motors) -> None:
    motors.now += 0.25
    motors.read(1, gain=32)
    motors.measured.at[:] = motors.now
    motors.watch.look(motors.now, motors.measured, motors.goal, LEADS, np.full(3, -1))
    assert not motors.watch.faults


def test_a_motor_is_hot_at_its_second_reading_above_the_limit_until_it_is_5_kelvin_cooler(motors: Motors) -> None:
    above = math.nextafter(HOT, math.inf)
    assert not motors.look_after(0, temperature=HOT)
    assert not motors.look_after(0, temperature=HOT), "exactly at the limit"
    assert not motors.look_after(0, temperature=above)
    assert not motors.look(), "the same reading does not count twice"
    assert "too hot" in motors.look_after(0, temperature=above)["hot/hip"]
    assert motors.look_after(0, temperature=HOT - 4.9)
    assert not motors.look_after(0, temperature=HOT - 5.0)
    assert not motors.look_after(0, temperature=above), "one reading"
    assert not motors.look_after(0), "readings in between end the count"
    assert not motors.look_after(0, temperature=above)


@pytest.mark.parametrize(
    ("what", "limit", "step", "says"),
    [("temperature", HOT, -5.0, "the robot holds at 64"), ("voltage", LOW, 0.5, "the robot holds at 10")],
)
def test_before_a_fault_there_is_a_warning_at_the_second_reading(
    motors: Motors, what: str, limit: float, step: float, says: str
) -> None:
    """It begins 5 K or half a volt before the limit, and ends as much before that."""
    near = math.nextafter(limit + step, limit)

    def warned(value: float) -> str:
        assert not motors.look_after(0, **{what: value})
        return "; ".join(motors.watch.warnings.values())

    assert not warned(limit + step)
    assert not warned(limit + step), "exactly at the limit"
    assert not warned(near)
    assert says in warned(near)
    assert says in warned(limit + 1.9 * step)
    assert not warned(limit + 2.0 * step)


def test_the_voltage_is_low_at_its_second_reading_below_the_limit_until_it_is_half_a_volt_higher(
    motors: Motors,
) -> None:
    below = math.nextafter(LOW, 0.0)
    assert not motors.look_after(0, voltage=LOW)
    assert not motors.look_after(0, voltage=LOW), "exactly at the limit"
    assert not motors.look_after(0, voltage=below)
    assert not motors.look(), "the same reading does not count twice"
    assert "too little" in motors.look_after(0, voltage=below)["voltage/hip"]
    assert motors.look_after(0, voltage=LOW + 0.4)
    assert not motors.look_after(0, voltage=LOW + 0.5)


def test_what_is_said_of_several_joints_is_said_once() -> None:
    """A weak battery is that of every motor."""
    found = {"torque/a": "a has lost its torque", "hot/b": "b is at 71 degC", "hot/c": "c is at 72 degC", "x": "y"}
    assert _joined(found) == "a has lost its torque; b is at 71 degC (also c); y"


def test_the_voltage_error_of_a_motor_counts_as_low_voltage(motors: Motors) -> None:
    motors.bus.error[0] = 1
    assert not motors.look_after(0)
    assert "outside of the limits in its registers" in motors.look_after(0)["voltage/hip"]
    assert "too little" in motors.look_after(0, voltage=LOW - 1.0)["voltage/hip"]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_joint_behind_its_goal_for_too_long_is_blocked(motors: Motors, side: float) -> None:
    motors.goal[1] = side * 0.95 * LEAD
    motors.look()
    assert not motors.look(2.0), "exactly at the limit"
    motors.goal[1] = side * BEYOND_LEAD
    assert not motors.look()
    assert not motors.look(BLOCKED)
    assert "knee cannot follow: 14 deg behind" in motors.look(2.0**-20)["blocked/knee"]


@pytest.mark.parametrize("load", [LOAD, -LOAD])
def test_a_joint_at_full_load_for_too_long_is_blocked(motors: Motors, load: float) -> None:
    motors.measured.load[1] = load * 0.99
    motors.look()
    assert not motors.look(2.0)
    motors.measured.load[1] = load
    assert not motors.look()
    assert "at 96 % load" in motors.look(1.1)["blocked/knee"]


def test_a_joint_that_follows_in_between_is_not_blocked(motors: Motors) -> None:
    for _ in range(5):
        motors.goal[1] = BEYOND_LEAD
        motors.look(0.4)
        motors.look(0.4)
        motors.goal[1] = 0.0
        motors.look(0.4)
    assert not motors.watch.faults


def test_the_time_of_full_load_before_an_activation_does_not_count(motors: Motors) -> None:
    motors.measured.load[1] = LOAD
    motors.look()
    motors.look(0.75)
    motors.watch.forget()
    assert not motors.look(0.75)
    assert motors.look(1.1)


def test_the_message_of_a_blocked_joint_keeps_the_first_values(motors: Motors) -> None:
    motors.measured.load[1] = LOAD
    motors.look()
    motors.look(1.1)
    motors.measured.load[1] = 1000.0
    assert "at 96 % load" in motors.look()["blocked/knee"]


def test_a_runaway_is_named_once_and_not_as_lost_torque_or_blocked(motors: Motors) -> None:
    motors.measured.runaway[1], motors.goal[1] = True, 2.0
    motors.look()
    motors.look_after(1, torque=False)
    faults = motors.look(2.0)
    assert list(faults) == ["runaway/knee"]
    assert "knee moved away from its goal at full torque, which is now off" in faults["runaway/knee"]
