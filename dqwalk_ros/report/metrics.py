"""Time series of a walk: every distance at every tick, computed from the joint angles and the phases alone.

The controller's own values are not used: each phase is rebuilt from its start and evaluated at the recorded angles.
A bag is evaluated in the same way, whichever program recorded it.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.features import CenterOfMassOnGround, Observer, Pose
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import ConvexPolygon, X
from dqwalk_ros.paper.kinematics import Kinematics, compose, support_tree
from dqwalk_ros.paper.phase import Phase, PhaseKind
from dqwalk_ros.plants.base import tilt
from dqwalk_ros.robot.model import RobotModel, Sole, parse_model
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ModelError
from dqwalk_ros.trace import PhaseRecord, PhysicsRecord, Trace

__all__ = [
    "Circle", "Ending", "Ground", "Series", "Span", "analyse", "commanded_way", "hull_margin", "middle",
    "pelvis_in_odom", "shortfall", "support_polygon", "urdf_soles",
]  # fmt: skip


FALLEN = 0.6
"""Height of the pelvis over the lower sole, relative to its first one, below which the robot has fallen."""
TIPPED = np.radians(20.0)
"""Tilt of the more loaded sole above which the robot has fallen [rad]."""
WAY = 0.8
"""Least part of the way of its steps that a walk covers; below it, it was stopped, and marked time."""
_TOUCH = 1e-4
"""Distance beyond an edge up to which the centre of pressure counts as inside, because contacts are soft [m]."""
_TURNED = np.radians(60.0)
"""Turn above which a circle is fitted to the path [rad]."""


# ---------------------------------------------------------------------- one state


def support_polygon(model: RobotModel, phase: Phase, kin: Kinematics) -> ConvexPolygon:
    """Return the convex hull of the soles on the ground, in the base sole's frame [m]."""
    corners = model.soles[phase.base].corners
    if phase.kind is not PhaseKind.SINGLE_SUPPORT:
        end = model.soles[phase.base.other]
        corners = np.concatenate([corners, DQ(kin.pose(end.frame)).transform_point(end.corners)])
    return ConvexPolygon.hull(corners)


# ---------------------------------------------------------------------- many states

_BLOCK = 2000
"""Number of hulls computed at a time; one takes some kilobytes."""
_TINY = 1e-12


def hull_margin(points: Array, p: Array) -> Array:
    """Return the signed distance of each point p[i] to the convex hull of points[i], positive inside.

    Equal to `geometry.ConvexPolygon.hull(points[i]).distance(p[i])`, for all i at once: a segment between two points is
    an edge of the hull if all other points are to its left.

    Parameters
    ----------
    points : ndarray, shape (N, k, 2) [m]
    p : ndarray, shape (N, 2) [m]

    Returns
    -------
    ndarray, shape (N,) [m]
    """
    if len(p) > _BLOCK:
        blocks = [slice(first, first + _BLOCK) for first in range(0, len(p), _BLOCK)]
        return np.concatenate([hull_margin(points[block], p[block]) for block in blocks])
    i, j = np.nonzero(~np.eye(points.shape[1], dtype=bool))  # m ordered pairs
    a = points[:, i]  # (N, m, 2)
    t = points[:, j] - a
    length = np.maximum(np.linalg.norm(t, axis=2), _TINY)
    n = np.stack([-t[..., 1], t[..., 0]], axis=2) / length[..., None]
    side = np.einsum("nmc,nkc->nmk", n, points) - np.einsum("nmc,nmc->nm", n, a)[..., None]
    edge = (side >= -_TINY).all(axis=2) & (length > 10.0 * _TINY)
    v = p[:, None] - a
    inside = np.where(edge, np.einsum("nmc,nmc->nm", v, n), np.inf).min(axis=1)
    s = np.clip(np.einsum("nmc,nmc->nm", v, t) / length**2, 0.0, 1.0)
    outside = np.where(edge, np.linalg.norm(v - s[..., None] * t, axis=2), np.inf).min(axis=1)
    out: Array = np.where(inside >= 0.0, inside, -outside)
    return out


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
class Ending:
    """Quantities at the end of a phase, which is the first state of the next phase.

    Attributes
    ----------
    error : float
        Norm of the task error, as in `Series.error`.
    com_to_axis : float
        Horizontal distance of the CoM from the centre of the next support foot [m].
    end : ndarray, shape (8,)
        Pose of the other sole in the base sole's frame.
    """

    error: float
    com_to_axis: float
    end: Array

    @classmethod
    def at(cls, model: RobotModel, phase: Phase, q: Array) -> Ending:
        """Return the end of a phase at joint angles `q` (n,)."""
        kin = Kinematics(model, q, phase.base)
        center = kin.point(model.soles[phase.support].frame, model.soles[phase.support].center)
        return cls(phase.evaluate(kin.q).error, float(np.linalg.norm((kin.com - center)[:2])), kin.pose(kin.swing))


