"""What a walk was worth: each phase and all of it, in numbers."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros import __version__
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.report.ground import numbers
from dqwalk_ros.report.series import Series
from dqwalk_ros.report.violations import groenwall, landing, settled_height, unit_norm_error, violations
from dqwalk_ros.robot import Foot

__all__ = ["report"]

Array = NDArray[np.float64]


def report(series: Series) -> dict[str, Any]:
    """Return everything there is to say about a walk, of plain types only.

    Returns
    -------
    dict
        ``ok``, ``violations`` (see `violations.Violation`), ``walk``, ``physics`` (None without), ``phases`` (a list),
        ``solve_time``, ``robot``, ``config`` and ``notes``. Lengths in metres, angles in radians, times in seconds.
    """
    trace = series.trace
    phases = [_phase(series, index) for index in range(len(series.spans))]
    broken, stood = violations(series), series.ground
    return {
        "format": "dqwalk_ros report 1",
        "version": __version__,
        "ok": not broken,
        "violations": [asdict(violation) for violation in broken],
        "walk": _walk(series, phases),
        "physics": None if stood is None else numbers(series, stood),
        "phases": phases,
        "solve_time": _solve_time(trace.solve_time),
        "robot": {
            "name": trace.model.name,
            "joints": list(trace.model.joint_names),
            "mass": trace.model.mass,
            "sole": {
                "length": trace.model.soles[Foot.LEFT].length,
                "width": trace.model.soles[Foot.LEFT].width,
            },
        },
        "config": {
            name: list(value) if isinstance(value, tuple) else value for name, value in trace.config.flat().items()
        },
        "notes": list(trace.notes),
    }


# ---------------------------------------------------------------------- numbers


def _least(series: Series, values: Array, ticks: slice = slice(None)) -> dict[str, float]:
    """Return the least value over some ticks and when it was."""
    part = values[ticks]
    at = int(np.nanargmin(part))
    return {"value": float(part[at]), "time": float(series.time[ticks][at])}


def _phase(series: Series, index: int) -> dict[str, Any]:
    span = series.spans[index]
    ending = span.ending
    distances = {name: column[span.ticks] for name, column in series.distances.items()}
    minimum = {
        name: _least(series, series.distances[name], span.ticks)
        for name, d in distances.items()
        if np.isfinite(d).any()
    }
    worst = min(minimum, key=lambda name: minimum[name]["value"])
    out: dict[str, Any] = {
        "index": index,
        "name": span.phase.name,
        "kind": span.phase.kind.value,
        "support": span.phase.support.value,
        "start": float(series.time[span.start]),
        "end": float(series.time[min(span.end, len(series.time) - 1)]),
        "ticks": span.end - span.start,
        "ended": ending is not None,
        "error": {
            "first": float(series.error[span.start]),
            "last": float(ending.error if ending else series.error[span.end - 1]),
        },
        "minimum": minimum,
        "worst": {"name": worst, **minimum[worst], "violation": max(0.0, -minimum[worst]["value"])},
        "residual": {
            name: float(np.nanmax(np.abs(column[span.ticks])))
            for name, column in series.residuals.items()
            if np.isfinite(column[span.ticks]).any()
        },
        "groenwall": {name: slack for name, slack, _ in groenwall(series, span)},
        "margin": _margins(series, span.ticks),
    }
    if span.double:
        out["slide"] = float(np.nanmax(series.slide[span.ticks]))
        out["tip_height_settled"] = settled_height(series, span)[0]
        out["com_to_axis"] = float(ending.com_to_axis if ending else series.com_to_axis[span.end - 1])
    elif ending is not None:
        out["landing"] = landing(span, ending)
    return out


def _margins(series: Series, ticks: slice) -> dict[str, dict[str, float]]:
    """Return the least of each margin of the CoM and of the joints."""
    out = {}
    if series.trace.config.gait.style == "paper":
        out["paper"] = _least(series, series.paper_margin, ticks)
    out["true"] = _least(series, series.true_margin, ticks)
    if series.urdf_margin is not None:
        out["true_urdf_sole"] = _least(series, series.urdf_margin, ticks)
    for name, values in (("true", series.true_margin), ("true_urdf_sole", series.urdf_margin)):
        if values is not None and (outside := np.flatnonzero(values[ticks] < 0.0)).size:
            out[name]["outside_from"] = float(series.time[ticks][outside[0]])
    out["joints"] = _least(series, series.joint_margin.min(axis=1), ticks)
    return out


def _walk(series: Series, phases: list[dict[str, Any]]) -> dict[str, Any]:
    trace = series.trace
    landings = [phase["landing"] for phase in phases if "landing" in phase]
    joint = int(np.argmin(series.joint_margin.min(axis=0)))
    begin, end = _between_the_feet(series, 0), _between_the_feet(series, len(series.time) - 1)
    speed = np.abs(trace.u) / trace.model.velocity_max
    return {
        "finished": trace.finished,
        "duration": float(series.time[-1] - series.time[0]),
        "ticks": len(series.time),
        "steps": len(landings),
        "distance": float(np.linalg.norm(end - begin)),
        "forward": float(end[0] - begin[0]),
        "lateral": float(end[1] - begin[1]),
        "turned": _turned(series),
        "landing_error": max((landing["error"] for landing in landings), default=None),
        "margin": _margins(series, slice(None)),
        "closest_joint": trace.model.joint_names[joint],
        "joint_speed": {
            "largest": float(np.nanmax(np.abs(trace.u), initial=0.0)),
            "of_limit": float(np.nanmax(speed, initial=0.0)),
        },
        "unit_norm_error": unit_norm_error(series),
        "unanswered": int(np.count_nonzero(~np.isfinite(trace.u).all(axis=1))),
    }


def _between_the_feet(series: Series, tick: int) -> Array:
    """Return the middle of the soles in odom, shape (2,) [m]."""
    span = series.spans[int(series.span_of[tick])]
    x, soles, base = DQ(span.record.x_odom_base), series.trace.model.soles, span.phase.base
    there = (x * DQ(series.end[tick])).transform_point(soles[base.other].center)
    middle: Array = 0.5 * (x.transform_point(soles[base].center) + there)[:2]
    return middle


def _turned(series: Series) -> float:
    """Return how far the base soles turned to the left, beyond a full turn too [rad]."""
    ahead = np.array([DQ(span.record.x_odom_base).rotation_matrix()[:, 0] for span in series.spans])
    yaw = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    return float(yaw[-1] - yaw[0])


def _solve_time(values: Array) -> dict[str, float] | None:
    known = values[np.isfinite(values)]
    if not len(known):
        return None
    return {
        "median": float(np.median(known)),
        "p99": float(np.percentile(known, 99)),
        "max": float(known.max()),
    }
