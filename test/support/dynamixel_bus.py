"""Emulation of Poppy's two motor buses with faults: in memory with a test clock, or over pseudo-terminals."""

from __future__ import annotations

import contextlib
import os
import random
import select
import sys
import threading
import time
import tty
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from stepped_time import SteppedTime

from dqwalk_ros.plants.poppy.dynamixel import PRESENT, TORQUE_ENABLE, DynamixelBus
from dqwalk_ros.plants.poppy.emulated_servos import EmulatedPort, EmulatedServo, EmulatedServos
from dqwalk_ros.plants.poppy.motors import Motor, load_motors
from dqwalk_ros.robot.servos import load_types

TYPES = load_types("servos")
MOTORS = load_motors("poppy", TYPES)
BUSES = ("lower", "upper")
TEMPERATURE, VOLTAGE, LOAD = 43, 42, 40
_SWITCH = 5e-4
"""Longest time for which another thread of the test delays a reply [s]."""


class FaultyServos(EmulatedServos):
    """The servos of one bus, with faults.

    Attributes
    ----------
    dead : bool
        The bus has no power, or its cable is unplugged.
    silent : set of int
        Servos that neither receive nor reply.
    unplugged : bool
        The port does not exist.
    damaged : float
        Fraction of the replies with one flipped bit.
    garbage : float
        Fraction of the replies replaced by random bytes.
    noise : callable
        Returns the bytes that arrive before a reply.
    drop_reply : callable
        Given an instruction packet, returns whether its reply is lost.
    slip : dict of int to float
        Error of the position of a servo [deg].
    """

    def __init__(
        self, servos: Sequence[EmulatedServo], clock: Callable[[], float] = time.monotonic, seed: int = 1
    ) -> None:
        super().__init__(servos, clock)
        self.rng = random.Random(seed)
        self.requests: list[bytes] = []
        self.clear_faults()

    def clear_faults(self) -> None:
        """Remove all faults except those stored in the servos."""
        self.dead = self.unplugged = False
        self.silent: set[int] = set()
        self.damaged = self.garbage = 0.0
        self.noise: Callable[[], bytes] = lambda: b""
        self.slip: dict[int, float] = {}
        self.drop_reply: Callable[[bytes], bool] = lambda packet: False
        for servo in self.servos.values():
            servo.blocked = False

    def cut_power(self) -> None:
        """Switch the power of the bus off and on again."""
        for servo in self.servos.values():
            servo.advance(self._clock())
            servo.power_on()

    def reply(self, packet: bytes) -> bytes:
        self.requests.append(packet)
        if self.dead:
            return b""
        hidden = {i: self.servos.pop(i) for i in self.silent if i in self.servos}
        try:
            out = super().reply(packet)
        finally:
            self.servos |= hidden
        if not out or self.drop_reply(packet):
            return b""
        if self.rng.random() < self.damaged:
            words = bytearray(out)
            words[self.rng.randrange(len(words))] ^= 1 << self.rng.randrange(8)
            return bytes(words)
        return self.noise() + (self.rng.randbytes(len(out)) if self.rng.random() < self.garbage else out)

    def read(self, number: int, address: int, length: int) -> bytes | None:
        out = super().read(number, address, length)
        if out is None or number not in self.slip or not address <= PRESENT < address + length:
            return out
        kind = self.servos[number].kind
        shown = kind.position(kind.degrees(self.servos[number].moved) + self.slip[number])
        k = PRESENT - address
        return out[:k] + shown.to_bytes(2, "little") + out[k + 2 :]

    def joint(self, name: str) -> EmulatedServo:
        """Return the servo of a joint."""
        return self.servos[MOTORS[name].id]


def servos_of(bus: str, angles: dict[str, float]) -> list[EmulatedServo]:
    """Return the servos of a bus, at angles of their joints [deg]."""
    own = [motor for motor in MOTORS.values() if motor.bus == bus]
    return [EmulatedServo(m.id, TYPES[m.type], m.servo(angles.get(m.name, 0.0))) for m in own]


# ---------------------------------------------------------------------- in memory


class TimedPort(EmulatedPort):
    """A port with the transmission times of packets and of reply timeouts."""

    timeout, per_byte, usb = 0.01, 1e-5, 2e-4  # [s]

    def __init__(self, servos: FaultyServos, clock: SteppedTime) -> None:
        if servos.unplugged:
            raise OSError("No such file or directory")
        super().__init__(servos)
        self._clock = clock

    def writePort(self, packet: Sequence[int]) -> int:
        if self.servos.unplugged:
            raise OSError("Input/output error")
        self._clock.now += self.usb + self.per_byte * len(packet)
        return super().writePort(packet)

    def readPort(self, length: int) -> bytes:
        if self.servos.unplugged:
            raise OSError("Input/output error")
        out = super().readPort(length)
        self._clock.now += self.per_byte * len(out)
        return out

    def isPacketTimeout(self) -> bool:
        over = super().isPacketTimeout()
        self._clock.now += self.timeout if over else 0.0
        return over


