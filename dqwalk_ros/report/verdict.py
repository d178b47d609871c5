"""Checks of a walk: the assessment of a single state, the rules violated by a whole walk, and the report in numbers.

The rules are those of the paper in sampled time: in every period a distance approaches its bound no faster than
`rows.sampled` allows, and so does the residual of an equality; the end foot is on the ground in double support,
every phase ends by its own rule, and every step lands on its target.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dqwalk_ros import __version__
from dqwalk_ros.config import Config, MonitorConfig
from dqwalk_ros.paper.constraints import Constraint
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import Phase, PhaseKind
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.report.binding import acting, limits_reached, most_loaded
from dqwalk_ros.report.causes import causes
from dqwalk_ros.report.ground import FALLEN, WAY, GroundTruth, shortfall
from dqwalk_ros.report.metrics import Series, paper_margin, support_polygon
from dqwalk_ros.report.spans import Ending, Span
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array

TILT = np.radians(2.0)
"""Largest tilt of the more loaded sole [rad]."""
_COP_INSIDE = 0.99
"""Smallest fraction of the ticks on which the centre of pressure is inside the phase's support soles."""
_LANDING = 0.011
"""Largest landing error in physics, as a fraction of the CoM's height: 5 mm for Poppy."""
_GROUND_TOLERANCE = 2e-5
"""Largest height of the end foot's tip after it has come down [m]; the paper reports 1e-5 due to discretisation."""
_LANDING_TOLERANCE = 2.1
"""Largest landing error [m] per unit of `ssp.threshold`: ||vec8|| of a pure translation t is |t| / 2."""
_UNIT_TOLERANCE = 1e-12
"""Largest error of the norm of a pose."""


# ---------------------------------------------------------------------- one state


@dataclass(frozen=True)
class Assessment:
    """The assessment of one state."""

    level: str
    """``"OK"``, ``"WARN"`` if a distance is closer to its bound than ``monitor.warn_margin``, ``"ERROR"`` if one is
    beyond its bound, or the residual of an equality larger than at the start of its phase, by more than
    ``monitor.tolerance``."""
    message: str
    """The phase, and the reason for the level."""
    values: Mapping[str, float]
    """``distance/NAME``, ``residual/NAME``, ``error``, and the margins: ``margin/paper`` of the CoM to the paper's
    planes (U9), (U10) or cylinder (U14), ``margin/polygon`` to the true support polygon, ``margin/joints``."""


class Assessor:
    """Assesses single states of one phase, in any order.

    How fast a distance approaches its bound is judged by `violations`, which has all states.
    """

    def __init__(self, config: Config, model: RobotModel, phase: Phase) -> None:
        self.config, self.model, self.phase = config, model, phase
        start = phase.distances(phase.q_start)
        self._most = {row.name: abs(start[row.name]) for row in phase.equalities if _has_bound(row)}

    def __call__(self, kin: Kinematics, elapsed: float, monitor: MonitorConfig | None = None) -> Assessment:
        """Return the assessment of one state, `elapsed` seconds after the phase began.

        `kin` is relative to the base sole of the phase; `monitor` replaces that of the configuration.
        """
        monitor = monitor or self.config.monitor
        distances = self.phase.evaluate(kin.q, kin.up, elapsed).distances()
        error = self.phase.assembly.error(kin, math.inf)  # from the end of a path
        values: dict[str, float] = {"error": error, "time in phase": elapsed}
        broken: list[str] = []
        close: list[str] = []
        for row in self.phase.equalities:
            d = values[f"residual/{row.name}"] = float(distances[row.name])
            if abs(d) > self._most.get(row.name, math.inf) + monitor.tolerance:
                broken.append(f"{row.name} has a residual of {d:.3g}")
        for row in self.phase.constraints:
            d = values[f"distance/{row.name}"] = float(distances[row.name])
            if d < -monitor.tolerance:
                broken.append(f"{row.name} is {-d:.3g} beyond its bound")
            elif (margin := row.margin(d)) < monitor.warn_margin:
                close.append(f"{row.name} within {margin:.2g}")
        values |= self._margins(kin, distances)
        text = "; ".join(broken or close)
        level = "ERROR" if broken else "WARN" if close else "OK"
        return Assessment(level, f"{self.phase.name}: {text}" if text else self.phase.name, values)

    def _margins(self, kin: Kinematics, distances: Mapping[str, float]) -> dict[str, float]:
        model, phase, paper = self.model, self.phase, paper_margin(self.phase, distances)
        return ({} if paper is None else {"margin/paper": float(paper)}) | {
            "margin/polygon": support_polygon(model, phase.base, kin, double=phase.double).distance(kin.com_on_ground),
            "margin/joints": float(np.minimum(kin.q - model.q_min, model.q_max - kin.q).min()),
        }


