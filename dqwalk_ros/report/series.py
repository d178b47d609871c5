"""Every distance of a walk at every tick, from the joint angles and the phases alone.

Nothing the controller said about itself is used: the phases are rebuilt from where they began, and the core's own
functions are asked again. A bag is judged in the same way whoever recorded it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.report.support import hull_margin, urdf_soles
from dqwalk_ros.robot import Foot, RobotModel, Sole
from dqwalk_ros.simulation import PhaseRecord, Trace
from dqwalk_ros.walk import Phase, PhaseKind

if TYPE_CHECKING:
    from dqwalk_ros.report.ground import Ground

__all__ = ["Ending", "Series", "Span", "analyse"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Ending:
    """A phase at the state that ended it, which is the first state of the next one.

    Attributes
    ----------
    error : float
        Norm of the task error, as in `Series.error`.
    com_to_axis : float
        Horizontal distance of the CoM from the centre of the foot that carries the weight from here on [m].
    end : ndarray, shape (8,)
        Pose of the other sole in the base sole's frame.
    """

    error: float
    com_to_axis: float
    end: Array


@dataclass(frozen=True)
class Span:
    """One phase of the walk.

    Attributes
    ----------
    record : PhaseRecord
        How it was recorded.
    phase : Phase
        The phase itself, rebuilt.
    start, end : int
        Its ticks, ``start <= tick < end``.
    ending : Ending or None
        None where the walk stopped before the phase did.
    """

    record: PhaseRecord
    phase: Phase
    start: int
    end: int
    ending: Ending | None

    @property
    def ticks(self) -> slice:
        """The ticks of the phase."""
        return slice(self.start, self.end)

    @property
    def double(self) -> bool:
        """Whether both feet are on the ground."""
        return self.phase.kind is not PhaseKind.SINGLE_SUPPORT


@dataclass(frozen=True)
class Series:
    """Time series of a walk, one value per tick (N of them); nan where a quantity has no meaning.

    Attributes
    ----------
    trace : Trace
    spans : tuple of Span
    error : ndarray, shape (N,)
        Norm of the task error: [m] in double support, of vec8 in single support.
    distances : dict of str to ndarray, shape (N,)
        Every inequality, its distance minus its bound: at or above zero where it is kept.
    residuals : dict of str to ndarray, shape (N,)
        Every equality: zero where it is kept.
    com : ndarray, shape (N, 3)
        Centre of mass (4) in the base sole's frame [m].
    end : ndarray, shape (N, 8)
        Pose of the other sole in the base sole's frame.
    pelvis : ndarray, shape (N, 3)
        Pelvis in the base sole's frame [m].
    com_on_ground : ndarray, shape (N, 2)
        Where the vertical through the CoM meets the base sole's plane [m]; an inertial sensor tells which way is up.
    """

    trace: Trace
    spans: tuple[Span, ...]
    error: Array
    distances: dict[str, Array]
    residuals: dict[str, Array]
    com: Array
    end: Array
    pelvis: Array
    com_on_ground: Array

    @property
    def time(self) -> Array:
        """Time of each tick [s], shape (N,)."""
        return self.trace.time

    def distance(self, name: str) -> Array:
        """Return an inequality's distance less its bound, shape (N,); all nan where no phase of the walk has it."""
        return self.distances.get(name, np.full(len(self.time), np.nan))

    @cached_property
    def com_odom(self) -> Array:
        """Centre of mass in odom [m], shape (N, 3)."""
        out = np.full_like(self.com, np.nan)
        for span in self.spans:
            x = DQ(span.record.x_odom_base)
            out[span.ticks] = x.translation() + x.P().Ad(DQ(self.com[span.ticks])).vec3()
        return out

    @cached_property
    def tip_height(self) -> Array:
        """Height of the other foot's tip above the base sole's ground [m], the distance of (8)."""
        return self._of_end_foot(lambda sole: sole.tip)[:, 2]

    @cached_property
    def slide(self) -> Array:
        """Distance of the end foot's tip from where it was when double support began [m], that of (7)."""
        tip = self._of_end_foot(lambda sole: sole.tip)[:, :2]
        out = np.full(len(self.time), np.nan)
        for span in self.spans:
            if span.double:
                kin = Kinematics(self.trace.model, span.record.q_start, span.phase.base)
                sole = self.trace.model.soles[span.phase.base.other]
                out[span.ticks] = np.linalg.norm(tip[span.ticks] - kin.point(sole.frame, sole.tip)[:2], axis=1)
        return out

    @cached_property
    def com_to_axis(self) -> Array:
        """Horizontal distance of the CoM from the centre of the foot that carries the weight, or will [m]."""
        center = self._of_end_foot(lambda sole: sole.center)[:, :2]
        for span in self.spans:
            if not span.double:
                center[span.ticks] = self.trace.model.soles[span.phase.base].center[:2]
        out: Array = np.linalg.norm(self.com[:, :2] - center, axis=1)
        return out

    @cached_property
    def joint_margin(self) -> Array:
        """Distance of each joint from the nearer limit [rad], shape (N, n)."""
        model, q = self.trace.model, self.trace.q
        out: Array = np.minimum(q - model.q_min, model.q_max - q)
        return out

    @cached_property
    def paper_margin(self) -> Array:
        """How far inside the support region of the paper the CoM is [m].

        Double support: the nearer of the tip and the back plane (9), (10). Single support: the radius of the cylinder
        (14) minus the distance from its axis. A standing walk has neither, and its margin is nan.
        """
        if self.trace.config.gait.style != "paper":
            return np.full(len(self.time), np.nan)
        out = self.trace.config.ssp.com_radius - self.com_to_axis
        for span in self.spans:
            if span.double:
                planes = [self.distances[name][span.ticks] for name in ("tip_plane", "back_plane")]
                out[span.ticks] = np.minimum(*planes)
        return out

    @cached_property
    def true_margin(self) -> Array:
        """Signed distance [m] of the CoM's projection to the hull of the soles on the ground, positive inside."""
        return self._hull_margin(self.trace.model.soles)

    @cached_property
    def urdf_margin(self) -> Array | None:
        """`true_margin` over the soles the URDF has, where the configuration states others; else None."""
        soles = urdf_soles(self.trace)
        return None if soles is None else self._hull_margin(soles)

    @cached_property
    def ground(self) -> Ground | None:
        """What the ground says of a walk in physics; None of another."""
        from dqwalk_ros.report.ground import ground

        return ground(self)

    def corners(self, tick: int, soles: Mapping[Foot, Sole] | None = None) -> tuple[Array, Array]:
        """Return the corners (4, 3) of the base and of the other sole at a tick, in the base sole's frame [m]."""
        soles = soles or self.trace.model.soles
        base = self.spans[int(self.span_of[tick])].phase.base
        return soles[base].corners, DQ(self.end[tick]).transform_point(soles[base.other].corners)

    @cached_property
    def span_of(self) -> NDArray[np.intp]:
        """Index of each tick's span, shape (N,)."""
        starts = [span.start for span in self.spans]
        return np.clip(np.searchsorted(starts, np.arange(len(self.time)), side="right") - 1, 0, None)

    def _of_end_foot(self, pick: Callable[[Sole], Array]) -> Array:
        """Return a point of the other sole in the base sole's frame at every tick, shape (N, 3)."""
        out = np.full((len(self.time), 3), np.nan)
        for span in self.spans:
            out[span.ticks] = DQ(self.end[span.ticks]).transform_point(
                pick(self.trace.model.soles[span.phase.base.other])
            )
        return out

    def _hull_margin(self, soles: Mapping[Foot, Sole]) -> Array:
        out = np.full(len(self.time), np.nan)
        for span in self.spans:
            base, other = soles[span.phase.base], soles[span.phase.base.other]
            corners = np.broadcast_to(base.corners[:, :2], (span.end - span.start, 4, 2))
            if span.double:
                x = DQ(self.end[span.ticks])
                ends = [x.transform_point(corner)[:, :2] for corner in other.corners]
                corners = np.concatenate([corners, np.stack(ends, axis=1)], axis=1)
            out[span.ticks] = hull_margin(corners, self.com_on_ground[span.ticks])
        return out