class Memory:
    """Both buses in memory.

    Parameters
    ----------
    timed : bool
        Whether packets take the time that they take on a robot.
    angles : float
        Initial angles of joints [deg].

    Attributes
    ----------
    clock : SteppedTime
    servos : dict of str to FaultyServos
        By bus.
    buses : dict of str to DynamixelBus
    """

    def __init__(
        self,
        *,
        sync_read: bool = True,
        seed: int = 1,
        timed: bool = True,
        clock: SteppedTime | None = None,
        **angles: float,
    ) -> None:
        self.clock, self._timed = clock or SteppedTime(), timed
        self.servos = {name: FaultyServos(servos_of(name, angles), self.clock, seed) for name in BUSES}
        self.sync_read = sync_read

    @property
    def buses(self) -> dict[str, DynamixelBus]:
        return {
            name: DynamixelBus(
                name,
                lambda servos=servos: self._port(servos),
                list(servos.servos),
                [servo.kind for servo in servos.servos.values()],
                sync_read=self.sync_read,
                clock=self.clock,
            )
            for name, servos in self.servos.items()
        }

    def _port(self, servos: FaultyServos) -> EmulatedPort:
        port = TimedPort(servos, self.clock)
        if not self._timed:
            port.timeout, port.per_byte, port.usb = 0.0, 0.0, 1e-9  # a new angle has a new time
        return port

    def clear_faults(self) -> None:
        """Remove all faults except those stored in the servos."""
        for servos in self.servos.values():
            servos.clear_faults()

    def of(self, joint: str) -> FaultyServos:
        """Return the servos of the bus of a joint."""
        return self.servos[MOTORS[joint].bus]

    def servo(self, joint: str) -> EmulatedServo:
        """Return the servo of a joint."""
        return self.of(joint).joint(joint)

    def angle(self, joint: str) -> float:
        """Return the true angle of a joint [rad]."""
        return angle_of(self.servo(joint), MOTORS[joint])

    def goal(self, joint: str) -> float:
        """Return the goal in the register of a joint [rad]."""
        servo = self.servo(joint)
        return float(np.radians(MOTORS[joint].user(servo.kind.degrees(servo.word(30)))))

    def torque(self, joint: str) -> bool:
        """Return whether the torque of a joint is on."""
        return bool(self.servo(joint).memory[TORQUE_ENABLE])


def angle_of(servo: EmulatedServo, motor: Motor) -> float:
    """Return the true angle of a servo's joint [rad]."""
    return float(np.radians(motor.user(servo.kind.degrees(servo.moved))))


# ---------------------------------------------------------------------- over pseudo-terminals


class Terminal(threading.Thread):
    """A pseudo-terminal with emulated servos at its other end.

    Attributes
    ----------
    port : str
        Name of the serial port: a link whose path is the same after the terminal is unplugged and plugged in again.
    """

    def __init__(self, servos: FaultyServos, port: Path) -> None:
        super().__init__(daemon=True)
        self.servos, self.port = servos, port
        self._over = False
        self._near = -1
        self.plug_in()
        self.start()

    @property
    def gone(self) -> bool:
        """Whether the port is unplugged."""
        return self._near < 0

    def plug_in(self) -> None:
        """Create the port."""
        near, self._far = os.openpty()
        tty.setraw(self._far)
        tty.setraw(near)
        self.port.unlink(missing_ok=True)
        self.port.symlink_to(os.ttyname(self._far))
        self._near = near

    def unplug(self) -> None:
        """Remove the port."""
        near, self._near = self._near, -1
        self.port.unlink(missing_ok=True)
        os.close(near)
        os.close(self._far)

    def run(self) -> None:
        waiting = bytearray()
        while not self._over:
            near = self._near
            if near < 0:
                waiting.clear()
                time.sleep(0.01)
                continue
            with contextlib.suppress(OSError, ValueError):
                if select.select([near], [], [], 0.05)[0]:
                    waiting += os.read(near, 4096)
                for packet in packets(waiting):
                    if answer := self.servos.reply(packet):
                        os.write(near, answer)

    def close(self) -> None:
        """Stop the thread and remove the port."""
        self._over = True
        self.join(2.0)
        if self._near >= 0:
            self.unplug()


def packets(waiting: bytearray) -> list[bytes]:
    """Remove the complete instruction packets from the received bytes, and return them."""
    found = []
    while (at := waiting.find(b"\xff\xff")) >= 0 and len(waiting) >= at + 4:
        end = at + 4 + waiting[at + 3]
        if len(waiting) < end:
            break
        found.append(bytes(waiting[at:end]))
        del waiting[:end]
    return found


class Terminals:
    """Both buses over pseudo-terminals, in real time."""

    def __init__(self, folder: Path, **angles: float) -> None:
        # a reply needs the interpreter several times; the default of 5 ms each is longer than the driver waits for it
        sys.setswitchinterval(_SWITCH)
        self.servos = {name: FaultyServos(servos_of(name, angles)) for name in BUSES}
        self.terminals = {name: Terminal(servos, folder / name) for name, servos in self.servos.items()}

    @property
    def settings(self) -> dict[str, Any]:
        """Parameters of the driver for these ports."""
        return {f"poppy.{name}_port": str(terminal.port) for name, terminal in self.terminals.items()}

    def of(self, joint: str) -> FaultyServos:
        """Return the servos of the bus of a joint."""
        return self.servos[MOTORS[joint].bus]

    def close(self) -> None:
        for terminal in self.terminals.values():
            terminal.close()
