"""Communication with one bus of Dynamixel servos (protocol 1).

The packets are made and checked by dynamixel_sdk of ROBOTIS. In addition, every angle has a time stamp, a missing or
damaged reply affects only its own servo and is stored as a cause, the duration of each call is bounded, and failures of
the port do not raise exceptions: a port that is lost is opened again as soon as it is available.

Registers and units: emanual.robotis.com, MX-28, MX-64 and AX-12 (protocol 1).
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from dqwalk_ros.robot.servos import ServoType
from dqwalk_ros.support.errors import PlantError

Clock = Callable[[], float]


ERROR_BITS: Final = {
    1: "input voltage",
    2: "angle limit",
    4: "overheating",
    8: "range",
    16: "checksum",
    32: "overload",
    64: "instruction",
}
"""Error bits in every reply of a servo."""

LIMITS: Final = 6
"""Lower and upper limit of the goal position, two bytes each."""
_IDENTITY: Final = 10
"""Number of bytes from the model number up to these limits."""
TORQUE_ENABLE: Final = 24
GAINS: Final = 26
"""D, I and P gain of an MX, a byte each; of an AX, other properties."""
GOAL: Final = 30
"""Goal, speed and torque limit, two bytes each."""
TORQUE_LIMIT: Final = 34
PRESENT: Final = 36
"""Position, speed and load, two bytes each."""
FULL_TORQUE: Final = 1023
"""Largest value of the register of the torque limit."""
_INSPECTED: Final = 20
"""Number of bytes from `TORQUE_ENABLE` up to the temperature."""
SILENT: Final = "does not answer"
DAMAGED: Final = "sends damaged replies"
UNSENT: Final = "cannot be asked: the port takes no bytes"
"""Why a reading failed."""
_SYNC_READ: Final = 0x84
"""Instruction of the USB2AX adapter, which reads the servos one after the other and replies for all of them."""
_TIMEOUT: Final = 0.01
"""Timeout of a reply, in addition to the transmission time of its bytes [s]."""
_GIVE_UP: Final = 3
"""Number of consecutive servos without an answer after which a cycle is aborted."""
_REOPEN: Final = 1.0
"""Time between two attempts to open a port again [s]."""
_REFUSED: Final = {
    errno.EACCES: "no permission: sudo usermod -aG dialout $USER, then log in again",
    errno.EAGAIN: "it is in use already",
    errno.EBUSY: "it is in use already",
}
"""Why a port cannot be opened, by the number of the error."""


@dataclass(frozen=True)
class Registers:
    """Registers of one servo at the last inspection."""

    torque: bool
    """Whether the torque is on."""
    gain: int
    """D, I and P gain of an MX as one number of three bytes: its P gain, if the others are 0."""
    goal: int
    """Value of the goal position register."""
    torque_limit: int
    """Up to 1023; 0 after the servo has switched its torque off."""
    voltage: float
    """[V]"""
    temperature: float
    """[degC]"""
    at: float
    """Time of the request, by the clock of the bus [s]."""


@dataclass(frozen=True)
class Identity:
    """What a servo is, by its permanent registers."""

    model: int
    id: int
    """Model number, and its id on the bus."""
    low: int
    high: int
    """Limits of its goal positions; equal in the modes in which it does not turn to a position."""


def open_port(name: str) -> Any:
    """Open a serial port at 1 Mbaud for exclusive use.

    Parameters
    ----------
    name : str
        Name of the port, such as ``/dev/ttyACM0``.

    Returns
    -------
    PortHandler
        Port of dynamixel_sdk.

    Raises
    ------
    ModuleNotFoundError
        If dynamixel_sdk or pyserial is missing.
    OSError
        If there is no such port, or another program uses it.
    """
    import serial
    from dynamixel_sdk import PortHandler

    class Port(PortHandler):  # type: ignore[misc]
        """Port of the SDK with blocking reads, a monotonic clock, and a timeout even if bytes arrive continuously."""

        def setupPort(self, cflag_baud: int) -> bool:
            self.ser = serial.Serial(self.port_name, self.baudrate, timeout=0.002, write_timeout=0.05, exclusive=True)
            self.is_open = True
            self.tx_time_per_byte = 1e4 / self.baudrate  # [ms]
            return True

        def getCurrentTime(self) -> float:
            return 1e3 * time.monotonic()

        def setPacketTimeout(self, packet_length: int) -> None:
            self.setPacketTimeoutMillis(self.tx_time_per_byte * packet_length + 1e3 * _TIMEOUT)

        def writePort(self, packet: Sequence[int]) -> int:
            try:
                return int(self.ser.write(bytearray(packet)) or 0)
            except serial.SerialTimeoutException:  # a busy computer or adapter; a port that is gone raises other errors
                return 0

        def readPort(self, length: int) -> bytes:
            over = self.getTimeSinceStart() > self.packet_timeout
            return b"" if over or length <= 0 else self.ser.read(length)

    port = Port(name)
    try:
        port.openPort()
    except OSError as error:
        why = _REFUSED.get(error.errno or 0) or (os.strerror(error.errno) if error.errno else str(error))
        raise OSError(f"{name}: {why}") from error
    return port


def find_port(ids: Sequence[int]) -> str:
    """Return the name of the serial port on which the largest number of these servos answers.

    Raises
    ------
    PlantError
        If no servo answers on any port.
    """
    from dynamixel_sdk import COMM_SUCCESS, Protocol1PacketHandler
    from serial.tools.list_ports import comports

    handler, found = Protocol1PacketHandler(), dict[str, int]()
    refused: list[str] = []
    for candidate in comports():
        try:
            port = open_port(candidate.device)
            found[candidate.device] = sum(handler.ping(port, i)[1] == COMM_SUCCESS for i in ids)
            port.closePort()
        except OSError as error:
            refused.append(str(error))
    best = max(found, key=lambda name: found[name], default="")
    if not best or not found[best]:
        searched = [*(f"{name}: none of them answers" for name in found), *refused]
        raise PlantError(
            f"no port with the motors {', '.join(map(str, ids))} ({'; '.join(searched) or 'no serial port'})"
        )
    return best


class DynamixelBus:
    """The servos of one bus.

    Parameters
    ----------
    name : str
        Name of the bus in messages.
    opener : callable
        Returns a port like `open_port`; called again after the port is lost.
    ids : sequence of int
        Ids of the n servos.
    types : sequence of ServoType
        Types of the servos.
    sync_read : bool
        Whether the adapter reads all servos with one instruction (USB2AX).
    clock : callable
        Monotonic time [s].

    Attributes
    ----------
    position : ndarray, shape (n,)
        Angles of the servos [deg]; nan before the first reading.
    load : ndarray, shape (n,)
        Percent of the largest torque, positive towards positive angles.
    at : ndarray, shape (n,)
        Times at which the angles were requested [s]; -inf before the first reading.
    cause : list of str
        Reason for which the last reading of a servo failed; empty if it succeeded.
    error : ndarray of int, shape (n,)
        Error bits of the last reply.
    registers : list of Registers or None
        Registers of each servo at its last inspection.
    lost : str
        Reason for which the port is not open; empty if it is open.

    Raises
    ------
    OSError
        If the port cannot be opened.
    """

    def __init__(
        self,
        name: str,
        opener: Callable[[], Any],
        ids: Sequence[int],
        types: Sequence[ServoType],
        *,
        sync_read: bool = False,
        clock: Clock = time.monotonic,
    ) -> None:
        from dynamixel_sdk import COMM_RX_TIMEOUT, COMM_SUCCESS, COMM_TX_FAIL, Protocol1PacketHandler

        self._success, self._handler = COMM_SUCCESS, Protocol1PacketHandler()
        self._causes = {COMM_RX_TIMEOUT: SILENT, COMM_TX_FAIL: UNSENT}
        self.name, self.ids, self.types = name, tuple(ids), tuple(types)
        self._open, self._sync_read, self._clock = opener, sync_read, clock
        n = len(self.ids)
        self.position, self.load = np.full(n, np.nan), np.zeros(n)
        self.at = np.full(n, -np.inf)
        self.cause = ["no answer yet"] * n
        self.error = np.zeros(n, np.intp)
        self.registers: list[Registers | None] = [None] * n
        self.lost = ""
        self._first = 0  # first servo of the next cycle
        self._retry = -math.inf
        self._port: Any = opener()

    # ------------------------------------------------------------------ packets

    def _guarded(self, exchange: Callable[[Any], Any]) -> Any:
        """Return the result of an exchange over the port; None if the port is lost."""
        if self._port is None:
            if self._clock() < self._retry:
                return None
            self._retry = self._clock() + _REOPEN
            try:
                self._port = self._open()
                self.lost = ""
            except Exception as error:  # pyserial, termios and the system raise different exceptions
                self._mark_lost(error)
                return None
        try:
            return exchange(self._port)
        except Exception as error:
            self._mark_lost(error)
            return None

    def _mark_lost(self, error: Exception) -> None:
        self.lost = f"the port is gone: {' '.join(str(error).split())[:200] or type(error).__name__}"
        self.cause = [self.lost] * len(self.ids)
        self.close()
        self._retry = self._clock() + _REOPEN

    def _read(self, i: int, address: int, length: int) -> bytes | None:
        """Return registers of one servo; None if it does not answer or its reply is damaged."""
        reply = self._guarded(lambda port: self._handler.readTxRx(port, self.ids[i], address, length))
        if reply is None:
            return None
        data, result, error = reply
        if result != self._success or len(data) != length:
            self.cause[i] = self._causes.get(result, DAMAGED)
            return None
        self.cause[i], self.error[i] = "", error
        return bytes(data)

    def _read_all(self, address: int, length: int) -> list[bytes | None]:
        """Return registers of all servos, read by the adapter in one exchange; None for those without an answer."""
        n = len(self.ids)

        def exchange(port: Any) -> tuple[bytes, int]:
            packet = [0, 0, 254, n + 4, _SYNC_READ, address, length, *self.ids, 0]
            result = self._handler.txPacket(port, packet)
            if result == self._success:
                port.setPacketTimeout(n * (length + 8) + 6)
                reply, result = self._handler.rxPacket(port)
            return (bytes(reply[5:-1]), result) if result == self._success else (b"", result)

        reply = self._guarded(exchange)
        if reply is None:
            return [None] * n
        data, result = reply
        if result != self._success or len(data) != n * length:
            why = self._causes.get(result, DAMAGED)
            self.cause = [why] * n
            return [None] * n
        out: list[bytes | None] = []
        for i in range(n):
            one = data[i * length : (i + 1) * length]
            there = one != b"\xff" * length  # reply of the adapter for a servo that does not answer
            self.cause[i] = "" if there else SILENT
            out.append(one if there else None)
        return out

    def _write(self, address: int, data: dict[int, bytes]) -> None:
        """Write registers of servos, by their index on the bus; there is no reply."""
        if not data:
            return
        size = len(next(iter(data.values())))
        words = [byte for i, some in data.items() for byte in (self.ids[i], *some)]
        self._guarded(lambda port: self._handler.syncWriteTxOnly(port, address, size, words, len(words)))

    # ------------------------------------------------------------------ measurements

    def read(self) -> None:
        """Read the angles and loads of all servos."""
        now = self._clock()
        if self._sync_read and len(self.ids) > 1:
            for i, data in enumerate(self._read_all(PRESENT, 6)):
                self._store(i, data, now)
            return
        n, failed = len(self.ids), 0
        for k in range(n):
            i = (self._first + k) % n
            asked = self._clock()
            data = self._read(i, PRESENT, 6)
            self._store(i, data, asked)
            failed = failed + 1 if data is None else 0
            if failed >= min(_GIVE_UP, n) or self.lost:
                self._first = (i + 1) % n
                return

    def _store(self, i: int, data: bytes | None, asked: float) -> None:
        if data is None:
            return
        position, _, load = (int.from_bytes(data[k : k + 2], "little") for k in (0, 2, 4))
        if position >= self.types[i].positions:
            self.cause[i] = f"sends the invalid position {position}"
            return
        self.position[i], self.at[i] = self.types[i].degrees(position), asked
        self.load[i] = (-1.0 if load & 1024 else 1.0) * (load & 1023) / 10.23

    def inspect(self, i: int) -> Registers | None:
        """Read and return the `Registers` of servo `i`; None if it does not answer."""
        asked = self._clock()
        data = self._read(i, TORQUE_ENABLE, _INSPECTED)
        if data is None:
            return None
        self._store(i, data[PRESENT - TORQUE_ENABLE :], asked)
        goal, limit = (int.from_bytes(data[k - TORQUE_ENABLE :][:2], "little") for k in (GOAL, TORQUE_LIMIT))
        gain = int.from_bytes(data[GAINS - TORQUE_ENABLE :][:3], "big")
        voltage, temperature = data[-2] / 10.0, float(data[-1])
        found = Registers(bool(data[0]), gain, goal, limit, voltage, temperature, asked)
        self.registers[i] = found
        return found

    def identity(self, i: int) -> Identity | None:
        """Read and return the `Identity` of servo `i`; None if it does not answer."""
        data = self._read(i, 0, _IDENTITY)
        if data is None:
            return None
        model, low, high = (int.from_bytes(data[k : k + 2], "little") for k in (0, LIMITS, LIMITS + 2))
        return Identity(model, data[3], low, high)

    # ------------------------------------------------------------------ commands

    def write_goals(self, goals: Mapping[int, tuple[float, float]]) -> None:
        """Send goals [deg] and speeds [deg/s] to servos, by their index on the bus."""
        words = {}
        for i, (angle, speed) in goals.items():
            goal, turns = self.types[i].position(angle), round(speed / self.types[i].speed_unit)
            words[i] = goal.to_bytes(2, "little") + min(max(turns, 1), 1023).to_bytes(2, "little")
        self._write(GOAL, words)

    def write_torque(self, on: bool, places: Iterable[int]) -> None:
        """Switch the torque of servos on or off."""
        self._write(TORQUE_ENABLE, {i: bytes([on]) for i in places})

    def write_gain(self, gain: int, places: Iterable[int]) -> None:
        """Set the P gain of MX servos, and their other gains to 0."""
        self._write(GAINS, {i: bytes([0, 0, gain]) for i in places})

    def write_torque_limit(self, limit: int, places: Iterable[int]) -> None:
        """Set the torque limit of servos, up to 1023."""
        self._write(TORQUE_LIMIT, {i: limit.to_bytes(2, "little") for i in places})

    def close(self) -> None:
        """Close the port and ignore its errors."""
        port, self._port = self._port, None
        if port is None:
            return
        with contextlib.suppress(Exception):  # the port may be lost
            port.closePort()
