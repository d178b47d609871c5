"""Faults on Poppy's motor buses: the robot stops, the motor is named, and no old angle is published as new."""

from __future__ import annotations

import errno
import os
from types import SimpleNamespace

import numpy as np
import pytest
from dynamixel_bus import BUSES, LOAD, MOTORS, TEMPERATURE, TYPES, VOLTAGE, FaultyServos, Memory
from poppy_rig import CONFIG, DT, MAX_AGE, MODEL, Rig

from dqwalk_ros.plants.poppy.buses import open_buses
from dqwalk_ros.plants.poppy.dynamixel import (
    GAINS,
    GOAL,
    LIMITS,
    TORQUE_ENABLE,
    TORQUE_LIMIT,
    DynamixelBus,
    find_port,
    open_port,
)
from dqwalk_ros.plants.poppy.emulated_servos import EmulatedPort, EmulatedServo
from dqwalk_ros.support.errors import PlantError

KNEE = MOTORS["l_knee_y"].id
READ, SYNC_WRITE, SYNC_READ = 2, 0x83, 0x84
STEP = 0.003
"""Two encoder steps of an MX, and more than half a step of an AX, which the head has [rad]."""


@pytest.fixture
def rig(request: pytest.FixtureRequest) -> Rig:
    """A robot in its first pose."""
    rig = Rig(sync_read=getattr(request, "param", True))
    rig.settle()
    return rig


read_either_way = pytest.mark.parametrize("rig", [True, False], indirect=True, ids=["read at once", "read one by one"])
"""For faults that concern the angles; registers are read one by one in any case."""


def check_holds(rig: Rig, seconds: float = 1.0) -> None:
    """Check that no goal changes although motion is commanded."""
    goals = {name: rig.memory.goal(name) for name in MOTORS}
    rig.run(seconds, u=0.3)
    assert goals == {name: rig.memory.goal(name) for name in MOTORS}


def check_moves(rig: Rig) -> None:
    """Check that a goal follows its command."""
    goal = rig.memory.goal("l_knee_y")
    rig.tick(0.3)
    rig.tick(0.3)
    assert rig.memory.goal("l_knee_y") > goal + 0.003


# ---------------------------------------------------------------------- the bus


def stop_answering(servos: FaultyServos) -> None:
    servos.dead = True


def silence_one_motor(servos: FaultyServos) -> None:
    servos.silent = {KNEE}


def unplug(servos: FaultyServos) -> None:
    servos.unplugged = True


def flip_bits(servos: FaultyServos) -> None:
    servos.damaged = 1.0


def send_garbage(servos: FaultyServos) -> None:
    servos.garbage = 1.0


def send_false_headers(servos: FaultyServos) -> None:
    servos.noise = lambda: bytes([255, 255, 1, 2, 0])


BUS = {
    "the bus is silent": (stop_answering, "lower bus: every motor does not answer; is the power on"),
    "one motor is silent": (silence_one_motor, "l_knee_y (motor 14, lower bus) does not answer; check its cable"),
    "the port is unplugged": (unplug, "lower bus: the port is gone: No such file or directory; plug it in"),
    "one bit of each reply is flipped": (flip_bits, "lower bus: every motor"),
    "replies are random bytes": (send_garbage, "lower bus: every motor"),
    "each reply follows the beginning of another": (send_false_headers, "lower bus: every motor"),
}


@read_either_way
@pytest.mark.parametrize("fault", BUS)
def test_old_angles_are_not_marked_fresh_and_nothing_moves(rig: Rig, fault: str) -> None:
    cause, text = BUS[fault]
    check_moves(rig)
    cause(rig.memory.servos["lower"])
    took = rig.until(lambda: not rig.plant.fresh, 0.3)
    assert took <= MAX_AGE + 4 * DT
    for _ in range(200):
        rig.tick(0.3)
        assert not rig.plant.fresh
    assert text in rig.faults
    check_holds(rig, 1.0)


@read_either_way
def test_noise_that_leaves_the_replies_intact_changes_nothing(rig: Rig) -> None:
    for servos in rig.memory.servos.values():
        servos.noise = lambda rng=servos.rng: rng.randbytes(rng.randint(1, 12))
    rig.settle()
    for _ in range(200):
        rig.tick(0.3)
        assert rig.plant.fresh
    assert not rig.faults
    check_moves(rig)


