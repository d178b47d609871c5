"""Decides which measured states of the whole body a controller accepts."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from dqwalk_ros.nodes.state_gate import StateGate
from dqwalk_ros.paper.state import State
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import StateError


class BodyGate(StateGate):
    """Decides which states of the whole body, joints and base, a controller accepts.

    Time is measured by the stamps. A push or a touchdown can accelerate the joints beyond the limits of the motors, so
    joint velocities up to `fast` times their limits are accepted.
    """

    may_repeat = True
    fast = 3.0
    """Largest accepted joint velocity, in units of its limit."""
    speed, turn = 10.0, 30.0
    """Largest accepted velocities of the base [m/s, rad/s]."""

    def __init__(self, model: RobotModel, dt: float, timeout: Callable[[], float], **options: Any) -> None:
        able = dataclasses.replace(model, velocity_max=self.fast * model.velocity_max)
        super().__init__(able, dt, timeout, **{**options, "by_stamp": True})

    def reset(self) -> None:
        """Accept any state next, as the first one."""
        super().reset()
        self._place: Array | None = None

    def accept_body(self, stamp: int, state: State, place: Array, v_base: Array) -> None:
        """Accept a state, or raise an error and change nothing.

        Parameters
        ----------
        stamp : int
            [ns]
        state : State
            With the velocities of the joints.
        place : ndarray, shape (3,)
            Of the base [m].
        v_base : ndarray, shape (6,)
            [m/s, rad/s]

        Raises
        ------
        StateError
            If a number is not finite, a velocity is too large, or joints or base jumped.
        """
        assert state.dq is not None
        if not all(np.isfinite(part).all() for part in (state.q, state.dq, place, v_base)):
            raise StateError("a number is not finite")
        if self.velocities.wrong:  # no torque follows from angles alone
            raise self._reject(self.velocities.wrong.reason)
        for does, rates, most, unit in (
            ("moves", v_base[:3], self.speed, "m/s"),
            ("turns", v_base[3:], self.turn, "rad/s"),
        ):
            if not (fastest := float(np.abs(rates).max())) <= most:
                raise self._reject(f"the base {does} at {fastest:.3g} {unit}")
        if self._place is not None and not self.impossible:
            moved = float(np.linalg.norm(place - self._place))
            if not moved <= self.speed * (max((stamp - self._stamp) * 1e-9, 0.0) + self._dt):
                raise self._reject(f"the base jumped by {moved:.3g} m")
        self.accept(stamp, state)
        self._place = place
