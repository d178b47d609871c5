"""The ground a robot truly stands on: its soles, and how far inside their hull a point is."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.bag.reader import model_of
from dqwalk_ros.exceptions import ModelError
from dqwalk_ros.geometry import ConvexPolygon
from dqwalk_ros.model import Foot, Sole
from dqwalk_ros.trace import Trace

__all__ = ["polygon_margin", "urdf_soles"]

Array = NDArray[np.float64]


def polygon_margin(polygon: ConvexPolygon, p: Array) -> Array:
    """Signed distance [m] of points (N, 2) to one polygon, as `geometry.point_to_polygon` has it of one point."""
    n, d = polygon.edges()
    inside = (p @ n.T - d).min(axis=1)
    a = polygon.vertices
    t = np.roll(a, -1, axis=0) - a
    v = p[:, None] - a  # (N, m, 2)
    s = np.clip(np.einsum("kij,ij->ki", v, t) / np.einsum("ij,ij->i", t, t), 0.0, 1.0)
    outside = np.linalg.norm(v - s[..., None] * t, axis=2).min(axis=1)
    out: Array = np.where(inside >= 0.0, inside, -outside)
    return out


def urdf_soles(trace: Trace) -> Mapping[Foot, Sole] | None:
    """Return the soles as the URDF's own boxes have them; None where there are none, or none but these."""
    robot = dataclasses.replace(trace.config.robot, sole_length=0.0, sole_width=0.0, sole_center="link")
    try:
        soles = model_of(trace.model.urdf, robot).soles
    except ModelError:
        return None
    mine = trace.model.soles
    same = all(np.allclose(soles[foot].corners, mine[foot].corners, atol=1e-6) for foot in Foot)
    return None if same else soles
