"""Poppy Humanoid's motors through pypot: joint velocities in, measured angles out.

pypot keeps 25 Dynamixel servos in step over two serial buses, at 50 Hz, in degrees and in its user's convention, which
is that of urdf/poppy.urdf. A servo takes a goal position and a speed, so velocities are integrated into goals here;
a goal never runs far ahead of its joint, no speed is ever zero (which the servo reads as: as fast as you can), and
the robot's first movement is slow. What pypot 5.0.2 breaks on today's Python (goto, goal_speed) is not used.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros import strict_yaml
from dqwalk_ros.config import PoppyConfig, find_share
from dqwalk_ros.controllers import Command, State
from dqwalk_ros.errors import ConfigError, PlantError
from dqwalk_ros.model import RobotModel

__all__ = ["Health", "Motor", "PoppyPlant", "load_motors", "register_speed"]

Array = NDArray[np.float64]

MIN_SPEED = 1.4
"""Two units of the servo's speed register [deg/s]. One unit is 0.684; below half of it the register reads 0, which
means no limit at all."""
_TYPES = ("MX-28", "MX-64", "MX-106", "AX-12", "AX-18")
_FIRST_READ = 5.0
"""Longest wait for the first angles [s]."""


@dataclass(frozen=True)
class Motor:
    """One servo.

    Attributes
    ----------
    name : str
        Of its joint.
    id : int
    type : str
    bus : str
    direct : bool
        Whether the servo turns the way the joint does.
    offset : float
        [deg]
    raw : tuple of float
        Limits in the servo's own angle [deg].
    """

    name: str
    id: int
    type: str
    bus: str
    direct: bool
    offset: float
    raw: tuple[float, float]

    def user(self, raw: float) -> float:
        """Return the joint's angle at an angle of the servo [deg]."""
        return (raw if self.direct else -raw) - self.offset

    def servo(self, user: float) -> float:
        """Return the servo's angle at an angle of the joint [deg]."""
        return user + self.offset if self.direct else -(user + self.offset)

    @property
    def limits(self) -> tuple[float, float]:
        """Limits of the joint [deg], lower first."""
        a, b = self.user(self.raw[0]), self.user(self.raw[1])
        return min(a, b), max(a, b)


def load_motors(source: str) -> dict[str, Motor]:
    """Read a table of motors: a path, or the name of one in config/motors/.

    Raises
    ------
    ConfigError
        If there is none, or it is not one; the message names the motor.
    """
    path = Path(source)
    if not path.is_file():
        path = find_share("config/motors", f"{source}.yaml" if not path.suffix else source)
    text = strict_yaml.read_text(path)
    tree = strict_yaml.read(text, source=str(path))
    table = tree.get("motors") if isinstance(tree, dict) else None
    if not isinstance(table, dict) or not table:
        raise ConfigError(f"{path}: expected 'motors: {{JOINT: {{id, type, bus, direct, offset, raw}}}}'")
    out: dict[str, Motor] = {}
    for name, entry in table.items():
        where = f"{path}, line {strict_yaml.line_of(text, ('motors', str(name)))}: motor '{name}'"
        try:
            numbers = {"raw": tuple(map(float, entry["raw"])), "offset": float(entry["offset"])}
            motor = Motor(name=str(name), **{**entry, **numbers})
        except (TypeError, KeyError, ValueError) as error:
            raise ConfigError(f"{where} needs id, type, bus, direct, offset and raw: {error}") from error
        bounded = all(abs(x) <= 360.0 for x in (motor.offset, *motor.raw))
        if len(motor.raw) != 2 or not bounded or not motor.raw[0] < motor.raw[1]:
            raise ConfigError(f"{where} must have raw: [lower, upper] and an offset in degrees, got {motor.raw}")
        if motor.type not in _TYPES or not isinstance(motor.direct, bool):
            raise ConfigError(f"{where} must have direct: true or false and a type of {', '.join(_TYPES)}")
        if not isinstance(motor.id, int) or not 0 <= motor.id <= 252 or motor.id in {m.id for m in out.values()}:
            raise ConfigError(f"{where} must have an id of its own between 0 and 252, got {motor.id!r}")
        out[motor.name] = motor
    return out


def register_speed(speed: float, highest: float) -> float:
    """Return the speed to write into a servo [deg/s]: never 0, never nothing, never above `highest`."""
    return min(max(abs(speed), MIN_SPEED), highest) if math.isfinite(speed) else MIN_SPEED


