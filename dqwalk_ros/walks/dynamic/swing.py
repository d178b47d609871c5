"""Path of a swing foot, whose landing position and time may change during the swing."""

from __future__ import annotations

import math

import numpy as np

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.kinematics import quaternion_product
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.walks.following import minimum_jerk

_LIFT, _LAND = 0.02, 0.06
"""Fractions of the duration at the beginning and at the end without motion along the ground."""
_GENTLE = 2.7
"""Exponent of the height at the end: with 2.5 stiff legs touch the ground too early, with 3 soft ones land late."""
_TOP = 2.0 / (2.0 + _GENTLE)
_SCALE = 1.0 / (_TOP**2 * (1.0 - _TOP) ** _GENTLE)
_CLEAR = 0.15
"""Fraction of the duration without motion along the ground, in addition, on the lower side of the edge of a stair."""
_DESCENDED = 0.9
"""Largest part of the way down before a stair that the foot is taken to have behind it when it turns back."""


@jit
def climbing(start: float, end: float, duration: float, elapsed: float) -> tuple[float, float]:
    """Return height [m] and velocity [m/s] on a minimum-jerk path of a duration [s], `elapsed` [s] after its start."""
    place, slope, _ = minimum_jerk(elapsed / duration)
    way = end - start
    return start + place * way, slope / duration * way


class Swing:
    """Path of a sole: minimum jerk along the ground, and an arch in height.

    On a stair the arch is added to the change of height: minimum jerk over the first half of the time on the way up,
    over the last half on the way down. The motion along the ground takes place while the foot is above the edge.

    Parameters
    ----------
    start, goal : ndarray, shape (8,)
        Poses in the base frame, as unit dual quaternions.
    height : float
        Largest height of the path [m].
    descent : float
        Duration of a whole swing of which only the descent remains; zero for a swing that starts on the ground [s].
    level : float
        Height of the ground at the start over that of the supporting sole [m].
    still : float
        Further fraction of the duration at the end without motion along the ground.

    Attributes
    ----------
    begun : float
        Time of the whole path before its start, on the descent from its largest height; zero if it starts on the
        ground [s].
    start, goal : ndarray, shape (2,)
        Where the foot lifts off and where it lands, which may be changed during the swing [m].
    """

    def __init__(
        self, start: Array, goal: Array, height: float, descent: float = 0.0, level: float = 0.0, still: float = 0.0
    ) -> None:
        a, b = DQ(start), DQ(goal)
        half = 0.5 * (b * a.conj()).rotation_vector()
        x, y, z = a.translation()
        z -= level
        climb = float(b.translation()[2]) - level
        done = 0.0
        if descent > 0.0:
            done = _descent(z / height)
            z, height = 0.0, z / _arch(done)[0]
        self.goal = b.translation()[:2]
        self.start = np.array([x, y])
        self.begun = done * descent
        lift, land = _LIFT + _CLEAR * (climb > 0.0), _LAND + _CLEAR * (climb < 0.0) + still
        self._path = np.array([z, height, *a.vec4(), *half, np.linalg.norm(half), level, climb, lift, land])
        self._state = np.array([done, self.begun, x, y, 0.0, 0.0])

    @property
    def compiled(self) -> tuple[Array, Array, Array]:
        """The first three arguments of `advanced`."""
        return self._state, self.goal, self._path

    @property
    def along(self) -> tuple[Array, Array]:
        """Place [m] and velocity [m/s] of the path along the ground at the last time, (2,) each."""
        return self._state[2:4], self._state[4:]

    def is_over(self, place: Array) -> bool:
        """Return whether the foot steps up, and is past half of its way at `place` (2,) [m], so over the stair."""
        left, whole = self.goal - place, self.goal - self.start
        return bool(self._path[11] > 0.0 and left @ left < 0.25 * whole @ whole)

    def stop(self, place: Array, height: float | None = None) -> Array:
        """Let the foot land at `place` (2,) [m], at which it is now; return where it lands.

        It stays at a `height` over the supporting sole [m]. Without one, a foot that climbs goes back to its start.
        """
        self.goal, path, s = place, self._path, float(self._state[0])
        level, climb = path[10:12]
        if height is not None:
            path[:2], path[10:12] = 0.0, (height, 0.0)
        elif climb > 0.0:
            way = 1.0 - min(minimum_jerk(2.0 * s - 1.0)[0], _DESCENDED)
            path[10] = (level + climb * minimum_jerk(2.0 * s)[0]) / way
            path[11] = -path[10]
            self.goal = self.start
        self._state[2:4], self._state[4:] = place, 0.0
        return self.goal


