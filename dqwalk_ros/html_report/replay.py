"""What the replay in a report is drawn from: bodies, shapes, joint angles and curves, packed small."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.analysis.series import Series
from dqwalk_ros.dq import DQ
from dqwalk_ros.model import Foot
from dqwalk_ros.scene import Scene, moment_of, shapes_of

__all__ = ["replay_data"]

Array = NDArray[np.float64]
_FRAMES = 2400
"""Pictures kept of a walk; between two of them the replay interpolates."""
_ROUND = 5


def replay_data(series: Series) -> dict[str, Any]:
    """Return plain data for `replay.js`; arrays of numbers as base64 of little-endian float32."""
    trace, model = series.trace, series.trace.model
    starts = [span.start for span in series.spans]
    ticks = np.linspace(0, len(trace) - 1, min(_FRAMES, len(trace))).astype(int)
    ticks = np.unique(np.concatenate([ticks, starts]))
    scene, phases = Scene(trace.config, model), {}  # type: ignore[var-annotated]
    root, com, curves, tight = [], [], {}, []  # type: ignore[var-annotated]
    for row, tick in enumerate(ticks.tolist()):
        view = scene.look(moment_of(trace, tick, phases))
        root.append(view.bodies[0])
        com.append(view.com)
        tight.append(view.tightest.name)
        for gauge in view.gauges:
            if gauge.role != "held":
                curve = curves.setdefault(gauge.name, {"unit": gauge.unit, "v": np.full(len(ticks), np.nan)})
                curve["v"][row] = gauge.value
    x = DQ(np.array(root))
    soles = {}
    for foot in Foot:
        frame = model.frames[model.soles[foot].frame]
        soles[foot.value] = {
            "b": frame.body,
            "corners": [_rounded(DQ(frame.pose).transform_point(c)) for c in model.soles[foot].corners],
        }
    began = float(trace.time[0])
    prints = []
    for span in series.spans:
        corners = DQ(span.record.x_odom_base).transform_point(model.soles[span.phase.base].corners)
        start = float(trace.time[span.start])
        prints.append({"t": start - began, "foot": span.phase.base.value, "c": [_rounded(c) for c in corners]})
    names = list(dict.fromkeys(tight))
    return {
        "robot": model.name,
        "bodies": [
            {"parent": b.parent, "joint": b.joint, **_pose(b.origin), "axis": _rounded(b.axis)} for b in model.bodies
        ],
        "shapes": [
            {"b": s.body, "k": s.kind, "s": list(s.size), "c": list(s.color), **_pose(s.pose)}
            for s in shapes_of(model)
        ],
        "n": model.n,
        "t": _packed(trace.time[ticks] - trace.time[0]),
        "q": _packed(trace.q[ticks]),
        "root": _packed(np.concatenate([x.translation(), np.array(root)[:, :4]], axis=1)),
        "com": _packed(np.array(com)),
        "soles": soles,
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
        "curves": [{"name": name, "unit": c["unit"], "v": _packed(c["v"])} for name, c in curves.items()],
        "tight": {"names": names, "at": base64.b64encode(bytes(names.index(t) for t in tight)).decode()},
    }


def _pose(x: Array) -> dict[str, list[float]]:
    return {"p": _rounded(DQ(x).translation()), "r": [float(v) for v in x[:4]]}


def _rounded(values: Array) -> list[float]:
    return [round(float(v), _ROUND + 2) for v in values]


def _packed(values: Array) -> str:
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode()
