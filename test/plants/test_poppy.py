"""Poppy's driver with emulated servos in memory: signs, limits, speeds, the slow start, a whole cycle."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from dynamixel_bus import MOTORS, TYPES
from poppy_rig import CONFIG, DT, MAX_AGE, MODEL, Rig

from dqwalk_ros.config import Config, find_share
from dqwalk_ros.paper.state import Command, State
from dqwalk_ros.plants.poppy.buses import MIN_SPEED, register_speed
from dqwalk_ros.plants.poppy.motors import Motor, load_motors, require_bus
from dqwalk_ros.plants.poppy.plant import PoppyPlant
from dqwalk_ros.robot.clearance import Clearance
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.errors import ConfigError, PlantError
from dqwalk_ros.walks.table import make_controller

KNEE = MODEL.joint_names.index("l_knee_y")


@pytest.fixture
def rig() -> Rig:
    """A robot in its first pose."""
    rig = Rig()
    rig.settle()
    return rig


# ---------------------------------------------------------------------- the table


def test_the_25_motors_and_their_limits_are_those_of_the_urdf() -> None:
    whole = load_model(Config().robot)
    assert set(MOTORS) == set(whole.joint_names)
    assert len(MOTORS) == 25
    for name, low, high in zip(whole.joint_names, whole.q_min, whole.q_max, strict=True):
        np.testing.assert_allclose(MOTORS[name].limits, np.degrees([low, high]), atol=1e-6, err_msg=name)


MIRRORED = ["hip_x", "hip_z", "hip_y", "knee_y", "ankle_y", "shoulder_y", "shoulder_x", "arm_z", "elbow_y"]


def test_a_mirrored_pose_is_mirrored_in_the_servos() -> None:
    """_y turns alike on both sides, _x and _z oppositely; orientation and offset then give the servo angle.

    The expected raw angles are written out from the wiring, not computed by the code under test.
    """
    angle = 10.0
    raw = {  # left, right [deg] for left +10 and its mirror image
        "hip_x": (10.0, -10.0),
        "hip_z": (-10.0, 10.0),
        "hip_y": (12.0, -10.0),
        "knee_y": (10.0, -10.0),
        "ankle_y": (10.0, -10.0),
        "shoulder_y": (100.0, -100.0),
        "shoulder_x": (80.0, -80.0),
        "arm_z": (-10.0, 10.0),
        "elbow_y": (10.0, -10.0),
    }
    for joint in MIRRORED:
        other = angle if joint.endswith("_y") else -angle
        assert MOTORS[f"l_{joint}"].servo(angle) == pytest.approx(raw[joint][0]), joint
        assert MOTORS[f"r_{joint}"].servo(other) == pytest.approx(raw[joint][1]), joint


def test_mirrored_limits_agree() -> None:
    for joint in MIRRORED:
        low, high = MOTORS[f"l_{joint}"].limits
        mirrored = (low, high) if joint.endswith("_y") else (-high, -low)
        np.testing.assert_allclose(
            MOTORS[f"r_{joint}"].limits, mirrored, atol=3.0, err_msg=joint
        )  # hip_y: built 1 to 3 off


MOTOR = {"id": "1", "type": "MX-28", "bus": "lower", "direct": "true", "offset": "0", "raw": "[0, 1]"}


def read_table(folder: Path, *motors: dict[str, str]) -> list[Motor]:
    """Return the motors m0, m1, ... of a table with these entries."""
    entries = ["{" + ", ".join(f"{key}: {value}" for key, value in motor.items()) + "}" for motor in motors]
    path = folder / "motors.yaml"
    path.write_text("motors:\n" + "".join(f"  m{k}: {entry}\n" for k, entry in enumerate(entries)), encoding="utf-8")
    return list(load_motors(str(path), TYPES).values())


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"type": "X"}, "the type must be one of MX-28"),
        ({"type": "null"}, r"\$\.type"),
        ({"direct": "3"}, "`bool`.*direct"),
        ({"id": "253"}, "<= 252.*id"),
        ({"id": "-1"}, ">= 0.*id"),
        ({"id": "1"}, "another motor has the id 1"),
        ({"offset": ".nan"}, "offset"),
        ({"offset": "361"}, "360.*offset"),
        ({"raw": "[1, 0]"}, r"\[lower, upper\]"),
        ({"raw": "[1, 1]"}, r"\[lower, upper\]"),
        ({"raw": "[0, 1, 2]"}, "length 2.*raw"),
        ({"gain": "1"}, "gain"),
        ({"name": "m0"}, "name"),
    ],
)
def test_an_invalid_motor_is_refused(tmp_path: Path, changes: dict[str, str], expected: str) -> None:
    with pytest.raises(ConfigError, match=f"line 3: motor 'm1': .*{expected}"):
        read_table(tmp_path, MOTOR, {**MOTOR, "id": "2", **changes})


def test_a_motor_without_properties_is_refused(tmp_path: Path) -> None:
    (tmp_path / "motors.yaml").write_text("motors:\n  m1:\n")
    with pytest.raises(ConfigError, match=r"line 2: motor 'm1': expected \{id, type"):
        load_motors(str(tmp_path / "motors.yaml"), TYPES)


def test_a_table_without_motors_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="expected 'motors"):
        read_table(tmp_path)
    (tmp_path / "list.yaml").write_text("motors: [l_knee_y]\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="expected 'motors"):
        load_motors(str(tmp_path / "list.yaml"), TYPES)


def test_the_extreme_values_of_a_motor_table_are_accepted(tmp_path: Path) -> None:
    first = {**MOTOR, "id": "0", "offset": "-360", "raw": "[-360, 360]"}
    motors = read_table(tmp_path, first, {**MOTOR, "id": "252", "offset": "360"})
    assert [motor.id for motor in motors] == [0, 252]
    with pytest.raises(ConfigError, match=r"-360.*offset"):
        read_table(tmp_path, {**MOTOR, "offset": "-361"})


# ---------------------------------------------------------------------- speeds, stiffness


@pytest.mark.parametrize("speed", [0.0, 1e-9, -1e-9, 0.34, 0.36, -0.1, math.nan, math.inf, -math.inf, 1e6])
def test_no_speed_is_written_as_unlimited(speed: float) -> None:
    """A servo rounds to units of 0.684 deg/s and treats 0 units as unlimited."""
    written = register_speed(speed, 120.0)
    assert MIN_SPEED <= written <= 120.0
    assert round(written / 0.684) >= 1


def test_the_least_speed_is_two_units_of_the_register() -> None:
    """One more than zero after any rounding, and slow enough not to be seen."""
    assert register_speed(0.0, 120.0) == pytest.approx(2 * 0.684, rel=0.05)


def test_a_servo_is_fast_enough_for_its_command_and_its_error(rig: Rig) -> None:
    k = KNEE
    for _ in range(5):
        rig.tick(0.3, 1.0)
    u = 0.3
    rig.plant.write(Command(0.0, np.full(rig.model.n, u), None), DT)
    error = abs(rig.plant.goal[k] - rig.plant.measured.q[k])
    speed = rig.memory.servo("l_knee_y").word(32) * TYPES["MX-28"].speed_unit
    assert speed == pytest.approx(math.degrees(1.5 * u + error / DT), abs=1.0)


def test_no_servo_receives_an_unlimited_speed() -> None:
    rig = Rig(angles={"l_knee_y": 40.0})
    speeds = []
    for name in MOTORS:
        servo = rig.memory.servo(name)
        write = servo.write

        def noted(address: int, data: bytes, write: Callable[[int, bytes], None] = write) -> None:
            if address == 30:
                speeds.append(int.from_bytes(data[2:4], "little"))
            write(address, data)

        servo.write = noted
    rig.settle()
    for u in (0.0, 1e-9, 0.01, 5.0, 1e9):
        rig.tick(u)
    rig.plant.close()
    assert len(speeds) > 1000
    assert min(speeds) >= 1
    assert max(speeds) <= CONFIG.poppy.max_speed / 0.666 + 1.0


@pytest.mark.parametrize(
    ("kind", "gain", "stiffness"), [("MX-28", 254, 51.0), ("MX-28", 32, 6.4), ("MX-64", 254, 121.0)]
)
def test_stiffness_of_a_gain(kind: str, gain: int, stiffness: float) -> None:
    """Figures of the literature: 51 and 120 N m/rad at the highest gain."""
    assert TYPES[kind].stall_torque * TYPES[kind].gain(gain) == pytest.approx(stiffness, rel=0.01)


def test_gains_are_written_and_read_back(rig: Rig) -> None:
    for name, motor in MOTORS.items():
        assert rig.memory.servo(name).memory[28] == (127 if motor.type.startswith("MX") else 32), name


def test_feedforward_torques_are_added_to_the_goals_as_angles(rig: Rig) -> None:
    """For 1 N m a servo of 25 N m/rad gets a goal 1/25 rad further, until the next torque."""
    rig.tick(0.0, 1.0)
    for effort, expected in ((None, 1.0), (100.0, MODEL.effort_max[KNEE]), (0.0, 0.0)):
        rig.tick(0.0, effort)
        assert rig.memory.goal("l_knee_y") == pytest.approx(expected / 25.3, abs=0.002)


def test_a_state_does_not_change_later(rig: Rig) -> None:
    state = rig.plant.state
    before = state.q.copy(), state.dq.copy()
    rig.run(0.2, 0.5)
    assert not np.array_equal(rig.plant.state.q, before[0])
    np.testing.assert_array_equal((state.q, state.dq), before)


# ---------------------------------------------------------------------- start and stop


def test_nothing_is_written_before_activate() -> None:
    rig = Rig(angles={"l_knee_y": 40.0})
    rig.run(1.0)
    sent = [packet for servos in rig.memory.servos.values() for packet in servos.requests]
    assert len(sent) > 100
    assert {packet[4] for packet in sent} <= {2, 0x84}  # read, read all
    assert rig.plant.fresh
    assert not rig.plant.ready
    assert rig.plant.measured.q[rig.plant.names.index("l_knee_y")] == pytest.approx(math.radians(40.0), abs=0.001)


def test_a_robot_in_its_first_pose_is_not_ready_before_activate() -> None:
    rig = Rig()
    rig.run(0.5)
    assert not rig.plant.ready


def test_the_time_of_the_states_is_that_of_the_commands(rig: Rig) -> None:
    began = rig.plant.state.time
    for k in range(10):
        rig.tick()
        assert rig.plant.state.time == pytest.approx(began + (k + 1) * DT)


def test_angles_are_fresh_up_to_their_maximum_age(rig: Rig) -> None:
    gate = rig.plant._gate
    gate.use(gate.q, 0.0)
    rig.memory.clock.now = MAX_AGE
    assert rig.plant.fresh
    rig.memory.clock.now = np.nextafter(MAX_AGE, 1.0)
    assert not rig.plant.fresh
    at = np.full(len(gate.at), rig.memory.clock.now)
    at[-1] = 0.0  # the last motor has not answered since
    gate.measure(gate.q.copy(), at, moving=False)
    assert not rig.plant.fresh, "the oldest angle counts"
    at[-1] = rig.memory.clock.now
    gate.measure(gate.q.copy(), at, moving=False)
    assert rig.plant.fresh


def test_nothing_moves_when_the_torque_is_switched_on() -> None:
    rig = Rig(angles={"l_knee_y": 40.0, "r_elbow_y": -70.0})
    before = rig.plant.measured.q.copy()
    rig.plant.activate()
    for name, q in zip(rig.plant.names, before, strict=True):
        assert rig.memory.torque(name)
        assert rig.memory.goal(name) == pytest.approx(q, abs=1e-3), name
        assert rig.memory.angle(name) == pytest.approx(q, abs=3e-3), name


def test_the_motion_to_the_first_pose_is_slow() -> None:
    rig = Rig(angles={"l_knee_y": 40.0, "r_knee_y": 10.0, "r_elbow_y": -70.0})
    rig.plant.activate()
    began = rig.memory.clock.now
    while not rig.plant.ready:
        before = np.array([rig.memory.angle(name) for name in rig.plant.names])
        rig.tick(5.0)  # for any command
        moved = np.abs(np.array([rig.memory.angle(name) for name in rig.plant.names]) - before)
        assert moved.max() <= 2.0 * CONFIG.poppy.start_speed * DT + 0.003
        assert rig.memory.clock.now < began + 20.0
    took = rig.memory.clock.now - began
    assert took >= math.radians(70.0) / CONFIG.poppy.start_speed - CONFIG.poppy.start_tolerance - DT
    assert np.abs(rig.plant.measured.q).max() < CONFIG.poppy.start_tolerance


def test_the_way_to_the_first_pose_keeps_the_links_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """From crossed legs, which would pass through each other on the straight way."""
    from dqwalk_ros.plants.mujoco import own_contacts

    whole = load_model(CONFIG.updated({"robot.lock": (), "robot.drop": ()}).robot)
    rig = Rig(angles={"l_hip_x": -20.0, "r_hip_x": 30.0, "l_hip_y": 30.0, "r_hip_y": -30.0})
    there = [rig.plant.names.index(name) for name in whole.joint_names]
    rig.plant.activate()
    way = [rig.plant.measured.q[there]]
    while not rig.plant.ready:
        rig.tick()
        way.append(rig.plant.measured.q[there])
        assert rig.memory.clock.now < 30.0, rig.faults
    standing = np.zeros(whole.n)
    assert not own_contacts(whole, np.array([standing, *way]))
    straight = np.linspace(way[0], standing, 40)
    assert own_contacts(whole, np.array([standing, *straight]))
    monkeypatch.setattr(Clearance, "way", lambda *_: ([], "l_shin and r_shin"))
    rig.plant.release()
    with pytest.raises(PlantError, match="no way to the first pose keeps l_shin and r_shin apart: move them by hand"):
        rig.plant.activate()
    assert not rig.memory.torque("l_knee_y")


def test_a_robot_without_torque_receives_no_goals(rig: Rig) -> None:
    rig.plant.release()
    assert not any(rig.memory.torque(name) for name in MOTORS)
    goals = [rig.memory.goal(name) for name in MOTORS]
    for _ in range(20):
        rig.tick(1.0)
    assert goals == [rig.memory.goal(name) for name in MOTORS]
    rig.memory.servo("l_knee_y").moved += 300.0  # the knee is bent by hand
    rig.run(0.3)
    assert rig.plant.measured.q[rig.plant.names.index("l_knee_y")] == pytest.approx(
        rig.memory.angle("l_knee_y"), abs=1e-3
    )
    rig.plant.activate()
    assert not rig.plant.ready  # it must reach the first pose again
    assert rig.memory.goal("l_knee_y") == pytest.approx(rig.memory.angle("l_knee_y"), abs=0.002)


def test_calibration_moves_the_zero_of_a_joint() -> None:
    """With the calibration -3, a servo angle of -3 degrees is a joint angle of zero."""
    rig = Rig(angles={"l_hip_y": -3.0}, settings={"poppy.calibration": ["l_hip_y=-3"]})
    i = rig.plant.names.index("l_hip_y")
    assert rig.plant.measured.q[i] == pytest.approx(0.0, abs=1e-3)
    rig.settle()
    assert rig.memory.goal("l_hip_y") == pytest.approx(math.radians(-3.0), abs=1e-3)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("zero", [10.0, -10.0])
def test_a_calibration_does_not_move_the_limits_of_a_servo(zero: float, side: float) -> None:
    rig = Rig(settings={"poppy.calibration": [f"r_ankle_y={zero}"]})
    rig.settle()
    k, low, high = rig.plant.names.index("r_ankle_y"), *MOTORS["r_ankle_y"].limits
    u = np.zeros(MODEL.n)
    u[k] = side
    reached = []
    for _ in range(150):
        rig.plant.step(Command(0.0, u), DT)
        rig.memory.clock.now += DT
        reached.append(math.degrees(rig.memory.goal("r_ankle_y")))
    assert low - 0.1 <= min(reached)
    assert max(reached) <= high + 0.1
    assert (max(reached) > high - 1.0 - abs(zero)) if side > 0.0 else (min(reached) < low + 1.0 + abs(zero))


def test_a_joint_whose_limits_exclude_zero_has_its_first_pose_at_the_nearest_limit(tmp_path: Path) -> None:
    text = find_share("config/motors", "poppy.yaml").read_text(encoding="utf-8")
    path = tmp_path / "motors.yaml"
    path.write_text(re.sub(r"(r_elbow_y:.*?raw: )\[.*?\]", r"\1[20.0, 90.0]", text), encoding="utf-8")
    low, high = load_motors(str(path), TYPES)["r_elbow_y"].limits
    nearest = low if low > 0.0 else high
    assert abs(nearest) > 10.0
    rig = Rig(angles={"r_elbow_y": 0.5 * (low + high)}, settings={"poppy.motors": str(path)})
    rig.settle()
    k = rig.plant.names.index("r_elbow_y")
    assert math.degrees(rig.plant.measured.q[k]) == pytest.approx(nearest, abs=0.5 + math.degrees(0.1))
    rig.run(2.0)
    assert math.degrees(rig.plant.measured.q[k]) == pytest.approx(nearest, abs=0.5)
    assert rig.plant.remaining < 0.01


def test_a_joint_locked_at_an_angle_is_held_there() -> None:
    """The controller takes it to be at this angle."""
    trunk_and_arms = ["abs_*", "bust_*", "head_*", "?_arm_*", "?_elbow_*", "?_shoulder_y", "?_shoulder_x=0.25"]
    rig = Rig(settings={"robot.drop": [], "robot.lock": trunk_and_arms})
    rig.settle()
    rig.run(2.0)
    held = [rig.plant.measured.q[rig.plant.names.index(name)] for name in ("l_shoulder_x", "r_shoulder_x", "head_z")]
    assert held == pytest.approx([0.25, 0.25, 0.0], abs=0.01)


def test_the_distance_from_the_first_pose_is_that_of_the_farthest_joint() -> None:
    rig = Rig(angles={"l_knee_y": 40.0, "r_elbow_y": -70.0})
    rig.tick()
    assert rig.plant.remaining == pytest.approx(math.radians(70.0), abs=0.01)


def test_a_period_of_zero_sends_no_goals(rig: Rig) -> None:
    goals = rig.plant.goal.copy()
    rig.plant.write(Command(0.0, np.ones(rig.model.n), np.ones(rig.model.n)), 0.0)
    np.testing.assert_array_equal(rig.plant.goal, goals)


def test_the_largest_calibration_is_45_degrees() -> None:
    rig = Rig(settings={"poppy.calibration": ["l_hip_y=45", "r_hip_y=-45"]})
    assert math.degrees(rig.plant.measured.q[rig.plant.names.index("l_hip_y")]) == pytest.approx(-45.0, abs=0.1)


@pytest.mark.parametrize("entry", ["l_hip_y", "l_hip_y=x", "nobody=1", "l_hip_y=45.1", "l_hip_y=nan"])
def test_an_invalid_calibration_is_refused(entry: str) -> None:
    with pytest.raises(ConfigError, match=r"poppy\.calibration"):
        Rig(settings={"poppy.calibration": [entry]})


@pytest.mark.parametrize("u", [math.nan, math.inf])
def test_a_command_that_is_not_finite_is_refused(rig: Rig, u: float) -> None:
    goals = rig.plant.goal.copy()
    with pytest.raises(PlantError, match="finite velocities"):
        rig.tick(u)
    one = np.zeros(rig.model.n)
    one[3] = u
    with pytest.raises(PlantError, match="finite velocities"):
        rig.plant.write(Command(0.0, one), DT)
    np.testing.assert_array_equal(rig.plant.goal, goals)


@pytest.mark.parametrize(("effort", "dt", "expected"), [(math.nan, DT, "finite torques"), (0.0, math.inf, "period")])
def test_torques_and_periods_that_are_not_finite_are_refused(rig: Rig, effort: float, dt: float, expected: str) -> None:
    goals = rig.plant.goal.copy()
    with pytest.raises(PlantError, match=expected):
        rig.plant.write(Command(0.0, np.zeros(rig.model.n), np.full(rig.model.n, effort)), dt)
    np.testing.assert_array_equal(rig.plant.goal, goals)


def test_torques_are_clamped_to_the_effort_limits(rig: Rig) -> None:
    goals = []
    for effort in (MODEL.effort_max, np.full(MODEL.n, 1e300)):
        rig.plant.write(Command(0.0, np.zeros(rig.model.n), effort), DT)
        goals.append(rig.plant.goal.copy())
    np.testing.assert_array_equal(*goals)


def test_velocities_are_differences_of_angles(rig: Rig) -> None:
    k = rig.plant.names.index("l_knee_y")
    for _ in range(10):
        rig.tick(0.3)
    measured = []
    for _ in range(20):
        rig.tick(0.3)
        measured.append(rig.plant.measured.dq[k])
    assert np.mean(measured) == pytest.approx(0.3, abs=0.02)


@pytest.mark.parametrize("sync_read", [True, False])
def test_one_period_suffices_for_all_motors(sync_read: bool) -> None:
    rig = Rig(sync_read=sync_read)
    rig.settle()
    took = [rig.tick(0.1) for _ in range(100)]
    assert max(took) < DT  # both buses one after the other; the driver reads them in parallel
    assert not rig.plant.watch.faults


@pytest.mark.parametrize(
    ("port", "expected"),
    [
        ("/dev/null", r"the lower bus cannot be opened \(port /dev/null\): (?!no port).*is it plugged in"),
        ("auto", r"the lower bus cannot be opened \(port auto\): no port with the motors 11, 12.*is it plugged in"),
    ],
)
def test_missing_ports_are_refused(port: str, expected: str) -> None:
    own = CONFIG.updated({"poppy.lower_port": port})
    with pytest.raises(PlantError, match=expected):
        PoppyPlant(own, MODEL, np.zeros(MODEL.n))


def test_one_port_is_not_that_of_both_buses(tmp_path: Path) -> None:
    (tmp_path / "by-id").symlink_to("/dev/null")
    own = CONFIG.updated({"poppy.lower_port": "/dev/null", "poppy.upper_port": str(tmp_path / "by-id")})
    with pytest.raises(ConfigError, match="are the same port"):
        require_bus(own)


def test_dummy_servos_can_be_read_and_activated() -> None:
    own = CONFIG.updated({"poppy.dummy": True})
    plant = PoppyPlant(own, MODEL, np.zeros(MODEL.n))
    assert plant.measured.q[plant.names.index("l_hip_y")] == pytest.approx(math.radians(-2.0), abs=0.001)
    plant.activate()
    assert plant.active
    plant.close()


def test_a_whole_walking_cycle_with_emulated_servos(rig: Rig) -> None:
    """The walk finishes within all limits, and measured angles stay within 0.05 rad of the goals."""
    plant, controller = rig.plant, make_controller(CONFIG, MODEL)
    worst, state = 0.0, State(0.0, plant.measured.q[: MODEL.n])
    for k in range(20_000):
        command = controller.step(state, CONFIG.dt)
        if controller.finished:
            break
        plant.step(command, CONFIG.dt)
        rig.memory.clock.now += 0.01
        assert not plant.watch.faults
        state = State((k + 1) * CONFIG.dt, plant.measured.q[: MODEL.n].copy())
        worst = max(worst, float(np.abs(state.q - plant.goal[: MODEL.n]).max()))
        assert (state.q <= MODEL.q_max + 1e-3).all()
        assert (state.q >= MODEL.q_min - 1e-3).all()
    assert controller.finished
    assert worst < 0.05
