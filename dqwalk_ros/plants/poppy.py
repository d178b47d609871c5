"""Poppy Humanoid's servos as a plant: joint velocities in, measured angles out.

A servo takes a goal position and a speed, so velocities are integrated into goals here, and torques that are fed
forward are turned into angles by the servo's stiffness. A goal never runs far ahead of its joint, no speed is ever
zero (which the servo reads as: as fast as you can), and the robot's first movement is slow. A motor, a cable or a
supply that fails stops the motion (`motor_watch.py`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros import strict_yaml
from dqwalk_ros.config import PoppyConfig, find_share
from dqwalk_ros.errors import ConfigError, PlantError
from dqwalk_ros.plants import Plant
from dqwalk_ros.plants.dynamixel import FULL_TORQUE, TYPES, Bus, Clock, Registers, find_port, open_port
from dqwalk_ros.plants.emulated_servos import EmulatedPort, EmulatedServo, EmulatedServos
from dqwalk_ros.plants.motor_watch import JUMPS, Measured, MotorWatch, Part
from dqwalk_ros.robot import RobotModel
from dqwalk_ros.state import Command, State

__all__ = ["Motor", "PoppyPlant", "load_motors", "open_buses", "register_speed"]

Array = NDArray[np.float64]

MIN_SPEED = 1.4
"""Two units of the servo's speed register [deg/s]. One unit is 0.684; below half of it the register reads 0, which
means no limit at all."""
_SLACK = 0.02
"""An angle may be this far from what the speed of its servo explains [rad]: 13 steps of an MX's encoder."""
_REACH = 0.04
"""Longest time for which a servo is believed to have turned at full speed [s]: two periods of the bus."""
_TRIES = 5
"""Times that a motor is told or asked before it counts as one that does not obey."""
_ARRIVAL = 3.0
"""Once the goals are in the first pose, the joints must be there within this time [s]."""


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
        If the table is missing or cannot be used; the message names the motor.
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
        try:
            out[str(name)] = _motor(str(name), entry, {motor.id for motor in out.values()})
        except ValueError as error:
            line = strict_yaml.line_of(text, ("motors", str(name)))
            raise ConfigError(f"{path}, line {line}: motor '{name}' {error}") from error
    return out


def _motor(name: str, entry: Any, taken: set[int]) -> Motor:
    """Return the motor of an entry of the table; a ValueError says what it must have."""
    try:
        numbers = {"raw": tuple(map(float, entry["raw"])), "offset": float(entry["offset"])}
        motor = Motor(name=name, **{**entry, **numbers})
    except (TypeError, KeyError, ValueError) as error:
        raise ValueError(f"needs id, type, bus, direct, offset and raw: {error}") from error
    bounded = all(abs(x) <= 360.0 for x in (motor.offset, *motor.raw))
    if len(motor.raw) != 2 or not bounded or not motor.raw[0] < motor.raw[1]:
        raise ValueError(f"must have raw: [lower, upper] and an offset in degrees, got {motor.raw}")
    if motor.type not in TYPES or not isinstance(motor.direct, bool):
        raise ValueError(f"must have direct: true or false and a type of {', '.join(TYPES)}")
    if not isinstance(motor.id, int) or not 0 <= motor.id <= 252 or motor.id in taken:
        raise ValueError(f"must have an id of its own between 0 and 252, got {motor.id!r}")
    return motor


def register_speed(speed: float, highest: float) -> float:
    """Return the speed to write into a servo [deg/s]: never 0, always finite, never above `highest`."""
    return min(max(abs(speed), MIN_SPEED), highest) if math.isfinite(speed) else MIN_SPEED


