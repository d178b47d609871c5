"""The control law from commands (velocities and torques) to the goal angles of servos.

Physics, the node `drive` (ros2_control) and the driver of Poppy execute it.

1. A measured angle is used if the joint can have reached it since the last accepted one; three impossible ones in a row
   are a fault (`AngleGate`).
2. Velocities and torques are clamped to the limits of the joints, velocities also to their range.
3. The goal integrates the velocity and is limited to a window around the predicted angle of the joint, the measured one
   plus the motion commanded within the delay. This is an integral action with anti-windup, which compensates the
   deflection of a servo under load. With a small window a leg complies with a force that is not fed forward, such as
   that of a stone under its sole. The window extends in the direction of motion by the lag of the joints. A goal beyond
   it returns at once, or with a time constant.
4. Feedforward torques are converted to an offset of the goal by the assumed stiffness of the servos. Where they are
   known, the goal is also ahead by the lag of a damped servo. The sum stays within the range of the joint and moves no
   faster than the joint can.
5. Goals are rounded to the steps of the servos, written at the rate of the bus and effective after its latency.
6. Without recent angles, or after a fault, no command has an effect: the last goal remains.
7. A joint that moves away from its goal, although its servo exerts its full torque, is a fault: its motor is not in
   position mode, its sensor is broken, or it is overpowered. A plant switches the torque of this motor off if it can.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.estimation.delay import CommandHistory
from dqwalk_ros.robot.limits import FASTEST, JointLimits, unreachable
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.servos import Drive, Servos, goal_windows
from dqwalk_ros.support.arrays import Array, Mask
from dqwalk_ros.support.compiled import jit

JUMPS = 3
"""Number of consecutive impossible angles of a joint that are a fault."""
_MOST_OFFSET = math.pi
"""Largest offset of a goal by torques, where neither effort limit nor stiffness bound it [rad]."""

_AWAY = 0.2
"""Motion against the full torque of a servo that is a fault [rad]: twice that of a joint that reverses at 2 rad/s, with
a delay of 60 ms."""
_BEYOND = 0.02
"""Position error beyond that of the full torque at which a servo has it certainly [rad]."""

_unreachable = jit(unreachable)


class AngleGate:
    """Decides which measured angles are used.

    An angle is used if the joint can have reached it from the last one that was used. Of a joint that no command moves
    (at the start, or without torque) a new angle is used, too, once `JUMPS` in a row agree.

    Parameters
    ----------
    joint_names : sequence of str
        The N joints.
    speed : ndarray, shape (N,)
        Largest velocities of the joints [rad/s].
    slack : float or ndarray, shape (N,)
        Tolerance of the motion between two measurements [rad].
    longest : callable
        Returns the longest time for which a joint can move unseen [s].
    timeout : callable
        Returns the age above which angles are not used [s].

    Attributes
    ----------
    q : ndarray, shape (N,)
        Angles to be used [rad]; nan before the first.
    at : ndarray, shape (N,)
        Times at which they were measured [s]; -inf before the first.
    jumps : ndarray of int, shape (N,)
        Consecutive impossible angles of each joint.
    rejected : int
        Number of impossible angles.
    fault : str
        Which joints have jumped, while commands moved them; empty if none has.
    """

    def __init__(
        self,
        joint_names: Sequence[str],
        speed: Array,
        slack: Array | float,
        *,
        longest: Callable[[], float],
        timeout: Callable[[], float],
    ) -> None:
        self._names, n = tuple(joint_names), len(joint_names)
        self._speed, self._slack = np.minimum(speed, FASTEST), np.broadcast_to(slack, (n,)).astype(np.float64)
        self._longest, self._timeout = longest, timeout
        self.q, self.at = np.full(n, np.nan), np.full(n, -np.inf)
        self._last, self._last_at = np.full(n, np.nan), np.full(n, -np.inf)  # used or not
        self.jumps, self._agreeing = np.zeros(n, np.intp), np.zeros(n, np.intp)
        self.rejected = 0
        self.fault = ""

    @property
    def known(self) -> bool:
        """Whether every joint has an angle to be used."""
        return bool(np.isfinite(self.q).all())

    @property
    def oldest(self) -> float:
        """Time at which the oldest of the angles was measured [s]."""
        time: float = _least(self.at)
        return time

    def age(self, time: float) -> float:
        """Return the age of the oldest of the angles at `time` [s]."""
        return time - self.oldest

    def fresh(self, time: float) -> bool:
        """Return whether no angle is older than the timeout at `time` [s]."""
        return self.age(time) <= self._timeout()

    def use(self, q: Array, time: float) -> None:
        """Use angles (N,) [rad] without a check, such as those of a simulated robot at its start."""
        self.q[:], self.at[:] = q, time
        self._last[:], self._last_at[:] = q, time

    def measure(self, q: Array, at: Array, moving: bool) -> Mask:
        """Process measurements, and return which of the joints have a new angle, shape (N,).

        Parameters
        ----------
        q : ndarray, shape (N,)
            Angles [rad].
        at : ndarray, shape (N,)
            Times at which they were measured [s]; an angle is new if its time is.
        moving : bool
            Whether commands move the joints.
        """
        taken = np.zeros(len(q), np.bool_)
        rejected, jumps = _judge(
            q, at, moving, self._speed, self._slack, self._longest(),
            self.q, self.at, self._last, self._last_at, self.jumps, self._agreeing, taken,
        )  # fmt: skip
        self.rejected += rejected
        if moving and not self.fault and jumps >= JUMPS:
            names = [self._names[i] for i in np.flatnonzero(self.jumps >= JUMPS)]
            self.fault = f"{', '.join(names)} {'has' if len(names) == 1 else 'have'} jumped to another angle"
        return taken

    def forgive(self) -> None:
        """Clear the fault, when an operator has confirmed that the angles are right."""
        self.fault = ""
        self.jumps[:] = 0

    def forget(self) -> None:
        """Use no angle, and clear the fault, until `JUMPS` in a row agree."""
        self.forgive()
        self.q[:], self.at[:], self._agreeing[:] = np.nan, -np.inf, 0


class ServoGoals:
    """Computes the goals of one servo per joint.

    Parameters
    ----------
    gate : AngleGate
        Of these joints.
    drive : Drive
        Assumed model of the servos.
    limits : RobotModel or JointLimits
        Of these joints.
    window : float or ndarray, shape (n,)
        Distance from the predicted angle of the joint beyond which the goal, without the offset by torques, returns
        [rad].
    window_lag : float
        Lag of the joints: a goal that moves may be farther ahead of its joint by the motion within this time [s].
    window_time : float
        Time constant of this return; 0: the goal is never beyond the window [s].
    resolution : float or ndarray, shape (n,)
        Steps of the goals [rad]; 0: continuous.
    rate, latency : float
        Of a simulated bus: rate at which goals are written, 0 for every command [Hz]; time until they act [s].

    Attributes
    ----------
    gate : AngleGate
    active : bool
        Whether commands have an effect, see `begin`.
    wanted : ndarray, shape (n,)
        Commanded positions without the offsets by feedforward torques [rad].
    goal : ndarray, shape (n,)
        Commanded positions with them [rad].
    window : ndarray, shape (n,)
        As above.
    runaway : ndarray of bool, shape (n,)
        Joints that have moved against the full torque of their servos.
    """

    def __init__(
        self,
        gate: AngleGate,
        drive: Drive,
        limits: RobotModel | JointLimits,
        window: Array | float,
        *,
        window_lag: float = 0.0,
        window_time: float = 0.0,
        resolution: Array | float = 0.0,
        rate: float = 0.0,
        latency: float = 0.0,
    ) -> None:
        n = len(limits.joint_names)
        self.gate, self._drive, self._limits = gate, drive, limits
        self.window, self._window_lag, self._window_time = np.full(n, window), window_lag, window_time
        self._fastest = np.minimum(limits.velocity_max, FASTEST)
        self._range = np.ascontiguousarray(limits.q_min), np.ascontiguousarray(limits.q_max)  # else compiled again
        self._step = np.maximum(np.broadcast_to(resolution, (n,)), 1e-12)
        self._rate, self._latency = rate, latency
        full = drive.angles(np.minimum(limits.effort_max, np.finfo(float).max))
        self._most = np.minimum(full, _MOST_OFFSET)  # of full torques
        self._ahead = drive.angles(drive.lead)  # [s]
        self._at, self._side, self._nearest = np.zeros(n), np.zeros(n), np.zeros(n)
        self.runaway, self._ran_away = np.zeros(n, np.bool_), False
        self.active = False
        zero = np.zeros(n)  # compiled here, so that the first command is not late
        self._offset_of(zero)
        _find_runaways(zero, zero, self._most, self._side, self._nearest, self.runaway)
        _goals(
            zero, zero, 1.0, zero, zero, self.window, 0.0, 0.0, *self._range,
            zero, zero, zero, self._fastest, self._step,
        )  # fmt: skip
        self._begin(gate.q.copy(), zero)

    @classmethod
    def of(
        cls,
        config: Config,
        model: RobotModel,
        timeout: Callable[[], float] = lambda: math.inf,
        *,
        simulated: Servos | None = None,
    ) -> ServoGoals:
        """Return the law for the joints of a model, as the section ``servo`` describes it.

        Parameters
        ----------
        timeout : callable
            Returns the age above which angles are not used [s].
        simulated : Servos, optional
            Servos whose goals are rounded, and written and effective as ``servo.rate`` and ``servo.latency`` say.
        """
        c, speed = config.servo, np.minimum(model.velocity_max, FASTEST)
        period = max(config.dt, 1.0 / config.sensors.rate if simulated is not None and config.sensors.rate else 0.0)
        gate = AngleGate(model.joint_names, speed, period * speed, longest=timeout, timeout=timeout)
        drive, window = Drive.of(config, model), goal_windows(config, model)
        if simulated is None:
            return cls(gate, drive, model, window, window_lag=c.window_lag, window_time=c.window_time)
        return cls(
            gate, drive, model, window, window_lag=c.window_lag, window_time=c.window_time,
            resolution=simulated.resolution, rate=c.rate, latency=c.latency,
        )  # fmt: skip

    def begin(self, effort: Array | None = None, held: Array | None = None) -> None:
        """Let commands have an effect, from the measured angles on.

        Parameters
        ----------
        effort : ndarray, shape (n,), optional
            Feedforward torques before the first command [N m].
        held : ndarray, shape (n,), optional
            Goals that the servos hold now [rad]; those that commands could have set remain until the first command.
        """
        self.gate.forgive()
        q, offset = self.gate.q.copy(), self._offset_of(np.zeros_like(self.gate.q) if effort is None else effort)
        self._begin(q, offset)
        if held is not None:
            self.goal = self._sent = np.where(np.abs(held - q) <= self.window + self._most, held, q)
        self.active = True

    def _begin(self, wanted: Array, offset: Array) -> None:
        self.wanted, self._offset, self._lead = wanted, offset, np.zeros(len(offset))
        self.goal = self._sent = wanted + offset
        self._side[:], self.runaway[:], self._ran_away = 0.0, False, False
        self._history = CommandHistory(self._drive.delay, len(offset))
        self._written = -math.inf
        self._queue: deque[tuple[float, Array]] = deque()

    def end(self) -> None:
        """Let no command have an effect."""
        self.active = False

    def forget(self) -> None:
        """Let no command have an effect; use no angle, and clear the fault, until `JUMPS` in a row agree."""
        self.end()
        self.gate.forget()
        self.runaway[:], self._ran_away = False, False

    @property
    def fault(self) -> str:
        """Why no command has an effect before the next `begin` or `forget`, with the names of joints; else empty."""
        if self.gate.fault or not self._ran_away:
            return self.gate.fault
        names = [self._limits.joint_names[i] for i in np.flatnonzero(self.runaway)]
        return f"{', '.join(names)} moved away from {'its goal' if len(names) == 1 else 'their goals'} at full torque"

    def measure(self, q: Array, at: Array | float) -> Mask:
        """Process measured angles (n,) [rad] and their times [s], shape () or (n,); return which of them are used."""
        self._at[:] = at
        used = self.gate.measure(q, self._at, self.active)
        if self.active:
            self._ran_away = _find_runaways(self.gate.q, self.goal, self._most, self._side, self._nearest, self.runaway)
        return used

    def moves(self, time: float) -> bool:
        """Return whether a command at `time` [s] has an effect."""
        return self.active and not self.fault and self.gate.fresh(time)

    def command(self, velocity: Array, effort: Array | None, time: float, dt: float) -> bool:
        """Process a command; return whether it has an effect.

        Parameters
        ----------
        velocity : ndarray, shape (n,)
            Joint velocities [rad/s].
        effort : ndarray, shape (n,), or None
            Feedforward torques [N m]; None: those of the last command.
        time, dt : float
            Time of the command, and the period for which it holds [s].
        """
        if not self.moves(time):
            return False
        if effort is not None:
            self._offset, self._lead = self._offset_of(effort), self._ahead
        pending = self._history.pending(self.gate.oldest)
        beyond = math.exp(-dt / self._window_time) if self._window_time else 0.0
        u, self.wanted, self.goal, rounded = _goals(
            self.wanted, velocity, dt, self.gate.q, pending, self.window, self._window_lag, beyond, *self._range,
            self._offset, self._lead, self.goal, self._fastest, self._step,
        )  # fmt: skip
        self._history.add(time, u, dt)
        if self._rate <= 0.0 or time - self._written >= 1.0 / self._rate - 1e-9:
            self._written = time
            self.output(time)  # those of the past, for which not every user asks
            self._queue.append((time + self._latency, rounded))
        return True

    def relieve(self, joint: int) -> None:
        """Set the goal of a joint that is blocked to its measured angle."""
        self.wanted[joint] = self.goal[joint] = self.gate.q[joint]
        self._offset[joint] = 0.0

    def output(self, time: float) -> tuple[Array, float]:
        """Return the goals (n,) of the servos at `time` [s] [rad], and the time at which they change next [s]."""
        while self._queue and self._queue[0][0] <= time + 1e-9:
            self._sent = self._queue.popleft()[1]
        return self._sent, self._queue[0][0] if self._queue else math.inf

    def _offset_of(self, effort: Array) -> Array:
        """Return the offsets (n,) of the goals [rad] that produce torques, within the effort limits."""
        out: Array = _clipped(self._drive.angles(effort), self._most)
        return out


@jit
def _clipped(values: Array, most: Array) -> Array:
    """Return values (n,) within +-`most` (n,)."""
    return np.minimum(np.maximum(values, -most), most)


@jit
def _least(at: Array) -> float:
    """Return the least of the times `at` (N,) [s], in a tenth of the time that numpy takes."""
    least: float = at.min()
    return least


@jit
def _judge(
    q: Array, at: Array, moving: bool, speed: Array, slack: Array, longest: float, used: Array, used_at: Array,
    last: Array, last_at: Array, jumps: NDArray[np.intp], agreeing: NDArray[np.intp], taken: Mask,
) -> tuple[int, int]:  # fmt: skip
    """Store which of the angles q (N,), measured at the times `at` (N,), are used.

    Return how many are impossible, and the most consecutive ones of a joint.
    """
    far = _unreachable(q, used, np.minimum(at - used_at, longest), speed, slack)
    apart = _unreachable(q, last, np.minimum(at - last_at, longest), speed, slack)
    rejected = 0
    for i in range(q.shape[0]):
        if not at[i] > last_at[i]:
            continue
        agreeing[i] = 1 if apart[i] else agreeing[i] + 1
        jumps[i] = jumps[i] + 1 if far[i] else 0
        last[i], last_at[i] = q[i], at[i]
        taken[i] = not far[i] or (not moving and agreeing[i] >= JUMPS)
        if taken[i]:
            used[i], used_at[i], jumps[i] = q[i], at[i], 0
        elif np.isfinite(used[i]):
            rejected += 1
    return rejected, jumps.max()


@jit
def _find_runaways(q: Array, goal: Array, most: Array, side: Array, nearest: Array, runaway: Mask) -> bool:
    """Set `runaway` (n,) of joints that have moved away from their goals at errors larger than `most` (n,) [rad].

    Return whether there is any.
    `side` (n,) is the sign of such an error, 0 without one; `nearest` (n,) the angle nearest to the goal since [rad].
    """
    for i in range(q.shape[0]):
        error = goal[i] - q[i]
        now = np.sign(error) if abs(error) > most[i] + _BEYOND else 0.0
        if now != side[i] or now * (q[i] - nearest[i]) > 0.0:
            side[i], nearest[i] = now, q[i]
        elif now * (nearest[i] - q[i]) > _AWAY:
            runaway[i] = True
    return bool(runaway.any())


@jit
def _goals(
    wanted: Array, velocity: Array, dt: float, q: Array, pending: Array, window: Array, lag: float, beyond: float,
    lower: Array, upper: Array, offset: Array, lead: Array, goal: Array, fastest: Array, step: Array,
) -> Array:  # fmt: skip
    """Return velocities within their limits [rad/s], and after one period the commanded positions [rad], (4, n).

    These are without and with the offsets and the lead [s], and the latter rounded. The joints are predicted at
    q + `pending` when the command acts. Of what a position is beyond the `window` (n,) [rad] around them, which extends
    in the direction of motion by the motion within `lag` [s], the fraction `beyond` remains. A joint outside its range
    may only move towards it.
    """
    out = np.empty((4, wanted.shape[0]))
    u, moved, shifted, rounded = out
    for i in range(wanted.shape[0]):
        low, high = min(lower[i], wanted[i]), max(upper[i], wanted[i])
        slowest, quickest = max((low - wanted[i]) / dt, -fastest[i]), min((high - wanted[i]) / dt, fastest[i])
        u[i], expected = min(max(velocity[i], slowest), quickest), q[i] + pending[i]
        asked = wanted[i] + dt * u[i]
        ahead = lag * u[i]
        first, last = expected + min(ahead, 0.0) - window[i], expected + max(ahead, 0.0) + window[i]
        near = min(max(asked, first), last)
        moved[i] = min(max(near + beyond * (asked - near), low), high)
        least, most = goal[i] - dt * fastest[i], goal[i] + dt * fastest[i]
        shifted[i] = min(max(min(max(moved[i] + offset[i] + lead[i] * u[i], low), high), least), most)
        rounded[i] = np.rint(shifted[i] / step[i]) * step[i]
    return out
