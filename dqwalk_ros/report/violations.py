"""Where a walk broke a rule.

The rules are those of the paper, in discrete time: no distance below its bound, each falling no faster than
``d[k] >= (1 - eta dt)^k d[0]`` (Groenwall's inequality for Euler's method), the end foot on the ground in double
support, every phase ended by its own rule, every step landed where it should.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.report.ground import COP_INSIDE, FALLEN, LANDING, TILT
from dqwalk_ros.report.series import Ending, Series, Span

__all__ = [
    "GROUND_TOLERANCE",
    "LANDING_TOLERANCE",
    "UNIT_TOLERANCE",
    "Violation",
    "groenwall",
    "landing",
    "settled_height",
    "unit_norm_error",
    "violations",
]

GROUND_TOLERANCE = 2e-5
"""Height [m] the end foot's tip may have once it has come down; the paper saw 1e-5 of discretisation."""
LANDING_TOLERANCE = 2.1
"""Largest landing error [m] per unit of `ssp.threshold`: ||vec8|| of a pure translation t is |t| / 2."""
UNIT_TOLERANCE = 1e-12
"""How far from one the norm of a pose may be."""


@dataclass(frozen=True)
class Violation:
    """A rule that was broken.

    Attributes
    ----------
    what : str
        Name of the distance or of the rule.
    phase : str
        Name of the phase; empty where it is the whole walk.
    time : float
        [s]
    value, allowed : float
    message : str
        All of it in one sentence.
    """

    what: str
    phase: str
    time: float
    value: float
    allowed: float
    message: str


def violations(series: Series) -> list[Violation]:
    """Return every rule that was broken, in the order of time within each phase."""
    return [*_of_the_phases(series), *_of_the_walk(series), *_of_the_ground(series)]


def landing(span: Span, ending: Ending) -> dict[str, float]:
    """Return where the swing foot landed and how far from its target [m, rad], in the support sole's frame."""
    target = span.record.swing_target
    assert target is not None  # single support has one
    off = DQ(target).conj() * DQ(ending.end)
    return {
        "x": float(DQ(ending.end).translation()[0]),
        "y": float(DQ(ending.end).translation()[1]),
        "z": float(DQ(ending.end).translation()[2]),
        "error": float(np.linalg.norm(off.translation())),
        "angle": float(2.0 * np.arctan2(np.linalg.norm(off.vec4()[1:]), abs(off.vec4()[0]))),
    }


def groenwall(series: Series, span: Span) -> Iterator[tuple[str, float, int]]:
    """Yield name, least slack ``d[k] - (1 - eta dt)^k d[0]`` and its tick for each constraint of a phase.

    An equality converges from either side: its slack is ``(1 - eta dt)^k |d[0]| - |d[k]|``.
    """
    dt = series.trace.config.dt
    k = np.round((series.time[span.ticks] - series.time[span.start]) / dt)
    for table, rows, sign in (
        (series.distances, span.phase.constraints, 1.0),
        (series.residuals, span.phase.equalities, -1.0),
    ):
        for row in rows:
            if math.isfinite(row.return_speed):
                continue  # its return is not at the rate eta
            d = table[row.name][span.ticks]
            d = d if sign > 0.0 else -np.abs(d)
            slack = d - (1.0 - min(1.0, row.eta * dt)) ** k * d[0]
            at = int(np.nanargmin(slack))
            yield row.name, float(slack[at]), span.start + at


def settled_height(series: Series, span: Span) -> tuple[float | None, int]:
    """Return the largest height of the end foot's tip [m] once it has come down to the ground, and its tick."""
    settle = 10.0 / series.trace.config.dsp.eta_ground
    first = span.start + int(np.searchsorted(series.time[span.ticks], series.time[span.start] + settle))
    if first >= span.end:
        return None, first
    at = first + int(np.argmax(np.abs(series.tip_height[first : span.end])))
    return float(series.tip_height[at]), at


