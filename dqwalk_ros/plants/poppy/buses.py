"""The motors of a robot on their buses: what they are, goals that are sent, and settings that they confirm."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np

from dqwalk_ros.config import PoppyConfig
from dqwalk_ros.plants.poppy.dynamixel import Clock, DynamixelBus, Identity, Registers, find_port, open_port
from dqwalk_ros.plants.poppy.emulated_servos import EmulatedPort, EmulatedServo, EmulatedServos
from dqwalk_ros.plants.poppy.motor_watch import Part
from dqwalk_ros.plants.poppy.motors import Motor
from dqwalk_ros.robot.servos import ServoType
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import PlantError

MIN_SPEED = 1.4
"""Least speed: two units of 0.684 deg/s of the servo's speed register [deg/s]. A speed of less than half a unit is
rounded to 0, which means unlimited speed."""
TRIES = 5
"""Number of attempts to write or read registers of a motor before an error is reported."""
_NARROWER = 1.0
"""Angle by which the limits of a servo may be narrower than those of the table [deg]."""


def register_speed(speed: float, highest: float) -> float:
    """Return abs(speed) [deg/s] limited to `MIN_SPEED` and `highest`; `MIN_SPEED` if `speed` is not finite."""
    return min(max(abs(speed), MIN_SPEED), highest) if math.isfinite(speed) else MIN_SPEED


class MotorBuses:
    """The N motors of a robot on several buses.

    Parameters
    ----------
    motors : mapping of str to Motor
        By the names of the N joints.
    kinds : sequence of ServoType
        Their servos, in the same order.
    buses : mapping of str to DynamixelBus
        By their names.
    each : callable, optional
        Applies a function to all parts, like `map`; by default in parallel threads.

    Attributes
    ----------
    parts : list of Part
        The buses, and the motors on them.
    """

    def __init__(
        self,
        motors: Mapping[str, Motor],
        kinds: Sequence[ServoType],
        buses: Mapping[str, DynamixelBus],
        each: Callable[..., Iterable[Any]] | None = None,
    ) -> None:
        self._names, self._motors, self._kinds = list(motors), list(motors.values()), kinds
        place = {(motor.bus, motor.id): k for k, motor in enumerate(self._motors)}
        self.parts = [Part(bus, np.array([place[name, i] for i in bus.ids])) for name, bus in buses.items()]
        self._pool = ThreadPoolExecutor(len(self.parts))
        self.each = each if each is not None else self._pool.map

    def on_each(self, function: Callable[[Part], None]) -> None:
        """Call a function with each part."""
        list(self.each(function, self.parts))

    def identify(self, table: str) -> None:
        """Check that each motor is the one of a table, by its permanent registers.

        Raises
        ------
        PlantError
            If a motor does not answer, or is not the one of the table; the message names it.
        """
        wrong, silent = [], []
        for part in self.parts:
            for i, (motor, kind) in enumerate((self._motors[k], self._kinds[k]) for k in part.places):
                answers = (part.bus.identity(i) for _ in range(TRIES))
                found = next((answer for answer in answers if answer is not None), None)
                if found is None:
                    silent.append(f"{motor.name} ({motor.id}, {part.bus.name} bus) {part.bus.cause[i]}")
                    if len(silent) >= TRIES:  # enough for the message
                        break
                elif text := _difference(found, motor, kind):
                    wrong.append(f"{motor.name} ({motor.id}) {text}")
        if silent:
            raise PlantError(
                f"the motors do not answer: {', '.join(silent)}; is the robot on, is each bus on its port "
                "(poppy.lower_port, poppy.upper_port), has an FTDI or U2D2 a latency timer of 1 ms, and no adapter an "
                "echo? (poppy.dummy:=true tries the driver without a robot)"
            )
        if wrong:
            raise PlantError(f"the motors are not those of the table '{table}': {', '.join(wrong)}")

    def send(self, part: Part, places: Iterable[int], angle: Array, speed: Array, most: float) -> None:
        """Send goals to the motors of a part at `places`.

        Parameters
        ----------
        angle : ndarray, shape (N,)
            Of the joints, zero at that of the table [deg].
        speed : ndarray, shape (N,)
            Of the servos, of which none is above `most` [deg/s].
        """
        words = {}
        for i in places:
            k = part.places[i]
            words[i] = (self._motors[k].servo(float(angle[k])), register_speed(float(speed[k]), most))
        part.bus.write_goals(words)

    def read(self, at: Array, load: Array) -> Array:
        """Return the angles of the joints last read (N,) [deg]; set the times of their requests [s], and the loads."""
        degrees = np.empty(len(self._motors))
        for part in self.parts:
            at[part.places], load[part.places] = part.bus.at, part.bus.load
            degrees[part.places] = [
                self._motors[k].user(x) for k, x in zip(part.places, part.bus.position, strict=True)
            ]
        return degrees

    def position(self, part: Part, i: int, angle: Array) -> int:
        """Return the value in the goal register of a motor at the angles of the joints (N,) [deg]."""
        k = part.places[i]
        return part.bus.types[i].position(self._motors[k].servo(float(angle[k])))

    def confirm(
        self, write: Callable[[Part, list[int]], None], confirms: Callable[[Part, int, Registers], bool]
    ) -> list[str]:
        """Repeat a write until all motors confirm it; return the joints of those that do not."""

        def one_bus(part: Part) -> list[str]:
            left = list(range(len(part.places)))
            for _ in range(TRIES):
                write(part, left)
                left = [i for i in left if (found := part.bus.inspect(i)) is None or not confirms(part, i, found)]
                if not left:
                    break
            return [self._names[part.places[i]] for i in left]

        return [name for names in self.each(one_bus, self.parts) for name in names]

    def switch_off(self) -> list[str]:
        """Switch the torque off, and return the joints that do not confirm it."""
        return self.confirm(lambda part, left: part.bus.write_torque(False, left), lambda _, __, r: not r.torque)

    def close(self) -> None:
        """Close the buses."""
        self._pool.shutdown()
        for part in self.parts:
            part.bus.close()


def _difference(found: Identity, motor: Motor, kind: ServoType) -> str:
    """Return how a motor differs from the one of the table; empty if it does not."""
    if found.model != kind.model:
        return f"is model {found.model}, not an {motor.type}"
    if found.id != motor.id:
        return f"says that its id is {found.id}"
    if found.low >= found.high:
        return (
            f"does not turn to positions (wheel or multi-turn mode, its limits are {found.low} and {found.high}): "
            f"set them to 0 and {kind.positions - 1}"
        )
    low, high = kind.degrees(found.low), kind.degrees(found.high)
    if low > motor.raw[0] + _NARROWER or high < motor.raw[1] - _NARROWER:
        return (
            f"has the angle limits {low:.0f} and {high:.0f} deg, narrower than 'raw' [{motor.raw[0]:g}, "
            f"{motor.raw[1]:g}] of the table"
        )
    return ""


def _opened(port: str, ids: Sequence[int]) -> Any:
    """Return a port by its name or, for ``auto``, the one of these servos, which may have another name each time."""
    return open_port(find_port(ids) if port == "auto" else port)


def open_buses(
    motors: Mapping[str, Motor], types: Mapping[str, ServoType], config: PoppyConfig, clock: Clock
) -> dict[str, DynamixelBus]:
    """Open the buses of a table of motors, or emulated buses if `config.dummy` is set.

    Returns
    -------
    dict of str to DynamixelBus
        By the name of the bus.

    Raises
    ------
    PlantError
        If a port cannot be opened.
    """
    buses: dict[str, DynamixelBus] = {}
    named = {"lower": config.lower_port, "upper": config.upper_port}
    for name in sorted({motor.bus for motor in motors.values()}):
        own = [motor for motor in motors.values() if motor.bus == name]
        ids, kinds = [motor.id for motor in own], [types[motor.type] for motor in own]
        port = named.get(name, "auto")
        try:
            if config.dummy:
                servos = EmulatedServos([EmulatedServo(i, kind) for i, kind in zip(ids, kinds, strict=True)], clock)
                opened: Callable[[], Any] = partial(EmulatedPort, servos)
            else:
                opened = partial(_opened, port, ids)
            buses[name] = DynamixelBus(name, opened, ids, kinds, sync_read=config.sync_read, clock=clock)
        except (OSError, PlantError) as error:
            for bus in buses.values():
                bus.close()
            raise PlantError(
                f"the {name} bus cannot be opened (port {port}): {error}; is it plugged in, and not used by another "
                "program? (poppy.dummy:=true tries the driver without a robot)"
            ) from error
    return buses