def test_each_register_is_written_with_its_own_length(rig: Rig) -> None:
    """A longer packet would write to the registers behind it."""
    requests = [packet for servos in rig.memory.servos.values() for packet in servos.requests]
    written = {(packet[5], packet[6]) for packet in requests if packet[4] == SYNC_WRITE}
    assert written == {(TORQUE_ENABLE, 1), (GAINS, 3), (GOAL, 4), (TORQUE_LIMIT, 2)}


def test_the_only_motor_of_a_bus_is_read_by_itself() -> None:
    """The adapter would answer a sync read of one motor with the id of this motor."""
    servos = FaultyServos([EmulatedServo(KNEE, TYPES["MX-28"])])
    bus = DynamixelBus("one", lambda: EmulatedPort(servos), [KNEE], [TYPES["MX-28"]], sync_read=True)
    bus.read()
    assert [packet[4] for packet in servos.requests] == [READ]
    assert not bus.cause[0]


@read_either_way
@pytest.mark.parametrize("fault", ["the bus is silent", "one motor is silent", "replies are random bytes"])
def test_a_short_bus_failure_ends_when_the_motors_have_been_checked(rig: Rig, fault: str) -> None:
    BUS[fault][0](rig.memory.servos["lower"])
    rig.run(0.5, u=0.3)
    rig.memory.servos["lower"].clear_faults()
    rig.until(lambda: rig.plant.fresh, 0.3)
    rig.until(lambda: not rig.plant.watch.faults, 2.0)
    check_moves(rig)


@read_either_way
def test_a_replugged_port_is_reopened(rig: Rig) -> None:
    unplug(rig.memory.servos["lower"])
    rig.run(0.5)
    rig.memory.servos["lower"].clear_faults()
    rig.until(lambda: rig.plant.fresh, 2.0)
    check_holds(rig)
    rig.settle()
    check_moves(rig)


@pytest.mark.parametrize("port", ["auto", "/dev/ttyACM0"])
def test_a_port_that_comes_back_under_another_name_is_searched_for(monkeypatch: pytest.MonkeyPatch, port: str) -> None:
    """Adapters that are plugged in again may exchange their names; only a port that is named stays the same."""
    name, opened, memory = "/dev/ttyACM0", [], Memory()
    monkeypatch.setattr("dqwalk_ros.plants.poppy.buses.find_port", lambda ids: name)

    def open_port(asked: str) -> object:
        opened.append(asked)
        return memory._port(memory.servos["lower"])

    monkeypatch.setattr("dqwalk_ros.plants.poppy.buses.open_port", open_port)
    own = CONFIG.updated({"poppy.lower_port": port}).poppy
    lower = {motor.name: motor for motor in MOTORS.values() if motor.bus == "lower"}
    (bus,) = open_buses(lower, TYPES, own, memory.clock).values()
    unplug(memory.servos["lower"])
    bus.read()
    assert bus.lost
    memory.servos["lower"].clear_faults()
    name = "/dev/ttyACM1"
    memory.clock.now += 2.0
    bus.read()
    assert not bus.lost
    assert opened == ["/dev/ttyACM0", name if port == "auto" else port]


@read_either_way
@pytest.mark.parametrize("fault", BUS)
def test_a_long_bus_failure_requires_a_new_activation(rig: Rig, fault: str) -> None:
    BUS[fault][0](rig.memory.servos["lower"])
    rig.run(2.0, u=0.3)
    assert "then ~/activate" in rig.faults
    with pytest.raises(PlantError, match="lower bus"):
        rig.plant.activate()
    rig.memory.servos["lower"].clear_faults()
    rig.until(lambda: rig.plant.fresh, 2.0)
    check_holds(rig)
    rig.settle()
    check_moves(rig)


@read_either_way
def test_motors_that_lost_power_are_not_assumed_to_hold(rig: Rig) -> None:
    """Their torque is off afterwards, and nothing moves until it is switched on again."""
    servos = rig.memory.servos["lower"]
    servos.dead = True
    rig.run(0.5)
    servos.cut_power()
    servos.clear_faults()
    rig.run(1.5, u=0.3)
    assert "l_knee_y has lost its torque or its gain" in rig.faults
    assert rig.plant.fresh
    check_holds(rig)
    rig.settle()
    assert not rig.plant.watch.faults
    assert all(rig.memory.torque(name) for name in MOTORS)
    check_moves(rig)


