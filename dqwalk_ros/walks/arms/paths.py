"""Trajectories of single joints, checked against the limits of the joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import StateError

_MOST_POINTS = 10_000
"""Largest number of points of a trajectory."""
_SPEEDS = "arms.joint_speed, joints.velocity, or the joint's own"
"""What limits the speed of an arm's joint."""


class Limits(NamedTuple):
    """Limits of the joints of all arms."""

    names: tuple[str, ...]
    """Of the joints."""
    low: Array
    high: Array
    """Least and largest angles, shape (k,) [rad]."""
    fastest: Array
    """Largest speeds, shape (k,) [rad/s]."""

    def check(self, place: int, k: int, q: float, v: float) -> None:
        """Raise a `StateError` if an angle or a velocity of a point is not within the limits of its joint."""
        where, low, high = f"point {k + 1} of {self.names[place]}", self.low[place], self.high[place]
        if not low <= q <= high:
            raise StateError(f"{where} is {q:.4g} rad; its limits are {low:.4g} and {high:.4g}")
        if not abs(v) <= self.fastest[place]:
            raise StateError(f"{where} has {v:.4g} rad/s; its limit is {self.fastest[place]:g} ({_SPEEDS})")


@dataclass(frozen=True)
class JointPath:
    """Path of one joint: cubic where velocities are given at the points, otherwise straight from point to point."""

    times: Array
    """Increasing, shape (k,) [s]."""
    angles: Array
    """Shape (k,) [rad]."""
    velocities: Array | None = None
    """Shape (k,) [rad/s]."""

    def at(self, time: float) -> tuple[float, float]:
        """Return angle [rad] and velocity [rad/s] at a time [s]; before and after the path the joint is at rest."""
        times, q, v = self.times, self.angles, self.velocities
        k = int(np.searchsorted(times, time, side="right")) - 1
        if k < 0 or k >= len(times) - 1:
            return float(q[max(k, 0)]), 0.0
        h, way = times[k + 1] - times[k], q[k + 1] - q[k]
        s = (time - times[k]) / h
        if v is None:
            return float(q[k] + s * way), float(way / h)
        a, c, d = _cubic(h, way, v[k], v[k + 1])
        return float(q[k] + s * (a + s * (c + s * d))), float((a + s * (2.0 * c + 3.0 * s * d)) / h)

    def beginning_at(self, q: float) -> JointPath:
        """Return the path that begins at time 0 at rest at the angle `q` [rad], before its first point."""
        v = None if self.velocities is None else np.append(0.0, self.velocities)
        return JointPath(np.append(0.0, self.times), np.append(q, self.angles), v)

    def fastest(self) -> list[float]:
        """Return the largest speed between each two points [rad/s]."""
        out, v = [], self.velocities
        for k, (h, way) in enumerate(zip(np.diff(self.times).tolist(), np.diff(self.angles).tolist(), strict=True)):
            if v is None:
                out.append(abs(way) / h)
                continue
            a, c, d = _cubic(h, way, v[k], v[k + 1])  # its velocity is a parabola
            top = min(max(-c / (3.0 * d), 0.0), 1.0) if d else 0.0
            out.append(max(abs(a + s * (2.0 * c + 3.0 * s * d)) / h for s in (0.0, top, 1.0)))
        return out


def checked(
    limits: Limits, places: Sequence[int], times: ArrayLike, angles: ArrayLike, velocities: ArrayLike | None
) -> list[JointPath]:
    """Return the paths of the joints at some places in `limits`, of points as `Arms.follow` takes; none without points.

    Raises
    ------
    StateError
        If they are not those of a trajectory within the limits; the message names the point.
    """
    t, q = np.atleast_1d(np.asarray(times, dtype=np.float64)), np.asarray(angles, dtype=np.float64)
    v = None if velocities is None else np.asarray(velocities, dtype=np.float64)
    if len(t) > _MOST_POINTS:
        raise StateError(f"the trajectory has {len(t)} points; {_MOST_POINTS} at most")
    if not len(t):
        return []
    for what, matrix in (("positions", q), ("velocities", v)):
        if matrix is not None and matrix.shape != (len(t), len(places)):
            raise StateError(f"the trajectory has {matrix.shape} {what} for {len(t)} points of {len(places)} joints")
    if not (np.isfinite(t).all() and t[0] >= 0.0 and (np.diff(t) > 0.0).all()):
        raise StateError("the times of the trajectory's points are not finite, not positive or not increasing")
    for column, place in enumerate(places):
        for k in range(len(t)):
            limits.check(place, k, float(q[k, column]), 0.0 if v is None else float(v[k, column]))
    paths = [JointPath(t, q[:, k].copy(), None if v is None else v[:, k].copy()) for k in range(len(places))]
    for place, path in zip(places, paths, strict=True):
        for k, needed in enumerate(path.fastest(), start=2):
            if needed > limits.fastest[place] * (1.0 + 1e-9):
                raise StateError(
                    f"{limits.names[place]} needs {needed:.3g} rad/s to point {k} of the trajectory; "
                    f"its limit is {limits.fastest[place]:g} ({_SPEEDS})"
                )
    return paths


def _cubic(h: float, way: float, begin: float, end: float) -> tuple[float, float, float]:
    """Return a, c and d of the way a s + c s^2 + d s^3, s in [0, 1], in a time h [s], by the velocities at its ends."""
    a, b = h * begin, h * end
    return a, 3.0 * way - 2.0 * a - b, a + b - 2.0 * way
