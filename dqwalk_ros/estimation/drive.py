"""Online identification of the drive's delay and stiffness, to detect deviations from the model of the controller.

The joints follow the integral S of the commanded velocities u with a delay T. With torques e that are fed forward by
the assumed stiffness K,

    q(t) - S(t - T) = const. + (1/K - 1/K_true) e(t - T) - (T_true - T) u(t - T)

Differences over a short time eliminate the constant; the other two terms are estimated for each joint by recursive
least squares with exponential forgetting. Backlash and friction reduce the apparent stiffness, so it is compared with
that at the beginning of the walk.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from dqwalk_ros.robot.servos import Drive
from dqwalk_ros.support.arrays import Array

__all__ = ["DriveWatch"]


_EVERY, _SPAN, _FORGET = 0.02, 0.2, 10.0
"""Sampling period, time over which differences are taken, and time constant of the forgetting [s]."""
_LEARNED = 15.0
"""Time of the walk at which the reference value of the stiffness is taken [s]."""
DELAYED, SAGGED = 0.015, 0.88
"""Limits of the warnings: delay beyond the assumed one [s], and ratio of the stiffness to its reference value."""


class DriveWatch:
    """Estimates delay and stiffness of the drive from measured angles and commands.

    Parameters
    ----------
    drive : Drive
        Model of the drive that the controller uses.

    Attributes
    ----------
    delay : float
        Difference of the true from the assumed delay [s]; nan before the first estimate.
    stiffness : float
        Ratio of the true to the assumed stiffness; nan before the first estimate.
    """

    def __init__(self, drive: Drive) -> None:
        self._drive, n = drive, drive.stiffness.size
        self.delay = self.stiffness = self._reference = math.nan
        self._sum, self._u, self._began = np.zeros(n), np.zeros(n), math.nan
        self._time = self._sampled = math.nan
        self._commands: deque[tuple[float, Array]] = deque()  # S, e and u (3, n), over the delay
        self._samples: deque[tuple[float, Array]] = deque()  # q - S, e and u (3, n), over the span
        self._products = np.zeros((3, 3, n))

    def add(self, time: float, q: Array, velocity: Array, effort: Array) -> None:
        """Add the angles at `time` [s], the command [rad/s] and the feedforward torques [N m], shape (n,) each."""
        if not 0.0 <= time - self._time < 5.0 * _SPAN:  # the first state, or the first one after an interruption
            self._commands.clear()
            self._samples.clear()
            self._sampled, self._time = -math.inf, time
            self._began = time if math.isnan(self._began) else self._began
        self._sum = self._sum + (time - self._time) * self._u
        self._time, self._u = time, velocity
        if time - self._sampled < _EVERY - 1e-9:
            return
        self._sampled = time
        self._commands.append((time, np.array([self._sum, effort, velocity])))
        delayed = time - self._drive.delay
        while len(self._commands) > 1 and self._commands[1][0] <= delayed:
            self._commands.popleft()
        if len(self._commands) < 2 or self._commands[0][0] > delayed:
            return
        (t0, before), (t1, after) = self._commands[0], self._commands[1]
        sample = before + (delayed - t0) / (t1 - t0) * (after - before)
        sample[0] = q - sample[0]
        self._samples.append((time, sample))
        if time - self._samples[0][0] < _SPAN - 1e-9:
            return
        d = sample - self._samples.popleft()[1]
        self._products = math.exp(-_EVERY / _FORGET) * self._products + d[:, None] * d[None]
        if time - self._began > _FORGET:
            self._solve()
            if math.isnan(self._reference) and time - self._began > _LEARNED:
                self._reference = self.stiffness

    def warnings(self) -> list[str]:
        """Return a message for each quantity that exceeds its limit, with its value."""
        out = []
        if self.delay > DELAYED:
            out.append(f"the drive is {1e3 * self.delay:.0f} ms later than servo.assumed_* say")
        if self.stiffness < SAGGED * self._reference:
            out.append(
                f"the servos have {100.0 * self.stiffness / self._reference:.0f} % of the stiffness of the beginning"
            )
        return out

    def _solve(self) -> None:
        """Set `delay` and `stiffness` to the means over the joints, weighted by the information of each joint."""
        (_, ye, yu), (_, ee, eu), (_, _, uu) = self._products
        det = np.maximum(ee * uu - eu * eu, 1e-30)
        softer, later = (ye * uu - yu * eu) / det, -(yu * ee - ye * eu) / det
        K = self._drive.stiffness
        of_u, of_e = det / np.maximum(ee, 1e-12), det / np.maximum(uu, 1e-12) / np.maximum(K, 1e-3) ** 2
        self.delay = float(of_u @ later / max(of_u.sum(), 1e-30))
        self.stiffness = 1.0 / max(1.0 - float(of_e @ (K * softer) / max(of_e.sum(), 1e-30)), 0.05)