@read_either_way
def test_a_short_power_cut_is_detected(rig: Rig) -> None:
    """Even if no reply is missing."""
    rig.memory.servos["lower"].cut_power()
    assert rig.until(lambda: "has lost its torque" in rig.faults, 1.0) <= 11 * DT
    check_holds(rig)


@pytest.mark.parametrize(
    ("address", "value"),
    [(TORQUE_ENABLE, 0), (TORQUE_LIMIT, 0), (TORQUE_LIMIT, 1), (GAINS + 2, 32), (GAINS, 254), (GAINS + 1, 254)],
)
def test_torque_and_gain_are_read_back_continuously(rig: Rig, address: int, value: int) -> None:
    servo = rig.memory.servo("l_knee_y")
    servo.write(address, bytes([value] * (2 if address == TORQUE_LIMIT else 1)))
    rig.until(lambda: "l_knee_y has lost its torque or its gain" in rig.faults, 11 * DT)
    check_holds(rig)


# ---------------------------------------------------------------------- one angle


@read_either_way
@pytest.mark.parametrize("angle", [90.0, -90.0, 20.0])
def test_a_single_wrong_angle_causes_no_motion(rig: Rig, angle: float) -> None:
    rig.run(0.2)
    goal = rig.memory.goal("l_knee_y")
    rig.memory.of("l_knee_y").slip = {KNEE: angle}
    rig.tick()
    rig.memory.of("l_knee_y").slip = {}
    for _ in range(10):
        rig.tick()
        assert rig.memory.goal("l_knee_y") == pytest.approx(goal, abs=STEP)
        assert rig.plant.measured.q[rig.plant.names.index("l_knee_y")] == pytest.approx(goal, abs=0.01)
    assert not rig.plant.watch.faults


@pytest.mark.parametrize(("beyond", "jumps"), [(0.5, 0), (2.0, 1)])
def test_the_limit_of_a_plausible_angle_is_the_motion_at_full_speed(beyond: float, jumps: int) -> None:
    """An MX-28 turns by 6.6 degrees in a period of 20 ms; 13 encoder steps, 1.1 degrees, more are tolerated."""
    rig = Rig()
    rig.settle()
    rig.memory.of("l_knee_y").slip = {KNEE: np.degrees(TYPES["MX-28"].no_load_speed) * DT + beyond}
    rig.tick()
    assert rig.plant.measured.jumps[rig.plant.names.index("l_knee_y")] == jumps


@read_either_way
def test_an_implausible_angle_counts_once_until_the_next_reply(rig: Rig) -> None:
    """A motor that falls silent after a wrong angle has not jumped."""
    servos, k = rig.memory.of("l_knee_y"), rig.plant.names.index("l_knee_y")
    servos.slip = {KNEE: 40.0}
    rig.tick()
    servos.silent = {KNEE}
    for _ in range(4):
        rig.tick()
        assert rig.plant.measured.jumps[k] == 1


@read_either_way
@pytest.mark.parametrize("angle", [90.0, -20.0, 17.0])
def test_a_slipped_encoder_is_detected_at_once_and_stays_reported(rig: Rig, angle: float) -> None:
    goal = rig.memory.goal("l_knee_y")
    rig.memory.of("l_knee_y").slip = {KNEE: angle}
    assert rig.until(lambda: "l_knee_y has jumped to another angle" in rig.faults, 0.3) <= 4 * DT
    check_holds(rig, 2.0)
    assert rig.memory.goal("l_knee_y") == pytest.approx(goal, abs=STEP)
    assert not rig.plant.fresh
    rig.plant.release()
    rig.run(0.5)
    assert rig.plant.fresh  # without torque, the measured angle is published


# ---------------------------------------------------------------------- hot, weak and blocked motors


