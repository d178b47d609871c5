"""Decides whether a controller uses measured joint velocities."""

from __future__ import annotations

import numpy as np

from dqwalk_ros.nodes.watchdog import FaultCounter
from dqwalk_ros.support.arrays import Array


class VelocityGate:
    """Decides whether measured joint velocities are used: their integral must be the motion of the angles.

    Those in another unit, of the other sign, or always zero would unbalance the robot, which walks as well without.

    Parameters
    ----------
    joint_names : tuple of str
        The n joints.
    limit : int
        Consecutive windows with a wrong integral after which velocities are not used until `reset`.

    Attributes
    ----------
    wrong : FaultCounter
    """

    window = 0.1
    """Time over which velocities are integrated [s]."""
    slack, part = 0.02, 0.7
    """Accepted norm of the difference from the motion [rad], and its part of the larger one of both."""
    shows = 0.1
    """Norm of the motion in a window from which on it shows that velocities are right: at rest zeros are, too [rad]."""

    def __init__(self, joint_names: tuple[str, ...], limit: int) -> None:
        self._names, self.wrong = joint_names, FaultCounter(limit)
        self.reset()

    def reset(self) -> None:
        """Use velocities until they are wrong."""
        self.wrong.reset()
        self._q: Array | None = None  # at the beginning of the window
        self._dq = self._integral = np.zeros(len(self._names))  # of the last state; since the beginning [rad]
        self._time = 0.0  # since then [s]
        self._doubted = False  # from a wrong integral on, until a window shows that they are right

    def use(self, q: Array, dq: Array | None, passed: float) -> Array | None:
        """Return the velocities (n,) [rad/s] at the angles `q` (n,), `passed` [s] after the last ones, or None.

        They are not used as soon as their integral is wrong, in the middle of a window, too: a robot that is balanced
        by them falls before `wrong` is sure.
        """
        if dq is None:
            return None
        if self._q is None:
            self._q, self._integral, self._time = q, np.zeros(len(q)), 0.0
        else:
            self._integral = self._integral + 0.5 * passed * (self._dq + dq)
            self._time += passed
            moved = q - self._q
            most = max(float(np.linalg.norm(moved)), float(np.linalg.norm(self._integral)))
            fits = float(np.linalg.norm(self._integral - moved)) <= self.slack + self.part * most
            over = self._time > self.window - 1e-9
            self._doubted = not fits or (self._doubted and not (over and most > self.shows))
            if over:
                self._judge(moved, fits=fits)
                self._q, self._integral, self._time = q, np.zeros(len(q)), 0.0
        self._dq = dq
        return None if self.wrong or self._doubted else dq

    def _judge(self, moved: Array, *, fits: bool) -> None:
        """Count a window in which the joints moved by (n,) [rad]."""
        if fits:
            self.wrong.good()
            return
        k = int(np.abs(self._integral - moved).argmax())
        self.wrong.fault(
            "the velocities of joint_states are not those of the angles, and are not used until ~/reset: "
            f"{self._names[k]} turned by {moved[k]:.3g} rad in {self._time:.2g} s, "
            f"and by {self._integral[k]:.3g} rad at its velocity; is that in rad/s?"
        )