def _has_bound(row: Constraint) -> bool:
    """Return whether each row of an equality has a bound of its own.

    Those of a held sole, which return at a limited speed, depend on each other.
    """
    return math.isinf(row.return_speed)


# ---------------------------------------------------------------------- violations of a whole walk


@dataclass(frozen=True)
class Violation:
    """A violated rule."""

    what: str
    """Name of the distance or of the rule."""
    phase: str
    """Name of the phase; empty for a rule of the whole walk."""
    time: float
    value: float
    allowed: float
    """Time [s], and value and its bound in the unit of the distance."""
    message: str
    """All of this in one sentence."""


def violations(series: Series) -> list[Violation]:
    """Return all violations: of each phase in turn, then of the whole walk, then in physics."""
    found = [violation for span in series.spans for violation in _of_a_phase(series, span)]
    return [*found, *_of_the_walk(series), *([] if series.ground is None else _of_the_ground(series, series.ground))]


def _broken(series: Series, what: str, tick: int, value: float, allowed: float, text: str, name: str = "") -> Violation:
    name, time = name or series.spans[int(series.span_of[tick])].phase.name, float(series.time[tick])
    return Violation(what, name, time, value, allowed, f"{name} at {time:.3f} s: {text}")


def _landing(span: Span, ending: Ending) -> dict[str, float]:
    """Return the landing position of the swing foot and its error [m, rad], in the support sole's frame."""
    assert span.record.swing_target is not None  # every single support has one
    off = DQ(span.record.swing_target).conj() * DQ(ending.end)
    place = dict(zip("xyz", DQ(ending.end).translation().tolist(), strict=True))
    error, angle = (float(np.linalg.norm(v)) for v in (off.translation(), off.rotation_vector()))
    return {**place, "error": error, "angle": angle}


def _held(series: Series, span: Span) -> Iterator[tuple[str, float, int]]:
    """Yield name, smallest value of `Series.held` and its tick for each constraint of a phase that has a bound."""
    for row in (*span.phase.constraints, *filter(_has_bound, span.phase.equalities)):
        held = series.held[row.name][span.ticks]
        at = int(np.nanargmin(held))
        yield row.name, float(held[at]), span.start + at


def _settled_height(series: Series, span: Span) -> tuple[float | None, int]:
    """Return the largest height of the end foot's tip [m] once it has come down to the ground, and its tick."""
    settle = 10.0 / series.trace.config.dsp.eta_ground
    first = span.start + int(np.searchsorted(series.time[span.ticks], series.time[span.start] + settle))
    if first >= span.end:
        return None, first
    at = first + int(np.argmax(np.abs(series.tip_height[first : span.end])))
    return float(series.tip_height[at]), at


def _of_a_phase(series: Series, span: Span) -> Iterator[Violation]:
    """Yield the violations of a phase."""
    tolerance, name = series.trace.config.monitor.tolerance, span.phase.name
    for row in span.phase.constraints:
        d = series.distances[row.name][span.ticks]
        at = int(np.nanargmin(d))
        if d[at] < -tolerance:
            text = f"{row.name} is {-d[at]:.3g} beyond its bound"
            yield _broken(series, row.name, span.start + at, float(d[at]), -tolerance, text, name)
    for what, held, tick in _held(series, span):
        if held < -tolerance:
            text = f"{what} moved towards its bound faster than eta allows, by {-held:.3g}"
            yield _broken(series, f"eta/{what}", tick, held, -tolerance, text, name)
    if span.double and span.phase.equalities:  # which an exercise in the air has not
        height, tick = _settled_height(series, span)
        allowed = max(_GROUND_TOLERANCE, tolerance)
        if height is not None and abs(height) > allowed:
            text = f"the end foot's tip is {1e3 * height:.3f} mm off the ground"
            yield _broken(series, "ground", tick, height, allowed, text, name)
    if span.ending is not None:
        yield from _of_an_ending(series, span, span.ending)