class PoppyPlant(Plant):
    """A Poppy, or emulated servos in its place.

    Nothing moves and no torque is switched before `activate`.

    Parameters
    ----------
    model : RobotModel
        Its joints are the ones that walk; the others go to their first pose and stay.
    config : PoppyConfig
    max_age : float
        Angles older than this count for nothing [s].
    buses : mapping of str to Bus, optional
        By the name of the bus in the table of motors; `open_buses` by default.
    clock : callable
        Steady time of the buses [s].
    each : callable
        As `map`, over the buses; by default it talks to all of them at the same time.

    Attributes
    ----------
    motors : dict of str to Motor
    names : tuple of str
        All N joints, those of the model first.
    active : bool
        Whether the torque is on, as it was read back.
    ready : bool
        Whether the robot has reached its first pose since; only then do commands count.
    measured : Measured
    watch : MotorWatch
        What is wrong with the motors; nothing moves while anything is.
    goal : ndarray, shape (N,)
        Goals of the servos, with what is fed forward [rad].

    Raises
    ------
    PlantError
        If dynamixel_sdk is missing, or motors do not answer or are not those of the table.
    ConfigError
        If the model has a joint without a motor, or the table of motors or the calibration cannot be used.
    """

    def __init__(
        self,
        model: RobotModel,
        config: PoppyConfig,
        max_age: float = 0.1,
        *,
        buses: Mapping[str, Bus] | None = None,
        clock: Clock = time.monotonic,
        each: Callable[..., Iterable[Any]] | None = None,
    ) -> None:
        self._model, self._config, self._max_age, self._clock = model, config, max_age, clock
        self.motors = load_motors(config.motors)
        if missing := [name for name in model.joint_names if name not in self.motors]:
            raise ConfigError(f"the motors '{config.motors}' lack {', '.join(missing)} of {model.name}")
        zero = _calibration(config.calibration, self.motors)
        self.names = (*model.joint_names, *(name for name in self.motors if name not in model.joint_names))
        self._table = [self.motors[name] for name in self.names]
        types = [TYPES[motor.type] for motor in self._table]
        n, every = model.n, len(self.names)
        self._zero = np.array([zero.get(name, 0.0) for name in self.names])  # [deg]
        low, high = np.array([motor.limits for motor in self._table]).T
        self._low, self._high = np.radians(low - self._zero), np.radians(high - self._zero)
        self._low[:n] = np.maximum(self._low[:n], model.q_min)
        self._high[:n] = np.minimum(self._high[:n], model.q_max)
        self._first = np.clip(np.zeros(every), self._low, self._high)
        self._fastest = np.radians([kind.free_speed for kind in types])
        with_gain = np.array([kind.has_gain for kind in types]) & (config.p_gain > 0)
        self._gain = np.where(with_gain, config.p_gain, -1)

        buses = buses if buses is not None else open_buses(self.motors, config)
        place = {(motor.bus, motor.id): k for k, motor in enumerate(self._table)}
        self.parts = [Part(bus, np.array([place[name, i] for i in bus.ids])) for name, bus in buses.items()]
        self._pool = ThreadPoolExecutor(len(self.parts))
        self._each = each if each is not None else self._pool.map
        self._turn = 0
        self._received = np.full(every, -np.inf)
        self.measured = Measured(
            np.full(every, np.nan), np.zeros(every), np.full(every, -np.inf), np.zeros(every, np.intp), np.zeros(every)
        )
        self.watch = MotorWatch(self.names, self.parts, config, max_age)
        self.active = self.ready = False
        self.goal, self._wanted = np.full(every, np.nan), np.full(every, np.nan)
        self._speed, self._sag = np.zeros(every), np.zeros(every)
        self._time, self._arrived_at = 0.0, np.inf
        self._resend = 0
        try:
            self._meet()
        except BaseException:
            self._let_go()
            raise

    # ------------------------------------------------------------------ the two verbs of a plant

    def step(self, command: Command, dt: float) -> State:
        """Do as `tell` and `read`."""
        self.tell(command, dt)
        return self.read()

    def tell(self, command: Command, dt: float) -> None:
        """Send goals that move the joints as commanded for `dt` [s], or towards the first pose until it is reached.

        Raises
        ------
        PlantError
            If the command is not finite or does not fit.
        """
        u = np.asarray(command.velocity, dtype=np.float64)
        if u.shape != (self._model.n,) or not np.isfinite(u).all():
            raise PlantError(f"the command must have {self._model.n} finite velocities, got {u}")
        moves = self.active and dt > 0.0 and not self.watch.faults and self.fresh
        if moves:
            self._aim(u, command.effort, dt)
        if moves or self._resend:
            self._resend = max(self._resend - 1, 0)
            list(self._each(lambda part: self._send(part, list(range(len(part.places)))), self.parts))
        self._time += dt

    def read(self) -> State:
        """Read the angles, look at one motor of each bus, and judge what was found."""
        turn, self._turn = self._turn, self._turn + 1

        def cycle(part: Part) -> None:
            part.bus.read()
            unsure = np.flatnonzero(self.watch.unsure[part.places])
            first = turn % 2 and len(unsure)
            part.bus.inspect(int(unsure[turn // 2 % len(unsure)]) if first else turn % len(part.places))

        list(self._each(cycle, self.parts))
        self._believe()
        before = set(self.watch.lasting)
        self.watch.look(self._clock(), self.measured, self.goal if self.active else None, self._gain)
        for k, name in enumerate(self.names):  # a joint that is stuck is not pushed any longer
            if (key := f"blocked/{name}") in self.watch.lasting and key not in before:
                self.goal[k] = self._wanted[k] = self.measured.q[k]
                self._resend = _TRIES
        if self.active and not self.ready:
            self._arrive()
        return self.state

    @property
    def state(self) -> State:
        """The joints of the model as they were measured last."""
        n = self._model.n
        return State(self._time, self.measured.q[:n], self.measured.dq[:n])

    @property
    def age(self) -> float:
        """Age of the oldest angle [s]."""
        return float(self._clock() - self.measured.at.min())

    @property
    def fresh(self) -> bool:
        """Whether every angle is young enough to count."""
        return self.age <= self._max_age

    @property
    def left(self) -> float:
        """Largest angle between a joint and its first pose [rad]."""
        return float(np.abs(self._first - self.measured.q).max())

    @property
    def stiffness(self) -> Array:
        """Torque per angle of error of each servo, by the gain that was read, shape (N,) [N m/rad]."""
        out = np.full(len(self.names), np.inf)
        if not self._config.dummy:  # emulated servos have no weight
            for part in self.parts:
                for kind, place, seen in zip(part.bus.types, part.places, part.bus.registers, strict=True):
                    if seen is not None:
                        out[place] = kind.stiffness(seen.gain)
        return out

    def _aim(self, u: Array, effort: Array | None, dt: float) -> None:
        """Set goals and speeds for the next `dt` [s]."""
        q, lead, n = self.measured.q, self._config.max_lead, self._model.n
        turns = np.zeros(len(q))
        if self.ready:
            turns[:n] = np.clip(u, -self._model.velocity_max, self._model.velocity_max)
            if effort is not None:
                self._sag[:n] = effort / np.maximum(self.stiffness[:n], 1e-3)
        else:
            speed = self._config.start_speed
            turns = np.clip((self._first - self._wanted) / dt, -speed, speed)
        # a joint that is outside its limits moves in, or stays
        low, high = np.minimum(self._low, self._wanted), np.maximum(self._high, self._wanted)
        self._wanted = np.clip(np.clip(self._wanted + dt * turns, low, high), q - lead, q + lead)
        self.goal = np.clip(np.clip(self._wanted + self._sag, low, high), q - lead, q + lead)
        # fast enough to be there within a period, and to catch up with what is left
        self._speed = 1.5 * np.abs(turns) + np.abs(self.goal - q) / max(dt, 1e-3)

    def _arrive(self) -> None:
        """Notice that the first pose is reached, or that it cannot be."""
        faults, now = self.watch.faults, self._clock()
        if faults or np.abs(self._first - self._wanted).max() > 1e-9:
            self._arrived_at = np.inf
            return
        self._arrived_at = min(self._arrived_at, now)
        behind = np.abs(self._first - self.measured.q)
        self.ready = bool(behind.max() < self._config.start_tolerance)
        if not self.ready and now - self._arrived_at > _ARRIVAL:
            k = int(behind.argmax())
            self.watch.lasting["first pose"] = (
                f"{self.names[k]} does not reach the first pose: {math.degrees(behind[k]):.0f} deg are left; free it, "
                "raise poppy.p_gain or poppy.start_tolerance, then ~/activate"
            )

    # ------------------------------------------------------------------ torque

    def activate(self) -> None:
        """Switch the torque on where the robot stands, and read it back; then `step` goes to the first pose.

        Raises
        ------
        PlantError
            If something is wrong with the motors, or one does not do as it is told: then the torque is off.
        """
        self.active = self.ready = False
        self.watch.forget()
        for _ in range(_TRIES):  # what was wrong may be over
            self.read()
            if not (faults := self.watch.faults):
                break
        else:
            raise PlantError("; ".join(faults.values()))
        self.goal, self._wanted = self.measured.q.copy(), self.measured.q.copy()
        self._speed[:] = self._sag[:] = 0.0
        self._arrived_at = np.inf
        degrees = np.degrees(self.goal) + self._zero

        def prepare(part: Part, left: list[int]) -> None:
            part.bus.write_torque_limit(FULL_TORQUE, left)
            for gain in set(self._gain[part.places[left]]) - {-1}:
                part.bus.write_gain(int(gain), [i for i in left if self._gain[part.places[i]] == gain])
            self._send(part, left)

        def prepared(part: Part, i: int, seen: Registers) -> bool:
            k = part.places[i]
            goal = part.bus.types[i].position(self._table[k].servo(degrees[k]))
            return seen.torque_limit == FULL_TORQUE and self._gain[k] in (seen.gain, -1) and seen.goal == goal

        if bad := self._insist(prepare, prepared):
            raise PlantError(f"{', '.join(bad)} cannot be set up: nothing was switched")
        if bad := self._insist(lambda part, left: part.bus.write_torque(True, left), lambda _, __, seen: seen.torque):
            self.release()
            raise PlantError(f"the torque of {', '.join(bad)} does not come on: all of it is off again")
        self.active = True

    def release(self) -> None:
        """Switch the torque off, and read it back.

        Raises
        ------
        PlantError
            If it stays on somewhere; the message names the motors.
        """
        self.active = self.ready = False
        self.watch.forget()
        off = self._insist(lambda part, left: part.bus.write_torque(False, left), lambda _, __, seen: not seen.torque)
        if off:
            raise PlantError(f"{', '.join(off)} did not confirm that the torque is off: switch the power off")

    def close(self) -> None:
        """Hold, or go limp if `torque_off_at_end`; let go of the buses, whatever they say.

        Raises
        ------
        PlantError
            If the torque could not be switched off.
        """
        try:
            if self._config.torque_off_at_end:
                self.release()
            elif self.active:  # the goals stay; whoever is on the way there slows down
                self._speed[:] = 0.0
                for part in self.parts:
                    self._send(part, list(range(len(part.places))))
        finally:
            self._let_go()

    def _let_go(self) -> None:
        self._pool.shutdown()
        for part in self.parts:
            part.bus.close()

    def _insist(
        self, tell: Callable[[Part, list[int]], None], obeys: Callable[[Part, int, Registers], bool]
    ) -> list[str]:
        """Tell the motors something until they say that they did it; return those that do not."""

        def one_bus(part: Part) -> list[str]:
            left = list(range(len(part.places)))
            for _ in range(_TRIES):
                tell(part, left)
                left = [i for i in left if (seen := part.bus.inspect(i)) is None or not obeys(part, i, seen)]
                if not left:
                    break
            return [self.names[part.places[i]] for i in left]

        return [name for names in self._each(one_bus, self.parts) for name in names]

    # ------------------------------------------------------------------ the buses

    def _meet(self) -> None:
        """Ask each motor who it is, and read everything once."""
        wrong, silent = [], []
        for part in self.parts:
            for i, motor in enumerate(self._table[k] for k in part.places):
                numbers = (part.bus.model(i) for _ in range(_TRIES))
                model = next((number for number in numbers if number is not None), None)
                if model is None:
                    silent.append(f"{motor.name} ({motor.id}, {part.bus.name} bus) {part.bus.cause[i]}")
                    if len(silent) >= _TRIES:  # that is enough to look for
                        break
                elif model != TYPES[motor.type].model:
                    wrong.append(f"{motor.name} ({motor.id}) is of model {model}, which is no {motor.type}")
        if silent:
            raise PlantError(
                f"the motors do not answer: {', '.join(silent)}; is the robot on, and are both buses plugged in? "
                "(poppy.dummy:=true tries the driver without a robot)"
            )
        if wrong:
            raise PlantError(f"the motors are not those of the table '{self._config.motors}': {', '.join(wrong)}")
        self._insist(lambda part, left: None, lambda part, i, seen: True)
        for _ in range(_TRIES):
            self.read()
            if np.isfinite(self.measured.q).all():
                return
        bad = [name for name, q in zip(self.names, self.measured.q, strict=True) if not math.isfinite(q)]
        raise PlantError(f"no angle from {', '.join(bad)}")

    def _send(self, part: Part, places: list[int]) -> None:
        """Send goals and speeds to motors of a bus."""
        words = {}
        for i in places:
            k = part.places[i]
            angle = math.degrees(self.goal[k]) + self._zero[k]
            speed = register_speed(math.degrees(self._speed[k]), self._config.max_speed)
            words[i] = (self._table[k].servo(angle), speed)
        part.bus.write_goals(words)

    def _believe(self) -> None:
        """Take over the angles that a joint can have turned to since the last one that was believed."""
        m = self.measured
        at, degrees = np.empty(len(self.names)), np.empty(len(self.names))
        for part in self.parts:
            at[part.places], m.load[part.places] = part.bus.at, part.bus.load
            degrees[part.places] = [self._table[k].user(x) for k, x in zip(part.places, part.bus.position, strict=True)]
        q = np.radians(degrees - self._zero)
        new, passed = at > self._received, at - m.at
        self._received = at
        far = np.abs(q - m.q) > self._fastest * np.minimum(passed, _REACH) + _SLACK  # false for the first, from nan
        m.jumps = np.where(new, np.where(far, m.jumps + 1, 0), m.jumps)
        # a robot without torque may have been turned by hand while nobody looked
        take = new & (~far | (m.jumps >= JUMPS if not self.active else False))
        m.jumps[take] = 0
        m.dq[take] = np.nan_to_num((q - m.q) / np.maximum(passed, 1e-3))[take]
        m.q[take], m.at[take] = q[take], at[take]


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


def open_buses(motors: Mapping[str, Motor], config: PoppyConfig) -> dict[str, Bus]:
    """Open the buses of a table of motors, or emulated ones.

    Raises
    ------
    PlantError
        If dynamixel_sdk is missing, or a port cannot be opened.
    """
    buses: dict[str, Bus] = {}
    named = {"lower": config.lower_port, "upper": config.upper_port}
    for name in sorted({motor.bus for motor in motors.values()}):
        own = [motor for motor in motors.values() if motor.bus == name]
        ids, types = [motor.id for motor in own], [TYPES[motor.type] for motor in own]
        try:
            if config.dummy:
                servos = EmulatedServos([EmulatedServo(i, kind) for i, kind in zip(ids, types, strict=True)])
                opened: Callable[[], Any] = partial(EmulatedPort, servos)
            else:
                port = named.get(name, "auto")
                opened = partial(open_port, find_port(ids) if port == "auto" else port)
            buses[name] = Bus(name, opened, ids, types, sync_read=config.sync_read)
        except (OSError, PlantError) as error:
            for bus in buses.values():
                bus.close()
            raise PlantError(
                f"the {name} bus cannot be opened: {error}; is it plugged in, and free? "
                "(poppy.dummy:=true tries the driver without a robot)"
            ) from error
    return buses