@dataclass(frozen=True)
class Health:
    """What the motors say of themselves, by joint; zeros where they are pypot's dummies."""

    temperature: dict[str, float]
    """[degC]"""
    voltage: dict[str, float]
    """[V]"""
    load: dict[str, float]
    """Percent of the largest torque."""

    @property
    def hottest(self) -> tuple[str, float]:
        """The hottest motor and its temperature [degC]."""
        return max(self.temperature.items(), key=lambda entry: entry[1])


class PoppyPlant:
    """A Poppy behind pypot, or pypot's dummies.

    Parameters
    ----------
    model : RobotModel
        Its joints are the ones that walk; the others go to their first pose and stay.
    config : PoppyConfig
    robot : object, optional
        A pypot robot to use instead of opening one.

    Raises
    ------
    PlantError
        If pypot is missing, the motors do not answer, or the model has a joint without a motor.
    ConfigError
        If the table of motors or the calibration cannot be used.
    """

    def __init__(self, model: RobotModel, config: PoppyConfig, robot: Any = None) -> None:
        self._model, self._config = model, config
        self.motors = load_motors(config.motors)
        if missing := [name for name in model.joint_names if name not in self.motors]:
            raise ConfigError(f"the motors '{config.motors}' lack {', '.join(missing)} of {model.name}")
        zero = _calibration(config.calibration, self.motors)
        self.names = (*model.joint_names, *(name for name in self.motors if name not in model.joint_names))
        self._zero = np.array([zero.get(name, 0.0) for name in self.names])  # [deg]
        low, high = np.array([self.motors[name].limits for name in self.names]).T
        self._low, self._high = np.radians(low - self._zero), np.radians(high - self._zero)
        n = model.n
        self._low[:n] = np.maximum(self._low[:n], model.q_min)
        self._high[:n] = np.minimum(self._high[:n], model.q_max)
        self._robot = robot if robot is not None else _open(self.motors, config)
        self._servos = [getattr(self._robot, name) for name in self.names]
        self._goal = self._read()
        self._time = 0.0
        self._first = np.clip(np.zeros(len(self.names)), self._low, self._high)
        self.ready = False
        self.compliant = True
        self._state = State(self._time, self._goal[:n], np.zeros(n))

    # ------------------------------------------------------------------ angles

    def _read(self) -> Array:
        """Return the measured angles of all joints [rad]."""
        degrees = np.array([servo.present_position for servo in self._servos], dtype=np.float64)
        if not np.isfinite(degrees).all():
            bad = [name for name, angle in zip(self.names, degrees, strict=True) if not math.isfinite(angle)]
            raise PlantError(f"no angle from {', '.join(bad)}")
        out: Array = np.radians(degrees - self._zero)
        return out

    def _write(self, goal: Array, speed: Array) -> None:
        """Send goals [rad], inside the limits, and speeds [rad/s]."""
        self._goal = np.clip(goal, self._low, self._high)
        highest = self._config.max_speed
        for servo, angle, v in zip(self._servos, np.degrees(self._goal) + self._zero, np.degrees(speed), strict=True):
            servo.moving_speed = register_speed(float(v), highest)
            servo.goal_position = float(angle)

    @property
    def q(self) -> Array:
        """Measured angles of all motors in the order of `names` [rad]."""
        return self._read()

    @property
    def goal(self) -> Array:
        """Goals of all motors in the order of `names` [rad]."""
        return self._goal

    @property
    def state(self) -> State:
        """The joints of the model as they were measured last."""
        return self._state

    # ------------------------------------------------------------------ moving

    def set_compliant(self, compliant: bool) -> None:
        """Switch the torque of all motors off, or on again where they stand; nothing moves by that."""
        if not compliant:
            self._write(self._read(), np.zeros(len(self.names)))
        for servo in self._servos:
            servo.compliant = compliant
        if not compliant:
            self._write(self._read(), np.zeros(len(self.names)))
        self.compliant = compliant
        self.ready = False

    def approach(self, dt: float) -> float:
        """Move towards the first pose for `dt` [s], slowly; return the largest angle that is left [rad].

        The robot is `ready` when every goal is there and every joint near it, or as near as it gets.
        """
        if dt <= 0.0:
            return float(np.abs(self._first - self._goal).max())
        speed = self._config.start_speed
        q = self._advance(np.clip((self._first - self._goal) / dt, -speed, speed), dt)
        left = float(np.abs(self._first - q).max())
        arrived = float(np.abs(self._first - self._goal).max()) < 1e-9
        self.ready = self.ready or (arrived and left < self._config.start_tolerance)
        return left

    def step(self, command: Command, dt: float) -> State:
        """Move as commanded for `dt` [s]; return what is measured now.

        Raises
        ------
        PlantError
            If the command is not finite or does not fit, or pypot has stopped.
        """
        u = np.asarray(command.velocity, dtype=np.float64)
        if u.shape != (self._model.n,) or not np.isfinite(u).all():
            raise PlantError(f"the command must have {self._model.n} finite velocities, got {u}")
        all_u = np.zeros(len(self.names))
        all_u[: self._model.n] = np.clip(u, -self._model.velocity_max, self._model.velocity_max)
        self._advance(all_u, dt)
        return self._state

    def _advance(self, u: Array, dt: float) -> Array:
        """Move the goals by u dt [rad] and note what is measured; return it [rad]."""
        self._check_alive()
        q = self._read()
        if not self.compliant:
            lead = self._config.max_lead
            goal = np.clip(self._goal + dt * u, q - lead, q + lead)
            # fast enough to be there within a period, and to catch up with what is left
            self._write(goal, 1.5 * np.abs(u) + np.abs(goal - q) / max(dt, 1e-3))
        n = self._model.n
        self._time += dt
        self._state = State(self._time, q[:n], (q[:n] - self._state.q) / dt if dt > 0.0 else np.zeros(n))
        return q

    def _check_alive(self) -> None:
        for controller in getattr(self._robot, "_controllers", ()):
            if not controller.running:
                raise PlantError("pypot's loop with the motors has ended: is a cable loose, or the power off?")

    @property
    def health(self) -> Health:
        """What the motors say of themselves."""
        return Health(*(self._register(key) for key in ("present_temperature", "present_voltage", "present_load")))

    def _register(self, key: str) -> dict[str, float]:
        return {name: float(getattr(s, key, 0.0) or 0.0) for name, s in zip(self.names, self._servos, strict=True)}

    def close(self) -> None:
        """Hold where it stands, or go limp if `torque_off_at_end`; then let go of the buses."""
        if self._config.torque_off_at_end:
            self.set_compliant(True)
        elif not self.compliant:
            self._write(self._read(), np.zeros(len(self.names)))
        time.sleep(0.05)  # pypot's loop sends it
        self._robot.close()