@dataclass(frozen=True)
class Span:
    """One phase of the walk.

    Attributes
    ----------
    record : PhaseRecord
        The recorded start of the phase.
    phase : Phase
        The rebuilt phase.
    start, end : int
        Its ticks, ``start <= tick < end``.
    ending : Ending or None
        None if the walk stopped before the end of the phase, or the phase was interrupted.
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
    """Time series of a walk, one value per tick (N of them); nan where a quantity is not defined.

    Attributes
    ----------
    error : ndarray, shape (N,)
        Norm of the task error: [m] in double support, of vec8 in single support.
    distances : dict of str to ndarray, shape (N,)
        Distance of each inequality minus its bound: not negative while the inequality holds.
    residuals : dict of str to ndarray, shape (N,)
        Residual of each equality: zero while it holds.
    com, pelvis : ndarray, shape (N, 3)
        Centre of mass (U4) and pelvis in the base sole's frame [m].
    end : ndarray, shape (N, 8)
        Pose of the other sole in the base sole's frame.
    com_on_ground : ndarray, shape (N, 2)
        Intersection of the vertical through the CoM with the base sole's plane [m]; with an inertial sensor, the
        vertical is the measured one.
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
        """Height of the other foot's tip above the base sole's ground [m], the distance of (U8)."""
        return self._of_end_foot(lambda sole: sole.tip)[:, 2]

    @cached_property
    def slide(self) -> Array:
        """Distance of the end foot's tip from its position at the start of double support [m], as in (U7)."""
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
        """Horizontal distance of the CoM from the centre of the support foot, in double support the next one [m]."""
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
        """Distance of the CoM to the boundary of the paper's support region, positive inside [m].

        Double support: the smaller distance to the tip and the back plane (U9), (U10). Single support: the radius of
        the cylinder (U14) minus the distance from its axis. A standing walk has neither; the margin is then nan.
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
        return self.polygon_margin(self.com_on_ground)

    @cached_property
    def urdf_margin(self) -> Array | None:
        """`true_margin` for the soles of the URDF, if the configuration has different ones; else None."""
        soles = urdf_soles(self.trace)
        return None if soles is None else self.polygon_margin(self.com_on_ground, soles)

    @cached_property
    def ground(self) -> Ground | None:
        """True motion and contact of a walk in physics; None without physics or ground."""
        physics, held = self.trace.physics, self.trace.config.physics.held
        return None if physics is None or held or not np.isfinite(physics.pelvis).any() else Ground(self, physics)

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
    kept: dict[str, Array] = {}
    residuals: dict[str, Array] = {}
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
        margins = np.empty((len(ticks), len(phase.assembly.names)))
        for k, tick in enumerate(ticks):
            kin = Kinematics.measured(model, trace.q[tick], phase.base, trace.up(tick))
            now = phase.evaluate(kin.q, kin.up)
            task_error[tick], com[tick], seen[tick] = now.error, kin.com, observe(kin)[0]
            margins[k] = now.margins
        found = phase.assembly.by_name(margins)
        for table, rows in ((residuals, phase.equalities), (kept, phase.constraints)):
            for row in rows:
                if row.name not in table:
                    table[row.name] = np.full(count, np.nan)
                table[row.name][ticks.start : ticks.stop] = found[row.name]
    end, pelvis, ground = seen[:, :8], DQ(seen[:, 8:16]).translation(), seen[:, 16:]
    return Series(trace, tuple(spans), task_error, kept, residuals, com, end, pelvis, ground)


# ---------------------------------------------------------------------- in physics


def middle(soles: Mapping[Foot, Array], model: RobotModel) -> Array:
    """Return the middle between the centres of both soles with poses (..., 8), shape (..., 3) [m]."""
    centers = [DQ(soles[foot]).transform_point(model.soles[foot].center) for foot in Foot]
    return np.asarray(np.mean(centers, axis=0))


def commanded_way(steps: Iterable[Phase]) -> float:
    """Return the length of the way of the middle between the soles if each step lands on its target [m].

    Parameters
    ----------
    steps : iterable of Phase
        The single supports that ended with a landing.
    """
    way, before = 0.0, None
    for phase in steps:
        assert phase.swing_target is not None
        if before is None:
            kin = Kinematics(phase.model, phase.q_start, phase.base)
            before = DQ(kin.pose(kin.swing))
        target = DQ(phase.swing_target)
        way += 0.5 * float(np.linalg.norm((target.translation() - before.translation())[:2]))
        before = target.conj()  # the foot that swings next, in the frame of the one that has landed
    return way


def shortfall(way: float, commanded: float) -> str:
    """Return a sentence that says that a walk covered too little of its commanded way [m]; empty if it did not."""
    short = way < WAY * commanded
    return f"the robot was stopped: its soles went {way:.2f} m, its steps lead {commanded:.2f} m" if short else ""


@dataclass(frozen=True)
class Circle:
    """The circle of least squares through a path.

    Attributes
    ----------
    center : ndarray, shape (2,)
        In the world [m].
    radius, deviation : float
        Radius, and root mean square distance of the path from the circle [m].
    """

    center: Array
    radius: float
    deviation: float

    @classmethod
    def through(cls, p: Array) -> Circle:
        """Return the circle of least squares through the points `p` (N, 2) [m]."""
        A = np.column_stack([2.0 * p, np.ones(len(p))])
        x, y, c = np.linalg.lstsq(A, (p**2).sum(axis=1), rcond=None)[0]
        center, radius = np.array([x, y]), float(np.sqrt(c + x**2 + y**2))
        off = np.linalg.norm(p - center, axis=1) - radius
        return cls(center, radius, float(np.sqrt(np.mean(off**2))))


class Ground:
    """True motion and contact of a walk in physics: tilt of the soles, centre of pressure, path.

    Computed from the true pose of the pelvis, the true joint angles and the wrenches on the soles. Bags from before the
    true angles were recorded have the measured ones instead, with the errors of the sensors. From the controller only
    the phases are used, which define the support soles. Series have one value per tick (N of them), in the world.

    Attributes
    ----------
    soles : dict of Foot to ndarray, shape (N, 8)
        True poses.
    com : ndarray, shape (N, 3)
        [m]
    tilt : ndarray, shape (N,)
        Of the more loaded sole [rad].
    cop_margin : ndarray, shape (N,)
        Distance of the centre of pressure to the edge of the phase's support soles, positive inside [m]; nan in the
        air.
    height : ndarray, shape (N,)
        Of the pelvis over the lower sole [m].
    stands : ndarray, shape (M, 3)
        x, y [m] and yaw [rad, unwrapped] halfway between the feet, at the start of each double support or stance and at
        the end.
    circle : Circle or None
        Fitted if the path turns far enough.
    power : ndarray, shape (N,)
        Of all joints in the period before each state, sum |tau dq| [W]; nan at the first state, and where torques were
        not recorded. It is the mean torque times the mean velocity: at a single moment, such as before each change of
        the servos' goals, the torque is not that of the period.
    work : ndarray, shape (N,)
        Sum of the positive part of each joint's power [W]: the power of servos that do not recover braking energy.
    """

    def __init__(self, series: Series, physics: PhysicsRecord) -> None:
        trace, model, count = series.trace, series.trace.model, len(series.trace)
        self.physics, self._series = physics, series
        self.soles = {foot: np.empty((count, 8)) for foot in Foot}
        self.com, self.cop_margin = np.empty((count, 3)), np.full(count, np.nan)
        true_q = np.where(np.isfinite(physics.q), physics.q, trace.q)
        for span in series.spans:
            ticks, base = span.ticks, span.phase.base
            kins = [Kinematics(model, q, base) for q in true_q[ticks]]
            pelvis, end = (
                np.array([kin.pose(f) for kin in kins]) for f in (model.pelvis, model.soles[base.other].frame)
            )
            x = DQ(physics.pelvis[ticks]) * DQ(pelvis).conj()
            self.soles[base][ticks] = x.vec8()
            self.soles[base.other][ticks] = (x * DQ(end)).vec8()
            self.com[ticks] = x.transform_point(np.array([kin.com for kin in kins]))
            feet = tuple(Foot) if span.double else (span.phase.support,)
            poses = {foot: DQ(self.soles[foot][ticks]) for foot in feet}
            corners = [x.transform_point(c)[:, :2] for foot, x in poses.items() for c in model.soles[foot].corners]
            self.cop_margin[ticks] = hull_margin(np.stack(corners, axis=1), physics.cop[ticks, :2])
        lower = np.min([DQ(self.soles[foot]).translation()[:, 2] for foot in Foot], axis=0)
        self.height = DQ(physics.pelvis).translation()[:, 2] - lower
        self.cop_margin[~np.isfinite(physics.cop).all(axis=1)] = np.nan
        loads = np.stack([physics.wrenches[foot][:, 2] for foot in Foot], axis=1)
        tilts = np.stack([tilt(self.soles[foot]) for foot in Foot], axis=1)
        self.tilt = tilts[np.arange(count), np.argmax(np.nan_to_num(loads), axis=1)]
        self.stands = self._stands()
        turned = abs(float(self.stands[-1, 2] - self.stands[0, 2]))
        arc = turned > _TURNED and len(self.stands) > 5
        self.circle = Circle.through(self.stands[1:, :2]) if arc else None
        joints = np.full(true_q.shape, np.nan)  # power [W]
        joints[1:] = physics.effort[1:] * np.diff(true_q, axis=0) / np.diff(trace.time)[:, None]
        self.power, self.work = np.abs(joints).sum(axis=1), np.maximum(joints, 0.0).sum(axis=1)

    @property
    def way(self) -> float:
        """Length of the path of the middle between the soles, from step to step [m]."""
        return float(np.linalg.norm(np.diff(self.stands[:, :2], axis=0), axis=1).sum())

    @property
    def commanded(self) -> float:
        """Length of that path if each step lands on its target [m]."""
        return commanded_way(span.phase for span in self._series.spans if not span.double and span.ending is not None)

    @property
    def inside(self) -> float:
        """Fraction of the ticks whose centre of pressure is inside; ticks in the air count as outside."""
        return float(np.mean(np.nan_to_num(self.cop_margin, nan=-np.inf) >= -_TOUCH))

    @property
    def fallen(self) -> bool:
        """Whether the robot fell: its pelvis is too low, or a loaded sole is tilted too far."""
        low = np.nanmin(self.height) < FALLEN * self.height[np.isfinite(self.height)][0]
        return bool(low or np.nanmax(self.tilt) > TIPPED)

    @property
    def swing_load(self) -> float | None:
        """Fraction of the weight on the swing foot, the median of all ticks; None without single support."""
        parts = []
        for span in self._series.spans:
            if not span.double:
                feet = (span.phase.support.other, span.phase.support)
                swing, support = (self.physics.wrenches[foot][span.ticks, 2] for foot in feet)
                parts.append(swing / np.maximum(swing + support, 1e-3))
        part = np.concatenate(parts) if parts else np.empty(0)
        return float(np.nanmedian(part)) if np.isfinite(part).any() else None

    @property
    def load_error(self) -> float | None:
        """Error of the estimated fraction of the weight on the left foot, the median; None without an estimate."""
        if (loads := self._series.trace.loads) is None:
            return None
        true = np.stack([self.physics.wrenches[foot][:, 2] for foot in Foot], axis=1)
        estimated, real = (f[:, 0] / np.maximum(f.sum(axis=1), 1e-3) for f in (loads, true))
        error = np.abs(estimated - real)
        return float(np.nanmedian(error)) if np.isfinite(error).any() else None

    @property
    def drift(self) -> float:
        """Horizontal error of odometry at the end, relative to the first base sole [m]."""
        first, last = self._series.spans[0], self._series.spans[-1]
        true = DQ(self.soles[first.phase.base][0]).conj() * DQ(self.soles[last.phase.base][-1])
        estimated = DQ(first.record.x_odom_base).conj() * DQ(last.record.x_odom_base)
        return float(np.linalg.norm((true.translation() - estimated.translation())[:2]))

    def _stands(self) -> Array:
        series = self._series
        ticks = [span.start for span in series.spans if span.double] + [len(series.time) - 1]
        soles, yaws = {foot: x[ticks] for foot, x in self.soles.items()}, []
        for x in soles.values():
            ahead = DQ(x).P().Ad(DQ(X)).vec3()
            yaws.append(np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0])))
        return np.column_stack([middle(soles, series.trace.model)[:, :2], np.mean(yaws, axis=0)])
