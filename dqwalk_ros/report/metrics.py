"""Time series of a walk: every distance at every tick, computed from the joint angles and the phases alone.

The controller's own values are not used: each phase is rebuilt from its start and evaluated at the recorded angles.
A bag is evaluated in the same way, whichever program recorded it.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.features import CenterOfMassOnGround, Observer, Pose
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import ConvexPolygon
from dqwalk_ros.paper.kinematics import Kinematics, compose, support_tree
from dqwalk_ros.paper.phase import Phase, PhaseKind
from dqwalk_ros.paper.rows import least_after
from dqwalk_ros.report.ground import GroundTruth
from dqwalk_ros.report.hull import hull_margin
from dqwalk_ros.report.spans import Ending, Span
from dqwalk_ros.robot.model import RobotModel, Sole, parse_model
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.support.errors import ModelError, PlantError
from dqwalk_ros.trace import Trace
from dqwalk_ros.walks.table import style_of

# ---------------------------------------------------------------------- one state


_KEEPING_COM = "tip_plane", "back_plane", "com_cylinder"
"""The constraints that keep the CoM in the paper's support region, (U9), (U10), (U14)."""


def paper_margin(phase: Phase, distances: Mapping[str, float | Array]) -> Array | None:
    """Return the distance of the CoM to the boundary of the paper's support region, positive inside [m].

    It is the smaller distance to the tip and the back plane in double support, and that to the surface of the cylinder
    in single support; None in a phase without them, such as one of a standing walk. `distances` are those of the
    constraints at one state, or at many, shape (N,); the result has the same shape.
    """
    rows = [row for row in phase.constraints if row.name in _KEEPING_COM]
    margins = [np.vectorize(row.margin, otypes=[float])(distances[row.name]) for row in rows]
    return np.min(margins, axis=0) if margins else None


def support_polygon(model: RobotModel, base: Foot, kin: Kinematics, *, double: bool) -> ConvexPolygon:
    """Return the convex hull of the base sole, or of both soles, in the base sole's frame [m]."""
    corners = model.soles[base].corners
    if double:
        end = model.soles[base.other]
        corners = np.concatenate([corners, DQ(kin.pose(end.frame)).transform_point(end.corners)])
    return ConvexPolygon.hull(corners)


# ---------------------------------------------------------------------- many states


def pelvis_in_odom(trace: Trace) -> Array:
    """Return the pose of the pelvis in odom at every tick, by leg odometry, shape (N, 8)."""
    out = np.tile(DQ(1.0).vec8(), (len(trace), 1))
    for record, ticks in zip(trace.phases, trace.spans, strict=True):
        for tick in ticks:
            out[tick] = compose(
                record.x_odom_base, Kinematics(trace.model, trace.q[tick], record.base).pose(trace.model.pelvis)
            )
    return out


def urdf_soles(trace: Trace) -> Mapping[Foot, Sole] | None:
    """Return the soles given by the collision boxes of the URDF; None if the configuration's soles are the same."""
    robot = dataclasses.replace(trace.config.robot, sole_length=0.0, sole_width=0.0, sole_center="link")
    try:
        soles = parse_model(trace.model.urdf, robot).soles
    except ModelError:
        return None
    configured = trace.model.soles
    same = all(np.allclose(soles[foot].corners, configured[foot].corners, atol=1e-6) for foot in Foot)
    return None if same else soles


