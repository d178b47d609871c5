"""Signed distances compared with other formulas, their Jacobians with central differences."""

from __future__ import annotations

import numpy as np
import pytest
from robots import central_difference

from dqwalk_ros.paper.geometry import (
    ConvexPolygon,
    Line,
    Plane,
    moved_inside,
    point_to_line_squared,
    point_to_wall,
    wall_side,
)

SQUARE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])


def generators():
    """Random number generators, one per case of a test."""
    return map(np.random.default_rng, range(20))


def unit(v):
    return v / np.linalg.norm(v)


# ---------------------------------------------------------------------- points, planes and lines


def test_point_to_plane():
    for rng in generators():
        a, b, c, p = rng.normal(size=(4, 3))
        plane = Plane.through(a, np.cross(b - a, c - a))
        # the height of the tetrahedron a, b, c, p
        height = np.linalg.det([b - a, c - a, p - a]) / np.linalg.norm(np.cross(b - a, c - a))
        assert plane.n @ p - plane.d == pytest.approx(height, abs=1e-12)


def test_point_to_line():
    for rng in generators():
        a, b, p = rng.normal(size=(3, 3))
        line = Line.through(a, b - a)
        t = np.dot(p - a, b - a) / np.dot(b - a, b - a)
        nearest = a + t * (b - a)
        assert point_to_line_squared(p, line.l, line.m)[0] == pytest.approx(np.sum((p - nearest) ** 2), abs=1e-12)


def test_point_to_wall():
    for rng in generators():
        a, b, p = rng.normal(size=(3, 3))
        n = unit(np.cross([0.0, 0.0, 1.0], b - a))
        side = wall_side(a, b, p)
        assert side == np.sign(n @ (p - a))
        s = np.concatenate([p, b])
        assert point_to_wall(s, a, 1.0)[0] == pytest.approx(n @ (p - a), abs=1e-12)
        assert point_to_wall(s, a, side)[0] == pytest.approx(abs(n @ (p - a)), abs=1e-12)


def test_two_points_above_each_other_do_not_define_a_wall():
    with pytest.raises(ValueError, match="do not define a vertical plane"):
        wall_side(np.array([1.0, 2.0, 0.0]), np.array([1.0, 2.0, 5.0]), np.zeros(3))


# ---------------------------------------------------------------------- gradients


def test_line_gradient():
    for rng in generators():
        p, line = rng.normal(size=3), Line.through(rng.normal(size=3), rng.normal(size=3))
        expected = central_difference(lambda p, line=line: point_to_line_squared(p, line.l, line.m)[0], p)
        np.testing.assert_allclose(point_to_line_squared(p, line.l, line.m)[1], expected, atol=1e-7)


def test_line_gradient_is_smooth_on_the_axis():
    """The gradient of the distance itself is undefined there, which is why its square is used."""
    line = Line.through([1.0, 2.0, 0.0], [0.0, 0.0, 1.0])
    np.testing.assert_allclose(point_to_line_squared(np.array([1.0, 2.0, 7.0]), line.l, line.m)[1], 0.0, atol=1e-15)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_wall_gradient_of_moving_points(side):
    for rng in generators():
        s, a = rng.normal(size=6), rng.normal(size=3)
        _, gradient = point_to_wall(s, a, side)
        expected = central_difference(lambda s, a=a: point_to_wall(s, a, side)[0], s)
        np.testing.assert_allclose(gradient, expected, atol=1e-7 * max(1.0, np.abs(gradient).max()))
        assert np.abs(gradient[3:]).max() > 1e-4  # the motion of the wall contributes


# ---------------------------------------------------------------------- polygons


def brute_force(p, vertices):
    """Return the distance to a boundary sampled at about 2e-4, with the sign of the winding number."""
    t = np.linspace(0.0, 1.0, 20001)[:, None]
    ends = np.roll(vertices, -1, axis=0)
    boundary = np.concatenate([a + t * (b - a) for a, b in zip(vertices, ends, strict=True)])
    far = np.linalg.norm(boundary - p, axis=1).min()
    to = vertices - p
    angles = np.arctan2(to[:, 1], to[:, 0])
    turns = np.angle(np.exp(1j * (np.roll(angles, -1) - angles))).sum() / (2.0 * np.pi)
    return far if turns > 0.5 else -far


def test_point_to_polygon():
    for rng in generators():
        polygon = ConvexPolygon.hull(rng.normal(size=(8, 2)))
        for p in 1.5 * rng.normal(size=(5, 2)):
            assert polygon.distance(p) == pytest.approx(brute_force(p, polygon.vertices), abs=1e-4)
            assert polygon.distance([*p, 5.0]) == polygon.distance(p)  # the ground projection of a point in space