def _of_an_ending(series: Series, span: Span, ending: Ending) -> Iterator[Violation]:
    """Yield the violations at the end of a phase: the rules of the paper's phases, and a landing beside the target."""
    config, name, last = series.trace.config, span.phase.name, min(span.end, len(series.time) - 1)
    paper, lands = series.style == "paper", span.phase.swing_target is not None
    radius, threshold = config.ssp.com_radius, config.ssp.threshold if paper else config.standing.swing_threshold
    transfers = span.phase.kind is PhaseKind.DOUBLE_SUPPORT  # unlike a stance
    if paper and transfers and ending.com_to_axis > radius:
        far = f"{1e3 * ending.com_to_axis:.1f} mm from the foot's centre, {1e3 * radius:.1f} mm are allowed"
        yield _broken(series, "end/cylinder", last, ending.com_to_axis, radius, f"ended with the CoM {far}", name)
    if paper and lands and ending.error >= threshold:
        text = f"ended with an error of {ending.error:.3g}, not below {threshold:g}"
        yield _broken(series, "end/error", last, ending.error, threshold, text, name)
    if lands:
        miss = _landing(span, ending)["error"]
        physics = not paper and series.ground is not None
        allowed = _LANDING * float(series.com[0, 2]) if physics else _LANDING_TOLERANCE * threshold
        if miss > allowed:
            why = f": {span.record.decision}" if span.record.decision else ""
            text = f"landed {1e3 * miss:.2f} mm from its target, {1e3 * allowed:.2f} mm are allowed{why}"
            yield _broken(series, "landing", last, miss, allowed, text, name)


def _of_the_walk(series: Series) -> Iterator[Violation]:
    """Yield the violations of the whole walk."""
    tolerance, end = series.trace.config.monitor.tolerance, float(series.time[-1])
    if not (series.trace.finished or series.trace.cut):  # what is not recorded is not judged
        name = series.spans[-1].phase.name
        text = f"the walk stopped before its end, in {name} at {end:.2f} s"
        yield Violation("finished", name, end, 0.0, 1.0, text)
    for i, name in enumerate(series.trace.model.joint_names):
        tick = int(np.argmin(series.joint_margin[:, i]))
        least, time = float(series.joint_margin[tick, i]), float(series.time[tick])
        if least < -tolerance:
            text = f"{name} is {-least:.3g} rad beyond its limit at {time:.3f} s"
            yield Violation(f"joint/{name}", "", time, least, -tolerance, text)
    if (error := _unit_norm_error(series)) > _UNIT_TOLERANCE:
        yield Violation("unit_norm", "", end, error, _UNIT_TOLERANCE, f"norm of a pose is off by {error:.2g}")


def _of_the_ground(series: Series, of: GroundTruth) -> Iterator[Violation]:
    """Yield the violations in physics: fall, way, tilt of the sole, centre of pressure."""
    low = of.height < FALLEN * of.height[0]
    if low.any():
        tick = int(np.argmax(low))
        text = f"the robot has fallen: its pelvis is {1e3 * of.height[tick]:.0f} mm above its lower sole"
        yield _broken(series, "fallen", tick, float(of.height[tick]), float(FALLEN * of.height[0]), text)
    if text := shortfall(of.way, of.commanded):
        yield Violation("way", "", float(series.time[-1]), of.way, WAY * of.commanded, text)
    tick = int(np.nanargmax(of.tilt))
    if of.tilt[tick] > TILT:
        text = f"the support sole is tilted by {np.degrees(of.tilt[tick]):.2f} degrees"
        yield _broken(series, "tilt", tick, float(of.tilt[tick]), float(TILT), text)
    inside = of.inside
    if inside is not None and inside < _COP_INSIDE:
        text = f"the centre of pressure is inside the support polygon in only {100 * inside:.2f} % of ticks"
        tick = int(np.argmin(np.nan_to_num(of.cop_margin, nan=-1.0)))
        yield Violation("cop", "", float(series.time[tick]), inside, _COP_INSIDE, text)


def _unit_norm_error(series: Series) -> float:
    """Return the largest deviation from one of the norms of the feet's poses and of the odometry."""
    x = DQ(np.concatenate([series.end, [span.record.x_odom_base for span in series.spans]]))
    return float(np.abs(x.norm().vec8() - DQ(1.0).vec8()).max())


