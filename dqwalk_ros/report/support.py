"""The ground a robot truly stands on: its soles, and how far inside their hull a point is."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.errors import ModelError
from dqwalk_ros.robot import Foot, Sole, parse_model
from dqwalk_ros.simulation import Trace

__all__ = ["hull_margin", "urdf_soles"]

Array = NDArray[np.float64]
_BLOCK = 2000
"""Ticks at a time; a tick takes some kilobytes."""
_TINY = 1e-12


def hull_margin(points: Array, p: Array) -> Array:
    """Signed distance of many points, each to the convex hull of its own points, positive inside.

    What `geometry.ConvexPolygon.hull(points[i]).distance(p[i])` gives, for all at once: a segment between two of the
    points is an edge of the hull where all others are to its left.

    Parameters
    ----------
    points : ndarray, shape (N, k, 2) [m]
    p : ndarray, shape (N, 2) [m]

    Returns
    -------
    ndarray, shape (N,) [m]
    """
    out = np.empty(len(p))
    for first in range(0, len(p), _BLOCK):
        block = slice(first, first + _BLOCK)
        out[block] = _hull_margin(points[block], p[block])
    return out


def _hull_margin(points: Array, p: Array) -> Array:
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


def urdf_soles(trace: Trace) -> Mapping[Foot, Sole] | None:
    """Return the soles as the collision boxes of the URDF have them; None where ours agree."""
    robot = dataclasses.replace(trace.config.robot, sole_length=0.0, sole_width=0.0, sole_center="link")
    try:
        soles = parse_model(trace.model.urdf, robot).soles
    except ModelError:
        return None
    mine = trace.model.soles
    same = all(np.allclose(soles[foot].corners, mine[foot].corners, atol=1e-6) for foot in Foot)
    return None if same else soles
