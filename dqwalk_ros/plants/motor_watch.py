"""What is wrong with the motors of a robot, which one it is, and what to do about it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import PoppyConfig
from dqwalk_ros.plants.dynamixel import ERROR_BITS, Bus

__all__ = ["JUMPS", "Measured", "MotorWatch", "Part"]

Array = NDArray[np.float64]

JUMPS = 3
"""Angles in a row, far from the last good one, that are no glitch any more."""
_BRIEF = 1.0
"""A silence that is shorter ends by itself; after a longer one somebody must look at the robot [s]."""
_TWICE = 2
"""Looks in a row that must find a motor too hot or its voltage too low."""
_COOLER, _FULLER = 5.0, 0.5
"""Heat and voltage must be this much better before a motor is well again [K], [V]."""
_SWITCHED_OFF = 4 | 32
"""Error bits with which a servo switches its torque off: overheating and overload."""


@dataclass(frozen=True)
class Part:
    """A bus, and the places of its servos among all motors."""

    bus: Bus
    places: NDArray[np.intp]


@dataclass
class Measured:
    """What is known of N motors.

    Attributes
    ----------
    q, dq : ndarray, shape (N,)
        Angles that are believed, and velocities [rad], [rad/s]; nan before the first.
    at : ndarray, shape (N,)
        When the servos were asked for these angles [s].
    jumps : ndarray, shape (N,)
        Angles in a row that were not believed since.
    load : ndarray, shape (N,)
        Percent of the largest torque.
    """

    q: Array
    dq: Array
    at: Array
    jumps: NDArray[np.intp]
    load: Array


class MotorWatch:
    """Judges the motors after each reading.

    Parameters
    ----------
    names : sequence of str
    parts : list of Part
    config : PoppyConfig
    max_age : float
        Angles older than this count for nothing [s].

    Attributes
    ----------
    passing : dict of str to str
        What is wrong now: the motor, the cause, and what to do, by kind and joint.
    lasting : dict of str to str
        What stays wrong until somebody switches the torque anew.
    unsure : ndarray of bool, shape (N,)
        Motors that were silent and have not been looked at since.
    """

    def __init__(self, names: tuple[str, ...], parts: list[Part], config: PoppyConfig, max_age: float) -> None:
        self._names, self._parts, self._config, self._max_age = names, parts, config, max_age
        n = len(names)
        self.passing: dict[str, str] = {}
        self.lasting: dict[str, str] = {}
        self.unsure = np.zeros(n, bool)
        self._looked = np.full(n, -np.inf)
        self._counts: dict[str, int] = {}
        self._pushing_since = np.full(n, np.inf)
        self._silent_since: dict[str, float] = {}

    @property
    def faults(self) -> dict[str, str]:
        """All that is wrong."""
        return self.passing | self.lasting

    def forget(self) -> None:
        """Begin anew: somebody has seen to the motors."""
        self.lasting.clear()
        self._pushing_since[:] = np.inf

    def look(self, now: float, measured: Measured, goal: Array | None, gain: NDArray[np.intp]) -> None:
        """Judge what was measured.

        Parameters
        ----------
        now : float
            [s]
        measured : Measured
        goal : ndarray, shape (N,), optional
            What the servos were told [rad]; None where their torque is off.
        gain : ndarray of int, shape (N,)
            Gains that they were told; negative for any.
        """
        on = goal is not None
        found: dict[str, str] = {}
        self._silence(now, measured, on, found)
        for part in self._parts:
            for i, place in enumerate(part.places):
                self._registers(part.bus, i, int(place), int(gain[place]) if on else None, found)
        if goal is not None:
            self._obedience(now, measured, goal)
        if on and not found and self.unsure.any():
            some = ", ".join(self._names[i] for i in np.flatnonzero(self.unsure))
            found["silent"] = f"{some}: looked at after a silence"
        self.passing = found

    def _silence(self, now: float, measured: Measured, on: bool, found: dict[str, str]) -> None:
        old = now - measured.at > self._max_age
        self.unsure |= old
        for part in self._parts:
            bus, silent = part.bus, np.flatnonzero(old[part.places])
            if bus.lost:
                found[f"silent/{bus.name}"] = f"{bus.name} bus: {bus.lost}; plug it in"
            elif len(silent) == len(part.places) and len(set(bus.cause)) == 1:
                found[f"silent/{bus.name}"] = (
                    f"{bus.name} bus: every motor {bus.cause[0]}; is the power on, and the cable in?"
                )
            else:
                for i in silent:
                    name = self._names[part.places[i]]
                    why = bus.cause[i] or "says angles that it cannot have"
                    found[f"silent/{name}"] = (
                        f"{name} (motor {bus.ids[i]}, {bus.name} bus) {why}; look at its cable and its lamp"
                    )
        self._silent_since = {key: self._silent_since.get(key, now) for key in found}
        if on:
            for key, since in self._silent_since.items():
                if now - since > _BRIEF or ": the port is gone" in found[key]:
                    self.lasting[key] = f"{found[key]}; then ~/activate"
            for k in np.flatnonzero(measured.jumps >= JUMPS):
                self.lasting[f"jump/{self._names[k]}"] = (
                    f"{self._names[k]} has jumped to another angle and stays there; look at its horn and its "
                    "calibration, then ~/activate"
                )

    def _registers(self, bus: Bus, i: int, place: int, gain: int | None, found: dict[str, str]) -> None:
        name, seen = self._names[place], bus.registers[i]
        if bus.error[i] & _SWITCHED_OFF and gain is not None:
            bits = " and ".join(text for bit, text in ERROR_BITS.items() if bit & bus.error[i] & _SWITCHED_OFF)
            self.lasting[f"error/{name}"] = (
                f"{name} reports {bits} and has switched its torque off; support the robot, let the motor cool, "
                "then ~/activate"
            )
        if seen is None:
            return
        new = seen.at > self._looked[place]
        self._looked[place] = seen.at
        if new:
            self.unsure[place] = False
            if gain is not None and not (seen.torque and seen.torque_limit and gain in (seen.gain, -1)):
                self.lasting[f"torque/{name}"] = (
                    f"{name} has lost its torque or its gain: was its power cut? support the robot, then ~/activate"
                )
        c = self._config
        self._doubt(
            f"hot/{name}",
            seen.temperature > c.hot - _COOLER * (f"hot/{name}" in self.passing),
            new,
            f"{name} is at {seen.temperature:.0f} degC, too hot; let it cool (poppy.hot)",
            found,
        )
        self._doubt(
            f"voltage/{name}",
            seen.voltage < c.low_voltage + _FULLER * (f"voltage/{name}" in self.passing) or bool(bus.error[i] & 1),
            new,
            f"{name} has {seen.voltage:.1f} V, too little; charge the battery (poppy.low_voltage)",
            found,
        )

    def _doubt(self, key: str, bad: bool, new: bool, text: str, found: dict[str, str]) -> None:
        """Believe what is bad at the second look."""
        if new:
            self._counts[key] = self._counts.get(key, 0) + 1 if bad else 0
        if self._counts.get(key, 0) >= _TWICE:
            found[key] = text

    def _obedience(self, now: float, measured: Measured, goal: Array) -> None:
        """Find joints that have pushed in vain for too long."""
        c = self._config
        behind = np.abs(goal - measured.q)
        pushing = (behind > 0.95 * c.max_lead) | (np.abs(measured.load) >= c.max_load)
        self._pushing_since = np.where(pushing, np.minimum(self._pushing_since, now), np.inf)
        for k in np.flatnonzero(now - self._pushing_since > c.blocked_after):
            self.lasting.setdefault(
                f"blocked/{self._names[k]}",
                f"{self._names[k]} cannot follow: {math.degrees(behind[k]):.0f} deg behind its goal at "
                f"{abs(measured.load[k]):.0f} % load; free it, then ~/activate",
            )
