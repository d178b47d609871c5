"""Data of the replay in a report: bodies, shapes, joint angles and curves, as compact JSON."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.kinematics import compose
from dqwalk_ros.report.metrics import Series
from dqwalk_ros.report.scene import Scene, Shape, moment_of, shapes_of, tightest
from dqwalk_ros.robot import Foot, RobotModel

__all__ = ["FRAMES", "packed", "replay_data", "robot_data", "rounded"]

Array = NDArray[np.float64]
FRAMES = 2400
"""Number of frames of a walk; the replay interpolates between them."""
_ROUND = 5


def replay_data(series: Series) -> dict[str, Any]:
    """Return plain data for `replay.js`; arrays of numbers as base64 of little-endian float32."""
    trace, model = series.trace, series.trace.model
    starts = [span.start for span in series.spans]
    ticks = np.linspace(0, len(trace) - 1, min(FRAMES, len(trace))).astype(int)
    ticks = np.unique(np.concatenate([ticks, starts]))
    scene, phases = Scene(trace.config, model), {}  # type: ignore[var-annotated]
    root, com, curves, tight = [], [], {}, []  # type: ignore[var-annotated]
    for row, tick in enumerate(ticks.tolist()):
        moment = moment_of(trace, tick, phases)
        kin, found = scene.assess(moment)
        gauges = scene.gauges(moment.phase, found)
        root.append(compose(moment.x_odom_base, kin.pose(scene.root)))
        com.append(DQ(moment.x_odom_base).transform_point(kin.com))
        tight.append(tightest(gauges).name)
        for gauge in gauges:
            if gauge.role != "held":
                curve = curves.setdefault(gauge.name, {"unit": gauge.unit, "v": np.full(len(ticks), np.nan)})
                curve["v"][row] = gauge.value
    x = DQ(np.array(root))
    began = float(trace.time[0])
    prints = []
    for span in series.spans:
        corners = DQ(span.record.x_odom_base).transform_point(model.soles[span.phase.base].corners)
        start = float(trace.time[span.start])
        prints.append({"t": start - began, "foot": span.phase.base.value, "c": [rounded(c) for c in corners]})
    names = list(dict.fromkeys(tight))
    return {
        **robot_data(trace.config, model),
        "t": packed(trace.time[ticks] - trace.time[0]),
        "q": packed(trace.q[ticks]),
        "root": packed(np.concatenate([x.translation(), np.array(root)[:, :4]], axis=1)),
        "com": packed(np.array(com)),
        "prints": prints,
        "phases": [
            {
                "name": span.phase.name,
                "t": float(trace.time[span.start]) - began,
                "double": span.double,
                "base": span.phase.base.value,
            }
            for span in series.spans
        ],
        "curves": [{"name": name, "unit": c["unit"], "v": packed(c["v"])} for name, c in curves.items()],
        "tight": {"names": names, "at": base64.b64encode(bytes(names.index(t) for t in tight)).decode()},
    }


def robot_data(config: Config, model: RobotModel) -> dict[str, Any]:
    """Return the constant data of a robot: bodies, their shapes, and the corners of the soles."""
    soles = {}
    for foot in Foot:
        frame = model.frames[model.soles[foot].frame]
        corners = [rounded(DQ(frame.pose).transform_point(c)) for c in model.soles[foot].corners]
        soles[foot.value] = {"b": frame.body, "corners": corners}
    return {
        "robot": model.name,
        "bodies": [
            {"parent": b.parent, "joint": b.joint, **_pose(b.origin), "axis": rounded(b.axis)} for b in model.bodies
        ],
        "shapes": [
            {"b": s.body, "k": s.kind, **_size(s), "c": list(s.color), **_pose(s.pose)}
            for s in shapes_of(config, model)
        ],
        "n": model.n,
        "soles": soles,
    }


def _size(shape: Shape) -> dict[str, Any]:
    if shape.vertices is None or shape.faces is None:
        return {"s": list(shape.size)}
    return {"s": [1.0, 1.0, 1.0], "v": packed(shape.vertices), "f": packed(shape.faces, "<u4")}


def _pose(x: Array) -> dict[str, list[float]]:
    return {"p": rounded(DQ(x).translation()), "r": [float(v) for v in x[:4]]}


def rounded(values: Array) -> list[float]:
    """Return numbers for JSON, rounded to keep the file small."""
    return [round(float(v), _ROUND + 2) for v in values]


def packed(values: NDArray[Any], kind: str = "<f4") -> str:
    """Return numbers as base64 of little-endian float32, or of another type."""
    return base64.b64encode(np.ascontiguousarray(values, kind).tobytes()).decode()