def test_a_hot_motor_stops_the_robot_until_it_has_cooled(rig: Rig) -> None:
    servo = rig.memory.servo("r_hip_y")
    servo.memory[TEMPERATURE] = 66
    rig.until(lambda: "r_hip_y is at 66 degC, too hot" in rig.faults, 1.0)
    check_holds(rig)
    servo.memory[TEMPERATURE] = 62
    check_holds(rig)
    servo.memory[TEMPERATURE] = 59
    rig.until(lambda: not rig.plant.watch.faults, 1.0)
    check_moves(rig)


def test_a_hot_motor_prevents_activation(rig: Rig) -> None:
    rig.memory.servo("r_hip_y").memory[TEMPERATURE] = 70
    rig.run(0.6)
    rig.plant.release()
    with pytest.raises(PlantError, match="r_hip_y is at 70 degC, too hot"):
        rig.plant.activate()
    assert not any(rig.memory.torque(name) for name in MOTORS)
    rig.run(1.0, u=0.3)
    assert not rig.plant.active


def test_a_hot_motor_stops_the_motion_to_the_first_pose() -> None:
    rig = Rig(angles={"l_knee_y": 60.0})
    rig.plant.activate()
    rig.run(0.5)
    rig.memory.servo("r_hip_y").memory[TEMPERATURE] = 75
    rig.until(lambda: "too hot" in rig.faults, 1.0)
    check_holds(rig)
    assert not rig.plant.ready


def test_an_empty_battery_stops_the_robot(rig: Rig) -> None:
    for servo in rig.memory.servos["lower"].servos.values():
        servo.memory[VOLTAGE] = 96
    rig.until(lambda: "l_hip_x has 9.6 V, too little; charge the battery" in rig.faults, 1.0)
    check_holds(rig)
    rig.plant.release()
    with pytest.raises(PlantError, match="too little"):
        rig.plant.activate()


@pytest.mark.parametrize(("bits", "text"), [(4, "overheating"), (32, "overload"), (36, "overheating and overload")])
def test_a_motor_that_switched_its_torque_off_is_named(rig: Rig, bits: int, text: str) -> None:
    servo = rig.memory.servo("l_knee_y")
    servo.error = bits
    servo.write(TORQUE_LIMIT, bytes(2))
    rig.until(lambda: f"l_knee_y reports {text} and has switched its torque off" in rig.faults, 11 * DT)
    check_holds(rig)
    servo.error = 0
    check_holds(rig)  # its torque stays off until the next activation
    rig.settle()
    check_moves(rig)


@pytest.mark.parametrize("u", [0.3, -0.3])
def test_a_blocked_joint_is_not_driven_for_long(rig: Rig, u: float) -> None:
    rig.memory.servo("l_ankle_y").blocked = True
    began = rig.memory.clock.now
    while "l_ankle_y cannot follow" not in rig.faults:
        rig.tick(u)
        assert rig.memory.clock.now - began < rig.config.poppy.max_lead / 0.3 + rig.config.poppy.blocked_after + 0.2
    requests = rig.memory.of("l_ankle_y").requests
    requests.clear()
    rig.tick(u)
    assert rig.memory.goal("l_ankle_y") == pytest.approx(rig.memory.angle("l_ankle_y"), abs=STEP)
    check_holds(rig)
    sent = [packet for packet in requests if packet[4] == SYNC_WRITE]
    assert len(sent) == 5, "a lost packet is repeated, and then no goal is sent"


def test_a_motor_at_full_load_is_reported_as_blocked(rig: Rig) -> None:
    rig.memory.servo("l_knee_y").write(LOAD, (1024 + 1000).to_bytes(2, "little"))
    took = rig.until(lambda: "l_knee_y cannot follow" in rig.faults, 3.0)
    assert took == pytest.approx(rig.config.poppy.blocked_after, abs=0.1)
    check_holds(rig)


def test_a_joint_blocked_before_the_first_pose_is_an_error() -> None:
    rig = Rig(angles={"l_knee_y": 60.0})
    rig.plant.activate()
    rig.run(0.3)
    rig.memory.servo("l_knee_y").blocked = True
    rig.until(lambda: "l_knee_y cannot follow" in rig.faults, 3.0)
    rig.tick()
    assert rig.memory.goal("l_knee_y") == pytest.approx(rig.memory.angle("l_knee_y"), abs=STEP)
    check_holds(rig, 3.0)
    assert not rig.plant.ready


