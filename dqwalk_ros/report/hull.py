"""The margin of points to convex hulls, for many of them at once."""

from __future__ import annotations

import numpy as np

from dqwalk_ros.support.arrays import Array

_BLOCK = 2000
"""Number of hulls computed at a time; one takes some kilobytes."""
_TINY = 1e-12
"""Length below which two points are one, and distance within which a point is on an edge [m]."""


def hull_margin(points: Array, p: Array) -> Array:
    """Return the signed distance of each point p[i] to the convex hull of points[i], positive inside.

    Equal to `geometry.ConvexPolygon.hull(points[i]).distance(p[i])`, for all i at once: a segment between two points is
    an edge of the hull if all other points are to its left.

    Parameters
    ----------
    points : ndarray, shape (N, k, 2) [m]
    p : ndarray, shape (N, 2) [m]

    Returns
    -------
    ndarray, shape (N,) [m]
    """
    if len(p) > _BLOCK:
        blocks = [slice(first, first + _BLOCK) for first in range(0, len(p), _BLOCK)]
        return np.concatenate([hull_margin(points[block], p[block]) for block in blocks])
    i, j = np.nonzero(~np.eye(points.shape[1], dtype=bool))  # m ordered pairs
    a = points[:, i]  # (N, m, 2)
    t = points[:, j] - a
    length = np.maximum(np.linalg.norm(t, axis=2), _TINY)
    n = np.stack([-t[..., 1], t[..., 0]], axis=2) / length[..., None]
    side = np.einsum("nmc,nkc->nmk", n, points) - np.einsum("nmc,nmc->nm", n, a)[..., None]
    edge = (side >= -_TINY).all(axis=2) & (length > 10.0 * _TINY)
    v = p[:, None] - a
    inside = np.where(edge, np.einsum("nmc,nmc->nm", v, n), np.inf).min(axis=1)
    s = np.clip(np.einsum("nmc,nmc->nm", v, t) / length**2, 0.0, 1.0)
    outside = np.where(edge, np.linalg.norm(v - s[..., None] * t, axis=2), np.inf).min(axis=1)
    out: Array = np.where(inside >= 0.0, inside, -outside)
    return out