@pytest.mark.parametrize(
    ("p", "distance"),
    [
        ([0.5, 0.4], 0.4),  # nearest to the lower edge
        ([1.9, 0.6], 0.1),
        ([1.0, -0.3], -0.3),  # beyond an edge
        ([2.3, 1.4], -0.5),  # beyond a corner: distance to the corner
        ([1.0, 0.0], 0.0),  # on the edge
        ([2.0, 1.0], 0.0),  # on a corner
    ],
)
def test_polygon_distances_of_known_points(p, distance):
    assert ConvexPolygon(SQUARE).distance(p) == pytest.approx(distance, abs=1e-15)


def test_hull_omits_points_inside_and_on_edges():
    inner = [[1.0, 0.5], [1.0, 0.0], [2.0, 0.5], [0.3, 0.2]]
    hull = ConvexPolygon.hull([*SQUARE.tolist(), *inner, *SQUARE.tolist()]).vertices
    assert hull.shape == (4, 2)
    assert {tuple(v) for v in hull} == {tuple(v) for v in SQUARE}
    n, d = ConvexPolygon(hull).edges()
    assert (n @ np.array([1.0, 0.5]) - d > 0.0).all()  # counter-clockwise, normals inwards


@pytest.mark.parametrize("offset", [0.0, 1e-9, 1e-6, 1e-3])
def test_a_point_beyond_an_edge_is_moved_onto_the_shrunk_polygon_and_no_further(offset):
    """Two soles side by side, one `offset` [m] ahead: edges that are nearly parallel must not add up."""
    sole, margin = np.array([[-0.072, -0.023], [0.072, -0.023], [0.072, 0.023], [-0.072, 0.023]]), 0.004
    n, d = ConvexPolygon.hull(np.concatenate([sole, sole + np.array([offset, 0.095])])).edges()
    for beyond in (0.005, 0.01, 0.02, 0.04):
        for p in ([0.072 + beyond, 0.05], [0.01, -0.023 - beyond], [0.072 + beyond, -0.023 - beyond]):
            moved = moved_inside(np.array(p), n, d, margin)
            assert abs((n @ moved - d).min() - margin) < 1e-4 * beyond
    inside = np.array([0.01, 0.03])
    assert np.array_equal(moved_inside(inside, n, d, margin), inside)


def test_a_point_is_moved_to_the_nearest_one_of_a_rectangle():
    n, d = ConvexPolygon(SQUARE).edges()
    for rng in generators():
        p, margin = 3.0 * rng.normal(size=2), rng.uniform(0.0, 0.3)
        nearest = np.clip(p, SQUARE.min(axis=0) + margin, SQUARE.max(axis=0) - margin)
        assert moved_inside(p, n, d, margin) == pytest.approx(nearest, abs=1e-12)


@pytest.mark.parametrize("jitter", [0.0, *(10.0**-k for k in range(6, 18))])
def test_no_point_is_outside_of_its_hull(jitter):
    """Two soles side by side, most corners collinear up to `jitter` [m]."""
    rng = np.random.default_rng(0)
    sole = np.array([[-0.072, -0.023], [0.072, -0.023], [0.072, 0.023], [-0.072, 0.023]])
    for _ in range(40):
        ahead, turn = rng.choice([0.0, rng.uniform(-0.06, 0.06)]), rng.choice([0.0, rng.uniform(-np.pi, np.pi)])
        R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        points = np.concatenate([sole, sole + np.array([ahead, 0.095])]) @ R.T + jitter * rng.normal(size=(8, 2))
        n, d = ConvexPolygon.hull(points).edges()
        distances = points @ n.T - d
        assert distances.min() > -2e-9  # the vertices are rounded to 1e-9
        assert distances.min(axis=0).max() < 2e-9  # every edge touches


def test_hull_matches_scipy():
    from scipy.spatial import ConvexHull

    for rng in generators():
        points = rng.normal(size=(30, 2))
        points = np.round(points, 9)
        ours, theirs = ConvexPolygon.hull(points).vertices, points[ConvexHull(points).vertices]
        assert {tuple(v) for v in ours} == {tuple(v) for v in theirs}


@pytest.mark.parametrize("points", [[[0, 0]], [[0, 0], [1, 1]], [[0, 0], [1, 1], [3, 3], [2, 2]], [[1, 1]] * 5])
def test_points_without_an_area_are_rejected(points):
    with pytest.raises(ValueError, match="no convex hull with an area"):
        ConvexPolygon.hull(points)