def _of_the_phases(series: Series) -> Iterator[Violation]:
    """Yield what each phase broke."""
    config, tolerance = series.trace.config, series.trace.config.monitor.tolerance
    for span in series.spans:
        name = span.phase.name

        def broken(what: str, tick: int, value: float, allowed: float, message: str, name: str = name) -> Violation:
            time = float(series.time[tick])
            return Violation(what, name, time, value, allowed, f"{name} at {time:.3f} s: {message}")

        for row in span.phase.constraints:
            d = series.distances[row.name][span.ticks]
            at = int(np.nanargmin(d))
            if d[at] < -tolerance:
                yield broken(
                    row.name,
                    span.start + at,
                    float(d[at]),
                    -tolerance,
                    f"{row.name} is {d[at]:.3g} beyond its bound",
                )
        for what, slack, tick in groenwall(series, span):
            if slack < -tolerance:
                text = f"{what} moved towards its bound faster than eta allows, by {-slack:.3g}"
                yield broken(f"groenwall/{what}", tick, slack, -tolerance, text)
        if span.double:
            height, tick = settled_height(series, span)
            if height is not None and abs(height) > max(GROUND_TOLERANCE, tolerance):
                yield broken(
                    "ground",
                    tick,
                    height,
                    max(GROUND_TOLERANCE, tolerance),
                    f"the end foot's tip is {1e3 * height:.3f} mm off the ground",
                )
        if (ending := span.ending) is None:
            continue
        last = min(span.end, len(series.time) - 1)
        radius, threshold = config.ssp.com_radius, config.ssp.threshold
        if config.gait.style == "standing":
            yield from _of_a_landing(series, span, ending, last)
            continue
        if span.double and ending.com_to_axis > radius:
            far = f"{1e3 * ending.com_to_axis:.1f} mm from the foot's centre, {1e3 * radius:.1f} mm are allowed"
            text = f"ended with the CoM {far}"
            yield broken("end/cylinder", last, ending.com_to_axis, radius, text)
        if not span.double:
            if ending.error >= threshold:
                text = f"ended with an error of {ending.error:.3g}, not below {threshold:g}"
                yield broken("end/error", last, ending.error, threshold, text)
            miss, allowed = landing(span, ending)["error"], LANDING_TOLERANCE * threshold
            if miss > allowed:
                yield broken("landing", last, miss, allowed, f"landed {1e3 * miss:.2f} mm from its target")


def _of_a_landing(series: Series, span: Span, ending: Ending, last: int) -> Iterator[Violation]:
    """Yield a landing of a standing walk that missed its footprint."""
    if span.phase.swing_target is None:
        return
    miss, allowed = landing(span, ending)["error"], LANDING_TOLERANCE * series.trace.config.standing.swing_threshold
    if series.ground is not None:
        allowed = LANDING
    if miss > allowed:
        name, time = span.phase.name, float(series.time[last])
        text = f"{name} at {time:.3f} s: landed {1e3 * miss:.2f} mm from its target"
        yield Violation("landing", name, time, miss, allowed, text)


def _of_the_walk(series: Series) -> Iterator[Violation]:
    """Yield what the walk as a whole broke."""
    tolerance = series.trace.config.monitor.tolerance
    if not series.trace.finished:
        last, time = series.spans[-1], float(series.time[-1])
        text = f"the walk stopped before its end, in {last.phase.name} at {time:.2f} s"
        yield Violation("finished", last.phase.name, time, 0.0, 1.0, text)
    for i, name in enumerate(series.trace.model.joint_names):
        tick = int(np.argmin(series.joint_margin[:, i]))
        least, time = float(series.joint_margin[tick, i]), float(series.time[tick])
        if least < -tolerance:
            text = f"{name} is {-least:.3g} rad beyond its limit at {time:.3f} s"
            yield Violation(f"joint/{name}", "", time, least, -tolerance, text)
    if (error := unit_norm_error(series)) > UNIT_TOLERANCE:
        yield Violation(
            "unit_norm",
            "",
            float(series.time[-1]),
            error,
            UNIT_TOLERANCE,
            f"a pose is {error:.2g} off unit norm",
        )


def _of_the_ground(series: Series) -> Iterator[Violation]:
    """Yield where a walk in physics did not stand."""
    of = series.ground
    if of is None:
        return

    def broken(what: str, tick: int, value: float, allowed: float, message: str) -> Violation:
        time, name = float(series.time[tick]), series.spans[int(series.span_of[tick])].phase.name
        return Violation(what, name, time, value, allowed, f"{name} at {time:.3f} s: {message}")

    low = of.height < FALLEN * of.height[0]
    if low.any():
        tick = int(np.argmax(low))
        text = f"the robot has fallen: its pelvis is {1e3 * of.height[tick]:.0f} mm high"
        yield broken("fallen", tick, float(of.height[tick]), float(FALLEN * of.height[0]), text)
    tick = int(np.nanargmax(of.tilt))
    if of.tilt[tick] > TILT:
        text = f"the sole that carries leans by {np.degrees(of.tilt[tick]):.2f} degrees"
        yield broken("tilt", tick, float(of.tilt[tick]), float(TILT), text)
    if of.inside < COP_INSIDE:
        text = f"the centre of pressure is inside the support polygon on {100 * of.inside:.2f} % of ticks only"
        tick = int(np.argmin(np.nan_to_num(of.cop_margin, nan=-1.0)))
        yield Violation("cop", "", float(series.time[tick]), of.inside, COP_INSIDE, text)


def unit_norm_error(series: Series) -> float:
    """Return the largest deviation from one of the norms of the feet's poses and of the odometry."""
    x = DQ(np.concatenate([series.end, [span.record.x_odom_base for span in series.spans]]))
    return float(np.abs(x.norm().vec8() - DQ(1.0).vec8()).max())
