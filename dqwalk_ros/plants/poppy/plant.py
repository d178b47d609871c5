"""The servos of Poppy Humanoid as a plant, which is commanded by joint velocities and measures joint angles.

The goals of the servos are those of `plants.servo_goals`. A servo accepts a goal position and a speed, which is never
zero (unlimited speed to the servo). The motion to the first pose is slow, on a way on which the links keep clear of
each other (`robot.clearance`), with a wide window, so that the servos carry the limbs without feedforward torques. A
fault of a motor, a cable or the power supply stops the motion (`motor_watch.py`).
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dqwalk_ros.config import Config, RobotConfig
from dqwalk_ros.paper.state import Command, State
from dqwalk_ros.plants.base import Plant, checked
from dqwalk_ros.plants.poppy.buses import TRIES, MotorBuses, open_buses
from dqwalk_ros.plants.poppy.dynamixel import FULL_TORQUE, Clock, DynamixelBus, Registers
from dqwalk_ros.plants.poppy.motor_watch import Measured, MotorWatch, Part
from dqwalk_ros.plants.poppy.motors import motors_of, typed
from dqwalk_ros.plants.servo_goals import JUMPS, AngleGate, ServoGoals
from dqwalk_ros.robot.limits import JointLimits
from dqwalk_ros.robot.model import RobotModel, load_model
from dqwalk_ros.robot.servos import Drive, Servos, goal_windows, load_types
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import PlantError

if TYPE_CHECKING:
    from dqwalk_ros.robot.clearance import Clearance

_SLACK = 0.02
"""Tolerance of the largest possible motion between two measurements [rad]: 13 encoder steps of an MX."""
_REACH = 0.04
"""Longest time of motion at full speed that is accepted as plausible [s]: two periods of the bus."""
_ARRIVAL = 3.0
"""Time in which the joints must reach the first pose after their goals [s]."""


class PoppyPlant(Plant):
    """The servos of a Poppy, or emulated servos.

    No joint moves and no torque is switched on before `activate`.

    Parameters
    ----------
    model : RobotModel
        Model whose joints are commanded; the other joints move to their first pose and hold it.
    posture : ndarray, shape (n,)
        First pose of the joints of the model [rad]; that of the others is their angle in ``robot.lock``, or zero. It is
        clipped to the limits.
    buses : mapping of str to DynamixelBus, optional
        By the name of the bus in the table of motors; `open_buses` by default.
    clock : callable
        Monotonic time [s].
    each : callable, optional
        Applies a function to all buses, like `map`; by default in parallel threads.

    Attributes
    ----------
    motors : dict of str to Motor
        By the name of the joint.
    names : tuple of str
        All N joints, those of the model first.
    ready : bool
        Whether the robot has reached its first pose since; commands have no effect before.
    measured : Measured
        Angles, velocities and loads.
    watch : MotorWatch
        Faults of the motors, during which no joint moves.

    Raises
    ------
    PlantError
        If motors do not answer or are not those of the table.
    ConfigError
        If the model has a joint without a motor, or the table of motors or the calibration is invalid.
    """

    def __init__(
        self,
        config: Config,
        model: RobotModel,
        posture: Array,
        *,
        buses: Mapping[str, DynamixelBus] | None = None,
        clock: Clock = time.monotonic,
        each: Callable[..., Iterable[Any]] | None = None,
    ) -> None:
        own, servo, types = config.poppy, config.servo, load_types(config.servo.table)
        self._model, self._config, self._clock = model, own, clock
        self.motors, zero = motors_of(config, model)
        self.names = (*model.joint_names, *(name for name in self.motors if name not in model.joint_names))
        table = [self.motors[name] for name in self.names]
        kinds = [types[motor.type] for motor in table]
        n, every = model.n, len(self.names)
        self._zero = np.array([zero.get(name, 0.0) for name in self.names])  # [deg]
        low, high = np.radians(np.array([motor.limits for motor in table]).T - self._zero)
        low[:n], high[:n] = np.maximum(low[:n], model.q_min), np.minimum(high[:n], model.q_max)
        self._first = np.clip([*posture, *(model.locked.get(name, 0.0) for name in self.names[n:])], low, high)
        self._gain = np.where([kind.p_register for kind in kinds], config.servo.p_gain, -1)
        self._full_error = np.array([1.0 / kind.gain(config.servo.p_gain) for kind in kinds])  # [rad]
        fastest, stall = np.array([(kind.no_load_speed, kind.stall_torque) for kind in kinds]).T
        self._gate = AngleGate(
            self.names, fastest, _SLACK, longest=lambda: _REACH, timeout=lambda: config.plant.command_timeout
        )
        of_joints = typed(config, table[:n])
        drive, self._servos = Drive.of(of_joints, model), Servos.of(of_joints, model)
        self._direction = np.array([1.0 if motor.direct else -1.0 for motor in table[:n]])
        stiffness = np.append(drive.stiffness, (stall / self._full_error)[n:])
        if own.dummy:  # emulated servos carry no load
            stiffness[:] = 0.0
        speed, effort = np.append(model.velocity_max, fastest[n:]), np.append(model.effort_max, stall[n:])
        limits = JointLimits(self.names, low, high, speed, effort)
        self._window = np.append(goal_windows(of_joints, model), np.full(every - n, servo.window))
        drive = replace(drive, stiffness=stiffness, lead=np.append(drive.lead, np.zeros(every - n)))
        self._law = ServoGoals(
            self._gate, drive, limits, own.max_lead, window_lag=servo.window_lag, window_time=servo.window_time
        )

        buses = buses if buses is not None else open_buses(self.motors, types, own, clock)
        self._buses = MotorBuses(dict(zip(self.names, table, strict=True)), kinds, buses, each)
        self.parts = self._buses.parts
        self._turn = 0
        gate = self._gate  # whose arrays these are, and those of the law
        self.measured = Measured(gate.q, np.zeros(every), gate.at, gate.jumps, np.zeros(every), self._law.runaway)
        self.watch = MotorWatch(self.names, self.parts, own, config.plant.command_timeout)
        self.ready = False
        self._speed = np.zeros(every)
        self._time, self._arrived_at = 0.0, np.inf
        self._resend = 0
        self._clearance, whole = _of_all_joints(config.updated({"robot.lock": (), "robot.drop": ()}).robot)
        self._places = [(k, whole[name]) for k, name in enumerate(self.names) if name in whole]
        self._way = [self._first]
        try:
            self._buses.identify(own.motors)
            self._read_all()
        except BaseException:
            self._buses.close()
            raise

    # ------------------------------------------------------------------ commands and states

    def step(self, command: Command, dt: float) -> State:
        """Call `write` and return the state of `read`."""
        self.write(command, dt)
        return self.read()

    def hold(self, dt: float) -> State:
        """Send the last goals again, or go on to the first pose, and return the state of `read`."""
        self.write(None, dt)
        return self.read()

    def write(self, command: Command | None, dt: float) -> None:
        """Send goals that move the joints as commanded for `dt` [s], or towards the first pose until it is reached.

        Without a command the last goals are sent again. None are sent while the torque is off, a fault is present or
        the angles are too old.

        Raises
        ------
        PlantError
            If the command is not finite or does not have one velocity per joint of the model.
        """
        n = self._model.n
        u, effort = np.zeros(len(self.names)), None
        if command is not None:
            u[:n] = checked(command.velocity, n, "velocities")
            if command.effort is not None:
                effort = np.zeros(len(self.names))
                effort[:n] = checked(command.effort, n, "torques")
        if not math.isfinite(dt):
            raise PlantError(f"the period must be finite, got {dt}")
        moves = dt > 0.0 and not self.watch.faults and self._law.moves(self._clock())
        if moves:
            self._set_goals(u, effort, dt, moving=command is not None)
        if moves or (self._resend and self.active):  # a goal switches the torque on
            self._resend = max(self._resend - 1, 0)
            self._buses.on_each(self._send_all)
        self._time += dt

    def _set_goals(self, u: Array, effort: Array | None, dt: float, *, moving: bool) -> None:
        """Set goals for the next `dt` [s], and the speeds of the servos."""
        before, law = self._law.goal, self._law
        if not self.ready:
            if len(self._way) > 1 and np.abs(self._way[0] - law.wanted).max() < 1e-9:
                del self._way[0]
            ahead = self._way[0] - law.wanted  # straight: all joints of a part of the way arrive together
            part = min(1.0, self._config.start_speed * dt / max(float(np.abs(ahead).max()), 1e-9))
            law.command(part * ahead / dt, None, self._clock(), dt)
        elif moving:
            law.command(u, effort, self._clock(), dt)
        # fast enough to reach the goal within a period and to reduce the remaining error
        self._speed = (1.5 * np.abs(law.goal - before) + np.abs(law.goal - self.measured.q)) / max(dt, 1e-3)

    def read(self) -> State:
        """Read the angles and further registers of one motor of each bus, update the faults, and return the state."""
        turn, self._turn = self._turn, self._turn + 1

        def cycle(part: Part) -> None:
            part.bus.read()
            unsure = np.flatnonzero(self.watch.unsure[part.places])
            first = turn % 2 and len(unsure)
            part.bus.inspect(int(unsure[turn // 2 % len(unsure)]) if first else turn % len(part.places))

        self._buses.on_each(cycle)
        self._accept_angles()
        if self.measured.runaway.any():
            self._buses.on_each(self._let_go)
        before = set(self.watch.lasting)
        lead = self._full_error if self.ready else np.minimum(self._full_error, self._law.window)
        self.watch.look(self._clock(), self.measured, self.goal if self.active else None, lead, self._gain)
        for k, name in enumerate(self.names):
            if (key := f"blocked/{name}") in self.watch.lasting and key not in before:
                self._law.relieve(k)
                self._resend = TRIES
        if self.active and not self.ready:
            self._check_arrival()
        return self.state

    @property
    def state(self) -> State:
        """Last measured angles and velocities of the joints of the model, with ``poppy.load`` also their torques."""
        n = self._model.n
        q, dq, effort = self.measured.q[:n].copy(), self.measured.dq[:n].copy(), None
        if self._config.load:
            effort = self._servos.effort(0.01 * self._direction * self.measured.load[:n], dq)
        return State(self._time, q, dq, effort=effort)

    @property
    def commanded(self) -> Array:
        """Goals of the joints of the model without the offsets by feedforward torques, shape (n,) [rad]."""
        return self._law.wanted[: self._model.n]

    @property
    def goal(self) -> Array:
        """Goals of the servos, including feedforward, shape (N,) [rad]."""
        return self._law.goal

    @property
    def active(self) -> bool:
        """Whether the torque is on and has been confirmed by the motors."""
        return self._law.active

    @property
    def warning(self) -> str:
        """Why the walk should end, before a fault holds the joints in mid-step; or empty."""
        return self.watch.warning

    @property
    def stiff(self) -> bool:
        """Whether a motor had its torque at its last inspection: also one that an earlier driver has left on."""
        return any(found is not None and found.torque for part in self.parts for found in part.bus.registers)

    @property
    def measured_at(self) -> float:
        """Time at which the oldest of the angles was measured, by the clock of the plant [s]."""
        return self._gate.oldest

    @property
    def age(self) -> float:
        """Age of the oldest of the angles [s]."""
        return self._gate.age(self._clock())

    @property
    def fresh(self) -> bool:
        """Whether no angle is older than ``plant.command_timeout``."""
        return self._gate.fresh(self._clock())

    @property
    def remaining(self) -> float:
        """Largest angle between a joint and its first pose [rad]."""
        return float(np.abs(self._first - self.measured.q).max())

    def _check_arrival(self) -> None:
        """Set `ready` once the first pose is reached; report a fault if it is not reached in time."""
        faults, now = self.watch.faults, self._clock()
        if faults or np.abs(self._first - self._law.wanted).max() > 1e-9:
            self._arrived_at = np.inf
            return
        self._arrived_at = min(self._arrived_at, now)
        behind = np.abs(self._first - self.measured.q)
        self.ready = bool(behind.max() < self._config.start_tolerance)
        if not self.ready and now - self._arrived_at > _ARRIVAL:
            k = int(behind.argmax())
            self.watch.lasting["first pose"] = (
                f"{self.names[k]} does not reach the first pose: {math.degrees(behind[k]):.0f} deg remain; free it, "
                "raise servo.p_gain or poppy.start_tolerance, then ~/activate"
            )
        if self.ready:
            self._law.window[:] = self._window

    # ------------------------------------------------------------------ torque

    def activate(self) -> None:
        """Switch the torque on in the current pose and confirm it; afterwards `step` moves to the first pose.

        Raises
        ------
        PlantError
            If a fault is present, no way to the first pose keeps the links apart, or a motor is not the one of the
            table or does not confirm its registers; the torque is then off.
        """
        self.ready = False
        self._law.end()
        self.watch.forget()
        self._gate.forgive()
        for _ in range(TRIES):  # earlier faults may have ended
            self.read()
            if not self.watch.faults:
                break
        else:
            raise PlantError(self.watch.fault)
        self._buses.identify(self._config.motors)
        self._find_way()
        self._law.window[:] = self._config.max_lead
        self._law.begin()
        self._speed[:], self._arrived_at = 0.0, np.inf
        degrees = np.degrees(self.goal) + self._zero

        def prepare(part: Part, left: list[int]) -> None:
            part.bus.write_torque_limit(FULL_TORQUE, left)
            if with_gain := [i for i in left if self._gain[part.places[i]] >= 0]:
                part.bus.write_gain(int(self._gain.max()), with_gain)
            self._send(part, left)

        def prepared(part: Part, i: int, registers: Registers) -> bool:
            goal = self._buses.position(part, i, degrees)
            right_gain = self._gain[part.places[i]] in (registers.gain, -1)
            return registers.torque_limit == FULL_TORQUE and right_gain and registers.goal == goal

        text = "{} cannot be set up"
        if not (bad := self._buses.confirm(prepare, prepared)):
            text = "the torque of {} did not switch on"
            bad = self._buses.confirm(lambda part, left: part.bus.write_torque(True, left), lambda _, __, r: r.torque)
        if bad:
            on = self._switch_off()  # also what the goals have switched on
            then = f"that of {', '.join(on)} may be on: switch the power off" if on else "all torque is off"
            raise PlantError(f"{text.format(', '.join(bad))}: {then}")

    def _find_way(self) -> None:
        """Find postures that lead to the first pose without one link touching another."""
        own, of_whole = map(list, zip(*self._places, strict=True))
        begin, end = np.zeros(self._clearance.joints), np.zeros(self._clearance.joints)
        begin[of_whole], end[of_whole] = self.measured.q[own], self._first[own]
        way, nearest = self._clearance.way(begin, end)
        if not way:
            raise PlantError(
                f"no way to the first pose keeps {nearest} apart: move them by hand, with ~/compliant if the torque is "
                "on, then ~/activate; no torque was switched on"
            )
        self._way = []
        for posture in way:
            self._way.append(self._first.copy())
            self._way[-1][own] = posture[of_whole]

    def release(self) -> None:
        """Switch the torque off and confirm it.

        Raises
        ------
        PlantError
            If motors do not confirm that their torque is off; the message names them.
        """
        if on := self._switch_off():
            raise PlantError(f"{', '.join(on)} did not confirm that the torque is off: switch the power off")

    def _switch_off(self) -> list[str]:
        """Switch the torque off, and return the joints that do not confirm it."""
        self.ready = False
        self._law.end()
        self.watch.forget()
        return self._buses.switch_off()

    def close(self) -> None:
        """Hold the goals, or switch the torque off if `torque_off_at_end` is set; then close the buses in any case.

        Raises
        ------
        PlantError
            If motors do not confirm that their torque is off.
        """
        try:
            if self._config.torque_off_at_end:
                self.release()
            elif self.active:  # keep the goals, and move to them at the least speed
                self._speed[:] = 0.0
                for part in self.parts:
                    self._send_all(part)
        finally:
            self._buses.close()

    # ------------------------------------------------------------------ the buses

    def _read_all(self) -> None:
        """Read all registers and angles once."""
        self._buses.confirm(lambda part, left: None, lambda part, i, found: True)
        for _ in range(TRIES + JUMPS):
            self.read()
            if self._gate.known:
                return
        cause = {k: why for part in self.parts for k, why in zip(part.places, part.bus.cause, strict=True)}
        bad = np.flatnonzero(~np.isfinite(self.measured.q)).tolist()
        names, causes = ", ".join(self.names[k] for k in bad), " or ".join(sorted({cause[k] for k in bad} - {""}))
        usb2ax = "; any adapter but a USB2AX needs poppy.sync_read: false" if self._config.sync_read else ""
        raise PlantError(f"no valid angle from {names}{causes and f': {causes}'}{usb2ax}")

    def _send(self, part: Part, places: list[int]) -> None:
        """Send goals and speeds to the motors of a bus at `places`."""
        angle, speed = np.degrees(self.goal) + self._zero, np.degrees(self._speed)
        self._buses.send(part, places, angle, speed, self._config.max_speed)

    def _send_all(self, part: Part) -> None:
        """Send goals and speeds to the motors of a bus, except those whose torque is off."""
        self._send(part, np.flatnonzero(~self.measured.runaway[part.places]).tolist())

    def _let_go(self, part: Part) -> None:
        """Switch off the torque of joints that move against it; repeatedly, because a packet may be lost."""
        if len(places := np.flatnonzero(self.measured.runaway[part.places])):
            part.bus.write_torque(False, places)

    def _accept_angles(self) -> None:
        """Accept the new angles that a joint can have reached since its last accepted angle."""
        m = self.measured
        at = np.empty(len(self.names))
        degrees = self._buses.read(at, m.load)
        q = np.radians(degrees - self._zero)
        before, then = m.q.copy(), m.at.copy()
        taken = self._law.measure(q, at)
        m.dq[taken] = np.nan_to_num((q[taken] - before[taken]) / np.maximum(at[taken] - then[taken], 1e-3))


@functools.lru_cache(maxsize=2)
def _of_all_joints(robot: RobotConfig) -> tuple[Clearance, dict[str, int]]:
    """Return the distances of the links of a robot, and the index of each of its joints."""
    from dqwalk_ros.robot.clearance import Clearance  # reads shapes, with much to import

    model = load_model(robot)
    return Clearance(model), {name: k for k, name in enumerate(model.joint_names)}
