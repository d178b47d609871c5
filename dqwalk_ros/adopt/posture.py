"""Finds the initial posture of a walk: soles level, knees bent, CoM over the middle of the soles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from dqwalk_ros.adopt.anatomy import Anatomy
from dqwalk_ros.adopt.legs import Leg, bent, leg_of
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import Y
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ModelError

_BENT = 0.96
"""Distance of hip and ankle as a fraction of the largest one within the limits of the knee."""
_UNBENT = 0.02
"""Largest difference of the length of a leg from the wanted one, as a fraction of this, in a good posture."""
_MARGINS = 0.05, 0.0
"""Least distance of joints from their limits [rad], a tenth of their range if that is less: without one if need be."""
_LEVER = 0.3
"""Lever by which angles are compared with lengths, as a fraction of the leg length [1/rad]."""
_TRUNK = 10.0
"""Weight of the angles of the trunk relative to those of the legs, in a posture over both feet."""
_STARTS = 6
"""Largest number of postures from which a standing posture is searched."""
_LEAST = 1e-3
"""Largest error of the constraints of a posture, as a fraction of the leg length."""
_SIDEWAYS, _FIXED = [1, 4], 0.01
"""The constraints along y, of sole and CoM, and their weight if the robot cannot move them without leaning."""


@dataclass(frozen=True)
class Standing:
    """A standing posture."""

    q: Array
    """Joint angles, shape (n,) [rad]."""
    com: Array
    """CoM in the axes of the left sole, relative to the point halfway between both soles, shape (3,) [m]."""
    pelvis: float
    """Height of the pelvis [m]."""
    error: float
    """Largest error of the constraints, with angles multiplied by 0.3 leg lengths [m]."""
    knee: float
    """Mean distance of the knees in front of the line from hip to ankle [m]."""
    off: float
    """Largest difference of the length of a leg from the wanted one, as a fraction of this."""
    margin: float
    """Least distance of the joints from their limits that was required [rad]."""


def stand(model: RobotModel, anatomy: Anatomy, bend: float = _BENT) -> Standing:
    """Find the standing posture, with the knees in front of the legs if there is such a posture.

    Joints are at a limit only if there is no posture without, as with hips that yaw or roll outwards only.

    Parameters
    ----------
    model : RobotModel
        Model with the soles of `anatomy`, whose root link has x forward and z up.
    bend : float
        Distance of hip and ankle as a fraction of the largest one within the limits of the knee.

    Raises
    ------
    ModelError
        If no posture has both soles level side by side and the CoM over their middle; the message names the joints at
        their limits.
    """
    found = list[Standing]()
    for margin in _MARGINS:
        found = _standings(model, anatomy, bend, margin)
        good = [one for one in found if one.error < _LEAST * max(anatomy.leg, 0.2)]
        if good:
            # prefer bent legs to stretched ones, in which a search ends as well, knees in front of the legs, and
            # smaller angles
            return max(good, key=lambda one: (one.off < _UNBENT, one.knee > 0.0, -float(np.abs(one.q).sum())))
    best = min(found, key=lambda one: one.error)
    raise ModelError(
        f"no posture was found with both soles level, {1e3 * anatomy.apart:.0f} mm apart, and the CoM over their "
        f"middle: the error of the best posture is {1e3 * best.error:.1f} mm{why_not(model, anatomy, best)}"
    )


def _standings(model: RobotModel, anatomy: Anatomy, bend: float, margin: float) -> list[Standing]:
    """Return postures that were searched from several ones, with a `margin` of the joints to their limits [rad]."""
    straight, start = np.zeros(model.n), np.zeros(model.n)
    for joints, axes, leg in leg_axes(model, anatomy):
        start[joints] = bent(axes, leg.knee, Y)
        straight[joints[leg.knee]] = leg.stretched(axes[leg.knee])
    found = [_solve(model, anatomy, bend, straight + way * start, margin) for way in (1.0, -1.0)]
    random = np.random.default_rng(0)
    while len(found) < _STARTS and min(one.error for one in found) > _LEAST * max(anatomy.leg, 0.2):
        found.append(_solve(model, anatomy, bend, straight + start + random.uniform(-0.5, 0.5, model.n), margin))
    return found


def over_one_foot(model: RobotModel, anatomy: Anatomy, standing: Standing, foot: Foot) -> Standing:
    """Return the posture with the CoM over one sole and both soles level, as far from the limits as `standing`."""
    y = 0.0 if foot is Foot.LEFT else -anatomy.apart
    return _solve(model, anatomy, _BENT, standing.q, standing.margin, com=(0.0, y), free_pelvis=True)


def at_limits(model: RobotModel, posture: Standing) -> list[str]:
    """Return the joints that are at the limits of a posture, with their angles and ranges."""
    q = posture.q
    low, high = _bounds(model, posture.margin)
    return [
        f"'{name}' at {q[k]:.2f} of {model.q_min[k]:.2f} to {model.q_max[k]:.2f} rad"
        for k, name in enumerate(model.joint_names)
        if min(q[k] - low[k], high[k] - q[k]) < 2e-3
    ]


def why_not(model: RobotModel, anatomy: Anatomy, posture: Standing) -> str:
    """Return what keeps a posture from being better, as the end of a message."""
    if stuck := at_limits(model, posture):
        return f"; at their limits are {', '.join(stuck)}"
    return "" if anatomy.sideways else "; its legs cannot move the pelvis sideways over flat soles"


def _bounds(model: RobotModel, margin: float) -> tuple[Array, Array]:
    """Return the range of the joints in a posture, both of shape (n,) [rad]."""
    away = np.minimum(margin, 0.1 * (model.q_max - model.q_min))
    return model.q_min + away, model.q_max - away


def leg_axes(model: RobotModel, anatomy: Anatomy) -> list[tuple[list[int], Array, Leg]]:
    """Return the k joints of each leg, their axes (k, 3), and the leg, at q = 0 in the frame of the left sole."""
    kin = Kinematics(model, np.zeros(model.n), Foot.LEFT)
    of = {body.joint: (link, body.axis) for body, link in zip(model.bodies, model.links, strict=True)}
    out = []
    for names in anatomy.legs.values():
        joints = [model.joint_names.index(name) for name in names]
        places = np.array([kin.point(of[k][0]) for k in joints])
        axes = np.array([kin.direction(*of[k]) for k in joints])
        leg = leg_of(places, axes)
        if leg is None:
            raise ModelError(f"the leg of {', '.join(names)} has no knee: none bends it between hip and foot")
        out.append((joints, axes, leg))
    return out


def _leg_points(
    model: RobotModel, anatomy: Anatomy, low: Array, high: Array
) -> list[tuple[list[tuple[str, Array]], float]]:
    """Return hip on the pelvis, knee, and ankle on the foot of each leg as links and points of these, and its length.

    That is the largest one with the knee between its angles in `low` and `high` (n,) [rad].
    """
    zero, out = Kinematics(model, np.zeros(model.n), Foot.LEFT), []
    links = {body.joint: link for body, link in zip(model.bodies, model.links, strict=True)}
    for joints, axes, leg in leg_axes(model, anatomy):
        on = (model.pelvis, leg.hip), (links[joints[leg.knee]], leg.middle), (links[joints[-1]], leg.ankle)
        points = [(link, DQ(zero.pose(link)).conj().transform_point(p)) for link, p in on]
        knee = joints[leg.knee]
        out.append((points, leg.longest(axes[leg.knee], low[knee], high[knee])))
    return out


def _solve(
    model: RobotModel,
    anatomy: Anatomy,
    bend: float,
    start: Array,
    margin: float,
    com: tuple[float, float] | None = None,
    free_pelvis: bool = False,
) -> Standing:
    low, high = _bounds(model, margin)
    legs = _leg_points(model, anatomy, low, high)
    wanted = (0.0, -0.5 * anatomy.apart) if com is None else com
    right = model.soles[Foot.RIGHT].frame
    lever = _LEVER * anatomy.leg
    place = np.array([0.0, -anatomy.apart, 0.0])
    rest = start if free_pelvis else np.zeros(model.n)
    walking = {name for names in anatomy.legs.values() for name in names}
    weight = np.array([1.0 if free_pelvis or name in walking else _TRUNK for name in model.joint_names])
    weight *= 1e-3 * anatomy.leg
    kept = np.ones(8 if free_pelvis else 11)
    if anatomy.lean is not None:
        kept[_SIDEWAYS] = _FIXED

    def constraints(q: Array) -> Array:
        kin = Kinematics(model, q, Foot.LEFT)
        other = DQ(kin.pose(right))
        root = DQ(kin.pose(model.root))
        upright = np.zeros(0) if free_pelvis else lever * root.rotation_vector()
        tilt = lever * other.rotation_vector()
        e: Array = kept * np.concatenate([other.translation() - place, kin.com[:2] - wanted, tilt, upright])
        return e

    def residual(q: Array) -> Array:
        kin = Kinematics(model, q, Foot.LEFT)
        longer = [
            float(np.linalg.norm(kin.point(*hip) - kin.point(*ankle))) - bend * longest
            for (hip, _, ankle), longest in legs
        ]
        return np.concatenate([constraints(q), 0.3 * np.array(longer), weight * (q - rest)])

    first = np.clip(start, low + 1e-3, high - 1e-3)
    q = least_squares(residual, first, bounds=(low, high), xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=200).x
    # satisfy the constraints exactly, near the solution of the weighted problem
    for _ in range(3):
        q = least_squares(
            lambda x, q0=q: np.concatenate([constraints(x), 1e-4 * (x - q0)]), q, bounds=(low, high), max_nfev=50
        ).x
    kin = Kinematics(model, q, Foot.LEFT)
    middle = np.array([0.0, 0.5 * anatomy.apart, 0.0])
    knees, off = [], 0.0
    for points, longest in legs:
        a, b, c = (kin.point(*p) for p in points)
        off = max(off, abs(float(np.linalg.norm(a - c)) / (bend * longest) - 1.0))
        share = (b[2] - c[2]) / max(a[2] - c[2], 1e-6)
        knees.append(b[0] - (c[0] + share * (a[0] - c[0])))
    return Standing(
        q=q,
        com=kin.com + middle,
        pelvis=float(kin.point(model.pelvis)[2]),
        error=float(np.abs(constraints(q)).max()),
        knee=float(np.mean(knees)),
        off=off,
        margin=margin,
    )