def _calibration(entries: tuple[str, ...], motors: Mapping[str, Motor]) -> dict[str, float]:
    """Return the zero of joints [deg] from texts such as ``l_hip_y=-3``."""
    out = {}
    for entry in entries:
        name, _, value = entry.partition("=")
        try:
            out[name] = float(value)
        except ValueError:
            out[name] = math.nan
        if name not in motors or not abs(out[name]) <= 45.0:
            raise ConfigError(f"poppy.calibration: '{entry}' should be JOINT=DEGREES, at most 45, such as l_hip_y=-3")
    return out


def _open(motors: Mapping[str, Motor], config: PoppyConfig) -> Any:
    try:
        from pypot.robot import from_config
    except ImportError as error:
        raise PlantError(
            "the Poppy driver needs pypot: pip install --no-deps pypot==5.0.2, and pip install pyserial "
            f"(missing: {error.name})"
        ) from error
    buses = sorted({motor.bus for motor in motors.values()})
    ports = dict(zip(("lower", "upper"), (config.lower_port, config.upper_port), strict=True))
    description = {
        "controllers": {
            bus: {"sync_read": config.sync_read, "attached_motors": [f"{bus}_motors"], "port": ports.get(bus, "auto")}
            for bus in buses
        },
        "motorgroups": {f"{bus}_motors": [m.name for m in motors.values() if m.bus == bus] for bus in buses},
        "motors": {
            m.name: {
                "id": m.id,
                "type": m.type,
                "orientation": "direct" if m.direct else "indirect",
                "offset": m.offset,
                "angle_limit": list(m.raw),
            }
            for m in motors.values()
        },
    }
    try:
        robot = from_config(description, use_dummy_io=config.dummy)
    except Exception as error:  # pypot, pyserial and the system each have their own
        raise PlantError(
            f"the motors do not answer: {' '.join(str(error).split())[:300]}; is the robot on, and are both buses "
            "plugged in? (poppy.dummy:=true tries the driver without a robot)"
        ) from error
    return robot
