"""Online identification of the drive's delay and stiffness during a walk.

The joints follow the integral S of the commanded velocities u with a delay T, and the torques e that are fed forward by
the assumed stiffness K. Friction and backlash f let a joint lag by an angle that changes its sign with the motion:

    q(t) - S(t - T) = const. + (1/K - 1/K_true) e(t - T) - (T_true - T) u(t - T) - (f/K) sign(u(t - T))

Differences over a short time eliminate the constant; the other terms are estimated for each joint by recursive least
squares with exponential forgetting while it moves. The delay is the median of the joints, so that one that is blocked
does not count, and replaces the assumed one as far as the motion has shown it, and where the difference is more than
the sampling leaves open. Backlash and friction reduce the apparent stiffness, so it is compared with that at the
beginning of the walk.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np

from dqwalk_ros.robot.servos import Drive
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit

_EVERY, _SPAN, _FORGET = 0.02, 0.2, 10.0
"""Sampling period, time over which differences are taken, and time constant of the forgetting [s]."""
_FADE = math.exp(-_EVERY / _FORGET)
_SOLVE = 0.1
"""Period in which the equations are solved [s]."""
_SIGN = 0.1
"""Velocity at which the friction has three quarters of its torque [rad/s]."""
_MOVES = 0.05
"""Largest velocity of a robot that stands still, and forgets nothing [rad/s]."""
_HELD = 0.9
"""S is ahead of the angles by this part of the period in which a goal is held: 1 in its middle, 0.5 at its end."""
_PRIOR = 30.0
"""Information that shows half of a deviation, the sum of the squares of changes of velocity [rad^2/s^2]."""
_NOISE = 0.005
"""Error above which the equations do not explain the angles: a joint is blocked, or its goal is clamped [rad]."""
_LEAST, _STEP, _MOST = 0.005, 0.002, 0.05
"""Least deviation of the delay that is corrected first, if it is more than half of a period, and then; and the largest
one [s]."""
_TINY = 1e-9
"""What is added to the sums of squares, so that a joint at rest has a solution."""
_LEARNED = 15.0
"""Time of the walk at which the reference value of the stiffness is taken [s]."""
_DELAYED, _SAGGED = 0.015, 0.88
"""Limits of the warnings: delay beyond the assumed one [s], and ratio of the stiffness to its reference value."""


class DriveWatch:
    """Estimates delay and stiffness of the drive from measured angles and commands.

    Parameters
    ----------
    assumed : Drive
        Model of the drive that the parameters describe.

    Attributes
    ----------
    drive : Drive
        The model with the delay that was learned.
    delay : float
        Difference of the true from the assumed delay [s]; nan before the first estimate.
    """

    def __init__(self, assumed: Drive) -> None:
        self.drive = self._assumed = assumed
        self._period, n = 0.0, assumed.stiffness.size
        self.delay = self._reference = math.nan
        self._T = assumed.delay  # of the differences q - S
        self._time = self._since = math.nan
        self._commands: deque[tuple[float, Array]] = deque()  # S and e (2, n), over the delay
        self._samples: deque[tuple[float, Array]] = deque()  # q - S, u, sign and e (4, n), over the span
        self._products, self._count, self._solved = np.zeros((n, 4, 4)), 0.0, -math.inf

    def add(self, time: float, q: Array, motion: Array, effort: Array | None, dt: float) -> None:
        """Add a state and the torques of the command that answers it.

        Parameters
        ----------
        time : float
            Time of the state [s].
        q, motion : ndarray, shape (n,)
            Its angles, and S before the command that answers it [rad].
        effort : ndarray, shape (n,), or None
            Torques that are fed forward [N m].
        dt : float
            Period for which the command holds [s].
        """
        if not 0.0 <= time - self._time < 5.0 * _SPAN:  # the first state, or the first one after an interruption
            self.interrupt()
            self._since = time if math.isnan(self._since) else self._since
        elif time - self._time < _EVERY - 1e-9:
            return
        self._time, self._period = time, dt
        self._commands.append((time, np.array([motion, np.zeros_like(q) if effort is None else effort])))
        delayed = time - self._T
        while len(self._commands) > 2 and self._commands[1][0] <= delayed:
            self._commands.popleft()
        if len(self._commands) < 2 or self._commands[0][0] > delayed:
            return
        (t0, before), (t1, after) = self._commands[0], self._commands[1]
        sample = _sampled(q, before, after, delayed - t0, t1 - t0)
        self._samples.append((time, sample))
        if time - self._samples[0][0] < _SPAN - 1e-9:
            return
        kept = _accumulate(self._products, sample, self._samples.popleft()[1])
        self._count = kept * self._count + 1.0
        if time - self._solved > _SOLVE - 1e-9:
            self._solved = time
            self._solve()

    def interrupt(self) -> None:
        """Compare the states that follow with no earlier one, because commands or angles were interrupted."""
        self._commands.clear()
        self._samples.clear()
        self._time = math.nan

    @property
    def stiffness(self) -> float:
        """Ratio of the true to the assumed stiffness; nan before the first estimate."""
        if not self._solved - self._since > _FORGET:
            return math.nan
        K = self._assumed.stiffness
        (_, _, softer), (_, _, known) = _fitted(self._products, 4, self._count)
        weights = known / np.maximum(K, 1e-3) ** 2
        return 1.0 / max(1.0 - float(weights @ (K * softer) / weights.sum()), 0.05)

    def warnings(self) -> list[str]:
        """Return a message for each quantity that exceeds its limit, with its value."""
        out = []
        if self.delay > _DELAYED:
            more = f"add {1e3 * self.delay:.0f} ms to servo.assumed_latency"
            out.append(f"the drive is {1e3 * self.delay:.0f} ms later than servo.assumed_* state; {more}")
        if (ratio := self.stiffness / self._reference) < _SAGGED:
            out.append(f"the servos have {100.0 * ratio:.0f} % of the stiffness of the beginning")
        return out

    def _solve(self) -> None:
        """Set `drive`, and after some time of walking `delay` and the reference of the stiffness."""
        (later, _), (known, _) = _fitted(self._products, 3, self._count)
        true, walked = self._T - _median(later, known) + _HELD * self._period, self._solved - self._since
        if walked > _FORGET:
            self.delay = true - self._assumed.delay
        if walked > _LEARNED and math.isnan(self._reference):
            self._reference = self.stiffness
        self._learn(true, float(known.sum()))

    def _learn(self, true: float, known: float) -> None:
        """Use the delay that was found [s], as far as the information `known` shows it; forget what led to it."""
        now, assumed = self.drive.delay, self._assumed.delay
        least = _STEP if self.drive is not self._assumed else max(_LEAST, 0.5 * self._period)
        delay = now + (true - now) * known / (known + _PRIOR)
        delay = min(max(delay, assumed - _MOST, 0.0), assumed + _MOST)
        if abs(delay - now) > least:
            self.drive, self._T = replace(self._assumed, delay=delay), max(delay - _HELD * self._period, 0.0)
            self.delay, self._reference, self._since = delay - assumed, math.nan, self._time
            self._products[:], self._count = 0.0, 0.0
            self._samples.clear()


@jit
def _sampled(q: Array, before: Array, after: Array, passed: float, period: float) -> Array:
    """Return q - S, u, its sign and e (4, n), a time `passed` after `before`, of a period to `after` [s].

    S and e are the rows of `before` and `after` (2, n), and q (n,) are the angles.
    """
    rate = (after - before) / period
    then, sample = before + passed * rate, np.empty((4, q.shape[0]))
    sample[0], sample[1], sample[2], sample[3] = q - then[0], rate[0], np.tanh(rate[0] / _SIGN), then[1]
    return sample


@jit
def _accumulate(products: Array, sample: Array, before: Array) -> float:
    """Add the products (n, 4, 4) of the changes of a sample (4, n) since `before`; return what is kept of earlier ones.

    That is all of them while the robot stands still.
    """
    kept, d = _FADE if np.abs(sample[1]).max() > _MOVES else 1.0, sample - before
    for i in range(d.shape[1]):
        for j in range(d.shape[0]):
            for k in range(d.shape[0]):
                products[i, j, k] = kept * products[i, j, k] + d[j, i] * d[k, i]
    return kept


@jit
def _fitted(products: Array, size: int, count: float) -> tuple[Array, Array]:
    """Return the coefficients with which other quantities explain the first one, and the information on each.

    Parameters
    ----------
    products : ndarray, shape (n, k, k)
        Sums of the products of the quantities, for each joint.
    size : int
        Number of the quantities that are used, from the first on.
    count : float
        Number of products.

    Returns
    -------
    coefficients, information : ndarray, shape (size - 1, n)
        The information is less where the first quantity is not explained.
    """
    n, m = products.shape[0], size - 1
    coefficients, information, inverse = np.zeros((m, n)), np.empty((m, n)), np.empty((m, m))
    for i in range(n):
        P, left = products[i], products[i, 0, 0]
        inverse[:] = P[1:size, 1:size]
        _invert(inverse)
        for j in range(m):
            for k in range(m):
                coefficients[j, i] += inverse[j, k] * P[k + 1, 0]
            left -= coefficients[j, i] * P[j + 1, 0]
        explained = min(_NOISE**2 / max(left / count, 1e-12), 1.0)
        for j in range(m):
            information[j, i] = explained / inverse[j, j]
    return coefficients, information


@jit
def _invert(A: Array) -> None:
    """Invert a symmetric, positive matrix (m, m), to which a little is added (Gauss and Jordan)."""
    for j in range(A.shape[0]):
        A[j, j] += _TINY
    for j in range(A.shape[0]):
        pivot = A[j, j]
        A[j, j] = 1.0
        A[j] /= pivot
        for i in range(A.shape[0]):
            if i != j:
                factor = A[i, j]
                A[i, j] = 0.0
                A[i] -= factor * A[j]


@jit
def _median(values: Array, weights: Array) -> float:
    """Return the median of values (n,) with weights (n,): the least one up to which there is half of the weight."""
    median, half = math.inf, 0.5 * weights.sum()
    for value in values:
        below = 0.0
        for i in range(values.shape[0]):
            if values[i] <= value:
                below += weights[i]
        if below >= half:
            median = min(median, value)
    return median
