"""What binds a walk: the joint closest to its servo's torque-speed curve, and the limits at which commands are."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dqwalk_ros.estimation.predictor import Predictor
from dqwalk_ros.paper.constraints import vfi
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.report.metrics import Series
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.servos import Drive, Servos
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.trace import Trace

_AT_LIMIT = 1e-6
"""Difference to a bound of a commanded velocity that is at the bound [rad/s]."""


@dataclass(frozen=True)
class Load:
    """The largest part of a torque-speed curve that a walk needs."""

    part: float
    """1: the servo cannot do more."""
    joint: str
    time: float
    """[s]"""

    def __str__(self) -> str:
        return f"{self.joint} needs {100.0 * self.part:.0f} % of its torque-speed curve at {self.time:.2f} s"


def most_loaded(trace: Trace) -> Load | None:
    """Return the joint whose servo is closest to its torque-speed curve; None if torques were not recorded.

    A torque is the mean of the period before its state, and so is the velocity that is compared with it.
    """
    if trace.physics is None or len(trace) < 2:
        return None
    q = np.where(np.isfinite(trace.physics.q), trace.physics.q, trace.q)
    velocity = np.diff(q, axis=0) / np.diff(trace.time)[:, None]
    load = Servos.of(trace.config, trace.model).load(trace.physics.effort[1:], velocity)
    if not np.isfinite(load).any():
        return None
    tick, joint = np.unravel_index(np.nanargmax(load), load.shape)
    return Load(float(load[tick, joint]), trace.model.joint_names[joint], float(trace.time[tick + 1]))


def acting(trace: Trace) -> tuple[Array, Array]:
    """Return the angles at which the controller expected its commands to act, and the delay that it used.

    Returns
    -------
    angles : ndarray, shape (N, n)
        [rad]
    delay : ndarray, shape (N,)
        [s]
    """
    predictor, dt = Predictor(Drive.of(trace.config, trace.model)), trace.config.dt
    angles, delay, last = np.empty_like(trace.q), np.empty(len(trace)), math.inf
    no_torques = np.zeros(trace.model.n)  # they do not matter for the delay
    for tick, (time, q, u) in enumerate(zip(trace.time.tolist(), trace.q, trace.u, strict=True)):
        if time - last > trace.config.plant.command_timeout:  # the plant held still, and the controller begins anew
            predictor.interrupt()
        last = time
        angles[tick], delay[tick] = predictor.acting(time, q), predictor.drive.delay
        if np.isfinite(u).all():
            fed_forward = trace.up(tick) is not None
            predictor.add(time, q, u, no_torques if fed_forward else None, dt)
    return angles, delay


def limits_reached(series: Series, angles: Array) -> Mapping[str, int]:
    """Return on how many ticks of its steps the velocity of a joint was at a limit, the most frequent limit first.

    The commands act at `angles` (N, n) [rad]. The names are those of the constraints (U12) and (U13), such as
    ``joint_max/l_knee_y``, and ``speed/l_knee_y``.
    """
    trace, model, found = series.trace, series.trace.model, Counter[str]()
    for span in series.spans:
        config, (upper, lower) = span.record.config or trace.config, span.phase.limits
        fastest = np.minimum(model.velocity_max, config.joints.velocity or np.inf)
        if span.phase.kind is PhaseKind.STANCE:
            continue
        u, q = trace.u[span.ticks], angles[span.ticks]
        known = np.isfinite(u).all(axis=1)
        u, q = u[known], q[known]
        most, least = (
            vfi(d.ravel(), np.full(d.size, row.bound), np.full(d.size, row.eta), row.return_speed, config.dt)
            for d, row in ((model.q_max - q, upper), (q - model.q_min, lower))
        )
        bounds = np.maximum(least.reshape(u.shape), -fastest), np.minimum(-most.reshape(u.shape), fastest)
        found.update(limits_at(u, *bounds, fastest, model))
    return dict(found.most_common())


def limits_at(u: Array, lower: Array, upper: Array, fastest: Array, model: RobotModel) -> dict[str, int]:
    """Return on how many ticks joint velocities are at which limits; see `limits_reached`.

    Parameters
    ----------
    u : ndarray, shape (..., n)
        Commanded velocities [rad/s].
    lower, upper : ndarray, shape (..., n)
        Their bounds by the joint limits and by the largest velocities, `fastest` (n,) [rad/s].
    """
    speed = np.abs(u) >= fastest - _AT_LIMIT
    kinds = {
        "speed": speed,
        "joint_max": ~speed & (u >= upper - _AT_LIMIT),
        "joint_min": ~speed & (u <= lower + _AT_LIMIT),
    }
    counts = {kind: np.count_nonzero(at.reshape(-1, model.n), axis=0) for kind, at in kinds.items()}
    return {f"{kind}/{model.joint_names[i]}": int(n[i]) for kind, n in counts.items() for i in np.flatnonzero(n)}
