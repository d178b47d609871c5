"""Margins to many convex hulls, against those of one."""

from __future__ import annotations

import numpy as np
import pytest

from dqwalk_ros.paper.geometry import ConvexPolygon
from dqwalk_ros.report.hull import hull_margin


@pytest.mark.parametrize("count", [4, 8])
def test_vectorized_hull_margins_match_single_ones(count):
    rng = np.random.default_rng(3)
    points, p = rng.normal(size=(5000, count, 2)), rng.normal(scale=1.2, size=(5000, 2))
    one_by_one = [ConvexPolygon.hull(k).distance(q) for k, q in zip(points, p, strict=True)]
    np.testing.assert_allclose(hull_margin(points, p), one_by_one, atol=2e-9)  # a hull rounds to 1e-9
    assert min(one_by_one) < 0.0 < max(one_by_one)


def test_hulls_of_touching_soles():
    """Coinciding corners and collinear edges, as of two soles side by side."""
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    points = np.concatenate([square, square + np.array([1.0, 0.0])])[None]
    for p, expected in (([1.0, 0.4], 0.4), ([0.25, 0.5], 0.25), ([3.0, 0.5], -1.0), ([3.0, 2.0], -np.sqrt(2.0))):
        assert hull_margin(points, np.array([p]))[0] == pytest.approx(expected)
