"""The law of the dynamic walk: from a measured state to the targets of its tasks and the force of the ground.

It is two compiled calls for each state, which call the functions of the CoM, the pendulum, the ground, the plan, the
swing foot and the force: `notice` what is measured, by which the step may be adjusted, and `answer`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.walks.com import projected
from dqwalk_ros.walks.dynamic.force import converging, fed_back, ground_force
from dqwalk_ros.walks.dynamic.ground import include, tipped
from dqwalk_ros.walks.dynamic.pendulum import Moving, advance, command, measure, when_acting
from dqwalk_ros.walks.dynamic.plan import REFERENCE
from dqwalk_ros.walks.dynamic.swing import advanced, climbing

_AHEAD_OF_DELAY = 0.75
"""Part of the delay less a period by which the reference of the CoM is ahead; with less the weight is transferred late,
and with all of it a bus at 50 Hz tilts the soles."""
_DOWN_AHEAD = 1.4
"""Multiple of the delay less a period by which the path of a swing foot ends early; with less the leg still moves when
the foot lands."""

GROUNDED = np.zeros(6), np.zeros(2), np.zeros(14), np.zeros(13)
"""Stands for the swing, see `answer`, of a phase without one."""


class Measured(NamedTuple):
    """A measured state, `elapsed` [s] after the beginning of the phase of a `duration` [s].

    `c` and `xi` (2,) are the CoM and the divergent component [m], `up` (3,) the vertical, and `vertical` (3,) its mean,
    that of the ground.
    """

    time: float
    elapsed: float
    duration: float
    c: Array
    xi: Array
    up: Array
    vertical: Array


class Settings(NamedTuple):
    """Constants of the law.

    `advance` is the delay of the drive less a period [s], `gain` that of the feedback, `unsure` the dead zone of the
    inclination of a sole [rad], `margin` the distance of the pressure from the edges [m], `late` the time for which a
    foot lands late [s], `reaction` the displacement of the pressure per acceleration of the swing foot [s^2], and
    `height` that of the CoM [m].
    """

    advance: float
    gain: float
    unsure: float
    margin: float
    late: float
    reaction: float
    height: float


@jit
def notice(
    time: float, dt: float, up: Array, vertical: Array, pendulum: tuple[Any, ...], c: Array, xi: Array, share: float,
    com: Array, J_com: Array, lines: Array, poses: Array, swing: tuple[Any, ...], sensor: tuple[Any, ...], dq: Array,
    gyro: Array,
) -> None:  # fmt: skip
    """Fill c and xi (2,) [m], and include a state at `time`, `dt` after the last one [s].

    The pendulum, whose fields are those of `Moving`, and the mean `vertical` (3,) of the ground go on. The arguments
    from `share` on are those of `projected`.
    """
    now = Moving(*pendulum)
    c[:], xi[:] = projected(up, now.omega, share, com, J_com, lines, poses, swing, sensor, dq, gyro)
    advance(now, dt)
    include(vertical, up, dt)
    measure(now, time, dt, xi)


_planned = REFERENCE.call


@jit
def answer(
    measured: tuple[Any, ...], settings: tuple[Any, ...], pendulum: tuple[Any, ...], reference: tuple[Any, Array],
    support: tuple[Array, Array], climb: tuple[float, float], transfers: bool, swings: bool, swing: tuple[Array, ...],
    com: Array, height: Array, upright: Array, force: Array,
) -> None:  # fmt: skip
    """Fill the numbers of the `Target` of each task, and the force (3,) of the ground per mass [m/s^2].

    Parameters
    ----------
    measured, settings, pendulum : tuple
        Fields of `Measured`, `Settings` and `Moving`; records arrive as plain tuples, as in `assembly`.
    reference : tuple
        `Reference.compiled`.
    support : (n, d)
        Edges of the support polygon, shapes (m, 2) and (m,).
    climb : tuple
        Heights of the CoM above that of the posture at the beginning and at the end of the phase [m].
    transfers, swings : bool
        Whether the phase is a double support that transfers the weight, or a single support.
    swing : tuple
        `Swing.compiled`, and the numbers of the target of the swing foot.
    com, height, upright : ndarray
        Numbers of the targets.
    """
    at, fixed, now, (function, numbers) = Measured(*measured), Settings(*settings), Moving(*pendulum), reference
    t, z, later = at.elapsed, np.empty(2), np.empty((2, 2))
    _planned(function, numbers, t, later)
    now.xi[:] = later[0]
    # the error of xi that remains when the command acts is fed back
    c, xi = when_acting(now, at.time, at.c, at.xi)
    due = np.empty((2, 2))
    _planned(function, numbers, t + now.delay, due)
    z[:] = due[1]
    if transfers:  # until a sole is down, no pressure can move towards it
        _planned(function, numbers, t + now.delay - fixed.advance, later)
        z[:] = later[1]
    reaction = 0.0
    if swings:  # the foot must be on the ground before the weight is transferred
        state, goal, path, target = swing
        down = at.duration - _DOWN_AHEAD * fixed.advance + fixed.late
        place, velocity, acceleration = advanced(state, goal, path, t, down)
        target[:7], target[7:] = tipped(at.vertical, at.up, fixed.unsure, place), velocity
        reaction = fixed.reaction * acceleration[0]
    command(now, at.time, fed_back(z, due[0], xi, fixed.gain, reaction, support[0], support[1], fixed.margin))
    force[:] = ground_force(c, now.pressure, now.omega, at.up)
    ahead = _AHEAD_OF_DELAY * fixed.advance
    _planned(function, numbers, t + ahead, later)
    com[:2], com[2:] = converging(now.c, now.xi, later[0], now.omega, ahead)
    above, rising = climbing(climb[0], climb[1], at.duration, t + ahead)
    height[0], height[1] = fixed.height + above, rising
    upright[:2], upright[2:] = at.up[:2], 0.0
