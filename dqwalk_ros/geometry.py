"""Geometric primitives and their signed distances, sections 3.1 to 3.3 [Adorno2017, Marinho2019].

Plain arrays of coordinates in one frame, in metres. A distance comes with its gradient; where a primitive moves with
the joints, the gradient has a part for what moves it: the residual of [Marinho2019].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqwalk_ros.compiled import jit
from dqwalk_ros.dual_quaternions import DQ

__all__ = [
    "ConvexPolygon",
    "Cylinder",
    "Line",
    "Plane",
    "point_to_line_squared",
    "point_to_polygon",
    "point_to_wall",
    "wall_side",
]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Plane:
    """Plane n + eps d: unit normal `n` (3,) and distance `d` [m] of the plane from the origin along it."""

    n: Array
    d: float

    @classmethod
    def through(cls, p: ArrayLike, n: ArrayLike) -> Self:
        """Return the plane through the point `p` with the normal `n`, which need not be of unit length."""
        normal = np.asarray(n, dtype=np.float64)
        normal = normal / np.linalg.norm(normal)
        return cls(normal, float(normal @ np.asarray(p)))

    def dq(self) -> DQ:
        """Return n + eps d."""
        return DQ(np.concatenate([[0.0], self.n, [self.d, 0.0, 0.0, 0.0]]))

    def distance(self, p: ArrayLike) -> float:
        """Signed distance of a point (3,), positive on the side the normal points at."""
        return float(np.asarray(p) @ self.n) - self.d


@dataclass(frozen=True)
class Line:
    """Pluecker line l + eps m: unit direction `l` (3,) and moment m = p x l (3,) [m] of any of its points p."""

    l: Array  # noqa: E741 - the paper's symbol
    m: Array

    @classmethod
    def through(cls, p: ArrayLike, l: ArrayLike) -> Self:  # noqa: E741
        """Return the line through the point `p` along `l`, which need not be of unit length."""
        direction = np.asarray(l, dtype=np.float64)
        direction = direction / np.linalg.norm(direction)
        return cls(direction, np.cross(np.asarray(p, dtype=np.float64), direction))

    def dq(self) -> DQ:
        """Return l + eps m."""
        return DQ(np.concatenate([[0.0], self.l, [0.0], self.m]))

    def distance_squared(self, p: ArrayLike) -> float:
        """Squared distance of a point (3,) [m^2]."""
        return float(point_to_line_squared(np.asarray(p, dtype=np.float64), self.l, self.m)[0])


@dataclass(frozen=True)
class Cylinder:
    """Infinite cylinder: the pair of its axis and its radius [m], section 3.2."""

    axis: Line
    radius: float

    def distance(self, p: ArrayLike) -> float:
        """d^2 - r^2 [m^2] of a point (3,): negative inside, as in the paper."""
        return self.axis.distance_squared(p) - self.radius**2


@dataclass(frozen=True)
class ConvexPolygon:
    """Convex polygon in the plane: `vertices` (m, 2) [m], counter-clockwise."""

    vertices: Array

    @classmethod
    def hull(cls, points: ArrayLike) -> Self:
        """Return the convex hull of points (k, 2), by Andrew's monotone chain; collinear points are left out.

        Points are rounded to a nanometre first: the chain sorts them, and two that differ only by rounding would be
        taken in an order that cuts corners off.

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
        """Return inward unit normals n (m, 2) and offsets d (m,) [m]; a point inside has n p - d >= 0."""
        return self._edges

    @cached_property
    def _edges(self) -> tuple[Array, Array]:
        a = self.vertices
        t = np.roll(a, -1, axis=0) - a
        n = np.stack([-t[:, 1], t[:, 0]], axis=1)
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        return n, np.einsum("ij,ij->i", n, a)

    def distance(self, p: ArrayLike) -> float:
        """Signed distance [m] of a point (2,) or (3,): inside that of the nearest edge, outside negative."""
        return float(point_to_polygon(np.asarray(p, dtype=np.float64), self.vertices)[0])


# ---------------------------------------------------------------------- distances and their gradients


@jit
def point_to_line_squared(p, l, m):  # type: ignore[no-untyped-def] # noqa: E741
    """Squared distance |p x l - m|^2 of a point (3,) to the line l + eps m [m^2], eq. (24) of [Marinho2019].

    Returns
    -------
    square : float
    gradient : ndarray, shape (3,)
        At the point.
    """
    h = np.cross(p, l) - m
    return h @ h, 2.0 * np.cross(l, h)


@jit
def point_to_wall(s, a, side):  # type: ignore[no-untyped-def]
    """Signed distance [m] of a point p to the upright plane through `a` (3,), which is at rest, and b, which moves.

    It is positive to the left of the way from `a` to `b` where `side` is 1, to the right where it is -1. Moving b
    turns the plane about a; where the foot of p lies at the part `share` of the way that moves the plane by share n.b'.

    Parameters
    ----------
    s : ndarray, shape (6,)
        p and b [m].
    a : ndarray, shape (3,)
    side : float

    Returns
    -------
    distance : float
    gradient : ndarray, shape (6,)
    """
    tx, ty = s[3] - a[0], s[4] - a[1]
    vx, vy = s[0] - a[0], s[1] - a[1]
    length = math.hypot(tx, ty)
    nx, ny = -side * ty / length, side * tx / length
    share = (tx * vx + ty * vy) / length**2
    return nx * vx + ny * vy, np.array([nx, ny, 0.0, -share * nx, -share * ny, 0.0])


def wall_side(a: Array, b: Array, inside: Array) -> float:
    """Return 1 where `inside` lies to the left of the way from `a` to `b` (3,) [m], -1 where it lies to the right.

    Raises
    ------
    ValueError
        If one of the points is above the other: then no single upright plane holds both.
    """
    t, v = b[:2] - a[:2], inside[:2] - a[:2]
    if np.hypot(*t) < 1e-9:
        raise ValueError("two points above each other do not fix an upright plane")
    return 1.0 if t[0] * v[1] >= t[1] * v[0] else -1.0


# ---------------------------------------------------------------------- points and polygons


def point_to_polygon(p: Array, vertices: Array) -> tuple[float, Array]:
    """Signed distance [m] of the ground projection of `p` (2,) or (3,) to a convex polygon (m, 2), and its gradient.

    Positive inside. Outside, the nearest feature may be a corner, and then the distance is that to the corner.

    Returns
    -------
    distance : float
    gradient : ndarray, shape (2,)
    """
    n, d = ConvexPolygon(vertices).edges()
    distances = n @ p[:2] - d
    nearest = int(np.argmin(distances))
    if distances[nearest] >= 0.0:
        return float(distances[nearest]), n[nearest]
    a = vertices
    t = np.roll(a, -1, axis=0) - a
    s = np.clip(np.einsum("ij,ij->i", p[:2] - a, t) / np.einsum("ij,ij->i", t, t), 0.0, 1.0)
    v = p[:2] - (a + s[:, None] * t)
    far = np.linalg.norm(v, axis=1)
    edge = int(np.argmin(far))
    return -float(far[edge]), -v[edge] / far[edge]
