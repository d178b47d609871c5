"""What the ground says of a walk in physics: tilt of the soles, centre of pressure, the true way.

Everything is computed from the true pose of the pelvis, the joint angles and the wrenches on the soles; of what the
controller believes only the phases are used, which say on which soles the robot means to stand.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.report.series import Series
from dqwalk_ros.report.support import hull_margin
from dqwalk_ros.robot import Foot

__all__ = ["COP_INSIDE", "FALLEN", "LANDING", "TILT", "TIPPED", "Circle", "Ground", "ground", "numbers"]

Array = NDArray[np.float64]

TILT = np.radians(2.0)
"""The sole that carries most may lean by this [rad]."""
COP_INSIDE = 0.99
"""The centre of pressure must be inside the support polygon on this part of the ticks."""
LANDING = 5e-3
"""A swing foot must land this close to its footprint [m]."""
FALLEN = 0.6
"""A robot whose pelvis is below this part of its first height has fallen."""
TIPPED = np.radians(20.0)
"""And so has one whose soles lean by this, the one that carries [rad]."""
_TOUCH = 1e-4
"""Contacts are soft: the centre of pressure counts as inside up to here beyond an edge [m]."""
_TURNED = np.radians(60.0)
"""From this turn on a way is taken for an arc."""


@dataclass(frozen=True)
class Circle:
    """The circle nearest to a way.

    Attributes
    ----------
    center : ndarray, shape (2,)
        In the world [m].
    radius, deviation : float
        And the root of the mean square distance from it [m].
    """

    center: Array
    radius: float
    deviation: float

    @classmethod
    def through(cls, p: Array) -> Circle:
        """Return the circle of least squares through the points `p` (N, 2) [m]."""
        A = np.column_stack([2.0 * p, np.ones(len(p))])
        x, y, c = np.linalg.lstsq(A, (p**2).sum(axis=1), rcond=None)[0]
        center, radius = np.array([x, y]), float(np.sqrt(c + x**2 + y**2))
        off = np.linalg.norm(p - center, axis=1) - radius
        return cls(center, radius, float(np.sqrt(np.mean(off**2))))


@dataclass(frozen=True)
class Ground:
    """Series of a walk in physics, one value per tick (N of them), in the world.

    Attributes
    ----------
    soles : dict of Foot to ndarray, shape (N, 8)
        True poses.
    com : ndarray, shape (N, 3)
        [m]
    tilt : ndarray, shape (N,)
        Of the sole that carries more [rad].
    cop_margin : ndarray, shape (N,)
        How far the centre of pressure is inside the soles that the phase stands on [m]; nan in the air.
    height : ndarray, shape (N,)
        Of the pelvis [m].
    stands : ndarray, shape (M, 3)
        x, y [m] and yaw [rad, without jumps] halfway between the feet, where a double support or stance begins and at
        the end.
    circle : Circle or None
        Where the way turned far enough.
    """

    soles: dict[Foot, Array]
    com: Array
    tilt: Array
    cop_margin: Array
    height: Array
    stands: Array
    circle: Circle | None

    @property
    def inside(self) -> float:
        """Part of the ticks whose centre of pressure is inside; one in the air is not."""
        return float(np.mean(np.nan_to_num(self.cop_margin, nan=-np.inf) >= -_TOUCH))

    @property
    def fallen(self) -> bool:
        """Whether the robot fell: its pelvis came down, or it tipped over."""
        low = np.nanmin(self.height) < FALLEN * self.height[np.isfinite(self.height)][0]
        return bool(low or np.nanmax(self.tilt) > TIPPED)


def ground(series: Series) -> Ground | None:
    """Return what the ground says; None for a walk without physics."""
    trace = series.trace
    known = trace.physics
    if known is None or not np.isfinite(known.pelvis).any():
        return None
    model, count = trace.model, len(trace)
    soles = {foot: np.empty((count, 8)) for foot in Foot}
    com, margin = np.empty((count, 3)), np.full(count, np.nan)
    for span in series.spans:
        ticks, base = span.ticks, span.phase.base
        poses = np.array([Kinematics(model, q, base).pose(model.pelvis) for q in trace.q[ticks]])
        x = DQ(known.pelvis[ticks]) * DQ(poses).conj()
        soles[base][ticks] = x.vec8()
        soles[base.other][ticks] = (x * DQ(series.end[ticks])).vec8()
        com[ticks] = x.translation() + x.P().Ad(DQ(series.com[ticks])).vec3()
        feet = tuple(Foot) if span.double else (span.phase.support,)
        corners = [DQ(soles[foot][ticks]).transform_point(c)[:, :2] for foot in feet for c in model.soles[foot].corners]
        margin[ticks] = hull_margin(np.stack(corners, axis=1), known.cop[ticks, :2])
    loads = np.stack([known.wrenches[foot][:, 2] for foot in Foot], axis=1)
    tilts = np.stack([_tilt(soles[foot]) for foot in Foot], axis=1)
    margin[~np.isfinite(known.cop).all(axis=1)] = np.nan
    stands = _stands(series, soles)
    turned = abs(float(stands[-1, 2] - stands[0, 2]))
    return Ground(
        soles=soles,
        com=com,
        tilt=tilts[np.arange(count), np.argmax(np.nan_to_num(loads), axis=1)],
        cop_margin=margin,
        height=DQ(known.pelvis).translation()[:, 2],
        stands=stands,
        circle=Circle.through(stands[1:, :2]) if turned > _TURNED and len(stands) > 5 else None,
    )


def numbers(series: Series, of: Ground) -> dict[str, Any]:
    """Return the figures of a walk in physics, of plain types only."""
    known, stands = series.trace.physics, of.stands
    assert known is not None  # there is a ground
    steps = sum(not span.double and span.ending is not None for span in series.spans)
    way = np.linalg.norm(np.diff(stands[:, :2], axis=0), axis=1).sum()
    at, duration = int(np.nanargmax(of.tilt)), float(series.time[-1] - series.time[0])
    landed = [
        float(DQ(of.soles[span.phase.support.other][span.end]).translation()[2])
        for span in series.spans
        if not span.double and span.ending is not None and span.end < len(series.time)
    ]
    out: dict[str, Any] = {
        "steps": steps,
        "way": float(way),
        "displacement": [float(x) for x in stands[-1, :2] - stands[0, :2]],
        "turned": float(stands[-1, 2] - stands[0, 2]),
        "seconds_per_step": duration / steps if steps else None,
        "tilt": {"value": float(of.tilt[at]), "time": float(series.time[at])},
        "cop_inside": of.inside,
        "cop_margin": float(np.nanmin(of.cop_margin)) if np.isfinite(of.cop_margin).any() else None,
        "landing_height": max(landed, default=None),
        "fallen": of.fallen,
        "swing_load": _swing_load(series),
        "odometry_drift": _drift(series, of),
    }
    if of.circle is not None:
        out["circle"] = {"radius": of.circle.radius, "deviation": of.circle.deviation}
    return out


def _swing_load(series: Series) -> float | None:
    """Return the part of the weight on the foot that swings, the median of all ticks; None where none swings."""
    known, parts = series.trace.physics, []
    assert known is not None  # there is a ground
    for span in series.spans:
        if not span.double:
            swing = known.wrenches[span.phase.support.other][span.ticks, 2]
            parts.append(swing / np.maximum(swing + known.wrenches[span.phase.support][span.ticks, 2], 1e-3))
    part = np.concatenate(parts) if parts else np.empty(0)
    return float(np.nanmedian(part)) if np.isfinite(part).any() else None


def _tilt(x: Array) -> Array:
    """Return the angle between the normals of soles (N, 8) and the vertical, shape (N,) [rad]."""
    out: Array = 2.0 * np.arcsin(np.clip(np.hypot(x[:, 1], x[:, 2]), 0.0, 1.0))
    return out


def _stands(series: Series, soles: dict[Foot, Array]) -> Array:
    ticks = [span.start for span in series.spans if span.double] + [len(series.time) - 1]
    places, yaws = [], []
    for foot in Foot:
        x = DQ(soles[foot][ticks])
        places.append(x.transform_point(series.trace.model.soles[foot].center)[:, :2])
        ahead = x.P().Ad(DQ(np.array([1.0, 0.0, 0.0]))).vec3()
        yaws.append(np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0])))
    return np.column_stack([np.mean(places, axis=0), np.mean(yaws, axis=0)])


def _drift(series: Series, of: Ground) -> float:
    """Return how far odometry ends from the truth, both seen from the first base sole [m]."""
    first, last = series.spans[0], series.spans[-1]
    base = last.phase.base
    true = DQ(of.soles[first.phase.base][0]).conj() * DQ(of.soles[base][-1])
    told = DQ(first.record.x_odom_base).conj() * DQ(last.record.x_odom_base)
    return float(np.linalg.norm((true.translation() - told.translation())[:2]))
