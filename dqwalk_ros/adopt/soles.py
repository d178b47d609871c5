"""Finds the soles of a biped: the largest rectangle in the plane on which a foot stands."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from dqwalk_ros.adopt.legs import leg_of
from dqwalk_ros.adopt.skeleton import Skeleton
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import X, Z, angle_of
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ModelError

_FLAT = 0.004
"""Largest distance from the plane of a sole of a point that belongs to it [m]."""
_MIRRORED = 0.004
"""Largest difference of two soles that mirror each other, in size and in place [m]."""
_EVEN = 0.25
"""Least part of the lower side of a foot that is even, within 3 degrees: that of a round foot is small."""
_UNLIKE, _TILTED = 1.5, math.radians(10.0)
"""Largest ratio of the sizes of two soles, and largest angle between them, that belong to one robot."""
_OVERLAP = 1.5
"""Largest width of soles in the zero posture, as a multiple of their lateral distance; narrower ones are set apart."""
_LEAST_SIDES = 0.03, 0.1
"""Least sides of a sole, the shorter and the longer one, as fractions of the distance of hip and ankle."""


@dataclass(frozen=True)
class FoundSole:
    """A sole."""

    link: str
    pose: DQ
    """Centre of the sole in the frame of the link, with x forward and z up."""
    length: float
    width: float
    """Size of the rectangle [m]."""
    source: str
    """How the sole was found."""
    confidence: str
    """``sure``, ``likely`` or ``guess``."""

    def placed(self, skeleton: Skeleton) -> DQ:
        """Return the pose in the zero posture, in the axes of the robot."""
        return skeleton.pose(self.link) * self.pose

    def __str__(self) -> str:
        x, y, z = 1e3 * self.pose.translation()
        size = f"{1e3 * self.length:.0f} x {1e3 * self.width:.0f} mm"
        return f"{size} at ({x:.0f}, {y:.0f}, {z:.0f}) mm of {self.link}"


def foot_links(skeleton: Skeleton, ankle: str) -> list[str]:
    """Return the links that the ankle carries: the foot and its toes."""
    return [link for link, chain in skeleton.chain.items() if ankle in chain]


def find_soles(skeleton: Skeleton, legs: dict[Foot, tuple[str, ...]], leg: float) -> dict[Foot, FoundSole]:
    """Return the soles, of equal size on both sides.

    The axes of the skeleton are x forward and z up, `legs` are the joints from hip to ankle, `leg` is their length [m].

    Raises
    ------
    ModelError
        If a foot has no shape, or is too small for a flat sole.
    """
    feet = [foot_links(skeleton, joints[-1]) for joints in legs.values()]
    which, _ = skeleton.complete(feet)
    found = {foot: _sole(skeleton, joints[-1], leg, which) for foot, joints in legs.items()}
    if _overlap(skeleton, found) and all(skeleton.points(links, "visuals")[1] for links in feet):
        found = {foot: _sole(skeleton, joints[-1], leg, "visuals") for foot, joints in legs.items()}
    if _overlap(skeleton, found):
        left, right = (found[foot] for foot in Foot)
        raise ModelError(
            f"the soles overlap each other in the zero posture: left {left}, right {right}; are the size and the scale "
            "of the shapes of the feet right?"
        )
    for foot, sole in found.items():
        sides = sorted((sole.length, sole.width))
        if any(side < least * leg for side, least in zip(sides, _LEAST_SIDES, strict=True)):
            raise ModelError(
                f"this biped stands on points or edges: its {foot.value} sole is {1e3 * sole.length:.0f} x "
                f"{1e3 * sole.width:.0f} mm, but the walk requires flat soles"
                f"{skeleton.lacking(foot_links(skeleton, legs[foot][-1]))}"
            )
    left, right = (found[foot] for foot in Foot)
    turn = _turned(left.placed(skeleton), right.placed(skeleton))
    ratio = max(_ratio(left.length, right.length), _ratio(left.width, right.width))
    if ratio > _UNLIKE or turn > _TILTED:
        raise ModelError(
            f"the soles do not mirror each other: left {left}, right {right}, turned by {math.degrees(turn):.0f} "
            "degrees against each other; compare the shapes of both feet"
        )
    if not _mirrored(skeleton, legs, found):
        why = "; the soles do not mirror each other"
        found = {foot: replace(sole, source=sole.source + why, confidence="guess") for foot, sole in found.items()}
    length, width = (min(getattr(sole, key) for sole in found.values()) for key in ("length", "width"))
    return {foot: replace(sole, length=length, width=width) for foot, sole in found.items()}


def _overlap(skeleton: Skeleton, found: dict[Foot, FoundSole]) -> bool:
    """Return whether soles are so much wider than their lateral distance that they cannot be those of one robot."""
    left, right = (sole.placed(skeleton).translation() for sole in found.values())
    return bool(min(sole.width for sole in found.values()) > _OVERLAP * abs(left[1] - right[1]))


def _turned(left: DQ, right: DQ) -> float:
    """Return the angle between a sole and the mirror image of the other one, or a copy of it if that is less [rad]."""
    w, x, y, z = left.vec8()[:4]
    mirrored = DQ([w, -x, y, -z, 0.0, 0.0, 0.0, 0.0])  # a rotation seen in the mirror of the plane y = 0
    return min(float(np.linalg.norm((one.conj() * right).rotation_vector())) for one in (mirrored, left))


def _ratio(a: float, b: float) -> float:
    return max(a, b) / max(min(a, b), 1e-9)


def _mirrored(skeleton: Skeleton, legs: dict[Foot, tuple[str, ...]], found: dict[Foot, FoundSole]) -> bool:
    """Return whether two soles mirror each other in the plane between the legs."""
    left, right = (found[foot] for foot in Foot)
    p, q = (sole.placed(skeleton).translation() for sole in (left, right))
    twice = sum(float(leg.hip[1]) for joints in legs.values() if (leg := leg_of(*skeleton.lines(joints))))  # 2 y
    place = p - [q[0], twice - q[1], q[2]]
    return bool(max(abs(left.length - right.length), abs(left.width - right.width), *np.abs(place)) < _MIRRORED)


def _sole(skeleton: Skeleton, ankle: str, leg: float, which: str) -> FoundSole:
    links = foot_links(skeleton, ankle)
    p, which = skeleton.points(links, which)
    foot = skeleton.joints[ankle].child
    if p is None:
        raise ModelError(
            f"the foot '{foot}' has no shape that can be read, so its sole is unknown{skeleton.lacking(links)}: "
            "add a box to it as <collision>"
        )
    normal, level, even = plane_below(p)
    near = p[(p - level) @ normal < min(_FLAT, 0.02 * leg)]
    x = X - normal[0] * normal
    x /= np.linalg.norm(x)
    axes = np.array([x, np.cross(normal, x), normal])  # rows: forward, left and up axis of the sole
    flat = (near - level) @ axes.T
    try:
        hull = ConvexHull(flat[:, :2])
    except QhullError:
        raise ModelError(f"this biped stands on points or edges: the foot '{foot}' has no flat area") from None
    x0, x1, y0, y1 = _rectangle(hull)
    if even < _EVEN:
        raise ModelError(
            f"this biped stands on points or edges: the foot '{foot}' is round below{skeleton.lacking(links)}"
        )
    center = level + np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.0]) @ axes
    tilt = math.degrees(angle_of(normal[2]))
    share = (x1 - x0) * (y1 - y0) / hull.volume
    source = f"largest rectangle within the lowest points of the {which.removesuffix('s')} shapes"
    if tilt > 0.0:
        source += f"; tilted by {tilt:.1f} degrees in the zero posture"
    return FoundSole(
        foot,
        skeleton.pose(foot).conj() * DQ.from_matrix(axes.T, center),
        float(x1 - x0),
        float(y1 - y0),
        source,
        "sure" if share > 0.7 and which == "collisions" else "likely",
    )


def plane_below(p: Array) -> tuple[Array, Array, float]:
    """Return the largest lower side of the convex hull of points (N, 3).

    Returns
    -------
    normal, point : ndarray, shape (3,)
        Upward normal, and a point of this side [m].
    share : float
        Its part of all sides whose normal is within 45 degrees of the vertical.
    """
    lowest = p[np.argmin(p[:, 2])]
    try:
        hull = ConvexHull(p)
    except QhullError:
        return Z, lowest, 1.0
    corners = p[hull.simplices]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    normals, offsets = hull.equations[:, :3], hull.equations[:, 3]
    below = normals[:, 2] < -0.7
    if not below.any():
        return Z, lowest, 1.0
    best, normal = 0.0, Z
    for k in np.flatnonzero(below):
        alike = below & (normals @ normals[k] > math.cos(math.radians(3.0)))
        alike &= np.abs(corners.mean(axis=1) @ normals[k] + offsets[k]) < _FLAT
        total = float(area[alike].sum())
        if total > best + 1e-9:
            best, normal = total, -(area[alike, None] * normals[alike]).sum(axis=0) / total
    normal = normal / np.linalg.norm(normal)
    if normal[2] > math.cos(math.radians(1.5)):
        normal = Z
    return normal, p[np.argmin(p @ normal)], best / float(area[below].sum())


def _rectangle(hull: ConvexHull) -> tuple[float, float, float, float]:
    """Return x0, x1, y0, y1 of the largest axis-aligned rectangle in a convex hull in the plane."""
    xs = np.linspace(hull.min_bound[0], hull.max_bound[0], 241)
    a, b, c = hull.equations.T[:, :, None]  # edges a x + b y + c = 0, positive outside
    with np.errstate(divide="ignore", invalid="ignore"):
        y = -(a * xs + c) / b  # of each edge at each x
    low = np.where(b < -1e-9, y, -np.inf).max(axis=0)
    high = np.where(b > 1e-9, y, np.inf).min(axis=0)
    bottom, top = np.maximum(low[:, None], low), np.minimum(high[:, None], high)
    area = np.maximum(top - bottom, 0.0) * np.maximum(xs - xs[:, None], 0.0)
    i, j = np.unravel_index(int(np.argmax(area)), area.shape)
    return float(xs[i]), float(xs[j]), float(bottom[i, j]), float(top[i, j])
