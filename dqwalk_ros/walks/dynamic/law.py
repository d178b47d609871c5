"""The control law of the dynamic walk: from a measured state to the targets of its tasks and the ground reaction force.

Three compiled calls for each state call the functions of the CoM, the pendulum, the ground, the plan, the swing foot
and the force: `notice` includes what is measured, by which the step may be adjusted; `answer` sets the targets;
`torques` belong to the command that the quadratic program gives. What they read and write in a phase is one `Memory`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dqwalk_ros.paper.kinematics import PLACE, Place
from dqwalk_ros.paper.statics import SOLES, Soles
from dqwalk_ros.support.arrays import Array, Mask
from dqwalk_ros.support.by_address import BOOLEANS, FLOAT, MATRIX, VECTOR, Record
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.walks.com import projected
from dqwalk_ros.walks.dynamic.force import converging, fed_back, feedforward, ground_force
from dqwalk_ros.walks.dynamic.ground import include, tipped
from dqwalk_ros.walks.dynamic.pendulum import MOVING, Moving, advance, command, measure, when_acting
from dqwalk_ros.walks.dynamic.plan import REFERENCE
from dqwalk_ros.walks.dynamic.swing import advanced, climbing

_AHEAD_OF_DELAY = 0.75
"""Part of the delay less a period by which the reference of the CoM is ahead; with less the weight is transferred late,
and with all of it a bus at 50 Hz tilts the soles."""
_DOWN_AHEAD = 1.4
"""Multiple of the delay less a period by which the path of a swing foot ends early; with less the leg still moves when
the foot lands."""

GROUNDED = np.zeros(6), np.zeros(2), np.zeros(14)
"""Stands for `Swing.compiled` in a phase without a swing."""


class Settings(NamedTuple):
    """Constants of the control law."""

    advance: float
    """Delay of the drive less a period [s]."""
    gain: float
    """Of the feedback."""
    unsure: float
    """Dead zone of the inclination of a sole [rad]."""
    margin: float
    """Distance of the CoP from the edges [m]."""
    late: float
    """Time for which a foot lands late [s]."""
    reaction: float
    """Displacement of the CoP per acceleration of the swing foot [s^2]."""
    height: float
    """Of the CoM [m]."""


class Memory(NamedTuple):
    """What the control law reads and writes in a phase."""

    settings: Settings
    pendulum: Moving
    c: Array
    xi: Array
    """The measured CoM and divergent component, shape (2,) [m]."""
    vertical: Array
    """Mean vertical, that of the ground, shape (3,)."""
    n: Array
    d: Array
    """Edges of the support polygon, shapes (m, 2) and (m,)."""
    from_height: float
    to_height: float
    """Heights of the CoM above that of the posture at the beginning and at the end of the phase [m]."""
    swing: Array
    com: Array
    height: Array
    upright: Array
    """Numbers of the `Target` of each task."""
    force: Array
    """Force of the ground per mass, shape (3,) [m/s^2]."""
    other: Place
    sensor: Place
    """Places of the other sole and of the inertial sensor."""
    mass: float
    acceleration: Array
    inertia: Array
    legs: Mask
    soles: Soles
    """Arguments of `feedforward`."""


MEMORY = Record(
    Memory, Record(Settings, *[FLOAT] * len(Settings._fields)), MOVING, *[VECTOR] * 3, MATRIX, VECTOR, FLOAT, FLOAT,
    *[VECTOR] * 5, PLACE, PLACE, FLOAT, VECTOR, MATRIX, BOOLEANS, SOLES,
)  # fmt: skip
_opened = MEMORY.opened


@jit
def notice(
    table: Array, time: float, dt: float, up: Array, share: float, com: Array, J_com: Array, lines: Array,
    poses: Array, dq: Array, gyro: Array,
) -> None:  # fmt: skip
    """Include a state at `time`, `dt` after the last one [s], in the `Memory` whose `table` is given.

    The arguments from `up` on are those of `projected`.
    """
    kept = _opened(table)
    now = kept.pendulum
    kept.c[:], kept.xi[:] = projected(up, now.omega, share, com, J_com, lines, poses, kept.other, kept.sensor, dq, gyro)
    advance(now, dt)
    include(kept.vertical, up, dt)
    measure(now, time, dt, kept.xi)


_planned = REFERENCE.call


@jit
def answer(
    table: Array, time: float, t: float, duration: float, up: Array, function: int, numbers: Array, transfers: bool,
    swings: bool, state: Array, goal: Array, path: Array,
) -> None:  # fmt: skip
    """Fill the targets and the force of a `Memory`, whose `table` is given, for the last state that it has noticed.

    Parameters
    ----------
    time : float
        Time of that state [s].
    t, duration : float
        Time since the phase began, and its duration [s].
    up : ndarray, shape (3,)
        The vertical.
    function, numbers
        `Reference.compiled`.
    transfers, swings : bool
        Whether the phase is a double support that transfers the weight, or a single support.
    state, goal, path : ndarray
        `Swing.compiled`.
    """
    kept, z, later = _opened(table), np.empty(2), np.empty((2, 2))
    fixed, now = kept.settings, kept.pendulum
    _planned(function, numbers, t, later)
    now.xi[:] = later[0]
    # the error of xi that remains when the command acts is fed back
    c, xi = when_acting(now, time, kept.c, kept.xi)
    due = np.empty((2, 2))
    _planned(function, numbers, t + now.delay, due)
    z[:] = due[1]
    if transfers:  # until a sole is down, the CoP cannot move towards it
        _planned(function, numbers, t + now.delay - fixed.advance, later)
        z[:] = later[1]
    reaction = 0.0
    if swings:  # the foot must be on the ground before the weight is transferred
        down = duration - _DOWN_AHEAD * fixed.advance + fixed.late
        place, velocity, acceleration = advanced(state, goal, path, t, down)
        kept.swing[:7], kept.swing[7:] = tipped(kept.vertical, up, fixed.unsure, place), velocity
        reaction = fixed.reaction * acceleration[0]
    command(now, time, fed_back(z, due[0], xi, fixed.gain, reaction, kept.n, kept.d, fixed.margin))
    kept.force[:] = ground_force(c, now.pressure, now.omega, up)
    ahead = _AHEAD_OF_DELAY * fixed.advance
    _planned(function, numbers, t + ahead, later)
    kept.com[:2], kept.com[2:] = converging(now.c, now.xi, later[0], now.omega, ahead)
    above, rising = climbing(kept.from_height, kept.to_height, duration, t + ahead)
    kept.height[0], kept.height[1] = fixed.height + above, rising
    kept.upright[:2], kept.upright[2:] = up[:2], 0.0


@jit
def torques(
    table: Array, before: Array, u: Array, passed: float, up: Array, com: Array, J_com: Array, lines: Array,
    poses: Array,
) -> Array:  # fmt: skip
    """Return the `feedforward` torques (n,) [N m] for the force in the `table` of a `Memory`."""
    kept = _opened(table)
    tau: Array = feedforward(
        kept.acceleration, before, u, passed, kept.mass, kept.force, kept.pendulum.pressure, kept.inertia, kept.legs,
        up, com, J_com, lines, poses, kept.soles,
    )  # fmt: skip
    return tau