@jit
def advanced(state: Array, goal: Array, path: Array, elapsed: float, duration: float) -> tuple[Array, Array, Array]:
    """Advance a `Swing` to a time, and return the motion there.

    Parameters
    ----------
    state : ndarray, shape (6,)
        Completed fraction of the time, the time [s], and place and velocity along the ground.
    goal : ndarray, shape (2,)
        Where the foot lands [m].
    path : ndarray, shape (14,)
        Height of the start over its ground and that of the arch [m], orientation at the start, half the rotation vector
        and its norm, height of the ground at the start and its change [m], and fractions of the time at the beginning
        and at the end without motion along the ground.
    elapsed : float
        Time since the lift-off; must not decrease [s].
    duration : float
        Current duration of the whole swing [s].

    Returns
    -------
    pose : ndarray, shape (7,)
        Position [m] and unit quaternion.
    velocity : ndarray, shape (6,)
        Linear [m/s] and angular [rad/s].
    acceleration : ndarray, shape (2,)
        Along the ground [m/s^2].
    """
    level, climb, lift, land = path[10], path[11], path[12], path[13]
    since, left = elapsed - state[1], max(duration - state[1], 1e-3)
    # the completed fraction of the time increases linearly to 1 at the end
    s = min(state[0] + (1.0 - state[0]) / left * since, 1.0)
    rate = (1.0 - s) / max(duration - elapsed, 1e-3) if s < 1.0 else 0.0
    (before, _), (place, slope) = _along(state[0], lift, land), _along(s, lift, land)
    p, v = state[2:4].copy(), np.zeros(2)
    if before < 1.0:  # the same fraction of the remaining distance as for a fixed goal
        p += (place - before) / (1.0 - before) * (goal - p)
    if place < 1.0 - 1e-9:
        v = slope * rate / (1.0 - place) * (goal - p)
    acceleration = (v - state[4:]) / since if since > 0.0 else np.zeros(2)
    state[0], state[1], state[2:4], state[4:] = s, elapsed, p, v
    arch, steep = _arch(s)
    start, height, r, half, angle = path[0], path[1], path[2:6], path[6:9], path[9]
    up, steeper, _ = minimum_jerk(2.0 * s if climb > 0.0 else 2.0 * s - 1.0)
    z = start * (1.0 - s) + height * arch + (level + climb * up)
    rise = -start + height * steep + 2.0 * climb * steeper
    sin = math.sin(angle * place) / angle if angle > 0.0 else 0.0
    axis = sin * half
    turned = quaternion_product(math.cos(angle * place), axis[0], axis[1], axis[2], r[0], r[1], r[2], r[3])
    pose = np.concatenate((p, np.array([z]), np.array(turned)))
    return pose, np.concatenate((v, np.array([rise * rate]), 2.0 * slope * rate * half)), acceleration


@jit
def _along(s: float, lift: float, land: float) -> tuple[float, float]:
    """Return the completed fraction of the distance along the ground at the fraction `s` of the time, and its slope.

    The fractions `lift` and `land` at the beginning and at the end are without motion.
    """
    span = 1.0 - lift - land
    place, slope, _ = minimum_jerk((s - lift) / span)
    return place, slope / span


@jit
def _arch(s: float) -> tuple[float, float]:
    """Return the height 0..1 at the fraction `s` of the time, and its slope: s^2 (1 - s)^2.7, scaled.

    It ends without velocity and acceleration: a foot that hits the ground unloads the supporting sole, which slips. A
    foot that comes down more slowly touches the ground too early.
    """
    left = 1.0 - s
    slope = _SCALE * s * left ** (_GENTLE - 1.0) * (2.0 - (2.0 + _GENTLE) * s)
    return _SCALE * s**2 * left**_GENTLE, slope


def _descent(part: float) -> float:
    """Return the fraction of the time at which the arch has come down to a part of its height."""
    s = np.linspace(_TOP, 1.0, 200)
    return float(s[np.argmax(_SCALE * s**2 * (1.0 - s) ** _GENTLE <= max(part, 0.1))]) if part < 1.0 else _TOP
