"""Finds the initial posture of a walk: soles level, knees bent, CoM over the middle of the soles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from dqwalk_ros.adopt.anatomy import Anatomy
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ModelError

__all__ = ["Standing", "over_one_foot", "stand"]


_BENT = 0.96
"""Distance of hip and ankle as a fraction of the straight leg."""
_MARGIN = 0.05
"""Least distance of joints from their limits [rad]; a tenth of their range if that is less."""
_LEVER = 0.3
"""Lever by which angles are compared with lengths, as a fraction of the leg length [1/rad]."""
_LEAST = 1e-3
"""Largest error of the constraints of a posture, as a fraction of the leg length."""


@dataclass(frozen=True)
class Standing:
    """A standing posture.

    Attributes
    ----------
    q : ndarray, shape (n,)
        Joint angles [rad].
    com : ndarray, shape (3,)
        CoM in the axes of the left sole, relative to the point halfway between both soles [m].
    pelvis : float
        Height of the pelvis [m].
    error : float
        Largest error of the constraints, with angles multiplied by 0.3 leg lengths [m].
    knee : float
        Mean distance of the knees in front of the line from hip to ankle [m].
    """

    q: Array
    com: Array
    pelvis: float
    error: float
    knee: float


def stand(model: RobotModel, anatomy: Anatomy, bent: float = _BENT) -> Standing:
    """Find the standing posture, with the knees in front of the legs if there is such a posture.

    Parameters
    ----------
    model : RobotModel
        Model with the soles of `anatomy`, whose root link has x forward and z up.
    bent : float
        Distance of hip and ankle as a fraction of the straight leg.

    Raises
    ------
    ModelError
        If no posture has both soles level side by side and the CoM over their middle, or a leg has fewer than three
        pitch joints.
    """
    bend, signs = np.zeros(model.n), _axis_signs(model)
    for joints in anatomy.legs.values():
        pitch = list(_pitch(model, joints, anatomy))
        bend[pitch] = np.array([-0.3, 0.6, -0.3]) * signs[pitch]
    found = [_solve(model, anatomy, bent, way * bend) for way in (1.0, -1.0)]
    good = [one for one in found if one.error < _LEAST * max(anatomy.leg, 0.2)]
    if not good:
        best = min(found, key=lambda one: one.error)
        raise ModelError(
            f"no posture was found with both soles level, {1e3 * anatomy.apart:.0f} mm apart, and the CoM over their "
            f"middle: the error of the best posture is {1e3 * best.error:.1f} mm"
        )
    # prefer knees in front of the legs, then the smaller angles
    return max(good, key=lambda one: (one.knee > 0.0, -float(np.abs(one.q).sum())))


def over_one_foot(model: RobotModel, anatomy: Anatomy, standing: Standing, foot: Foot) -> tuple[Array, float]:
    """Return a posture (n,) [rad] with the CoM over one sole and both soles level, and its largest error [m]."""
    y = 0.0 if foot is Foot.LEFT else -anatomy.apart
    best = _solve(model, anatomy, _BENT, standing.q, com=(0.0, y), free_pelvis=True)
    return best.q, best.error


def _pitch(model: RobotModel, joints: Sequence[str], anatomy: Anatomy) -> tuple[int, int, int]:
    """Return the indices of hip, knee and ankle: the first, the middle and the last pitch joint."""
    index = {name: k for k, name in enumerate(model.joint_names)}
    pitch = [name for name, kind in zip(joints, anatomy.kinds, strict=True) if kind == "P"]
    if len(pitch) < 3:
        raise ModelError(f"a leg has {len(pitch)} pitch joints ({', '.join(pitch)}); hip, knee and ankle are required")
    return index[pitch[0]], index[pitch[len(pitch) // 2]], index[pitch[-1]]


def _solve(
    model: RobotModel,
    anatomy: Anatomy,
    bent: float,
    start: Array,
    com: tuple[float, float] | None = None,
    free_pelvis: bool = False,
) -> Standing:
    links = {body.joint: link for body, link in zip(model.bodies, model.links, strict=True)}
    legs = {foot: [links[k] for k in _pitch(model, joints, anatomy)] for foot, joints in anatomy.legs.items()}
    zero, straight = Kinematics(model, np.zeros(model.n), Foot.LEFT), {}
    for foot, leg in legs.items():
        a, b, c = map(zero.point, leg)
        straight[foot] = float(np.linalg.norm(b - a) + np.linalg.norm(c - b))
    margin = np.minimum(_MARGIN, 0.1 * (model.q_max - model.q_min))
    low, high = model.q_min + margin, model.q_max - margin
    wanted = (0.0, -0.5 * anatomy.apart) if com is None else com
    right = model.soles[Foot.RIGHT].frame
    lever = _LEVER * anatomy.leg
    place = np.array([0.0, -anatomy.apart, 0.0])
    rest = start if free_pelvis else np.zeros(model.n)

    def constraints(q: Array) -> Array:
        kin = Kinematics(model, q, Foot.LEFT)
        other = DQ(kin.pose(right))
        root = DQ(kin.pose(model.root))
        upright = np.zeros(0) if free_pelvis else lever * root.rotation_vector()
        tilt = lever * other.rotation_vector()
        return np.concatenate([other.translation() - place, tilt, upright, kin.com[:2] - wanted])

    def residual(q: Array) -> Array:
        kin = Kinematics(model, q, Foot.LEFT)
        longer = [
            float(np.linalg.norm(kin.point(hip) - kin.point(ankle))) - bent * straight[foot]
            for foot, (hip, _, ankle) in legs.items()
        ]
        return np.concatenate([constraints(q), 0.3 * np.array(longer), 1e-3 * anatomy.leg * (q - rest)])

    first = np.clip(start, low + 1e-3, high - 1e-3)
    q = least_squares(residual, first, bounds=(low, high), xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=200).x
    # satisfy the constraints exactly, near the solution of the weighted problem
    for _ in range(3):
        q = least_squares(
            lambda x, q0=q: np.concatenate([constraints(x), 1e-4 * (x - q0)]), q, bounds=(low, high), max_nfev=50
        ).x
    kin = Kinematics(model, q, Foot.LEFT)
    middle = np.array([0.0, 0.5 * anatomy.apart, 0.0])
    knees = []
    for leg in legs.values():
        a, b, c = map(kin.point, leg)
        share = (b[2] - c[2]) / max(a[2] - c[2], 1e-6)
        knees.append(b[0] - (c[0] + share * (a[0] - c[0])))
    return Standing(
        q=q,
        com=kin.com + middle,
        pelvis=float(kin.point(model.pelvis)[2]),
        error=float(np.abs(constraints(q)).max()),
        knee=float(np.mean(knees)),
    )


def _axis_signs(model: RobotModel) -> Array:
    """Return 1 for joints whose axis points to the left in the zero posture, else -1, shape (n,)."""
    kin = Kinematics(model, np.zeros(model.n), Foot.LEFT)
    y = {body.joint: kin.direction(link, body.axis)[1] for body, link in zip(model.bodies, model.links, strict=True)}
    return np.where(np.array([y[k] for k in range(model.n)]) < 0.0, -1.0, 1.0)