@dataclass(frozen=True)
class Series:
    """Time series of a walk, one value per tick (N of them); nan where a quantity is not defined."""

    trace: Trace
    spans: tuple[Span, ...]
    error: Array
    """Norm of the task error, shape (N,): [m] in double support, of vec8 in single support."""
    distances: dict[str, Array]
    """Distance of each inequality minus its bound, shape (N,): not negative while the inequality holds."""
    residuals: dict[str, Array]
    """Residual of each equality, shape (N,): zero while it holds."""
    spare: dict[str, Array]
    """Distance of each inequality less the least one that the sampled-data bound allows after the period before it, per
    second (`rows.least_after`), shape (N,); nan at the start of a phase, inf where the program leaves out what is
    far."""
    held: dict[str, Array]
    """The same since the start of the phase, for equalities and inequalities: not negative while the bound holds."""
    com: Array
    """Centre of mass (U4) in the base sole's frame, shape (N, 3) [m]."""
    end: Array
    """Pose of the other sole in the base sole's frame, shape (N, 8)."""
    pelvis: Array
    """In the base sole's frame, shape (N, 3) [m]."""
    com_on_ground: Array
    """Intersection of the vertical through the CoM with the base sole's plane, shape (N, 2) [m]; with an inertial
    sensor, the vertical is the measured one."""

    @property
    def time(self) -> Array:
        """Time of each tick [s], shape (N,)."""
        return self.trace.time

    def distance(self, name: str) -> Array:
        """Return an inequality's distance minus its bound, shape (N,); all nan if no phase of the walk contains it."""
        return self.distances.get(name, np.full(len(self.time), np.nan))

    @cached_property
    def soles(self) -> dict[Foot, Array]:
        """Pose of each sole in odom, shape (N, 8)."""
        out = {foot: np.full((len(self.time), 8), np.nan) for foot in Foot}
        for span in self.spans:
            x, base = DQ(span.record.x_odom_base), span.phase.base
            out[base][span.ticks] = x.vec8()
            out[base.other][span.ticks] = (x * DQ(self.end[span.ticks])).vec8()
        return out

    @cached_property
    def com_odom(self) -> Array:
        """Centre of mass in odom [m], shape (N, 3)."""
        return self._by_span(lambda span: DQ(span.record.x_odom_base).transform_point(self.com[span.ticks]))

    @cached_property
    def tip_height(self) -> Array:
        """Height of the other foot's tip above the base sole's ground, the distance of (U8), shape (N,) [m]."""
        return self._of_end_foot(lambda sole: sole.tip)[:, 2]

    @cached_property
    def slide(self) -> Array:
        """Distance of the end foot's tip from its place at the start of double support, as in (U7), shape (N,) [m]."""
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
        """Horizontal distance of the CoM from the centre of the support foot, in double support the next, (N,) [m]."""
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
    def least_joint_margin(self) -> Array:
        """The smallest `joint_margin` of all joints [rad], shape (N,)."""
        out: Array = self.joint_margin.min(axis=1)
        return out

    @cached_property
    def paper_margin(self) -> Array:
        """The function `paper_margin` of every tick, shape (N,) [m]; nan where it is None."""
        out = np.full(len(self.time), np.nan)
        for span in self.spans:
            margin = paper_margin(span.phase, {name: d[span.ticks] for name, d in self.distances.items()})
            out[span.ticks] = np.nan if margin is None else margin
        return out

    @cached_property
    def true_margin(self) -> Array:
        """Distance of the CoM's projection to the hull of the soles on the ground, positive inside, shape (N,) [m]."""
        return self.polygon_margin(self.com_on_ground)

    @cached_property
    def urdf_margin(self) -> Array | None:
        """`true_margin` for the soles of the URDF, if the configuration has different ones; else None."""
        soles = urdf_soles(self.trace)
        return None if soles is None else self.polygon_margin(self.com_on_ground, soles)

    @cached_property
    def style(self) -> str:
        """The ``gait.style`` of the walk, see `style_of`."""
        return style_of(self.trace.config)

    @cached_property
    def ground(self) -> GroundTruth | None:
        """True motion and contact of a walk in physics; None without physics or ground."""
        physics, held = self.trace.physics, self.trace.config.physics.held
        if physics is None or held or not np.isfinite(physics.pelvis).any():
            return None
        return GroundTruth(self.trace, self.spans, physics)

    @property
    def judged(self) -> GroundTruth:
        """The true motion, by which a walk in physics is judged.

        Raises
        ------
        PlantError
            If it is not known.
        """
        if self.ground is None:
            raise PlantError(
                f"the plant '{self.trace.config.plant.name}' has no ground truth, by which a walk is judged"
            )
        return self.ground

    def polygon_margin(self, points: Array, soles: Mapping[Foot, Sole] | None = None) -> Array:
        """Return the signed distance of points (N, 2) in the base sole's frame to the support polygon [m], (N,)."""
        soles = soles or self.trace.model.soles
        out = np.full(len(self.time), np.nan)
        for double, base in itertools.product((True, False), Foot):
            spans = [span for span in self.spans if span.double is double and span.phase.base is base]
            ticks = np.concatenate([np.zeros(0, np.intp), *(np.arange(span.start, span.end) for span in spans)])
            corners = np.broadcast_to(soles[base].corners[:, :2], (len(ticks), 4, 2))
            if double:
                x = DQ(self.end[ticks])
                ends = [x.transform_point(corner)[:, :2] for corner in soles[base.other].corners]
                corners = np.concatenate([corners, np.stack(ends, axis=1)], axis=1)
            out[ticks] = hull_margin(corners, points[ticks])
        return out

    @cached_property
    def span_of(self) -> NDArray[np.intp]:
        """Index of each tick's span, shape (N,)."""
        starts = [span.start for span in self.spans]
        return np.clip(np.searchsorted(starts, np.arange(len(self.time)), side="right") - 1, 0, None)

    def _by_span(self, value: Callable[[Span], Array]) -> Array:
        """Return a series of points, shape (N, 3), from those of each phase."""
        out = np.full((len(self.time), 3), np.nan)
        for span in self.spans:
            out[span.ticks] = value(span)
        return out

    def _of_end_foot(self, pick: Callable[[Sole], Array]) -> Array:
        """Return a point of the other sole in the base sole's frame at every tick, shape (N, 3)."""
        soles = self.trace.model.soles
        return self._by_span(lambda s: DQ(self.end[s.ticks]).transform_point(pick(soles[s.phase.base.other])))


