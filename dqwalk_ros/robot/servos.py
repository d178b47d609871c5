"""Models of position servos: the servos of the simulated robot, and the model of them that the controller uses.

A Dynamixel converts its position error e to a duty cycle, and the duty cycle to a torque on the output axis:

    duty = clip(P k e, -1, 1),    tau = stall (duty - dq / no_load_speed)

So stall P k is a stiffness, and stall / no_load_speed (back EMF) is a damping that also limits the speed.
"""

from __future__ import annotations

import fnmatch
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config, find_file
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support import strict_yaml
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ConfigError

IDENTIFIED = ("stiffness", "damping", "backlash", "friction")
"""Names allowed in an entry of ``servo.assumed`` [N m/rad, s, rad, N m]."""
_LATE = 0.045
"""Delay at which no damping is fed back where the servo has damping of its own [s]. At 40 ms the full damping excites
the joint; without any, the dynamic walk falls with delays of 15 to 26 ms."""


P_MOST = 254
"""Largest value of a P register."""


@dataclass(frozen=True)
class ServoType:
    """One row of config/servos.yaml, which explains each column and its unit.

    The columns after the armature are needed only by the driver of Poppy.
    """

    stall_torque: float
    no_load_speed: float
    voltage: float
    duty: float
    p_register: bool
    backlash: float
    resolution: float
    friction: float
    armature: float
    model: int = 0
    positions: int = 0
    range: float = 0.0
    speed_unit: float = 0.0

    def gain(self, p_gain: int) -> float:
        """Return the duty cycle per position error [1/rad]; `p_gain` is the P register, if there is one."""
        return self.duty * (p_gain if self.p_register else 1)

    def degrees(self, value: NDArray[Any] | float) -> Any:
        """Return the angle for a value of the position register [deg]; 0 is the middle of the range."""
        return self.range * value / (self.positions - 1) - 0.5 * self.range

    def position(self, degrees: float) -> int:
        """Return the value of the position register for an angle [deg], clipped to the range."""
        value = round((self.positions - 1) * (degrees / self.range + 0.5))
        return min(max(value, 0), self.positions - 1)


def load_types(source: str) -> dict[str, ServoType]:
    """Read a table of servo types from a path, or from the file of this name in config/.

    Raises
    ------
    ConfigError
        If the file is missing or not a valid table; the message names the type.
    """
    path = find_file("table of servos", source, "config", ("servos",))
    tree = strict_yaml.read(strict_yaml.read_text(path), source=str(path))
    try:
        return msgspec.convert(tree, dict[str, dict[str, ServoType]])["servos"]
    except (msgspec.ValidationError, KeyError) as error:
        raise ConfigError(f"{path}: expected 'servos: {{TYPE: {{stall_torque, ...}}}}': {error}") from error


@dataclass(frozen=True)
class Servos:
    """The servos of the simulated robot: tau = clip(stiffness e - damping dq, +-torque) - back_emf dq.

    All arrays have the shape (n,); e is the position error.
    """

    stiffness: Array
    """[N m/rad]"""
    damping: Array
    back_emf: Array
    """[N m s/rad]"""
    torque: Array
    """Stall torque [N m]."""
    backlash: Array
    """Total play of the gears [rad]."""
    friction: Array
    """Dry friction [N m]."""
    armature: Array
    """Inertia of the rotor, reflected through the gears [kg m^2]."""
    resolution: Array
    """Step size of the goal positions [rad]; 0: continuous."""

    @classmethod
    def of(cls, config: Config, model: RobotModel) -> Servos:
        """Return the servos of the section ``servo``; those of the joints in ``servo.types`` are from the table.

        Raises
        ------
        ConfigError
            If a type is not in the table, or an entry matches no joint.
        """
        c = config.servo
        stiffness = np.full(model.n, c.stiffness)
        out = cls(
            stiffness=stiffness,
            damping=c.damping * stiffness,
            back_emf=np.zeros(model.n),
            torque=np.minimum(c.torque_scale * model.effort_max, 1e3),
            backlash=np.full(model.n, c.backlash),
            friction=np.full(model.n, c.friction),
            armature=np.full(model.n, c.armature),
            resolution=np.full(model.n, c.resolution),
        )
        types = load_types(c.table) if c.types else {}
        for joints, name in _entries("servo.types", c.types, model):
            if name not in types:
                raise ConfigError(f"servo.types names '{name}'; servo.table has {', '.join(types)}")
            out.equip(joints, types[name], c.voltage, c.p_gain)
        return out

    def equip(self, joints: list[int] | slice, kind: ServoType, voltage: float, p_gain: int) -> None:
        """Put servos of a type, at a voltage [V] and with a gain, into some joints."""
        stall = kind.stall_torque * voltage / kind.voltage
        self.stiffness[joints] = stall * kind.gain(p_gain)
        self.damping[joints] = 0.0
        self.back_emf[joints] = kind.stall_torque / kind.no_load_speed  # independent of the voltage
        self.torque[joints] = stall
        self.backlash[joints] = kind.backlash
        self.friction[joints] = kind.friction
        self.armature[joints] = kind.armature
        self.resolution[joints] = kind.resolution

    @classmethod
    def identified(cls, config: Config, model: RobotModel) -> Servos:
        """Return the servos as ``servo.assumed`` says, where it says it; all others as `of` does.

        Raises
        ------
        ConfigError
            As `of`, or if an entry of ``servo.assumed`` cannot be read.
        """
        out = cls.of(config, model)
        for joints, text in _entries("servo.assumed", config.servo.assumed, model):
            given = _numbers(text)
            for name in ("stiffness", "backlash", "friction"):
                getattr(out, name)[joints] = given.get(name, getattr(out, name)[joints])
            if "damping" in given:
                out.damping[joints], out.back_emf[joints] = 0.0, given["damping"] * out.stiffness[joints]
        return out

    def load(self, effort: Array, velocity: Array) -> Array:
        """Return the part of its torque-speed curve that a torque at a velocity needs, shape (..., n); 1: all.

        Parameters
        ----------
        effort, velocity : ndarray, shape (..., n)
            Torques on the joints [N m], and their velocities [rad/s].
        """
        out: Array = np.abs(effort + self.back_emf * velocity) / self.torque
        return out

    def effort(self, load: Array, velocity: Array) -> Array:
        """Return the torques on the joints [N m] of signed loads, the inverse of `load`; shape (..., n) of all."""
        out: Array = load * self.torque - self.back_emf * velocity
        return out


