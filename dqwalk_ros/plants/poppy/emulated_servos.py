"""Emulated Dynamixel servos that exchange packets of protocol 1: the dummy motors of the Poppy driver.

The driver runs on them without any change. While its torque is on, an emulated servo turns to its goal at its moving
speed; gravity and inertia are not simulated.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from dqwalk_ros.plants.poppy.dynamixel import GOAL, LIMITS, PRESENT, TORQUE_ENABLE, TORQUE_LIMIT
from dqwalk_ros.robot.servos import ServoType

_PING, _READ, _WRITE, _SYNC_WRITE, _SYNC_READ = 1, 2, 3, 0x83, 0x84
_ADAPTER = 0xFD
"""Id with which a USB2AX answers a sync read of several servos."""


class EmulatedServo:
    """The registers and the motion of one servo.

    Parameters
    ----------
    number : int
        Id of the servo.
    degrees : float
        Initial angle [deg].
    """

    def __init__(self, number: int, kind: ServoType, degrees: float = 0.0) -> None:
        self.number, self.kind = number, kind
        self.memory = bytearray(74)
        self.error = 0
        self.moved = kind.position(degrees) * 1.0
        self.blocked = False
        self._at = 0.0
        self.power_on()

    def power_on(self) -> None:
        """Set the registers to their values after power-on, with the torque off."""
        self.write(0, self.kind.model.to_bytes(2, "little") + bytes([30, self.number, 1]))
        self.write(LIMITS, bytes(2) + (self.kind.positions - 1).to_bytes(2, "little"))  # limits of its angle
        self.write(TORQUE_ENABLE, bytes([0]))
        self.write(26, bytes([0, 0, 32, 32]))  # D, I, P of an MX; margin and slope of an AX
        self.write(GOAL, round(self.moved).to_bytes(2, "little") + bytes(2) + (1023).to_bytes(2, "little"))
        self.write(42, bytes([120, 38]))  # 12 V, 38 degC

    def word(self, address: int) -> int:
        """Return a register of two bytes."""
        return int.from_bytes(self.memory[address : address + 2], "little")

    def write(self, address: int, data: bytes) -> None:
        """Write registers."""
        self.memory[address : address + len(data)] = data

    def advance(self, now: float) -> None:
        """Simulate the motion until the time `now` [s]."""
        passed, self._at = max(now - self._at, 0.0), now
        if self.memory[TORQUE_ENABLE] and self.word(TORQUE_LIMIT) and not self.blocked:
            unit = self.kind.range / (self.kind.positions - 1)  # [deg]
            speed = self.word(GOAL + 2) * self.kind.speed_unit or math.degrees(self.kind.no_load_speed)
            step = speed / unit * passed
            if not self.word(LIMITS) and not self.word(LIMITS + 2):  # wheel mode: it turns without end
                self.moved = (self.moved + step) % self.kind.positions
            else:
                self.moved += min(max(self.word(GOAL) - self.moved, -step), step)
        self.write(PRESENT, round(self.moved).to_bytes(2, "little"))


class EmulatedServos:
    """The servos of one bus, and the replies they give.

    Parameters
    ----------
    clock : callable
        Monotonic time [s].

    Attributes
    ----------
    goals_switch_on : bool
        Whether a goal switches the torque of its servo on, as some firmware does.
    """

    goals_switch_on = False

    def __init__(self, servos: Sequence[EmulatedServo], clock: Callable[[], float] = time.monotonic) -> None:
        self.servos = {servo.number: servo for servo in servos}
        self._clock = clock

    def reply(self, packet: bytes) -> bytes:
        """Return the reply of the bus to an instruction packet; empty if there is no reply."""
        number, instruction, words = packet[2], packet[4], packet[5:-1]
        if instruction == _SYNC_WRITE:
            address, length = words[0], words[1]
            for k in range(2, len(words), length + 1):
                self.write(words[k], address, words[k + 1 : k + 1 + length])
        elif instruction == _SYNC_READ:
            address, length = words[0], words[1]
            data = b"".join(self.read(i, address, length) or b"\xff" * length for i in words[2:])
            return self.status(_ADAPTER, 0, data)
        elif number in self.servos and instruction in (_PING, _READ, _WRITE):
            if instruction == _WRITE:
                self.write(number, words[0], words[1:])
            reply = self.read(number, words[0], words[1]) if instruction == _READ else b""
            return b"" if reply is None else self.status(number, self.servos[number].error, reply)
        return b""

    def read(self, number: int, address: int, length: int) -> bytes | None:
        """Return registers of a servo; None if there is no servo with this id."""
        if (servo := self.servos.get(number)) is None:
            return None
        servo.advance(self._clock())
        return bytes(servo.memory[address : address + length])

    def write(self, number: int, address: int, data: bytes) -> None:
        """Write registers of a servo, if there is one with this id."""
        if (servo := self.servos.get(number)) is not None:
            servo.advance(self._clock())
            servo.write(address, data)
            if self.goals_switch_on and address <= GOAL < address + len(data):
                servo.write(TORQUE_ENABLE, bytes([1]))

    @staticmethod
    def status(number: int, error: int, data: bytes) -> bytes:
        """Return a status packet."""
        body = bytes([number, len(data) + 2, error]) + data
        return b"\xff\xff" + body + bytes([~sum(body) & 255])


class EmulatedPort:
    """A port of dynamixel_sdk connected to emulated servos, which reply immediately or not at all."""

    def __init__(self, servos: EmulatedServos) -> None:
        self.servos = servos
        self.is_using = False
        self._waiting = b""

    def clearPort(self) -> None:
        """Discard the bytes received."""
        self._waiting = b""

    def writePort(self, packet: Sequence[int]) -> int:
        """Send a packet."""
        self._waiting += self.servos.reply(bytes(packet))
        return len(packet)

    def readPort(self, length: int) -> bytes:
        """Return the bytes received, at most `length`."""
        out, self._waiting = self._waiting[: max(length, 0)], self._waiting[max(length, 0) :]
        return out

    def setPacketTimeout(self, length: int) -> None:
        """Do nothing: a reply is available immediately."""

    def isPacketTimeout(self) -> bool:
        """Return whether all bytes received have been read."""
        return not self._waiting

    def closePort(self) -> None:
        """Do nothing."""
