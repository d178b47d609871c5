"""The geometry of legs: knees, centres of hips and ankles, and the motions that flat soles leave to the pelvis.

Only the axes of the joints as lines in space are used. Where a description has the origin of a joint along its axis is
arbitrary, and so is the order of the axes of a hip, which need be neither parallel to those of the robot nor to each
other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dqwalk_ros.support.arrays import Array

_LEAST = 0.28
"""Least distance of the knee's axis from hip and ankle, as a fraction of the distance between these."""
_RANK = 0.05
"""Least singular value of motions that count as independent, relative to the largest one."""
_COMMON = 0.995
"""Least cosine of the angle between motions of two legs that are the same motion."""
_SHARE = 0.3
"""Least part of a motion, among all of the same size, that counts as possible."""
_PARALLEL = np.cos(np.radians(15.0))
"""Least cosine of the angle between axes that are parallel."""
_BEND = 0.6
"""Angle of a bent knee [rad]."""


@dataclass(frozen=True)
class Leg:
    """Hip, knee and ankle of a leg, in the axes of its joints."""

    knee: int
    """Index of the knee among the joints of the leg."""
    hip: Array
    ankle: Array
    """Points nearest to the axes of all joints above, and below the knee, shape (3,) [m]."""
    middle: Array
    """Point of the knee's axis, shape (3,) [m]."""
    straight: float
    """Distance of hip and ankle when the leg is straight [m]."""

    def longest(self, axis: Array, low: float, high: float) -> float:
        """Return the largest distance of hip and ankle with the knee between two angles [m].

        `axis` (3,) is the knee's, and the leg is in the posture in which the angle of the knee is zero.
        """
        angles = np.linspace(max(low, -np.pi), min(high, np.pi), 400)[:, None]
        shank = self.ankle - self.middle
        turned = (  # Rodrigues
            np.cos(angles) * shank
            + np.sin(angles) * np.cross(axis, shank)
            + (1.0 - np.cos(angles)) * (axis @ shank) * axis
        )
        return float(np.linalg.norm(self.middle + turned - self.hip, axis=1).max())

    def stretched(self, axis: Array) -> float:
        """Return the angle of the knee about its `axis` (3,) at which the leg is straight [rad].

        It is measured from the posture of the leg, and not zero where the knee is not on the line from hip to ankle.
        """
        thigh, shank = self.middle - self.hip, self.ankle - self.middle
        return float(np.arctan2(axis @ np.cross(shank, thigh), shank @ thigh - (axis @ shank) * (axis @ thigh)))


def leg_of(places: Array, axes: Array) -> Leg | None:
    """Return hip, knee and ankle of a leg: the knee's axis is that which is farthest from both ends.

    Parameters
    ----------
    places, axes : ndarray, shape (k, 3)
        A point [m] and the unit vector of the axis of each joint, from the hip to the ankle.

    Returns
    -------
    Leg or None
        None if no joint has an axis away from the joints above and below it.
    """
    best: tuple[float, Leg] | None = None
    for k in range(1, len(places) - 1):
        hip, ankle = _center(places[:k], axes[:k]), _center(places[k + 1 :], axes[k + 1 :])
        p, a = places[k], axes[k]
        above, below = (np.linalg.norm(np.cross(a, end - p)) for end in (hip, ankle))
        least = float(min(above, below))
        if least > _LEAST * float(np.linalg.norm(ankle - hip)) and (best is None or least > best[0]):
            aside = float((ankle - hip) @ a)
            middle = p + (0.5 * (hip + ankle) - p) @ a * a
            best = least, Leg(k, hip, ankle, middle, float(np.hypot(above + below, aside)))
    return best[1] if best else None


def _center(places: Array, axes: Array) -> Array:
    """Return the point nearest to some lines, and among these that nearest to their given points, shape (3,) [m]."""
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    H, b = across.sum(axis=0), np.einsum("kij,kj->i", across, places)
    mean = places.mean(axis=0)
    out: Array = mean + np.linalg.lstsq(H, b - H @ mean, rcond=_RANK)[0]
    return out


def bent(axes: Array, knee: int, lateral: Array) -> Array:
    """Return joint angles (k,) [rad] that turn the thigh back, the shank forth and the foot back about `lateral` (3,).

    The joints of hip and ankle share the rotation in the way of least angles, whatever their axes.
    """
    angles = np.zeros(len(axes))
    angles[knee] = _BEND * (np.sign(axes[knee] @ lateral) or 1.0)
    for part in (slice(0, knee), slice(knee + 1, None)):
        angles[part] = np.linalg.pinv(axes[part].T, rcond=0.2) @ (-0.5 * _BEND * lateral)
    return angles


def axes_differ(p: Array, a: Array, q: Array, b: Array, lateral: Array) -> Array:
    """Return how far the joints of two legs are from being mirror images or copies of each other, shape (k,) [m].

    Parameters
    ----------
    p, q : ndarray, shape (k, 3)
        A point of each axis of both legs [m].
    a, b : ndarray, shape (k, 3)
        Unit vectors of these axes.
    lateral : ndarray, shape (3,)
        Horizontal unit vector from one leg to the other.
    """
    known = np.abs(a @ lateral) < 0.5  # where a joint is along its own axis is arbitrary
    known = known if known.any() else np.ones(len(a), bool)
    twice, apart = (float(np.median(x[known])) for x in ((p + q) @ lateral, (p - q) @ lateral))
    mirrored = q + np.outer(twice - 2.0 * q @ lateral, lateral), b - 2.0 * np.outer(b @ lateral, lateral)
    copied = q + apart * lateral, b
    off = [_between(p, a, *other) for other in (mirrored, copied)]
    return min(off, key=lambda distances: float(distances.max()))


def _between(p: Array, a: Array, q: Array, b: Array) -> Array:
    """Return the distances of lines that should be the same, or of their points where they are not parallel, (k,)."""
    off = p - q
    along = np.where(np.abs(np.sum(a * b, axis=1)) > _PARALLEL, np.sum(off * a, axis=1), 0.0)
    out: Array = np.linalg.norm(off - along[:, None] * a, axis=1)
    return out


def freedom(legs: tuple[tuple[Array, Array], tuple[Array, Array]], length: float) -> tuple[bool, bool]:
    """Return whether the pelvis can move sideways over two flat soles, and whether a sole can turn under the pelvis.

    The motions that a leg allows between pelvis and sole are spanned by its axes, as the screws (a, p x a). Both soles
    stay on the ground in the motions that both legs allow.

    Parameters
    ----------
    legs : two tuples of ndarray, shape (k, 3)
        Points and axes of the joints of both legs, with bent knees; x is forward, z up.
    length : float
        Length of a leg [m].
    """
    middle = np.mean([p[0] for p, _ in legs], axis=0)
    spans = []
    for p, a in legs:
        screws = np.concatenate([a, np.cross((p - middle) / length, a)], axis=1)
        u, s, _ = np.linalg.svd(screws.T, full_matrices=False)
        spans.append(u[:, s > _RANK * s[0]])
    u, cosines, _ = np.linalg.svd(spans[0].T @ spans[1])
    common = spans[0] @ u[:, : len(cosines)][:, cosines > _COMMON]
    sideways = float(np.linalg.norm(common[4])) if common.size else 0.0
    turns = min(float(np.linalg.norm(span[2])) for span in spans)
    return sideways > _SHARE, turns > _SHARE