# ---------------------------------------------------------------------- in numbers


def report(series: Series) -> dict[str, Any]:
    """Return the complete report of a walk, in plain types.

    Returns
    -------
    dict
        ``ok``, ``violations`` (see `Violation`), ``causes`` of a fall (see `causes.causes`), ``walk``, ``physics``
        (or None), ``phases`` (a list), ``solve_time``, ``robot``, ``config`` and ``notes``. Lengths in metres, angles
        in radians, times in seconds.
    """
    trace, broken, sole = series.trace, violations(series), series.trace.model.soles[Foot.LEFT]
    phases = [_phase(series, index, span) for index, span in enumerate(series.spans)]
    solved = trace.solve_time[np.isfinite(trace.solve_time)]
    return {
        "format": "dqwalk_ros report 1",
        "version": __version__,
        "ok": not broken,
        "violations": [asdict(violation) for violation in broken],
        "causes": [asdict(cause) for cause in causes(series)],
        "walk": _walk(series, phases),
        "physics": None if series.ground is None else _physics(series, series.ground),
        "phases": phases,
        "solve_time": _quantiles(solved) if len(solved) else None,
        "robot": {
            "name": trace.model.name,
            "joints": list(trace.model.joint_names),
            "mass": trace.model.mass,
            "sole": {"length": sole.length, "width": sole.width},
        },
        "config": {
            name: list(value) if isinstance(value, tuple) else value for name, value in trace.config.flat().items()
        },
        "notes": list(trace.notes),
    }


def _quantiles(values: Array) -> dict[str, float]:
    return dict(zip(("median", "p99", "max"), np.percentile(values, (50, 99, 100)).tolist(), strict=True))


def _least(series: Series, values: Array, ticks: slice = slice(None)) -> dict[str, float]:
    """Return the smallest value over some ticks, its time and its tick."""
    part = values[ticks]
    at = int(np.nanargmin(part))
    return {"value": float(part[at]), "time": float(series.time[ticks][at]), "tick": (ticks.start or 0) + at}


def _bounds(series: Series) -> dict[str, dict[str, dict[str, float]]]:
    """Return how close each constraint came to its bound in the walk, and each period to its sampled-data bound.

    The second, ``spare``, is in the unit of the distance per second (`Series.spare`); it is left out for bodies that
    were always too far apart for a row of the quadratic program.
    """
    out = {}
    for name, distance in series.distances.items():
        out[name] = {"distance": _least(series, distance)}
        spare = np.where(np.isfinite(series.spare[name]), series.spare[name], np.nan)
        if np.isfinite(spare).any():
            out[name]["spare"] = _least(series, spare)
    return out


def _phase(series: Series, index: int, span: Span) -> dict[str, Any]:
    ticks, ending = span.ticks, span.ending
    minimum = {name: _least(series, d, ticks) for name, d in series.distances.items() if np.isfinite(d[ticks]).any()}
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
            name: float(np.nanmax(np.abs(column[ticks])))
            for name, column in series.residuals.items()
            if np.isfinite(column[ticks]).any()
        },
        "held": {name: held for name, held, _ in _held(series, span)},
        "margin": _margins(series, ticks),
    }
    if span.double:
        out["slide"] = float(np.nanmax(series.slide[ticks]))
        out["tip_height_settled"] = _settled_height(series, span)[0]
        out["com_to_axis"] = float(ending.com_to_axis if ending else series.com_to_axis[span.end - 1])
    elif ending is not None:
        out["landing"] = _landing(span, ending)
    return out


def _margins(series: Series, ticks: slice = slice(None)) -> dict[str, dict[str, float]]:
    """Return the smallest value of each margin of the CoM and of the joints."""
    hulls = {"true": series.true_margin, "true_urdf_sole": series.urdf_margin}
    known = {name: values for name, values in hulls.items() if values is not None}
    paper = {"paper": series.paper_margin} if np.isfinite(series.paper_margin[ticks]).any() else {}
    out = {name: _least(series, values, ticks) for name, values in (paper | known).items()}
    for name, values in known.items():
        if (outside := np.flatnonzero(values[ticks] < 0.0)).size:
            out[name]["outside_from"] = float(series.time[ticks][outside[0]])
    return out | {"joints": _least(series, series.least_joint_margin, ticks)}


