"""Finds the causes of a fall, the earliest first, each with its measured value and the parameter to change.

A fall is unavoidable when the divergent component of the CoM, xi = c + v/w, leaves the support polygon and does not
return; motions of the joints after that time are consequences. Servos and delay act from the beginning. At some time a
path may require a centre of pressure beyond the soles, or a torque may reach its limit.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.report.hull import hull_margin
from dqwalk_ros.report.metrics import Series, support_polygon
from dqwalk_ros.robot.servos import Servos
from dqwalk_ros.robot.standing_limits import Finding, divergent_component, longest_delay, servo_findings
from dqwalk_ros.support.arrays import Array, Mask
from dqwalk_ros.walks.following import ComPath, com_path

_SMOOTH = 0.05
"""Time over which velocities of the CoM are averaged [s]."""
_BEYOND = 1e-3
"""Distance of the required centre of pressure beyond the soles above which a path is a cause [m]."""
_AT_LIMIT, _BRIEFLY = 0.98, 0.02
"""Fraction of its limit above which a torque counts as limited, and the shortest time of it that is a cause [s]."""
_DELAYS, _SPAN, _ALIKE = 0.3, 0.1, 0.8
"""Longest delay considered [s], duration of the compared joint motions [s], and least correlation."""
_DELAY_PART = 0.5
"""Fraction of `standing_limits.longest_delay` that a robot with legs and servos tolerates."""


def causes(series: Series) -> list[Finding]:
    """Return the causes of a fall, the earliest first; an empty list if the robot did not fall.

    Requires the record of an inertial sensor, because joint angles alone do not show that the robot tips.
    """
    tick = lost(series)
    if tick is None:
        return []
    config, model = series.trace.config, series.trace.model
    found: list[Finding] = []
    if series.style != "paper":
        found += servo_findings(config, model)
        found += _delay(series, tick)
    found += _pressure(series, tick)
    found += _torque(series, tick)
    return sorted(found, key=lambda finding: finding.time) or [_unknown(series, tick)]


def lost(series: Series) -> int | None:
    """Return the first tick from which the divergent component stays outside the support polygon until the end.

    If the robot fell without leaving its support polygon, this is the last tick; None if it did not fall.
    """
    trace = series.trace
    if trace.finished or trace.interrupted or trace.physics is None or len(series.time) < 2:
        return None
    if not np.isfinite(trace.physics.orientation).any():
        return None
    outside = series.polygon_margin(_divergent(series)) < 0.0
    if not outside[-1]:
        return len(series.time) - 1 if series.ground is not None and series.ground.fallen else None
    inside = np.flatnonzero(~outside)
    return int(inside[-1]) + 1 if inside.size else 0


def _divergent(series: Series) -> Array:
    """Return the divergent component of the CoM on the ground, in the base sole's frame, shape (N, 2) [m]."""
    width, out = max(1, round(_SMOOTH / series.trace.config.dt)), series.com_on_ground.copy()
    for span in series.spans:
        c = series.com_on_ground[span.ticks]
        if len(c) > 2 * width:
            v = (c[width:] - c[:-width]) / (series.time[span.ticks][width:] - series.time[span.ticks][:-width])[:, None]
            h = np.maximum(series.com[span.ticks][width:, 2:], 0.05)
            out[span.ticks][width:] = divergent_component(c[width:], v, h)
    return out


def _delay(series: Series, tick: int) -> Iterator[Finding]:
    """Yield a delay between commands and joint motion that the balance control does not tolerate."""
    config, height = series.trace.config, float(series.com[0, 2])
    tolerated = _DELAY_PART * longest_delay(config.standing.balance, height)
    weak = _at_limit(series, slice(0, tick)).any(axis=1)  # a joint that is too weak lags as well
    delay = _measured_delay(series, int(np.argmax(weak)) if weak.any() else tick)
    if delay is not None and delay > tolerated:
        late, assumed = 1e3 * delay, 1e3 * config.servo.assumed_latency
        yield Finding(
            f"the joints follow their commands {late:.0f} ms late (servo.assumed_latency is {assumed:.0f} ms); at this "
            f"height standing.balance = {config.standing.balance:g} tolerates about {1e3 * tolerated:.0f} ms",
            "servo.latency, sensors.age, standing.balance",
            "latency",
            float(series.time[0]),
        )


def _measured_delay(series: Series, tick: int) -> float | None:
    """Return the delay T for which q(t) and the integral of u until t - T correlate most; None if they do not."""
    dt = series.trace.config.dt
    q, u = series.trace.q[:tick], np.nan_to_num(series.trace.u[:tick])
    reach, span = round(_DELAYS / dt), max(1, round(_SPAN / dt))
    if tick < 2 * (reach + span):
        return None
    integral = dt * (np.cumsum(u, axis=0) - u)
    moved = (q[span:] - q[:-span])[reach:]
    asked = integral[span:] - integral[:-span]
    late = [asked[reach - k : len(asked) - k] for k in range(reach)]
    norms = [float(np.linalg.norm(moved) * np.linalg.norm(a)) for a in late]
    correlation = [float((moved * a).sum()) / max(norm, 1e-12) for a, norm in zip(late, norms, strict=True)]
    best = int(np.argmax(correlation))
    return best * dt if correlation[best] > _ALIKE else None


