"""The preview of the balance: a point mass, its steps, and how it can stop, section III [Sherikov2014].

Times of the preview are those of a grid t + k T, k = 0..N, that moves along with the clock. A *support coordinate* s
says where the robot stands: s = j on foot j alone, between j and j + 1 while the weight goes over, and s = -1 on both
feet before the first step, where "foot -1" is the middle of the two.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqwalk_ros.config import WholeBodyConfig
from dqwalk_ros.robot import Foot

__all__ = ["PointMass", "Preview", "Stepping", "Swing", "previewed", "swing_acceleration", "swing_jerk"]

Array = NDArray[np.float64]

_EPS = 1e-9


@dataclass(frozen=True)
class PointMass:
    """The linear inverted pendulum (10) with a CoP that moves piecewise linearly, per axis.

    Attributes
    ----------
    height : float
        c^z [m].
    interval : float
        T [s].
    intervals : int
        N.
    gravity : float
        [m/s^2]
    """

    height: float
    interval: float
    intervals: int
    gravity: float = 9.81

    @property
    def omega(self) -> float:
        """sqrt(g / c^z) [1/s]."""
        return math.sqrt(self.gravity / self.height)

    @property
    def zeta(self) -> float:
        """c^z / g of z = c - zeta c'' [s^2]."""
        return self.height / self.gravity

    @property
    def alpha(self) -> Array:
        """Coefficients of the capturability constraint (14), shape (N + 1,).

        With xi = c + c'/omega, of which xi' = omega (xi - z), the robot comes to rest, c'_N + c''_N/omega = 0, if and
        only if sum_k alpha_k z_k = xi_0. They sum up to one.
        """
        w, T, N = self.omega, self.interval, self.intervals
        alpha = np.empty(N + 1)
        alpha[0] = 1.0 - (1.0 - math.exp(-w * T)) / (w * T)
        alpha[1:N] = np.exp(-w * T * np.arange(1, N)) * (2.0 * math.cosh(w * T) - 2.0) / (w * T)
        alpha[N] = math.exp(-w * T * N) * (math.exp(w * T) - 1.0) / (w * T)
        return alpha

    def capture_point(self, c: Array, c_dot: Array) -> Array:
        """Return xi of (13), shape (2,) [m]."""
        return c[:2] + c_dot[:2] / self.omega

    def matrices(self) -> tuple[Array, Array, Array]:
        """Return A (3, 3), B (3,), D (3,) of (10) over T: x+ = A x + B z', z = D x with x = (c, c', c'')."""
        w, T = self.omega, self.interval
        sh, ch = math.sinh(w * T), math.cosh(w * T)
        A = np.array([[1.0, sh / w, (ch - 1.0) / w**2], [0.0, ch, sh / w], [0.0, w * sh, ch]])
        return A, np.array([T - sh / w, 1.0 - ch, -w * sh]), np.array([1.0, 0.0, -1.0 / w**2])


@dataclass(frozen=True)
class Swing:
    """A swing in progress: the foot that swings, and the time that went by and that is left [s]."""

    foot: Foot
    elapsed: float
    remaining: float


@dataclass(frozen=True)
class Stepping:
    """When which foot carries the robot; durations are given, places are not.

    Attributes
    ----------
    first : Foot
        The foot 0, which carries first.
    standing, double, single : float
        Durations of the first double support, of a transition and of a single support [s].
    """

    first: Foot
    standing: float
    double: float
    single: float

    @classmethod
    def of(cls, config: WholeBodyConfig, first: Foot) -> Stepping:
        """Return the timing that a configuration describes."""
        return cls(first, config.first_double_support, config.double_support, config.single_support)

    @property
    def begin(self) -> float:
        """When the first single support begins [s]."""
        return self.standing + self.double

    @property
    def period(self) -> float:
        """Duration of a step [s]."""
        return self.single + self.double

    def foot(self, index: int) -> Foot:
        """Which foot has the index 0, 1, 2, ..."""
        return self.first if index % 2 == 0 else self.first.other

    def coordinate(self, time: ArrayLike) -> Array:
        """Support coordinate s at times [s]; any shape."""
        t = np.asarray(time, dtype=np.float64)
        step = np.floor((t - self.begin + _EPS) / self.period)
        within = t - self.begin - step * self.period
        walking = step + np.clip((within - self.single) / self.double, 0.0, 1.0)
        starting = np.clip((t - self.standing) / self.double, 0.0, 1.0) - 1.0
        s: Array = np.where(t < self.begin - _EPS, starting, walking)
        nearest = np.round(s)
        return np.where(np.abs(s - nearest) < 1e-6, nearest, s)

    def step(self, time: float) -> int:
        """Index of the foot that carries at a time [s], -1 before the first single support."""
        return -1 if time < self.begin - _EPS else math.floor((time - self.begin + _EPS) / self.period)

    def swing(self, time: float) -> Swing | None:
        """Return the swing at a time [s], None in double support."""
        index = self.step(time)
        if index < 0:
            return None
        elapsed = time - self.begin - index * self.period
        if elapsed >= self.single - _EPS:
            return None
        return Swing(self.foot(index + 1), max(elapsed, 0.0), self.single - elapsed)


@dataclass(frozen=True)
class Preview:
    """Where the CoP may be at t + T .. t + N T, as a function of K footsteps dP: z = V0 + V dP + Z, |Z| <= half.

    Attributes
    ----------
    V : ndarray, shape (N, K)
        Of one axis; both have the same.
    V0 : ndarray, shape (N, 2)
        [m]
    half : ndarray, shape (N, 2)
        Half sizes of the CoP's rectangle (11) [m].
    lower, upper : ndarray, shape (K, 2)
        Bounds of the displacements dP from each foot to the next (12) [m].
    """

    V: Array
    V0: Array
    half: Array
    lower: Array
    upper: Array

    @property
    def steps(self) -> int:
        """K."""
        return int(self.V.shape[1])


def previewed(config: WholeBodyConfig, stepping: Stepping, time: float, places: Mapping[int, Array]) -> Preview:
    """Return the preview at a time.

    Parameters
    ----------
    config : WholeBodyConfig
    stepping : Stepping
    time : float
        [s]
    places : mapping of int to ndarray, shape (2,)
        Where the feet that landed last are, by index; -1 is the middle of both feet before the first step [m].

    Notes
    -----
    While the weight goes over from foot j to j + 1 the rectangle goes over with it, "translated support areas", so
    that the constraints change smoothly as the grid moves.
    """
    base = max(places)
    s = stepping.coordinate(time + config.interval * np.arange(1, config.intervals + 1))
    count = max(math.ceil(s[-1] - base - _EPS), 1)
    V = np.clip(s[:, None] - base - np.arange(count), 0.0, 1.0)
    V0 = np.tile(places[base], (config.intervals, 1))
    if base - 1 in places:
        V0 += np.minimum(s - base, 0.0)[:, None] * (places[base] - places[base - 1])
    standing = np.clip(-s, 0.0, 1.0)[:, None] * [0.0, 0.5 * config.feet_distance]
    half = np.array([0.5 * config.cop_length, 0.5 * config.cop_width]) + standing
    lower, upper = np.empty((count, 2)), np.empty((count, 2))
    lower[:, 0], upper[:, 0] = -config.step_length, config.step_length
    for k in range(count):
        left = stepping.foot(base + 1 + k) is Foot.LEFT
        near, far = config.step_width_min, config.step_width_max
        lower[k, 1], upper[k, 1] = (near, far) if left else (-far, -near)
    if base < 0:  # the first foot stands already
        y = 0.5 * config.feet_distance
        lower[0] = upper[0] = [0.0, y if stepping.first is Foot.LEFT else -y]
    return Preview(V, V0, half, lower, upper)


def swing_acceleration(remaining: float) -> tuple[float, float]:
    """Coefficients (a, b) of the cubic that ends at s_l at rest (16): s'' = a (s_l - s) - b s' [1/s^2, 1/s]."""
    return 6.0 / remaining**2, 4.0 / remaining


def swing_jerk(remaining: float) -> tuple[float, float]:
    """Coefficients (a, b) of its jerk (20): s''' = -a (s_l - s) + b s' [1/s^3, 1/s^2]."""
    return 12.0 / remaining**3, 6.0 / remaining**2
