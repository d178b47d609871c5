"""Where the feet go: footprints beside the body's path, moved to the nearest place the legs can reach."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.kinematics import Kinematics, pose_difference, pose_difference_jacobian
from dqwalk_ros.model import Foot, RobotModel
from dqwalk_ros.standing.phases import flat, posture

__all__ = ["Footsteps"]

Array = NDArray[np.float64]

_LEVER = 0.1
"""What an angle counts beside a distance when the nearest place is looked for [m/rad]."""
_KEPT, _POSTURE = 30.0, 1e-3
"""What is to be kept counts so much more than the nearest place, and the standing posture so much less [m/rad]."""
_UPRIGHT, _FREE = [2, 3, 4], [0, 1, 5]
_FREE_WEIGHT = np.array([1.0, 1.0, _LEVER])
_STEPS, _STILL, _DAMPING = 60, 1e-5, 1e-4
"""Of Levenberg and Marquardt's method, what change of the footprint is none [m], and the least damping."""


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
            self._known[key] = self.reachable(support, self.wanted(support, length, side, turn))
        return self._known[key]

    def wanted(self, support: Foot, length: float, side: float, turn: float) -> Array:
        """Return where the swing sole would land whatever the legs reach, as `step`, shape (8,)."""
        about_z = np.array([math.cos(0.5 * turn), 0.0, 0.0, math.sin(0.5 * turn)])
        moved = DQ.from_pose([length, side, 0.0], about_z)
        return (self._place[support].conj() * moved * self._place[support.other]).vec8()

    def reachable(self, support: Foot, wanted: Array) -> Array:
        """Return the flat pose of the swing sole nearest to `wanted` that the legs reach, shape (8,).

        It is looked for with two postures at once: one with the CoM over the support sole, in which the swing foot
        lands, and one with the CoM over the swing sole, in which the double support after it ends. Levenberg-Marquardt
        from the standing posture; height, roll and pitch, that both agree, and the places of the CoM are kept, the rest
        gives way. A joint at its limit stays there unless it is drawn back in.
        """
        model, n = self._model, self._model.n
        frame = model.soles[support.other].frame
        over = [model.soles[support].center, model.soles[support.other].center]
        q_ref = np.tile(np.clip(self._q_ref, model.q_min, model.q_max), 2)
        low, high = np.tile(model.q_min, 2), np.tile(model.q_max, 2)

        def residual(q: Array) -> tuple[Array, Array]:
            J, e = np.zeros((16 + 2 * n, 2 * n)), np.zeros(16 + 2 * n)
            for k in range(2):
                part, rows = slice(k * n, (k + 1) * n), slice(8 * k, 8 * k + 8)
                kin = Kinematics(model, q[part], support)
                off, turn = pose_difference(kin.pose(frame), wanted), pose_difference_jacobian(kin, frame, wanted)
                center, J_center = over[0], np.zeros((3, n))
                if k == 1:
                    center, J_center = kin.point(frame, over[1]), kin.point_jacobian(frame, over[1])
                com, J_com = (kin.com - center)[:2], (kin.com_jacobian - J_center)[:2]
                e[rows] = np.concatenate([_KEPT * off[_UPRIGHT], _FREE_WEIGHT * off[_FREE], _KEPT * com])
                J[rows, part] = np.concatenate(
                    [_KEPT * turn[_UPRIGHT], _FREE_WEIGHT[:, None] * turn[_FREE], _KEPT * J_com]
                )
            # of the second posture not the place counts, but that it is that of the first
            e[11:14] = _KEPT * (e[11:14] - e[3:6])
            J[11:14, n:] *= _KEPT
            J[11:14, :n] = -_KEPT * J[3:6, :n]
            e[16:] = _POSTURE * (q - q_ref)
            J[16:] = _POSTURE * np.eye(2 * n)
            return e, J

        q, damping = q_ref, _DAMPING
        e, J = residual(q)
        for _ in range(_STEPS):
            gradient = J.T @ e
            stuck = ((q <= low) & (gradient > 0.0)) | ((q >= high) & (gradient < 0.0))
            free = np.flatnonzero(~stuck)
            step = np.zeros(2 * n)
            H = J[:, free].T @ J[:, free]
            step[free] = np.linalg.solve(H + damping * np.eye(len(free)), -gradient[free])
            moved = np.clip(q + step, low, high)
            e_moved, J_moved = residual(moved)
            if e_moved @ e_moved >= e @ e:
                damping *= 10.0
                if damping > 1e6:
                    break
                continue
            done = np.abs(e_moved - e)[:16].max() < _STILL
            q, e, J, damping = moved, e_moved, J_moved, max(0.2 * damping, _DAMPING)
            if done:
                break
        return flat(Kinematics(model, q[:n], support).pose(frame))