def analyse(trace: Trace) -> Series:
    """Compute every series of a walk."""
    model, config = trace.model, trace.config
    count = len(trace.time)
    shapes = ((), (3,), (8,), (3,), (2,))
    task_error, com, end, pelvis, ground = (np.full((count, *shape), np.nan) for shape in shapes)
    up = _up(trace)
    kept: dict[str, Array] = {}
    residuals: dict[str, Array] = {}
    spans: list[Span] = []
    stops = [record.start for record in trace.phases[1:]] + [count]
    ends: list[Array | None] = [record.q_start for record in trace.phases[1:]]
    ends.append(trace.q[-1] if trace.finished else None)
    for record, stop, q_end in zip(trace.phases, stops, ends, strict=True):
        phase = record.phase(config, model)
        span = Span(record, phase, record.start, stop, _ending(model, phase, q_end))
        spans.append(span)
        tables = [(row.name, residuals) for row in phase.equalities] + [(row.name, kept) for row in phase.constraints]
        columns = [(name, table.setdefault(name, np.full(count, np.nan))) for name, table in tables]
        for tick in range(record.start, stop):
            kin = Kinematics(model, trace.q[tick], phase.base)
            if up is not None and np.isfinite(up[tick]).all():
                kin = kin.tilted(kin.direction(model.imu, up[tick]))
            now = phase.evaluate(kin)
            task_error[tick], com[tick], ground[tick] = now.error, kin.com, kin.com_on_ground
            end[tick], pelvis[tick] = kin.pose(kin.swing), kin.point(model.pelvis)
            distances = now.distances()
            for name, column in columns:
                column[tick] = distances[name]
    return Series(trace, tuple(spans), task_error, kept, residuals, com, end, pelvis, ground)


def _up(trace: Trace) -> Array | None:
    """Return the unit vectors against gravity in the inertial sensor's frame, shape (N, 3)."""
    if trace.physics is None:
        return None
    return DQ(trace.physics.orientation).conj().Ad(DQ(np.array([0.0, 0.0, 1.0]))).vec3()


def _ending(model: RobotModel, phase: Phase, q: Array | None) -> Ending | None:
    if q is None:
        return None
    kin = Kinematics(model, q, phase.base)
    carrying = model.soles[phase.support]
    center = kin.point(carrying.frame, carrying.center)
    return Ending(
        phase.error(kin),
        float(np.linalg.norm((kin.com - center)[:2])),
        kin.pose(model.soles[phase.base.other].frame),
    )
