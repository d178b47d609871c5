"""Does the drive still do what the controller is told of it? Its delay and stiffness, from the walk itself.

Joints follow the integral S of the commanded velocities u a delay T later. With torques e that are fed forward by the
stiffness K they are told to have,

    q(t) - S(t - T) = const. + (1/K - 1/K_true) e(t - T) - (T_true - T) u(t - T)

of which the constant drops out of differences over a short time; the rest is a least-squares problem per joint that
forgets. What backlash and friction take from the stiffness they take at the beginning of a walk, too.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.servos import Drive

__all__ = ["DriveWatch"]

Array = NDArray[np.float64]

_EVERY, _SPAN, _FORGET = 0.02, 0.2, 10.0
"""Time between two samples, between those that are subtracted, and after which one counts less [s]."""
_LEARNED = 15.0
"""The stiffness at this time of a walk is the one that it is compared with later [s]."""
DELAYED, SAGGED = 0.015, 0.88
"""A delay this much beyond what is told [s], and this part of the stiffness at the beginning, are worth a warning."""


class DriveWatch:
    """Compares what joints did with what they were told, state by state.

    Parameters
    ----------
    drive : Drive
        What the controller is told.

    Attributes
    ----------
    delay : float
        By how much the delay is longer than told [s]; nan before it is known.
    stiffness : float
        As a part of the told one; nan before it is known.
    """

    def __init__(self, drive: Drive) -> None:
        self._drive, n = drive, drive.stiffness.size
        self.delay = self.stiffness = self._first = math.nan
        self._sum, self._u, self._began = np.zeros(n), np.zeros(n), math.nan
        self._time = self._sampled = math.nan
        self._sent: deque[tuple[float, Array]] = deque()  # S, e and u (3, n), over the delay
        self._seen: deque[tuple[float, Array]] = deque()  # q - S, e and u (3, n), over the span
        self._products = np.zeros((3, 3, n))

    def add(self, time: float, q: Array, velocity: Array, effort: Array) -> None:
        """Take a state at `time` [s], its command [rad/s] and the torques fed forward [N m], shape (n,) each."""
        if not 0.0 <= time - self._time < 5.0 * _SPAN:  # the first one, or after a silence
            self._sent.clear()
            self._seen.clear()
            self._sampled, self._time = -math.inf, time
            self._began = time if math.isnan(self._began) else self._began
        self._sum = self._sum + (time - self._time) * self._u
        self._time, self._u = time, velocity
        if time - self._sampled < _EVERY - 1e-9:
            return
        self._sampled = time
        self._sent.append((time, np.array([self._sum, effort, velocity])))
        then = time - self._drive.delay
        while len(self._sent) > 1 and self._sent[1][0] <= then:
            self._sent.popleft()
        if len(self._sent) < 2 or self._sent[0][0] > then:
            return
        (t0, before), (t1, after) = self._sent[0], self._sent[1]
        told = before + (then - t0) / (t1 - t0) * (after - before)
        told[0] = q - told[0]
        self._seen.append((time, told))
        if time - self._seen[0][0] < _SPAN - 1e-9:
            return
        d = told - self._seen.popleft()[1]
        self._products = math.exp(-_EVERY / _FORGET) * self._products + d[:, None] * d[None]
        if time - self._began > _FORGET:
            self._solve()
            if math.isnan(self._first) and time - self._began > _LEARNED:
                self._first = self.stiffness

    def warnings(self) -> list[str]:
        """Return what does not hold any more, with the number."""
        out = []
        if self.delay > DELAYED:
            out.append(f"the drive is {1e3 * self.delay:.0f} ms later than servo.assumed_* say")
        if self.stiffness < SAGGED * self._first:
            out.append(
                f"the servos have {100.0 * self.stiffness / self._first:.0f} % of the stiffness of the beginning"
            )
        return out

    def _solve(self) -> None:
        """Combine the joints, each by how much its motion and its torque say of either."""
        (_, ye, yu), (_, ee, eu), (_, _, uu) = self._products
        det = np.maximum(ee * uu - eu * eu, 1e-30)
        softer, later = (ye * uu - yu * eu) / det, -(yu * ee - ye * eu) / det
        K = self._drive.stiffness
        of_u, of_e = det / np.maximum(ee, 1e-12), det / np.maximum(uu, 1e-12) / np.maximum(K, 1e-3) ** 2
        self.delay = float(of_u @ later / max(of_u.sum(), 1e-30))
        self.stiffness = 1.0 / max(1.0 - float(of_e @ (K * softer) / max(of_e.sum(), 1e-30)), 0.05)