def goal_windows(config: Config, model: RobotModel) -> Array:
    """Return the goal windows of the joints, shape (n,) [rad].

    They are ``servo.window``; of servos with a P register below `P_MOST` they are wider by as much as these are softer,
    so that a goal at the edge of its window exerts the same torque.

    Raises
    ------
    ConfigError
        As `Servos.of`.
    """
    c = config.servo
    windows, types = np.full(model.n, c.window), load_types(c.table) if c.types else {}
    for joints, name in _entries("servo.types", c.types, model):
        windows[joints] = c.window * (P_MOST / c.p_gain if types[name].p_register else 1.0)
    return windows


@dataclass(frozen=True)
class Drive:
    """The model of the servos that the controller uses; it may differ from the true servos."""

    stiffness: Array
    """Stiffness by which feedforward torques are converted to offsets of the goal, shape (n,) [N m/rad]; 0: no
    feedforward."""
    lag: Array
    """Torque per joint velocity by which a servo lags, shape (n,): its damping and back EMF [N m s/rad]."""
    lead: Array
    """Torque per commanded velocity by which the goal is ahead, against the damping of a servo, shape (n,) [N m s/rad].
    It is in addition to a command's torques and to their limits, because the servo takes it away again."""
    armature: Array
    """Inertia of the rotor, reflected through the gears, shape (n,) [kg m^2]."""
    delay: float
    """Time from a measurement to the effect of its command [s]: latency, half of the period at which goals are written,
    and the lag by damping minus the lead."""

    @classmethod
    def of(cls, config: Config, model: RobotModel) -> Drive:
        """Return the model given by ``servo.assumed_*``, ``servo.types`` and, with precedence, ``servo.assumed``.

        Raises
        ------
        ConfigError
            As `Servos.of`, or if an entry of ``servo.assumed`` is not valid.
        """
        c = config.servo
        stiffness, lag, lead, armature = (
            np.full(model.n, value)
            for value in (c.assumed_stiffness, c.assumed_damping, c.assumed_lead, c.assumed_armature)
        )
        if c.types:
            servos = Servos.of(config, model)
            typed = servos.back_emf > 0.0
            stiffness[typed], lag[typed] = servos.stiffness[typed], (servos.back_emf / servos.stiffness)[typed]
            lead[typed], armature[typed] = np.minimum(lead, lag)[typed], servos.armature[typed]
        for joints, text in _entries("servo.assumed", c.assumed, model):
            given = _numbers(text)
            stiffness[joints] = given.get("stiffness", stiffness[joints])
            if "damping" in given:
                lag[joints] = given["damping"]
                lead[joints] = np.minimum(lead[joints], lag[joints])
        period = 1.0 / c.assumed_rate if c.assumed_rate > 0.0 else 0.0
        delay = c.assumed_latency + 0.5 * period + max(float((lag - lead).mean()), 0.0)
        return cls(stiffness, lag * stiffness, lead * stiffness, armature, delay)

    @cached_property
    def damping(self) -> Array:
        """Torque per joint velocity that is fed back, shape (n,) [N m s/rad].

        It is the lag less the part that the lead compensates where the feedback would act late.
        """
        return np.maximum(self.lag - min(self.delay / _LATE, 1.0) * self.lead, 0.0)

    def angles(self, effort: Array) -> Array:
        """Return the offsets of the goals (n,) [rad] that produce the torques `effort` (n,) [N m]."""
        return effort * self._compliance

    @cached_property
    def _compliance(self) -> Array:
        """Inverse of the stiffness, zero where the stiffness is zero, shape (n,) [rad/(N m)]."""
        return np.divide(1.0, self.stiffness, out=np.zeros_like(self.stiffness), where=self.stiffness > 0.0)


def _entries(key: str, entries: tuple[str, ...], model: RobotModel) -> list[tuple[list[int], str]]:
    """Return the joint indices and the text of each entry JOINT=TEXT; locked joints match, but have no index."""
    out = []
    for entry in entries:
        name, equals, text = (part.strip() for part in entry.partition("="))
        if not equals or not text:
            raise ConfigError(f"{key} has '{entry}'; it must be JOINT=...")
        joints = [k for k, joint in enumerate(model.joint_names) if fnmatch.fnmatchcase(joint, name)]
        if not joints and not fnmatch.filter(model.all_joints, name):
            raise ConfigError(f"{key} names '{name}'; the joints are {', '.join(model.joint_names)}")
        out.append((joints, text))
    return out


def _numbers(text: str) -> dict[str, float]:
    """Return the numbers of a text such as 'stiffness 49.2, damping 0.009', by name."""
    try:
        pairs = [part.split() for part in text.split(",")]
        found = {name: float(value) for name, value in pairs}
    except ValueError:
        found = {}
    if not found or set(found) - set(IDENTIFIED) or not all(0.0 <= value < 1e4 for value in found.values()):
        raise ConfigError(f"servo.assumed has '{text}'; it must be 'stiffness 49.2, damping 0.009' of {IDENTIFIED}")
    return found