def _walk(series: Series, phases: list[dict[str, Any]]) -> dict[str, Any]:
    trace = series.trace
    landings = [phase["landing"] for phase in phases if "landing" in phase]
    joint = int(np.argmin(series.joint_margin.min(axis=0)))
    stands = [DQ(x[[0, -1]]).transform_point(trace.model.soles[foot].center) for foot, x in series.soles.items()]
    way = np.diff(np.mean(stands, axis=0), axis=0)[0]  # of the middle of the soles
    ahead = np.array([DQ(span.record.x_odom_base).rotation_matrix()[:, 0] for span in series.spans])
    yaw = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))  # of the base soles, unwrapped
    angles, delay = acting(trace)
    return {
        "style": series.style,
        "finished": trace.finished,
        "cut": trace.cut,
        "duration": float(series.time[-1] - series.time[0]),
        "ticks": len(series.time),
        "steps": len(landings),
        "distance": float(np.linalg.norm(way[:2])),
        "forward": float(way[0]),
        "lateral": float(way[1]),
        "turned": float(yaw[-1] - yaw[0]),
        "landing_error": max((landing["error"] for landing in landings), default=None),
        "margin": _margins(series),
        "bounds": _bounds(series),
        "closest_joint": trace.model.joint_names[joint],
        "joint_speed": {
            "largest": float(np.nanmax(np.abs(trace.u), initial=0.0)),
            "of_limit": float(np.nanmax(np.abs(trace.u) / trace.model.velocity_max, initial=0.0)),
        },
        "limits_reached": limits_reached(series, angles),
        "delay": {"assumed": float(delay[0]), "used": float(delay[-1])},
        "unit_norm_error": _unit_norm_error(series),
        "unanswered": int(np.count_nonzero(~np.isfinite(trace.u).all(axis=1))),
    }


def _seconds_per_step(series: Series, landed: Sequence[Span]) -> float | None:
    """Return the median time from landing to landing [s], for a single step its duration; None without a step."""
    if not landed:
        return None
    landings = series.time[[min(span.end, len(series.time) - 1) for span in landed]]
    if len(landed) == 1:
        return float(landings[0] - series.time[landed[0].start])
    return float(np.median(np.diff(landings)))


def _physics(series: Series, of: GroundTruth) -> dict[str, Any]:
    """Return the figures of a walk in physics."""
    stands, at = of.stands, int(np.nanargmax(of.tilt))
    landed = [span for span in series.spans if not span.double and span.ending is not None]
    heights = []  # of the landed soles over their targets
    for span in landed:
        if span.end < len(series.time) and span.record.swing_target is not None:
            support, swing = (DQ(of.soles[foot][span.end]) for foot in (span.phase.support, span.phase.support.other))
            target = support * DQ(span.record.swing_target)
            heights.append(float((swing.translation() - target.translation())[2]))
    steps, duration = len(landed), float(series.time[-1] - series.time[0])
    out: dict[str, Any] = {
        "steps": steps,
        "way": of.way,
        "commanded_way": of.commanded,
        "displacement": [float(x) for x in stands[-1, :2] - stands[0, :2]],
        "turned": float(stands[-1, 2] - stands[0, 2]),
        "seconds_per_step": _seconds_per_step(series, landed),
        "tilt": {"value": float(of.tilt[at]), "time": float(series.time[at])},
        "cop_inside": of.inside,
        "cop_margin": float(np.nanmin(of.cop_margin)) if np.isfinite(of.cop_margin).any() else None,
        "landing_height": max(heights, default=None),
        "fallen": of.fallen,
        "swing_load": of.swing_load,
        "load_error": of.load_error,
        "odometry_drift": of.drift,
    }
    if (load := most_loaded(series.trace)) is not None:
        out["load"] = asdict(load)
    if np.isfinite(of.power).any():
        # cost of transport: positive work per weight and path length
        work = float(np.nanmean(of.work)) * duration
        moved = series.trace.model.mass * series.trace.config.physics.mass_scale * GRAVITY * out["way"]
        out["energy"] = {
            "power": float(np.nanmean(of.power)),
            "positive": float(np.nanmean(of.work)),
            "cost_of_transport": work / moved if steps else None,
        }
    if of.circle is not None:
        out["circle"] = {"radius": of.circle.radius, "deviation": of.circle.deviation}
    return out