def _pressure(series: Series, tick: int) -> Iterator[Finding]:
    """Yield the first time at which the path of the CoM requires a centre of pressure beyond the soles."""
    if series.style == "paper":
        short = series.true_margin
        text, parameter = "the paper's walk moves the CoM beyond the real soles", "gait.style"
    else:
        short = _planned_margin(series)
        text, parameter = "the path of the CoM requires a centre of pressure beyond the soles", "standing."
    first = _recent(series, tick).start
    end = series.spans[int(series.span_of[tick])].end  # a path that begins during the fall begins beyond the soles
    beyond = np.flatnonzero(short[first:end] < -_BEYOND)
    if not beyond.size:
        return
    begin = first + int(beyond[0])
    span = series.spans[int(series.span_of[begin])]
    if parameter == "standing.":
        parameter += "transfer_duration" if span.double else "swing_duration"
    worst = begin + int(np.nanargmin(short[begin : max(span.end, begin + 1)]))
    time = float(series.time[begin])
    yield Finding(
        f"{text} in {span.phase.name}: from {time:.2f} s on, by up to {-1e3 * short[worst]:.0f} mm",
        parameter,
        "pressure",
        time,
    )


def _planned_margin(series: Series) -> Array:
    """Return the margin of the centre of pressure c - h/g c'' of the CoM's path to the edges of the soles, (N,) [m].

    The poses of the soles are those at the start of the phase.
    """
    model, out = series.trace.model, np.full(len(series.time), np.nan)
    for span in series.spans:
        path = next((task for task in span.phase.tasks if isinstance(task, ComPath)), None)
        if path is None:
            continue
        kin = Kinematics(model, span.record.q_start, span.phase.base)
        goals = np.concatenate([np.zeros(2), *(point.value(kin) for point in path.over)])
        elapsed = series.time[span.ticks] - span.record.time
        way = [com_path(goals, path.start, float(t), path.duration) for t in elapsed]
        pressure = np.array([c - float(kin.com[2]) / GRAVITY * a for c, _, a in way])
        corners = np.array(support_polygon(model, span.phase.base, kin, double=span.double).vertices)
        out[span.ticks] = hull_margin(np.broadcast_to(corners, (len(way), *corners.shape)), pressure)
    return out


def _torque(series: Series, tick: int) -> Iterator[Finding]:
    """Yield the joint that was at its torque limit for the longest time."""
    trace, ticks = series.trace, _recent(series, tick)
    at_limit = _at_limit(series, ticks)
    count = at_limit.sum(axis=0)
    worst = int(np.argmax(count))
    duration = float(count[worst]) * trace.config.dt
    if duration > _BRIEFLY:
        time = float(series.time[ticks][np.argmax(at_limit[:, worst])])
        limit = Servos.of(trace.config, trace.model).torque[worst]
        yield Finding(
            f"'{trace.model.joint_names[worst]}' was at its limit of {limit:.3g} N m for {duration:.2f} s, "
            f"from {time:.2f} s on",
            "servo.torque_scale, the effort limits of the URDF",
            "torque",
            time,
        )


def _at_limit(series: Series, ticks: slice) -> Mask:
    """Return which torques were at their limits, shape (ticks, n); all false if torques were not recorded."""
    trace, physics = series.trace, series.trace.physics
    if physics is None or ticks.stop - ticks.start < 2:
        return np.zeros((1, trace.model.n), bool)
    servos = Servos.of(trace.config, trace.model)
    dq = np.gradient(trace.q[ticks], series.time[ticks], axis=0)
    out: Mask = servos.load(physics.effort[ticks], dq) > _AT_LIMIT
    return out


def _recent(series: Series, tick: int) -> slice:
    """Return the ticks before `tick` in its phase and in the phase before it."""
    index = int(series.span_of[tick])
    return slice(series.spans[max(index - 1, 0)].start, tick)


def _unknown(series: Series, tick: int) -> Finding:
    span = series.spans[int(series.span_of[tick])]
    time = float(series.time[tick])
    into = time - span.record.time
    return Finding(
        f"the divergent component left the soles at {time:.2f} s, {into:.2f} s into {span.phase.name}, and neither "
        "servos, delay, torques nor the path of the CoM explain it; possible causes are a push, the ground, or a step "
        "that is too fast or too long",
        "standing.swing_duration, gait.step_length",
        "unknown",
        time,
    )