def analyse(trace: Trace) -> Series:
    """Compute every series of a walk."""
    model, config = trace.model, trace.config
    count = len(trace.time)
    task_error, com, seen = (np.full((count, *shape), np.nan) for shape in ((), (3,), (18,)))
    kept, residuals, spare, held = (dict[str, Array]() for _ in range(4))
    spans: list[Span] = []
    ends: list[Array | None] = [record.q_start for record in trace.phases[1:]]
    ends.append(trace.q[-1] if trace.finished else None)
    for k, (record, after) in enumerate(itertools.pairwise(trace.phases)):
        if record.kind is after.kind is PhaseKind.SINGLE_SUPPORT:  # steps catch a push before the foot has landed
            ends[k] = None
    for record, ticks, q_end in zip(trace.phases, trace.spans, ends, strict=True):
        phase = record.phase(config, model)
        ending = None if q_end is None else Ending.at(model, phase, q_end)
        spans.append(Span(record, phase, ticks.start, ticks.stop, ending))
        features = Pose(model.soles[phase.base.other].frame), Pose(model.pelvis), CenterOfMassOnGround()
        observe = Observer(features, support_tree(model, phase.base))
        margins = np.empty((len(ticks), len(phase.assembly.rows.names)))
        for k, tick in enumerate(ticks):
            kin = Kinematics.measured(model, trace.q[tick], phase.base, trace.up(tick))
            margins[k] = phase.evaluate(kin.q, kin.up, trace.time[tick] - trace.time[ticks.start]).margins
            task_error[tick] = phase.assembly.error(kin, math.inf)  # from the end of a path
            com[tick], seen[tick] = kin.com, observe(kin)[0]
        at, by_name = slice(ticks.start, ticks.stop), phase.assembly.rows.by_name
        left, since = (by_name(values) for values in _sampled(phase, config.dt, trace.time[at], trace.q[at], margins))
        found = by_name(margins)
        for table, rows, values in (
            (residuals, phase.equalities, found),
            (kept, phase.constraints, found),
            (spare, phase.constraints, left),
            (held, (*phase.equalities, *phase.constraints), since),
        ):
            for row in rows:
                table.setdefault(row.name, np.full(count, np.nan))[at] = values[row.name]
    end, pelvis, ground = seen[:, :8], DQ(seen[:, 8:16]).translation(), seen[:, 16:]
    return Series(trace, tuple(spans), task_error, kept, residuals, spare, held, com, end, pelvis, ground)


def _sampled(phase: Phase, dt: float, time: Array, q: Array, margins: Array) -> tuple[Array, Array]:
    """Return `Series.spare` and `Series.held` of each row of a phase of some ticks, both (ticks, rows)."""
    rows, d = phase.assembly.rows, margins.copy()
    d[:, : rows.equalities] = -np.abs(d[:, : rows.equalities])  # an equality converges from either side
    spare, held = np.full(d.shape, np.nan), np.zeros(d.shape)
    turned = np.abs(np.diff(q, axis=0)).sum(axis=1)
    _follow_bounds(d, np.diff(time), turned, dt, rows.numbers, rows.near, rows.radius, spare, held)
    count = len(rows.near)
    spare[1:, :count][d[:-1, :count] >= rows.near] = np.inf
    return spare, held


@jit
def _follow_bounds(
    d: Array,
    periods: Array,
    turned: Array,
    dt: float,
    numbers: Array,
    near: Array,
    radius: Array,
    spare: Array,
    held: Array,
) -> None:
    """Fill `spare` and `held` from the margins d of some ticks, all (ticks, rows); see `rows.least_after`."""
    least = d[0]
    for k in range(len(periods)):
        spare[k + 1] = (d[k + 1] - least_after(d[k], numbers, near, radius, turned[k], periods[k], dt)) / periods[k]
        least = least_after(least, numbers, near, radius, turned[k], periods[k], dt)
        held[k + 1] = d[k + 1] - least
