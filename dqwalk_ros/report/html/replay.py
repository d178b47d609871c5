"""Data of the replay in a report: shapes, poses of the bodies and curves, as compact JSON."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.report.metrics import Series
from dqwalk_ros.report.scene import BodyShape, Moments, Scene, bodies_of, shapes_of, tightest
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array

__all__ = ["frames_of", "replay_data", "shape_data", "walk_data"]

_FRAMES, _RATE = 2400, 60.0
"""Largest number of frames of a walk, and largest rate [Hz]; the replay interpolates between them."""
_DIGITS = 7
"""Digits of positions in JSON, to keep the file small."""


def frames_of(time: Array) -> NDArray[np.intp]:
    """Return the indices of the states that are the frames of a walk, given the times of its states (N,) [s]."""
    count = min(len(time), _FRAMES, math.ceil(_RATE * float(time[-1] - time[0])) + 1)
    return np.unique(np.linspace(0, len(time) - 1, count).astype(np.intp))


def replay_data(series: Series) -> dict[str, Any]:
    """Return the data of a walk of phases; see `walk_data`."""
    trace, model = series.trace, series.trace.model
    starts = [span.start for span in series.spans]
    ticks = np.unique(np.concatenate([frames_of(trace.time), starts]))
    scene, moments = Scene(trace.config, model), Moments(trace, (span.phase for span in series.spans))
    bodies, com, curves, tight = [], [], {}, []  # type: ignore[var-annotated]
    for row, tick in enumerate(ticks.tolist()):
        moment = moments.at(tick)
        kin, found = scene.assess(moment)
        gauges = scene.gauges(moment.phase, found)
        bodies.append(bodies_of(kin, moment.x_odom_base))
        com.append(DQ(moment.x_odom_base).transform_point(kin.com))
        tight.append(tightest(gauges).name)
        for gauge in gauges:
            if gauge.role != "held":
                curves.setdefault(gauge.name, (gauge.unit, np.full(len(ticks), np.nan)))[1][row] = gauge.value
    if trace.loads is not None:
        curves |= {f"load on the {foot.value} sole": ("N", trace.loads[ticks, k]) for k, foot in enumerate(Foot)}
    prints, phases = [], []
    for span in series.spans:
        start, base = float(trace.time[span.start] - trace.time[0]), span.phase.base
        prints.append((start, base, DQ(span.record.x_odom_base).transform_point(model.soles[base].corners)))
        phases.append((start, span.phase.name, span.double, base))
    return walk_data(
        trace.config, model, trace.time[ticks] - trace.time[0], np.array(bodies), np.array(com),
        prints, phases, curves, tight,
    )  # fmt: skip


def walk_data(
    config: Config,
    model: RobotModel,
    time: Array,
    bodies: Array,
    com: Array,
    prints: Sequence[tuple[float, Foot, Array]],
    phases: Sequence[tuple[float, str, bool, Foot]],
    curves: Mapping[str, tuple[str, Array]],
    tight: Sequence[str],
    points: Sequence[tuple[tuple[float, float, float], Array]] = (),
) -> dict[str, Any]:
    """Return plain data for `replay.js`; arrays of numbers as base64 of little-endian float32.

    Parameters
    ----------
    time, bodies, com : ndarray, shapes (N,) [s], (N, B, 8), (N, 3) [m]
        Of each frame: time since the first one, poses of the bodies, centre of mass.
    prints : sequence of (time, Foot, corners)
        Each footprint with the time from which it is shown [s] and its corners (4, 3) [m].
    phases : sequence of (time, name, double support, base foot)
    curves : mapping of str to (unit, ndarray of shape (N,))
    tight : sequence of str
        Name of the curve that is marked in each frame.
    points : sequence of (color, ndarray of shape (N, 3))
        Further points that are drawn as balls: red, green and blue from 0 to 1, and positions [m], nan where absent.
    """
    names, shapes = list(dict.fromkeys(tight)), shapes_of(config, model)
    p, r = DQ(bodies).translation(), DQ(bodies).rotation().copy()
    r[1:] *= np.where((r[1:] * r[:-1]).sum(-1, keepdims=True) < 0.0, -1.0, 1.0).cumprod(axis=0)  # r and -r are the same
    corners = np.stack([_corners(model, bodies, foot) for foot in Foot], axis=1)  # (N, 2, 4, 3)
    tops = [DQ(bodies[0, s.body]).transform_point(DQ(s.pose).translation())[2] for s in shapes]
    return {
        "shapes": [shape_data(shape) for shape in shapes],
        "height": float(max(*tops, *p[0, :, 2]) - corners[0, ..., 2].min()),
        "t": _packed(time),
        "bodies": _packed(np.concatenate([p, r], axis=-1)),
        "corners": _packed(corners),
        "com": _packed(com),
        "prints": [{"t": t, "foot": foot.value, "c": [_rounded(c) for c in corners]} for t, foot, corners in prints],
        "phases": [{"name": name, "t": t, "double": both, "base": base.value} for t, name, both, base in phases],
        "curves": [{"name": name, "unit": unit, "v": _packed(v)} for name, (unit, v) in curves.items()],
        "points": [{"color": color, "v": _packed(v)} for color, v in points],
        "tight": {"names": names, "at": base64.b64encode(bytes(names.index(name) for name in tight)).decode()},
    }


def _corners(model: RobotModel, bodies: Array, foot: Foot) -> Array:
    """Return the corners of a sole (N, 4, 3) [m], given the poses of all bodies (N, B, 8)."""
    sole = model.soles[foot]
    frame = model.frames[sole.frame]
    x = DQ(bodies[:, [frame.body]]) * DQ(frame.pose)
    return x.transform_point(sole.corners)


def shape_data(shape: BodyShape) -> dict[str, Any]:
    """Return the data of a shape: its body, kind, size, colour and pose, and the triangles of a mesh."""
    return {"b": shape.body, "k": shape.kind, **_size(shape), "c": list(shape.color), **_pose(shape.pose)}


def _size(shape: BodyShape) -> dict[str, Any]:
    if shape.vertices is None or shape.faces is None:
        return {"s": list(shape.size)}
    return {"s": [1.0, 1.0, 1.0], "v": _packed(shape.vertices), "f": _packed(shape.faces, "<u4")}


def _pose(x: Array) -> dict[str, list[float]]:
    return {"p": _rounded(DQ(x).translation()), "r": [float(v) for v in x[:4]]}


def _rounded(values: Array) -> list[float]:
    """Return numbers for JSON, rounded to keep the file small."""
    return [round(float(v), _DIGITS) for v in values]


def _packed(values: NDArray[Any], kind: str = "<f4") -> str:
    """Return numbers as base64 of little-endian float32, or of another type."""
    return base64.b64encode(np.ascontiguousarray(values, kind).tobytes()).decode()