def test_a_first_pose_not_reached_within_tolerance_is_an_error() -> None:
    """A soft joint under load stops near the pose, but outside the tolerance."""
    rig = Rig(angles={"l_knee_y": 60.0}, settings={"poppy.start_tolerance": 0.05})
    rig.plant.activate()
    rig.until(lambda: rig.memory.angle("l_knee_y") < 0.08, 10.0)
    rig.memory.servo("l_knee_y").blocked = True
    took = rig.until(lambda: "l_knee_y does not reach the first pose" in rig.faults, 6.0)
    assert took > 3.0, "it has some time after its goal"
    assert not rig.plant.ready


@pytest.mark.parametrize("while_", ["holding", "commanded", "on the way to the first pose"])
def test_a_motor_that_turns_without_end_loses_its_torque(while_: str) -> None:
    """It was set to wheel mode while the robot was active; the first packet that switches its torque off is lost."""
    first = while_ == "on the way to the first pose"
    rig = Rig(angles={"r_elbow_y": -40.0} if first else None)
    rig.plant.activate()
    if not first:
        rig.until(lambda: rig.plant.ready, 30.0)
    servo, others = rig.memory.servo("l_knee_y"), [name for name in MOTORS if name != "l_knee_y"]
    began, lost, write = rig.memory.angle("l_knee_y"), [], servo.write

    def losing(address: int, data: bytes) -> None:
        if address == TORQUE_ENABLE and not lost:
            lost.append(data)
        else:
            write(address, data)

    servo.write = losing
    servo.write(LIMITS, bytes(4))
    for _ in range(1500):
        if while_ == "holding":
            rig.plant.hold(DT)
            rig.memory.clock.now += DT
        else:
            rig.tick(0.0)
    assert lost
    assert not rig.memory.torque("l_knee_y")
    assert all(rig.memory.torque(name) for name in others)
    assert rig.memory.angle("l_knee_y") - began < 0.45
    assert "l_knee_y moved away from its goal at full torque, which is now off" in rig.faults
    check_holds(rig)
    let_goals_switch_on(rig)
    for part in rig.plant.parts:  # as at the end, and after another joint was blocked
        rig.plant._send_all(part)
    assert not rig.memory.torque("l_knee_y")
    with pytest.raises(PlantError, match=r"l_knee_y .*does not turn to positions"):
        rig.plant.activate()
    write(LIMITS, bytes(2) + (4095).to_bytes(2, "little"))
    rig.settle()
    check_moves(rig)


# ---------------------------------------------------------------------- switching the torque


@pytest.mark.parametrize("sync_read", [True, False])
def test_a_lost_reply_at_activation_leaves_no_torque_off(sync_read: bool) -> None:
    """For any lost reply, the torque is on in all motors afterwards."""

    def started(lost: int) -> int:
        memory, count = Memory(sync_read=sync_read), iter(range(10**9))
        for servos in memory.servos.values():
            servos.drop_reply = lambda packet: next(count) == lost
        rig = Rig.__new__(Rig)
        rig.model, rig.config, rig.memory = MODEL, CONFIG, memory
        rig.plant = rig.opened()
        rig.plant.activate()
        assert all(memory.torque(name) for name in MOTORS), lost
        return next(count)

    replies = started(-1)
    for lost in range(0, replies, 7 if sync_read else 11):
        started(lost)


def test_a_torque_that_does_not_switch_on_is_an_error() -> None:
    rig = Rig()
    servo = rig.memory.servo("l_knee_y")
    write = servo.write
    servo.write = lambda address, data: None if address == TORQUE_ENABLE else write(address, data)
    with pytest.raises(PlantError, match="the torque of l_knee_y did not switch on: all torque is off"):
        rig.plant.activate()
    assert not rig.plant.active
    assert not any(rig.memory.torque(name) for name in MOTORS)


def let_goals_switch_on(rig: Rig) -> None:
    """Let the servos have a firmware that switches the torque on with each goal."""
    for servos in rig.memory.servos.values():
        servos.goals_switch_on = True


