"""Geometric primitives and their signed distances, sections 3.1 to 3.3 [Adorno2017, Marinho2019].

Every function takes and returns plain arrays of coordinates in one frame, in metres; a Jacobian `J_p` maps
joint velocities to the velocity of the point `p`, shape (3, n). Where a primitive moves with the joints its own
Jacobian is an argument too: that is the residual of the distance's derivative.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqwalk_ros.dual_quaternions import DQ

__all__ = [
    "ConvexPolygon",
    "Cylinder",
    "Line",
    "Plane",
    "point_to_line_squared",
    "point_to_line_squared_jacobian",
    "point_to_plane",
    "point_to_plane_jacobian",
    "point_to_polygon",
    "point_to_polygon_jacobian",
    "point_to_wall",
    "point_to_wall_jacobian",
    "wall_normal",
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

    def moved(self, x: DQ) -> Plane:
        """Return the plane carried along by the rigid motion `x`."""
        h = x.Ad_sharp(self.dq()).vec8()
        return Plane(h[1:4], float(h[4]))

    def distance(self, p: ArrayLike) -> float:
        """Signed distance of a point (3,), positive on the side the normal points at."""
        return float(point_to_plane(np.asarray(p), self.n, self.d))


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

    def moved(self, x: DQ) -> Line:
        """Return the line carried along by the rigid motion `x`."""
        h = x.Ad(self.dq()).vec8()
        return Line(h[1:4], h[5:])

    def distance_squared(self, p: ArrayLike) -> float:
        """Squared distance of a point (3,) [m^2]."""
        return float(point_to_line_squared(np.asarray(p), self.l, self.m))


@dataclass(frozen=True)
class Cylinder:
    """Infinite cylinder: the pair of its axis and its radius [m], section 3.2."""

    axis: Line
    radius: float

    def moved(self, x: DQ) -> Cylinder:
        """Return the cylinder carried along by the rigid motion `x`."""
        return Cylinder(self.axis.moved(x), self.radius)

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


# ---------------------------------------------------------------------- points and planes


def point_to_plane(p: Array, n: Array, d: float) -> float:
    """Signed distance <p, n> - d of a point (3,) to the plane n + eps d [m]."""
    return float(p @ n) - d


def point_to_plane_jacobian(
    p: Array, J_p: Array, n: Array, J_n: Array | None = None, J_d: Array | None = None
) -> Array:
    """Jacobian (n,) of `point_to_plane`; `J_n` (3, n) and `J_d` (n,) are the residual of a plane that moves."""
    J = n @ J_p
    if J_n is not None:
        J = J + p @ J_n
    if J_d is not None:
        J = J - J_d
    return J


def wall_normal(a: Array, b: Array, inside: Array) -> Array:
    """Horizontal unit normal (3,) of the upright plane through the points `a` and `b`, towards the side of `inside`.

    Raises
    ------
    ValueError
        If one of the points is above the other: then no single upright plane holds both.
    """
    t = b[:2] - a[:2]
    length = np.hypot(*t)
    if length < 1e-9:
        raise ValueError("two points above each other do not fix an upright plane")
    n: Array = np.array([-t[1], t[0], 0.0]) / length
    return n if n @ (inside - a) >= 0.0 else -n


def point_to_wall(p: Array, a: Array, b: Array, side: float) -> float:
    """Signed distance [m] of `p` to the upright plane through `a` and `b` (all (3,)).

    It is positive to the left of the way from `a` to `b` where `side` is 1, to the right where it is -1.
    """
    t = b[:2] - a[:2]
    return float(side * (t[0] * (p[1] - a[1]) - t[1] * (p[0] - a[0])) / np.hypot(t[0], t[1]))


def point_to_wall_jacobian(p: Array, J_p: Array, a: Array, b: Array, J_b: Array, side: float) -> Array:
    """Jacobian (n,) of `point_to_wall` where `a` is at rest and `b` moves with `J_b` (3, n).

    Moving `b` turns the plane about `a`; at the distance s |b - a| along it that moves the plane by s n.db, so
    d' = n (J_p - s J_b).
    """
    t = b[:2] - a[:2]
    length = np.hypot(*t)
    n = side * np.array([-t[1], t[0]]) / length
    s = float(t @ (p[:2] - a[:2])) / length**2
    jacobian: Array = n @ (J_p[:2] - s * J_b[:2])
    return jacobian


# ---------------------------------------------------------------------- points and lines


def point_to_line_squared(p: Array, l: Array, m: Array) -> float:  # noqa: E741
    """Squared distance |p x l - m|^2 of a point (3,) to the line l + eps m [m^2], eq. (24) of [Marinho2019]."""
    h = np.cross(p, l) - m
    return float(h @ h)


def point_to_line_squared_jacobian(
    p: Array,
    J_p: Array,
    l: Array,  # noqa: E741
    m: Array,
    J_l: Array | None = None,
    J_m: Array | None = None,
) -> Array:
    """Jacobian (n,) of `point_to_line_squared`; `J_l`, `J_m` (3, n) are the residual of a line that moves."""
    h = np.cross(p, l) - m
    J = 2.0 * np.cross(l, h) @ J_p
    if J_l is not None:
        J = J + 2.0 * np.cross(h, p) @ J_l
    if J_m is not None:
        J = J - 2.0 * h @ J_m
    return J


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


def point_to_polygon_jacobian(p: Array, J_p: Array, vertices: Array) -> Array:
    """Jacobian (n,) of `point_to_polygon` with the polygon at rest; `J_p` (2 or 3, n)."""
    jacobian: Array = point_to_polygon(p, vertices)[1] @ J_p[:2]
    return jacobian
