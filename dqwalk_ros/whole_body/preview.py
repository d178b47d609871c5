"""The preview of section III [Sherikov2014]: point-mass model, timing of the steps, CoP constraints, capturability.

The preview samples the times t + k T, k = 0..N, after the present time t. A *support coordinate* s describes the
support at a time: s = j in single support on foot j, between j and j + 1 while the weight is transferred to foot j + 1,
and s = -1 on both feet before the first step, where "foot -1" is the middle between them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from dqwalk_ros.config import Config, WholeBodyConfig
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.support.arrays import Array

_EPS = 1e-9


@dataclass(frozen=True)
class PointMass:
    """The linear inverted pendulum (S10) of one axis, with a piecewise linear CoP."""

    height: float
    """c^z [m]."""
    interval: float
    """T [s]."""
    intervals: int
    """N."""

    @property
    def omega(self) -> float:
        """sqrt(g / c^z) [1/s]."""
        return math.sqrt(GRAVITY / self.height)

    @property
    def zeta(self) -> float:
        """c^z / g of z = c - zeta c'' [s^2]."""
        return self.height / GRAVITY

    @cached_property
    def alpha(self) -> Array:
        """Coefficients of the capturability constraint (S14) in closed form, shape (N + 1,).

        The capture point obeys xi' = omega (xi - z). With a CoP that is linear between the samples the robot comes to
        rest, c'_N + c''_N/omega = 0, if and only if sum_k alpha_k z_k = xi_0. The sum of all alpha_k is one.
        """
        w, T, N = self.omega, self.interval, self.intervals
        alpha = np.empty(N + 1)
        alpha[0] = 1.0 - (1.0 - math.exp(-w * T)) / (w * T)
        alpha[1:N] = np.exp(-w * T * np.arange(1, N)) * (2.0 * math.cosh(w * T) - 2.0) / (w * T)
        alpha[N] = math.exp(-w * T * N) * (math.exp(w * T) - 1.0) / (w * T)
        return alpha

    def capture_point(self, c: Array, c_dot: Array) -> Array:
        """Return the capture point xi, shape (2,) [m]."""
        return c[:2] + c_dot[:2] / self.omega  # (S13)


@dataclass(frozen=True)
class Swing:
    """A swing in progress: the swing foot, the time since lift-off and the time until landing [s]."""

    foot: Foot
    elapsed: float
    remaining: float


@dataclass(frozen=True)
class Stepping:
    """Timing of the steps."""

    first: Foot
    """The foot 0, the first support foot."""
    standing: float
    double: float
    single: float
    """Durations of the first double support, of a double support between steps and of a single support [s]."""

    @classmethod
    def of(cls, config: Config) -> Stepping:
        """Return the timing of a configuration."""
        s = config.whole_body
        return cls(Foot(config.gait.first_support), s.first_double_support, s.double_support, s.single_support)

    @property
    def begin(self) -> float:
        """Time at which the first single support begins [s]."""
        return self.standing + self.double

    @property
    def period(self) -> float:
        """Duration of a step [s]."""
        return self.single + self.double

    def foot(self, index: int) -> Foot:
        """Return the foot with the index 0, 1, 2, ..."""
        return self.first if index % 2 == 0 else self.first.other

    def coordinate(self, time: ArrayLike) -> Array:
        """Return the support coordinate s at times [s], of the same shape."""
        t = np.asarray(time, dtype=np.float64)
        step = np.floor((t - self.begin + _EPS) / self.period)
        within = t - self.begin - step * self.period
        walking = step + np.clip((within - self.single) / self.double, 0.0, 1.0)
        starting = np.clip((t - self.standing) / self.double, 0.0, 1.0) - 1.0
        s: Array = np.where(t < self.begin - _EPS, starting, walking)
        nearest = np.round(s)
        return np.where(np.abs(s - nearest) < 1e-6, nearest, s)

    def step(self, time: float) -> int:
        """Return the index of the support foot at a time [s], -1 before the first single support."""
        return -1 if time < self.begin - _EPS else math.floor((time - self.begin + _EPS) / self.period)

    def landed(self, time: float) -> int:
        """Return the index of the foot that landed last at a time [s], -1 before the first transfer of the weight."""
        if time < self.begin - _EPS:
            return 0 if time >= self.standing - _EPS else -1
        return self.step(time) + (self.swing(time) is None)

    def swing(self, time: float) -> Swing | None:
        """Return the swing at a time [s], None in double support."""
        index = self.step(time)
        if index < 0:
            return None
        elapsed = time - self.begin - index * self.period
        if elapsed >= self.single - _EPS:
            return None
        return Swing(self.foot(index + 1), max(elapsed, 0.0), self.single - elapsed)

    def stance(self, time: float) -> tuple[Foot, ...]:
        """Return the feet on the ground at a time [s]."""
        swing = self.swing(time)
        return tuple(Foot) if swing is None else (swing.foot.other,)

    def landing(self, time: float, dt: float) -> Foot | None:
        """Return the foot that touches down between a time and `dt` later [s]."""
        swing = self.swing(time)
        return swing.foot if swing is not None and swing.remaining <= dt + _EPS else None


@dataclass(frozen=True)
class Preview:
    """The CoP at t + k T, k = 0..N, for each axis: z = offset + M y with y = (c''_0, Z, P).

    Z are the CoPs at k = 1..N relative to the middle of their foot, P the K displacements from each foot to the next.
    """

    M: Array
    """The same for both axes, shape (N + 1, 1 + N + K)."""
    offset: Array
    """Shape (N + 1, 2) [m]."""
    lower: Array
    upper: Array
    """Bounds of y, shape (1 + N + K, 2); those of c''_0 are infinite."""

    @property
    def cops(self) -> slice:
        """Indices of Z in y."""
        return slice(1, self.M.shape[0])

    @property
    def feet(self) -> slice:
        """Indices of P in y."""
        return slice(self.M.shape[0], self.M.shape[1])


def previewed(
    config: WholeBodyConfig, stepping: Stepping, mass: PointMass, time: float, com: Array, places: Mapping[int, Array]
) -> Preview:
    """Return the preview at a time.

    Parameters
    ----------
    time : float
        [s]
    com : ndarray, shape (2,) or (3,)
        c_0 [m].
    places : mapping of int to ndarray, shape (2,)
        Positions of the feet that landed last, by index; -1 is the middle of both feet before the first step [m].

    Notes
    -----
    While the weight is transferred from foot j to j + 1, the rectangle of the CoP moves from one to the other
    ("translated support areas"), so that the constraints change continuously with time.
    """
    N, base = mass.intervals, max(places)
    s = stepping.coordinate(time + mass.interval * np.arange(1, N + 1))
    K = max(math.ceil(s[-1] - base - _EPS), 1)
    M, offset = np.zeros((N + 1, 1 + N + K)), np.empty((N + 1, 2))
    M[0, 0], offset[0] = -mass.zeta, com[:2]  # (S10) z = c - c'' c^z/g
    M[np.arange(1, N + 1), np.arange(1, N + 1)] = 1.0
    M[1:, N + 1 :] = np.clip(s[:, None] - base - np.arange(K), 0.0, 1.0)  # V, which selects footsteps
    offset[1:] = places[base]
    if base - 1 in places:
        offset[1:] += np.minimum(s - base, 0.0)[:, None] * (places[base] - places[base - 1])
    upper = np.full((1 + N + K, 2), np.inf)
    lower = -upper
    # (S11) the CoP is in the rectangle of its foot; before the first step, in the rectangle around both feet
    upper[1 : N + 1] = 0.5 * config.cop_length, 0.5 * config.cop_width
    upper[1 : N + 1, 1] += np.clip(-s, 0.0, 1.0) * 0.5 * config.feet_distance
    lower[1 : N + 1] = -upper[1 : N + 1]
    # (S12) each foot lands in a box beside the previous one
    for k in range(K):
        side = 1.0 if stepping.foot(base + 1 + k) is Foot.LEFT else -1.0
        across = sorted((side * config.step_width_min, side * config.step_width_max))
        lower[N + 1 + k], upper[N + 1 + k] = (-config.step_length, across[0]), (config.step_length, across[1])
    if base < 0:  # the first foot stands already
        side = 1.0 if stepping.first is Foot.LEFT else -1.0
        lower[N + 1] = upper[N + 1] = 0.0, side * 0.5 * config.feet_distance
    return Preview(M, offset, lower, upper)


def swing_acceleration(remaining: float) -> tuple[float, float]:
    """Coefficients (a, b) of the cubic that ends at s_l at rest (S16): s'' = a (s_l - s) - b s' [1/s^2, 1/s]."""
    return 6.0 / remaining**2, 4.0 / remaining


def swing_jerk(remaining: float) -> tuple[float, float]:
    """Coefficients (a, b) of its jerk (S20): s''' = -a (s_l - s) + b s' [1/s^3, 1/s^2]."""
    return 12.0 / remaining**3, 6.0 / remaining**2
