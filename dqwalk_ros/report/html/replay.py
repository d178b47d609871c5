"""Data of the replay in a report: bodies, shapes, joint angles and curves, as compact JSON."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import compose
from dqwalk_ros.report.metrics import Series
from dqwalk_ros.report.scene import BodyShape, Moments, Scene, shapes_of, tightest
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array

__all__ = ["FRAMES", "replay_data", "robot_data", "walk_data"]

FRAMES = 2400
"""Number of frames of a walk; the replay interpolates between them."""
_DIGITS = 7
"""Digits of positions in JSON, to keep the file small."""


def replay_data(series: Series) -> dict[str, Any]:
    """Return the data of a walk of phases; see `walk_data`."""
    trace, model = series.trace, series.trace.model
    starts = [span.start for span in series.spans]
    ticks = np.linspace(0, len(trace) - 1, min(FRAMES, len(trace))).astype(int)
    ticks = np.unique(np.concatenate([ticks, starts]))
    scene, moments = Scene(trace.config, model), Moments(trace, (span.phase for span in series.spans))
    root, com, curves, tight = [], [], {}, []  # type: ignore[var-annotated]
    for row, tick in enumerate(ticks.tolist()):
        moment = moments.at(tick)
        kin, found = scene.assess(moment)
        gauges = scene.gauges(moment.phase, found)
        root.append(compose(moment.x_odom_base, kin.pose(model.root)))
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
        trace.config, model, trace.time[ticks] - trace.time[0], trace.q[ticks], np.array(root), np.array(com),
        prints, phases, curves, tight,
    )  # fmt: skip


def walk_data(
    config: Config,
    model: RobotModel,
    time: Array,
    q: Array,
    x_root: Array,
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
    time, q, x_root, com : ndarray, shapes (N,) [s], (N, n) [rad], (N, 8), (N, 3) [m]
        Of each frame: time since the first one, joint angles, pose of the first body, centre of mass.
    prints : sequence of (time, Foot, corners)
        Each footprint with the time from which it is shown [s] and its corners (4, 3) [m].
    phases : sequence of (time, name, double support, base foot)
    curves : mapping of str to (unit, ndarray of shape (N,))
    tight : sequence of str
        Name of the curve that is marked in each frame.
    points : sequence of (color, ndarray of shape (N, 3))
        Further points that are drawn as balls: red, green and blue from 0 to 1, and positions [m], nan where absent.
    """
    names = list(dict.fromkeys(tight))
    return {
        **robot_data(config, model),
        "t": _packed(time),
        "q": _packed(q),
        "root": _packed(np.concatenate([DQ(x_root).translation(), x_root[:, :4]], axis=1)),
        "com": _packed(com),
        "prints": [{"t": t, "foot": foot.value, "c": [_rounded(c) for c in corners]} for t, foot, corners in prints],
        "phases": [{"name": name, "t": t, "double": both, "base": base.value} for t, name, both, base in phases],
        "curves": [{"name": name, "unit": unit, "v": _packed(v)} for name, (unit, v) in curves.items()],
        "points": [{"color": color, "v": _packed(v)} for color, v in points],
        "tight": {"names": names, "at": base64.b64encode(bytes(names.index(name) for name in tight)).decode()},
    }


def robot_data(config: Config, model: RobotModel) -> dict[str, Any]:
    """Return the constant data of a robot: bodies, their shapes, and the corners of the soles."""
    soles = {}
    for foot in Foot:
        frame = model.frames[model.soles[foot].frame]
        corners = [_rounded(DQ(frame.pose).transform_point(c)) for c in model.soles[foot].corners]
        soles[foot.value] = {"b": frame.body, "corners": corners}
    return {
        "bodies": [
            {"parent": b.parent, "joint": b.joint, **_pose(b.origin), "axis": _rounded(b.axis)} for b in model.bodies
        ],
        "shapes": [
            {"b": s.body, "k": s.kind, **_size(s), "c": list(s.color), **_pose(s.pose)}
            for s in shapes_of(config, model)
        ],
        "n": model.n,
        "soles": soles,
    }


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
