"""Poppy's driver on servos that carry the robot: MuJoCo behind both emulated buses, in simulated time."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from dynamixel_bus import MOTORS, TEMPERATURE, TYPES, Memory

import dqwalk_ros as dq
from dqwalk_ros.config import Config, overlaid
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.state import Command, State
from dqwalk_ros.plants.base import Inertial, Plant, Truth
from dqwalk_ros.plants.mujoco import PhysicsPlant
from dqwalk_ros.plants.poppy.dynamixel import PRESENT
from dqwalk_ros.plants.poppy.emulated_servos import EmulatedServo
from dqwalk_ros.plants.poppy.plant import PoppyPlant
from dqwalk_ros.plants.servo_goals import AngleGate, ServoGoals
from dqwalk_ros.report import analyse, report
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.servos import Drive
from dqwalk_ros.simulation import simulate
from dqwalk_ros.walks.table import make_controller, make_walk

CONFIG = overlaid(dq.load("poppy"), "poppy_as_built").updated({"qp.solver": "daqp"})
DYNAMIC = overlaid(dq.load("poppy_dynamic_50hz"), "poppy_as_built")
MODEL = dq.load_model(CONFIG.robot)
GAINS = (254, 127)
LESS_EXACT: dict[str, Any] = {"least_inside": 99.0, "apart": 0.01, "tolerated": frozenset({"landing"})}
"""The dynamic walk: at 50 Hz single ticks have their pressure outside, and some steps land 5 to 7 mm off."""
SAMPLE = 0.004  # time between two readings of the set points by the engine [s]


class LoadedServo(EmulatedServo):
    """A servo whose joint is moved by the engine: `moved` is only its set point, `present` what it measures."""

    present = bytes(6)

    def advance(self, now: float) -> None:
        super().advance(now)
        self.write(PRESENT, self.present)

    def measure(self, degrees: float, speed: float, torque: float) -> None:
        """Set position [deg] and speed [deg/s] of its axis, and the load of its torque [N m], in the registers' units.

        The load is the duty cycle: a torque, and the back EMF.
        """
        words = [self.kind.position(degrees)]
        duty = torque / self.kind.stall_torque + math.radians(speed) / self.kind.no_load_speed
        for value in (speed / self.kind.speed_unit, 1023.0 * duty):
            words.append(min(round(abs(value)), 1023) | (1024 if value < 0.0 else 0))
        self.present = b"".join(word.to_bytes(2, "little") for word in words)


class RegisterGoals(ServoGoals):
    """The set points of emulated servos, after the latency of the robot, are the goals of the servos in the engine."""

    def __init__(self, config: Config, model: RobotModel, memory: Memory) -> None:
        gate = AngleGate(model.joint_names, model.velocity_max, 1.0, longest=lambda: 1.0, timeout=lambda: 1.0)
        super().__init__(gate, Drive.of(config, model), model, config.servo.window)
        self._names, self._memory, self._delay = model.joint_names, memory, config.servo.latency

    def command(self, velocity: np.ndarray, effort: object, time: float, dt: float) -> bool:
        """Do nothing: the driver has written the goals to the registers."""
        return True

    def output(self, time: float) -> tuple[np.ndarray, float]:
        self._memory.clock.now = time
        points = []
        for name in self._names:
            self._memory.servo(name).advance(time)
            points.append(self._memory.angle(name))
        self._queue.append((time + self._delay, np.array(points)))
        return super().output(time)[0], time + SAMPLE


class PoppyOnTheFloor(Plant):
    """The driver, both buses, and the robot in MuJoCo; straps hold the robot until it is in its first pose."""

    def __init__(self, config: Config, model: RobotModel, warming: float = 0.0) -> None:
        self._warming = warming  # of the left knee, which begins at 57 degC [K/s]
        posture = make_walk(config, model).posture
        degrees = dict(zip(model.joint_names, np.degrees(posture), strict=True))
        self.memory, self._names = Memory(**degrees), model.joint_names
        for name in model.joint_names:
            motor = MOTORS[name]
            servo = LoadedServo(motor.id, TYPES[motor.type], motor.servo(degrees[name]))
            self.memory.of(name).servos[motor.id] = servo
        self.robot = PhysicsPlant(config, model, posture, law=RegisterGoals(config, model, self.memory))
        self.memory.clock.now = self.robot.data.time
        self._measure()
        memory = self.memory
        self.driver = PoppyPlant(config, model, posture, buses=memory.buses, clock=memory.clock, each=map)
        self.driver.activate()
        while not self.driver.ready:
            self._state = self.driver.step(Command(0.0, np.zeros(model.n)), config.dt)
            assert not self.driver.watch.faults
        self._state = self._sensed(self.driver.state)

    def step(self, command: Command, dt: float) -> State:
        self.driver.write(command, dt)
        self.robot.step(Command(command.time, np.zeros_like(command.velocity)), dt)
        self.memory.clock.now = self.robot.data.time
        if self._warming:
            heat = round(57.0 + self._warming * self.robot.state.time)
            self.memory.servo("l_knee_y").memory[TEMPERATURE] = heat
        self._measure()
        self._state = self._sensed(self.driver.read())
        return self._state

    def _measure(self) -> None:
        state, effort = self.robot.state, self.robot.truth.effort
        for k, name in enumerate(self._names):
            motor = MOTORS[name]
            sign = 1.0 if motor.direct else -1.0
            angle, speed = np.degrees([state.q[k], sign * state.dq[k]])
            self.memory.servo(name).measure(motor.servo(angle), speed, sign * effort[k])

    def _sensed(self, measured: State) -> State:
        """Return the angles of the motors with the measurements of the inertial sensor."""
        return replace(self.robot.state, q=measured.q, dq=measured.dq, effort=measured.effort)

    @property
    def state(self) -> State:
        return self._state

    @property
    def truth(self) -> Truth:
        return self.robot.truth

    @property
    def inertial(self) -> Inertial:
        return self.robot.inertial

    @property
    def fallen(self) -> bool:
        return self.robot.fallen

    @property
    def warning(self) -> str:
        return self.driver.warning


def settings(gain: int, seed: int, steps: int, config: Config = CONFIG) -> Config:
    changes = {"gait.steps": steps, "servo.p_gain": gain, "sensors.seed": seed}
    return config.updated(changes)


def check_walk(
    config: Config,
    *,
    ramp: int = 0,
    least_inside: float = 99.9,
    apart: float = 0.005,
    tolerated: frozenset = frozenset(),
) -> None:
    plant = PoppyOnTheFloor(config, MODEL)
    trace = simulate(make_controller(config, MODEL), plant)
    found = report(analyse(trace))
    physics = found["physics"]
    tilt, ahead = np.degrees(physics["tilt"]["value"]), physics["displacement"][0]
    inside = 100.0 * physics["cop_inside"]
    print(f"{physics['steps'] - 1} steps: {ahead:.3f} m, tilt at most {tilt:.2f} deg, pressure inside {inside:.2f} %")
    assert trace.finished, trace.notes
    assert not plant.driver.watch.faults
    assert not {one["what"] for one in found["violations"]} - tolerated
    assert not physics["fallen"]
    assert tilt < 1.0
    assert inside > least_inside
    assert ahead > 0.95 * config.gait.step_length * (config.gait.steps - ramp) - 0.01
    feet = [DQ(x).translation() for x in plant.truth.soles.values()]
    assert abs(feet[0][0] - feet[1][0]) < apart  # together


@pytest.mark.parametrize("gain", [pytest.param(254, marks=pytest.mark.long), 127])
def test_the_robot_walks_through_the_driver(gain: int) -> None:
    check_walk(settings(gain, 0, 3))


@pytest.mark.long
@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("gain", GAINS)
def test_20_steps_through_the_driver(gain: int, seed: int) -> None:
    check_walk(settings(gain, seed, 20))


def test_the_robot_walks_dynamically_through_the_driver() -> None:
    check_walk(settings(254, 0, 6, DYNAMIC), ramp=2, **LESS_EXACT)


@pytest.mark.long
@pytest.mark.parametrize("warming", [0.5, 1.0, 2.0])
def test_a_dynamic_walk_ends_on_both_feet_before_a_motor_is_too_hot(warming: float) -> None:
    config = settings(254, 0, 100, DYNAMIC)
    plant = PoppyOnTheFloor(config, MODEL, warming)
    trace = simulate(make_controller(config, MODEL), plant)
    print(f"{warming:g} K/s: {trace.notes}, ended at {trace.time[-1]:.2f} s")
    assert trace.finished
    assert "l_knee_y is at 61 degC" in trace.notes[0]
    assert not plant.driver.watch.faults
    feet = [DQ(x).translation() for x in plant.truth.soles.values()]
    assert abs(feet[0][0] - feet[1][0]) < 0.01
    while not plant.driver.watch.faults:
        plant.step(Command(0.0, np.zeros(MODEL.n)), config.dt)
    assert "too hot" in str(plant.driver.watch.faults)
    for _ in range(50):
        plant.step(Command(0.0, np.zeros(MODEL.n)), config.dt)
    assert not plant.fallen


@pytest.mark.long
def test_the_driver_knows_which_foot_bears_what() -> None:
    """From the present loads of the motors, whose bus is slow and late."""
    config = settings(254, 0, 6, DYNAMIC).updated({"poppy.load": True})
    trace = simulate(make_controller(config, MODEL), PoppyOnTheFloor(config, MODEL))
    assert trace.finished, trace.notes
    error = report(analyse(trace))["physics"]["load_error"]
    print(f"the load of a foot is {error:.3f} of the weight off (median)")
    assert error < 0.1


@pytest.mark.long
@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("gain", GAINS)
def test_20_dynamic_steps_through_the_driver(gain: int, seed: int) -> None:
    check_walk(settings(gain, seed, 20, DYNAMIC), ramp=3, **LESS_EXACT)
