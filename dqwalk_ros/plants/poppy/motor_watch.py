"""Detects faults of the motors of a robot; each message names the motor, the cause and the remedy."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import PoppyConfig
from dqwalk_ros.plants.poppy.dynamixel import DAMAGED, ERROR_BITS, FULL_TORQUE, SILENT, UNSENT, DynamixelBus, Registers
from dqwalk_ros.plants.servo_goals import JUMPS
from dqwalk_ros.support.arrays import Array, Mask
from dqwalk_ros.support.wording import listed, without_numbers

_BRIEF = 1.0
"""Longest timeout after which the motion continues; after a longer one an operator must activate the robot [s]."""
_TWICE = 2
"""Number of consecutive readings of a high temperature or a low voltage that are a fault."""
_COOLER, _FULLER = 5.0, 0.5
"""Hysteresis of temperature [K] and voltage [V] for the end of a fault, and distance of its warning before it."""
_DAMAGED = "is the cable intact, and does no other program use the port?"
_ASKS = {
    SILENT: "is the power on, and the cable plugged in?",
    UNSENT: "is this computer too busy, or its adapter to be plugged in again?",
}
"""What to look for if no servo of a bus is read, for each cause; else `_DAMAGED`."""
_FULL = 0.95
"""Part of the position error of full torque at which a servo counts as pushing."""
_SWITCHED_OFF = 4 | 32
"""Error bits of faults at which a servo switches its torque off: overheating and overload."""


@dataclass(frozen=True)
class Part:
    """A bus, and the indices `places` (k,) of its k servos among all motors."""

    bus: DynamixelBus
    places: NDArray[np.intp]


@dataclass
class Measured:
    """Measurements of N motors."""

    q: Array
    dq: Array
    """Accepted angles [rad], nan before the first, and velocities [rad/s], each of shape (N,)."""
    at: Array
    """Times at which these angles were requested, shape (N,) [s]."""
    jumps: NDArray[np.intp]
    """Number of implausible angles since, shape (N,)."""
    load: Array
    """Percent of the largest torque, shape (N,)."""
    runaway: Mask
    """Whether the joints have moved against their full torque, which is therefore switched off, shape (N,)."""


class _Limit(NamedTuple):
    """A limit of a motor, and a reading of it."""

    kind: str
    at: float
    excess: float
    """By how much the reading exceeds it."""
    near: float
    """How near it is a warning."""
    reading: str
    beyond: str
    """The reading, and that it is beyond the limit, in words."""
    remedy: str
    alarm: bool = False
    """Whether the motor itself reports that it is beyond its limit."""


def _joined(messages: Mapping[str, str]) -> str:
    """Return messages, by kind and joint, in one text, with one for all joints of which the same is said."""
    alike: dict[str, tuple[str, list[str]]] = {}
    for key, text in messages.items():
        name = key.rpartition("/")[2]
        alike.setdefault(without_numbers(text.removeprefix(name)), (text, []))[1].append(name)
    return "; ".join(text + (f" (also {listed(more)})" if more else "") for text, (_, *more) in alike.values())


class MotorWatch:
    """Detects faults of the motors after each reading.

    Parameters
    ----------
    names : sequence of str
        The N joints.
    max_age : float
        Age above which angles are not used [s].

    Attributes
    ----------
    passing : dict of str to str
        Messages of the current faults, by kind and joint.
    warnings : dict of str to str
        What will soon be a fault, so that a walk should end before.
    lasting : dict of str to str
        Messages of the faults that remain until an operator switches the torque on again.
    unsure : ndarray of bool, shape (N,)
        Motors that did not answer in time and whose registers have not been read since.
    """

    def __init__(self, names: tuple[str, ...], parts: list[Part], config: PoppyConfig, max_age: float) -> None:
        self._names, self._parts, self._config, self._max_age = names, parts, config, max_age
        n = len(names)
        self.passing: dict[str, str] = {}
        self.warnings: dict[str, str] = {}
        self.lasting: dict[str, str] = {}
        self.unsure = np.zeros(n, bool)
        self._looked = np.full(n, -np.inf)
        self._counts: dict[str, int] = {}
        self._pushing_since = np.full(n, np.inf)
        self._silent_since: dict[str, float] = {}

    @property
    def faults(self) -> dict[str, str]:
        """Messages of all faults."""
        return self.passing | self.lasting

    @property
    def fault(self) -> str:
        """All faults in one text; or empty."""
        return _joined(self.faults)

    @property
    def warning(self) -> str:
        """All warnings in one text; or empty."""
        return _joined(self.warnings)

    def forget(self) -> None:
        """Clear the lasting faults, when the torque is switched on or off."""
        self.lasting.clear()
        self._pushing_since[:] = np.inf

    def look(self, now: float, measured: Measured, goal: Array | None, lead: Array, gain: NDArray[np.intp]) -> None:
        """Update the faults from the measurements.

        Parameters
        ----------
        now : float
            Time of the buses' clock [s].
        goal : ndarray, shape (N,), optional
            Goals of the servos [rad]; None if the torque is off.
        lead : ndarray, shape (N,)
            Largest distances of the goals at which the servos do not have their full torque [rad].
        gain : ndarray of int, shape (N,)
            Commanded gains; negative if any gain is allowed.
        """
        on = goal is not None
        found, warnings = dict[str, str](), dict[str, str]()
        self._timeouts(now, measured, on, found)
        for part in self._parts:
            for i, place in enumerate(part.places):
                given = int(gain[place]) if on and not measured.runaway[place] else None
                self._registers(part.bus, i, int(place), given, found, warnings)
        if goal is not None:
            self._blocked_joints(now, measured, goal, lead)
            for name in (self._names[k] for k in np.flatnonzero(measured.runaway)):
                self.lasting[f"runaway/{name}"] = (
                    f"{name} moved away from its goal at full torque, which is now off: it is not in the mode for "
                    "positions, its sensor is broken, or the load is too large; support the robot, then ~/activate"
                )
        if on and not found and self.unsure.any():
            some = ", ".join(self._names[i] for i in np.flatnonzero(self.unsure))
            found["silent"] = f"{some}: being checked after a timeout"
        self.passing, self.warnings = found, warnings

    def _timeouts(self, now: float, measured: Measured, on: bool, found: dict[str, str]) -> None:
        old = now - measured.at > self._max_age
        self.unsure |= old
        for part in self._parts:
            bus, silent = part.bus, np.flatnonzero(old[part.places])
            if bus.lost:
                found[f"silent/{bus.name}"] = f"{bus.name} bus: {bus.lost}; plug it in"
            elif len(silent) == len(part.places) and not any(bus.cause) and not measured.jumps[part.places].any():
                late = now - measured.at[part.places].min()
                found[f"silent/{bus.name}"] = f"{bus.name} bus: not read for {late:.2f} s; is this computer too busy?"
            elif len(silent) == len(part.places) and len(set(bus.cause)) == 1 and bus.cause[0]:
                why = bus.cause[0]
                found[f"silent/{bus.name}"] = f"{bus.name} bus: every motor {why}; {_ASKS.get(why, _DAMAGED)}"
            else:
                for i in silent:
                    name = self._names[part.places[i]]
                    why = bus.cause[i] or "sends implausible angles"
                    found[f"silent/{name}"] = (
                        f"{name} (motor {bus.ids[i]}, {bus.name} bus) {why}; check its cable and its LED"
                        f"{', and that no other motor has its id' if why == DAMAGED else ''}"
                    )
        self._silent_since = {key: self._silent_since.get(key, now) for key in found}
        if on:
            for key, since in self._silent_since.items():
                if now - since > _BRIEF or ": the port is gone" in found[key]:
                    self.lasting[key] = f"{found[key]}; then ~/activate"
            for k in np.flatnonzero(measured.jumps >= JUMPS):
                self.lasting[f"jump/{self._names[k]}"] = (
                    f"{self._names[k]} has jumped to another angle and stays there; check its horn and its "
                    "calibration, then ~/activate"
                )

    def _registers(
        self, bus: DynamixelBus, i: int, place: int, gain: int | None, found: dict[str, str], warnings: dict[str, str]
    ) -> None:
        name, registers = self._names[place], bus.registers[i]
        if bus.error[i] & _SWITCHED_OFF and gain is not None:
            bits = " and ".join(text for bit, text in ERROR_BITS.items() if bit & bus.error[i] & _SWITCHED_OFF)
            self.lasting[f"error/{name}"] = (
                f"{name} reports {bits} and has switched its torque off; support the robot, let the motor cool, "
                "then ~/activate"
            )
        if registers is None:
            return
        new = registers.at > self._looked[place]
        self._looked[place] = registers.at
        if new:
            self.unsure[place] = False
            full = registers.torque and registers.torque_limit == FULL_TORQUE
            if gain is not None and not (full and gain in (registers.gain, -1)):
                self.lasting[f"torque/{name}"] = (
                    f"{name} has lost its torque or its gain: was its power cut, or has another program written to it? "
                    "support the robot, then ~/activate"
                )
        for limit in self._limits(registers, alarm=bool(bus.error[i] & 1)):
            self._compare(name, limit, new, found, warnings)

    def _limits(self, registers: Registers, *, alarm: bool) -> tuple[_Limit, _Limit]:
        """Return temperature and supply voltage beside their limits; `alarm` is the motor's own of its voltage."""
        hot, low = self._config.hot, self._config.low_voltage
        charge = "charge the battery (poppy.low_voltage)"
        beyond = f"too little; {charge}"
        if alarm and registers.voltage >= low:
            beyond = "outside of the limits in its registers; check battery and supply"
        cool = "let it cool (poppy.hot)"
        heat, supply = f"is at {registers.temperature:.0f} degC", f"has {registers.voltage:.1f} V"
        return (
            _Limit("hot", hot, registers.temperature - hot, _COOLER, heat, f"too hot; {cool}", cool),
            _Limit("voltage", low, low - registers.voltage, _FULLER, supply, beyond, charge, alarm),
        )

    def _compare(self, name: str, limit: _Limit, new: bool, found: dict[str, str], warnings: dict[str, str]) -> None:
        """Report a motor that is beyond a limit as a fault, and one that is near it as a warning."""
        key, soon = f"{limit.kind}/{name}", f"soon {limit.kind}/{name}"
        beyond = limit.alarm or limit.excess > -limit.near * (key in self.passing)
        self._report_repeated(key, beyond, new, f"{name} {limit.reading}, {limit.beyond}", found)
        near = limit.excess > -limit.near * (1 + (soon in self.warnings))
        text = f"{name} {limit.reading}, the robot holds at {limit.at:g}; {limit.remedy}"
        self._report_repeated(soon, near, new, text, warnings)

    def _report_repeated(self, key: str, bad: bool, new: bool, text: str, found: dict[str, str]) -> None:
        """Report a fault, or a warning, at its second consecutive reading."""
        if new:
            self._counts[key] = self._counts.get(key, 0) + 1 if bad else 0
        if self._counts.get(key, 0) >= _TWICE:
            found[key] = text

    def _blocked_joints(self, now: float, measured: Measured, goal: Array, lead: Array) -> None:
        """Report joints that have been at full load or far from their goals for too long."""
        c = self._config
        behind = np.abs(goal - measured.q)
        pushing = ((behind > _FULL * lead) | (np.abs(measured.load) >= c.max_load)) & ~measured.runaway
        self._pushing_since = np.where(pushing, np.minimum(self._pushing_since, now), np.inf)
        for k in np.flatnonzero(now - self._pushing_since > c.blocked_after):
            self.lasting.setdefault(
                f"blocked/{self._names[k]}",
                f"{self._names[k]} cannot follow: {math.degrees(behind[k]):.0f} deg behind its goal at "
                f"{abs(measured.load[k]):.0f} % load; free it, then ~/activate",
            )
