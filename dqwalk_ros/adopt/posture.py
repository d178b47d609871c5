"""The posture in which a biped stands ready to walk: soles level, knees bent, CoM over the middle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from dqwalk_ros.adopt.anatomy import Anatomy
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import ModelError
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.robot import Foot, RobotModel

__all__ = ["Standing", "over_one_foot", "stand"]

Array = NDArray[np.float64]

_BENT = 0.96
"""Distance of hip and ankle as a part of the straight leg."""
_MARGIN = 0.05
"""Joints keep this distance from their limits [rad], or a tenth of their range where that is less."""
_LEVER = 0.3
"""What an angle counts beside a length, in legs per radian."""
_LEAST = 1e-3
"""A posture is found when all that it must keep is off by no more than this [m, of a leg of 1 m]."""


@dataclass(frozen=True)
class Standing:
    """A standing posture.

    Attributes
    ----------
    q : ndarray, shape (n,)
        [rad]
    width : float
        Lateral distance of the soles' centres [m].
    com : ndarray, shape (3,)
        In the left sole's frame, shifted to halfway between both soles [m].
    pelvis : float
        Height of the pelvis [m].
    error : float
        What is off, largest length or angle times 0.3 legs [m].
    knee : float
        How far the knees are ahead of the line from hip to ankle [m].
    """

    q: Array
    width: float
    com: Array
    pelvis: float
    error: float
    knee: float


def stand(model: RobotModel, anatomy: Anatomy, width: float, bent: float = _BENT) -> Standing:
    """Find the standing posture.

    Parameters
    ----------
    model : RobotModel
        Its soles are those of `anatomy`; its root link has x ahead and z up.
    anatomy : Anatomy
    width : float
        Lateral distance of the soles' centres [m].
    bent : float
        Distance of hip and ankle as a part of the straight leg.

    Raises
    ------
    ModelError
        If no posture has both soles level side by side and the CoM over their middle.
    """
    pitches = {foot: _pitch(model, joints, anatomy) for foot, joints in anatomy.legs.items()}
    found = []
    turns = _turns(model)
    for way in (1.0, -1.0):
        start = np.zeros(model.n)
        for pitch in pitches.values():
            start[list(pitch)] = way * np.array([-0.3, 0.6, -0.3]) * turns[list(pitch)]
        found.append(_solve(model, anatomy, width, bent, pitches, start))
    good = [one for one in found if one.error < _LEAST * max(anatomy.leg, 0.2)]
    if not good:
        best = min(found, key=lambda one: one.error)
        raise ModelError(
            f"no posture was found with both soles level, {1e3 * width:.0f} mm apart, and the CoM over their middle: "
            f"the best one is off by {1e3 * best.error:.1f} mm"
        )
    # knees ahead where both ways serve alike; else the way they bend
    return max(good, key=lambda one: (one.knee > 0.0, -float(np.abs(one.q).sum())))


def over_one_foot(model: RobotModel, anatomy: Anatomy, standing: Standing, foot: Foot) -> tuple[Array, float]:
    """Return a posture (n,) with the CoM over one sole, both soles level, and how far off it is at best [m]."""
    pitches = {side: _pitch(model, joints, anatomy) for side, joints in anatomy.legs.items()}
    y = 0.0 if foot is Foot.LEFT else -standing.width
    best = _solve(model, anatomy, standing.width, _BENT, pitches, standing.q, com=(0.0, y), free_pelvis=True)
    return best.q, best.error


def _pitch(model: RobotModel, joints: Sequence[str], anatomy: Anatomy) -> tuple[int, int, int]:
    """Return the indices of hip, knee and ankle: the first, the middle and the last joint that pitch."""
    index = {name: k for k, name in enumerate(model.joint_names)}
    pitch = [name for name, kind in zip(joints, anatomy.kinds, strict=True) if kind == "P"]
    if len(pitch) < 3:
        raise ModelError(
            f"the legs have {len(pitch)} joints that pitch ({', '.join(pitch)}); hip, knee and ankle are needed"
        )
    return index[pitch[0]], index[pitch[len(pitch) // 2]], index[pitch[-1]]


def _solve(
    model: RobotModel,
    anatomy: Anatomy,
    width: float,
    bent: float,
    pitches: Mapping[Foot, tuple[int, int, int]],
    start: Array,
    com: tuple[float, float] | None = None,
    free_pelvis: bool = False,
) -> Standing:
    names = model.joint_names
    bodies = {foot: [names[k] for k in pitch] for foot, pitch in pitches.items()}
    frames = _joint_frames(model)
    straight = {}
    for foot, (hip, knee, ankle) in bodies.items():
        kin = Kinematics(model, np.zeros(model.n), Foot.LEFT)
        p = [kin.point(frames[name]) for name in (hip, knee, ankle)]
        straight[foot] = float(np.linalg.norm(p[1] - p[0]) + np.linalg.norm(p[2] - p[1]))
    margin = np.minimum(_MARGIN, 0.1 * (model.q_max - model.q_min))
    low, high = model.q_min + margin, model.q_max - margin
    wanted = (0.0, -0.5 * width) if com is None else com
    right = model.soles[Foot.RIGHT].frame
    lever = _LEVER * anatomy.leg
    place = np.array([0.0, -width, 0.0])
    rest = start if free_pelvis else np.zeros(model.n)

    def kept(q: Array) -> Array:
        kin = Kinematics(model, q, Foot.LEFT)
        other = DQ(kin.pose(right))
        root = DQ(kin.pose(model.root))
        upright = np.zeros(0) if free_pelvis else lever * _turn(root)
        return np.concatenate([other.translation() - place, lever * _turn(other), upright, kin.com[:2] - wanted])

    def residual(q: Array) -> Array:
        kin = Kinematics(model, q, Foot.LEFT)
        legs = [
            float(np.linalg.norm(kin.point(frames[hip]) - kin.point(frames[ankle]))) - bent * straight[foot]
            for foot, (hip, _, ankle) in bodies.items()
        ]
        return np.concatenate([kept(q), 0.3 * np.array(legs), 1e-3 * anatomy.leg * (q - rest)])

    first = np.clip(start, low + 1e-3, high - 1e-3)
    q = least_squares(residual, first, bounds=(low, high), xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=200).x
    # what must be kept is kept exactly; the rest gave its place
    for _ in range(3):
        q = least_squares(
            lambda x, q0=q: np.concatenate([kept(x), 1e-4 * (x - q0)]), q, bounds=(low, high), max_nfev=50
        ).x
    kin = Kinematics(model, q, Foot.LEFT)
    middle = np.array([0.0, 0.5 * width, 0.0])
    knees = []
    for hip, knee, ankle in bodies.values():
        a, b, c = (kin.point(frames[name]) for name in (hip, knee, ankle))
        share = (b[2] - c[2]) / max(a[2] - c[2], 1e-6)
        knees.append(b[0] - (c[0] + share * (a[0] - c[0])))
    return Standing(
        q=q,
        width=width,
        com=kin.com + middle,
        pelvis=float(kin.point(model.pelvis)[2]),
        error=float(np.abs(kept(q)).max()),
        knee=float(np.mean(knees)),
    )


def _turns(model: RobotModel) -> Array:
    """Return 1 for joints that turn about the left, -1 for those about the right, in the zero posture, shape (n,)."""
    kin = Kinematics(model, np.zeros(model.n), Foot.LEFT)
    frames = _joint_frames(model)
    axes = {body.joint: body.axis for body in model.bodies}
    y = [kin.direction(frames[name], axes[k])[1] for k, name in enumerate(model.joint_names)]
    return np.where(np.array(y) < 0.0, -1.0, 1.0)


def _joint_frames(model: RobotModel) -> dict[str, str]:
    """Return a frame at each joint: the link that it carries."""
    first: dict[int, str] = {}
    for name, frame in model.frames.items():
        first.setdefault(frame.body, name)
    return {model.joint_names[body.joint]: first[k] for k, body in enumerate(model.bodies) if body.joint >= 0}


def _turn(x: DQ) -> Array:
    """Return twice the vector part of a pose's rotation, with its sign chosen so that small turns are small, (3,)."""
    r = x.vec8()[:4]
    out: Array = 2.0 * np.copysign(1.0, r[0]) * r[1:]
    return out