@pytest.mark.parametrize("goals", [False, True])
@pytest.mark.parametrize("address", [GAINS, 30, TORQUE_LIMIT])
def test_a_motor_that_cannot_be_set_up_is_an_error(address: int, goals: bool) -> None:
    rig = Rig(angles={"l_knee_y": 40.0})
    if goals:
        let_goals_switch_on(rig)
    servo = rig.memory.servo("l_knee_y")
    write = servo.write
    servo.write(30, (1000).to_bytes(2, "little"))
    servo.write(TORQUE_LIMIT, bytes(2))
    servo.write = lambda at, data: None if at == address else write(at, data)
    with pytest.raises(PlantError, match="l_knee_y cannot be set up: all torque is off"):
        rig.plant.activate()
    assert not any(rig.memory.torque(name) for name in MOTORS)


def test_goals_that_are_sent_again_switch_no_torque_on_that_was_switched_off(rig: Rig) -> None:
    """The goal of a blocked joint is sent some times; the robot fell meanwhile, and its torque was switched off."""
    let_goals_switch_on(rig)
    rig.memory.servo("l_knee_y").blocked = True
    rig.run(0.2, u=0.5)
    rig.until(lambda: "cannot follow" in rig.faults, 10.0)
    rig.plant.release()
    rig.run(1.0, u=0.5)
    assert not any(rig.memory.torque(name) for name in MOTORS)


def test_a_motor_of_another_type_is_refused() -> None:
    rig = Rig()
    rig.plant.close()
    rig.memory.servo("l_knee_y").write(0, (310).to_bytes(2, "little"))
    with pytest.raises(PlantError, match=r"l_knee_y \(14\) is model 310, not an MX-28"):
        rig.opened()


REPLACED = {
    "another model": (0, (310).to_bytes(2, "little"), r"is model 310, not an MX-28"),
    "wheel mode": (
        LIMITS,
        bytes(4),
        r"does not turn to positions \(wheel .* limits are 0 and 0\): set them to 0 and 4095",
    ),
    "multi-turn mode": (LIMITS, b"\xff\x0f\xff\x0f", r"does not turn to positions .* limits are 4095 and 4095"),
    "narrower limits": (
        LIMITS,
        (2048).to_bytes(2, "little") + b"\xff\x0f",
        r"has the angle limits 0 and 180 deg, narrower",
    ),
    "another id": (3, bytes([99]), r"says that its id is 99"),
}
"""Register, its bytes, and the message about a knee."""


@pytest.mark.parametrize("kind", REPLACED)
def test_a_motor_is_identified_at_every_activation(rig: Rig, kind: str) -> None:
    address, data, expected = REPLACED[kind]
    rig.plant.release()
    rig.memory.servo("l_knee_y").write(address, data)
    with pytest.raises(PlantError, match=rf"table 'poppy': l_knee_y \(14\) {expected}"):
        rig.plant.activate()
    assert not any(rig.memory.torque(name) for name in MOTORS)
    angle = rig.memory.angle("l_knee_y")
    rig.run(1.0, u=0.3)
    assert rig.memory.angle("l_knee_y") == angle
    rig.plant.close()
    with pytest.raises(PlantError, match=rf"l_knee_y \(14\) {expected}"):
        rig.opened()


def test_motors_that_are_missing_at_start_are_named() -> None:
    rig = Rig()
    rig.plant.close()
    rig.memory.of("l_knee_y").silent = {KNEE, KNEE + 1}
    with pytest.raises(PlantError, match=r"l_knee_y \(14, lower bus\) does not answer, l_ankle_y \(15.*robot on"):
        rig.opened()


def test_a_motor_without_a_valid_angle_at_start_is_named() -> None:
    rig = Rig(sync_read=False, settings={"poppy.sync_read": False})
    rig.plant.close()
    rig.memory.of("l_knee_y").drop_reply = lambda packet: packet[2] == KNEE and packet[4] == READ and packet[5] > 0
    with pytest.raises(PlantError, match=r"no valid angle from l_knee_y: does not answer$"):
        rig.opened()


def test_an_adapter_that_knows_no_sync_read_is_named() -> None:
    """Such as an FTDI or a U2D2: each servo answers alone."""
    rig = Rig()
    rig.plant.close()
    for bus in rig.memory.servos.values():
        bus.drop_reply = lambda packet: packet[4] == SYNC_READ
    with pytest.raises(PlantError, match=r"no valid angle from .*: does not answer; any adapter but a USB2AX needs"):
        rig.opened()


