"""Where the feet go: footprints beside the body's path, moved to the nearest place the legs can reach."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.dq import DQ
from dqwalk_ros.kinematics import Kinematics, pose_difference, pose_difference_jacobian
from dqwalk_ros.model import Foot, RobotModel
from dqwalk_ros.phases.standing import flat, posture

__all__ = ["Footsteps"]

Array = NDArray[np.float64]

_LEVER = 0.1
"""What an angle counts beside a distance when the nearest place is looked for [m/rad]."""


class Footsteps:
    """Footprints of a standing walk.

    Parameters
    ----------
    config : Config
    model : RobotModel
    """

    def __init__(self, config: Config, model: RobotModel) -> None:
        self._model = model
        self._q_ref = posture(config, model)
        rest = {
            foot: DQ(Kinematics(model, np.zeros(model.n), foot.other).pose(model.soles[foot].frame)) for foot in Foot
        }
        width = config.gait.step_width
        if width:
            side = {Foot.LEFT: 0.5 * width, Foot.RIGHT: -0.5 * width}
            self._place = {foot: DQ.from_pose([0.0, side[foot], 0.0]) for foot in Foot}
        else:  # as the zero posture has them, seen from halfway between
            half = 0.5 * rest[Foot.LEFT].translation()
            self._place = {Foot.RIGHT: DQ.from_pose(-half), Foot.LEFT: DQ.from_pose(half)}
        self._known: dict[tuple[object, ...], Array] = {}

    def beside(self, support: Foot) -> Array:
        """Return where the other sole stands when the feet are together, in the sole of `support`, shape (8,)."""
        return self.step(support, 0.0, 0.0, 0.0)

    def step(self, support: Foot, length: float, side: float, turn: float) -> Array:
        """Return where the swing sole lands, in the sole of `support`, shape (8,); flat, and within reach.

        The body, halfway between the feet, moves by (length, side) [m] and turns by `turn` [rad]; the swing foot
        comes to its place beside it.
        """
        key = (support, round(length, 6), round(side, 6), round(turn, 6))
        if key not in self._known:
            body = self._place[support].conj()
            about_z = np.array([math.cos(0.5 * turn), 0.0, 0.0, math.sin(0.5 * turn)])
            wanted = body * DQ.from_pose([length, side, 0.0], about_z) * self._place[support.other]
            self._known[key] = self.reachable(support, wanted.vec8())
        return self._known[key]

    def reachable(self, support: Foot, wanted: Array) -> Array:
        """Return the flat pose of the swing sole nearest to `wanted` that the legs reach, shape (8,).

        Gauss-Newton from the standing posture; height, roll and pitch are kept, the rest gives way.
        """
        model = self._model
        frame = model.soles[support.other].frame
        weight = np.array([1.0, 1.0, 30.0, 30.0 * _LEVER, 30.0 * _LEVER, _LEVER])
        q = np.clip(self._q_ref, model.q_min, model.q_max)
        damping = 1e-6 * np.eye(model.n)
        for _ in range(60):
            kin = Kinematics(model, q, support)
            e = weight * pose_difference(kin.pose(frame), wanted)
            J = weight[:, None] * pose_difference_jacobian(kin, frame, wanted)
            step = np.linalg.solve(J.T @ J + damping, -J.T @ e)
            q = np.clip(q + np.clip(step, -0.2, 0.2), model.q_min, model.q_max)
            if np.abs(step).max() < 1e-6:
                break
        return flat(Kinematics(model, q, support).pose(frame))
