"""Geometric primitives and their signed distances, sections 3.1 to 3.3 [Adorno2017, Marinho2019].

All coordinates are in the same frame, in metres. The functions of points that move with the joints also return the
gradient; where the primitive moves, too, the gradient at its moving point gives the residual of [Marinho2019].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit

X, Y, Z = np.eye(3)
"""Unit vectors along the axes of the frame in which they are used; z is up in the base, odom and world frames."""


def angle_of(cosine: float) -> float:
    """Return the angle [rad] of a cosine, which rounding may have moved beyond 1."""
    return math.acos(min(max(cosine, -1.0), 1.0))


@dataclass(frozen=True)
class Plane:
    """Plane n + eps d: unit normal `n` (3,) and signed distance `d` [m] of the plane from the origin along `n`."""

    n: Array
    d: float

    @classmethod
    def through(cls, p: ArrayLike, n: ArrayLike) -> Self:
        """Return the plane through the point `p` (3,) with the normal `n` (3,), which need not be of unit length."""
        normal = np.asarray(n, dtype=np.float64)
        normal = normal / np.linalg.norm(normal)
        return cls(normal, float(normal @ np.asarray(p)))


@dataclass(frozen=True)
class Line:
    """Pluecker line l + eps m: unit direction `l` (3,), and moment m = p x l (3,) [m] with any point p of the line."""

    l: Array
    m: Array

    @classmethod
    def through(cls, p: ArrayLike, l: ArrayLike) -> Self:
        """Return the line through the point `p` (3,) along `l` (3,), which need not be of unit length."""
        direction = np.asarray(l, dtype=np.float64)
        direction = direction / np.linalg.norm(direction)
        return cls(direction, np.cross(np.asarray(p, dtype=np.float64), direction))


@dataclass(frozen=True)
class Cylinder:
    """Infinite cylinder, given by its axis and its radius [m], section 3.2."""

    axis: Line
    radius: float


@dataclass(frozen=True)
class ConvexPolygon:
    """Convex polygon in the plane: `vertices` (m, 2) [m], counter-clockwise."""

    vertices: Array

    @classmethod
    def hull(cls, points: ArrayLike) -> Self:
        """Return the convex hull of points (k, 2), by Andrew's monotone chain; collinear points are omitted.

        Points are rounded to a nanometre first: the algorithm sorts them, and two points that differ by rounding errors
        only could be sorted such that a corner is lost.

        Raises
        ------
        ValueError
            If the points do not span an area.
        """
        pts = sorted(set(map(tuple, np.round(np.asarray(points, dtype=np.float64)[:, :2], 9).tolist())))

        def half(points: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
            out: list[tuple[float, ...]] = []
            for c in points:
                while len(out) > 1:
                    (ax, ay), (bx, by) = out[-2], out[-1]
                    if (bx - ax) * (c[1] - ay) - (by - ay) * (c[0] - ax) > 1e-15:
                        break
                    out.pop()
                out.append(c)
            return out[:-1]

        vertices = half(pts) + half(pts[::-1])
        if len(vertices) < 3:
            raise ValueError("points on one line have no convex hull with an area")
        return cls(np.array(vertices))

    def edges(self) -> tuple[Array, Array]:
        """Return inward unit normals n (m, 2) and offsets d (m,) [m]; a point p is inside if n p - d >= 0."""
        return self._edges

    @cached_property
    def _edges(self) -> tuple[Array, Array]:
        a = self.vertices
        t = np.concatenate([a[1:], a[:1]]) - a
        n = t[:, ::-1] * (-1.0, 1.0)
        n /= np.sqrt((n * n).sum(axis=1, keepdims=True))
        return n, (n * a).sum(axis=1)

    def distance(self, p: ArrayLike) -> float:
        """Signed distance [m] of the ground projection of a point (2,) or (3,) from the boundary, positive inside.

        Outside it is minus the distance from the nearest edge or corner.
        """
        n, d = self.edges()
        point = np.asarray(p, dtype=np.float64)[:2]
        nearest = (n @ point - d).min()
        if nearest >= 0.0:
            return float(nearest)
        a = self.vertices
        t = np.roll(a, -1, axis=0) - a
        s = np.clip(np.einsum("ij,ij->i", point - a, t) / np.einsum("ij,ij->i", t, t), 0.0, 1.0)
        return -float(np.linalg.norm(point - (a + s[:, None] * t), axis=1).min())


@jit
def moved_inside(p: Array, n: Array, d: Array, margin: float) -> Array:
    """Return a point p (2,) moved into a polygon with the edges n (m, 2), d (m,), at `margin` [m] from all of them.

    It is projected onto the line of the edge that it violates most, up to six times. At an obtuse corner a small part
    of the violation may remain.
    """
    for _ in range(6):
        short = np.maximum(d + margin - n @ p, 0.0)
        if not short.any():
            break
        k = np.argmax(short)
        p = p + short[k] * n[k]
    return p


# ---------------------------------------------------------------------- distances and their gradients


@jit
def point_to_line_squared(p: Array, l: Array, m: Array) -> tuple[float, Array]:
    """Squared distance |p x l - m|^2 of a point p (3,) from the line l + eps m [m^2], eq. (24) of [Marinho2019].

    Returns
    -------
    square : float
    gradient : ndarray, shape (3,)
        With respect to p.
    """
    h = np.cross(p, l) - m
    return float(h @ h), 2.0 * np.cross(l, h)


@jit
def point_to_wall(s: Array, a: Array, side: float) -> tuple[float, Array]:
    """Signed distance [m] of a point p from the vertical plane through a fixed point `a` (3,) and a moving point b.

    Seen from above, the distance is positive to the left of the line from `a` to b for `side` = 1, and to the right for
    `side` = -1. A motion of b turns the plane about `a`: at the projection of p, a fraction r of the way from `a` to b,
    the plane moves by r n.b'.

    Parameters
    ----------
    s : ndarray, shape (6,)
        p and b [m].
    a : ndarray, shape (3,)
    side : float
        1 or -1; see `wall_side`.

    Returns
    -------
    distance : float
    gradient : ndarray, shape (6,)
        With respect to p and b.
    """
    tx, ty = s[3] - a[0], s[4] - a[1]
    vx, vy = s[0] - a[0], s[1] - a[1]
    length = math.hypot(tx, ty)
    nx, ny = -side * ty / length, side * tx / length
    ratio = (tx * vx + ty * vy) / length**2
    return nx * vx + ny * vy, np.array([nx, ny, 0.0, -ratio * nx, -ratio * ny, 0.0])


def wall_side(a: Array, b: Array, inside: Array) -> float:
    """Return 1 if `inside` is to the left of the line from `a` to `b` seen from above, else -1; points (3,) [m].

    Raises
    ------
    ValueError
        If `a` and `b` are on one vertical line, so that the vertical plane through them is not unique.
    """
    t, v = b[:2] - a[:2], inside[:2] - a[:2]
    if np.hypot(*t) < 1e-9:
        raise ValueError("two points on one vertical line do not define a vertical plane")
    return 1.0 if t[0] * v[1] >= t[1] * v[0] else -1.0