@pytest.mark.parametrize("torque_off", [True, False])
@pytest.mark.parametrize("fault", [None, *BUS])
def test_close_releases_the_bus_and_leaves_the_torque_as_configured(torque_off: bool, fault: str | None) -> None:
    rig = Rig(settings={"poppy.torque_off_at_end": torque_off})
    rig.settle()
    closed = []
    for part in rig.plant.parts:
        port = part.bus._port
        port.closePort = lambda name=part.bus.name: closed.append(name)
    if fault:
        BUS[fault][0](rig.memory.servos["lower"])
    if torque_off and fault:
        with pytest.raises(PlantError, match=r"l_knee_y.* did not confirm .*: switch the power off"):
            rig.plant.close()
    else:
        rig.plant.close()
    assert sorted(closed) == list(BUSES)
    # a servo executes a request even if its reply is damaged
    unreachable = {"the bus is silent": "l_", "the port is unplugged": "l_", "one motor is silent": "l_knee_y"}.get(
        fault or "", "-"
    )
    for name in MOTORS:
        if not (name.startswith(unreachable) or (unreachable == "l_" and MOTORS[name].bus == "lower")):
            assert rig.memory.torque(name) is not torque_off, name


@read_either_way
def test_every_error_of_the_port_is_handled(rig: Rig) -> None:
    """Errors of pyserial, termios and the operating system are handled alike."""
    import termios

    for error in (OSError("x"), termios.error(5, "x"), TypeError("x"), ValueError("x"), NotImplementedError("x")):

        def fail(*_: object, error: Exception = error) -> None:
            raise error

        bus = rig.plant.parts[0].bus
        bus._port.writePort = fail
        rig.run(0.3, u=0.3)
        assert "the port is gone" in rig.faults
        rig.until(lambda: rig.plant.fresh, 3.0)
        rig.settle()


def test_a_port_that_takes_no_bytes_for_a_moment_is_not_lost(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy computer or adapter delays a packet; the motion continues with the next one."""
    bus = rig.plant.parts[0].bus
    with monkeypatch.context() as patch:
        patch.setattr(bus._port, "writePort", lambda packet: 0)
        rig.run(0.5, u=0.3)
        assert "lower bus: every motor cannot be asked: the port takes no bytes; is this computer" in rig.faults
    assert not bus.lost
    rig.until(lambda: not rig.plant.watch.faults, 2.0)
    check_moves(rig)


def test_a_port_whose_buffer_is_full_takes_no_bytes() -> None:
    """The other end of a pseudo terminal that nobody reads."""
    here, there = os.openpty()
    port = open_port(os.ttyname(there))
    try:
        taken = [port.writePort([255] * 1000) for _ in range(100)]
    finally:
        port.closePort()
        os.close(here)
        os.close(there)
    assert taken[0] == 1000
    assert taken[-1] == 0


def test_a_search_says_why_each_port_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """One port is silent, one is in use by a bus, of one the user has no rights: a Poppy's first start."""
    import serial
    from serial.tools import list_ports

    ends = [os.openpty() for _ in range(2)]
    silent, used = (os.ttyname(there) for _, there in ends)
    plain = serial.Serial

    def opened(name: str, *given: object, **named: object) -> object:
        if name == "/dev/denied":
            raise serial.SerialException(errno.EACCES, f"could not open port {name}")
        return plain(name, *given, **named)

    monkeypatch.setattr(serial, "Serial", opened)
    monkeypatch.setattr(
        list_ports, "comports", lambda: [SimpleNamespace(device=n) for n in (silent, used, "/dev/denied")]
    )
    port = open_port(used)
    try:
        with pytest.raises(PlantError) as error:
            find_port([11, 12])
    finally:
        port.closePort()
        for end in ends:
            for one in end:
                os.close(one)
    wanted = [f"no port with the motors 11, 12 ({silent}: none of them answers", f"{used}: it is in use already"]
    assert all(one in str(error.value) for one in [*wanted, "/dev/denied: no permission: sudo usermod -aG dialout"])
