"""The content of a picture of the walk: bodies, soles, constraints as shapes, and every margin.

Nothing is drawn here. The live page (`dqwalk_ros.report.viewer`), the replay in a report and the markers for RViz draw
the same `View`; the movie draws its shapes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.paper.constraints import PLAIN, Constraint, Region
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import ConvexPolygon
from dqwalk_ros.paper.kinematics import Kinematics, compose
from dqwalk_ros.paper.phase import Phase
from dqwalk_ros.report.colors import Rgb
from dqwalk_ros.report.metrics import support_polygon
from dqwalk_ros.report.verdict import Assessment, Assessor
from dqwalk_ros.robot.model import RobotModel, find_urdf
from dqwalk_ros.robot.shapes import PRIMITIVES, kind_and_size, meshes_of, rgba_of
from dqwalk_ros.robot.standing_limits import divergent_component
from dqwalk_ros.robot.urdf import Urdf, pose_of
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ModelError
from dqwalk_ros.trace import Trace
from dqwalk_ros.walks.table import make_walk

_Rgba = tuple[float, float, float, float]
_GREY: _Rgba = (0.7, 0.72, 0.75, 1.0)


@dataclass(frozen=True)
class BodyShape:
    """One visual shape of the robot."""

    body: int
    """Index of the body to which it is attached."""
    kind: str
    """``box`` (size: x, y, z), ``cylinder`` (radius, length; along z), ``sphere`` (radius), or ``mesh``."""
    size: tuple[float, ...]
    """[m]"""
    pose: Array
    """In the frame of the body, shape (8,)."""
    color: _Rgba
    """Red, green, blue, opacity."""
    vertices: Array | None = None
    faces: NDArray[np.int64] | None = None
    """Of a mesh, shapes (N, 3) [m] and (M, 3)."""


def shapes_of(config: Config, model: RobotModel) -> tuple[BodyShape, ...]:
    """Return the visual shapes of the model's URDF; meshes whose file is missing are omitted."""
    urdf = Urdf(model.urdf, model.name)
    try:
        near = find_urdf(config.robot.urdf)
    except ModelError:
        near = Path(config.robot.urdf)
    plain = [
        BodyShape(
            frame.body,
            kind,
            size,
            (DQ(frame.pose) * pose_of(shape.origin)).vec8(),
            rgba_of(shape) or _GREY,
        )
        for name, frame in model.frames.items()
        for shape in urdf.links[name].visuals
        for kind, size in [kind_and_size(shape)]
        if kind in PRIMITIVES
    ]
    meshes = [
        BodyShape(frame.body, "mesh", (), frame.pose, surface.color or _GREY, surface.vertices, surface.faces)
        for name, surface in meshes_of(urdf, near)
        if (frame := model.frames.get(name)) is not None
    ]
    return (*plain, *meshes)


def bodies_of(kin: Kinematics, x_base: Array) -> Array:
    """Return the poses (B, 8) of all bodies, given that of the base sole (8,)."""
    return (DQ(x_base) * DQ(np.array([kin.pose(link) for link in kin.model.links]))).vec8()


def top_of(shapes: Iterable[BodyShape], bodies: Array) -> float:
    """Return the height of the highest point of a robot [m], of meshes or origins, given the poses (B, 8) of bodies."""
    tops = [DQ(bodies).translation()[:, 2].max()]
    for shape in shapes:
        points = np.zeros((1, 3)) if shape.vertices is None else shape.vertices
        tops.append((DQ(bodies[shape.body]) * DQ(shape.pose)).transform_point(points)[:, 2].max())
    return float(max(tops))


def on_ground(polygon: ConvexPolygon, x_base: Array) -> Array:
    """Return the vertices (m, 3) [m] of a polygon in the plane of the base sole, given the sole's pose (8,)."""
    corners: Array = DQ(x_base).transform_point(np.pad(polygon.vertices, ((0, 0), (0, 1))))
    return corners


class NamedRegion(NamedTuple):
    """The region of a constraint with its name and colour, in odom or in the base frame."""

    name: str
    region: Region
    color: Rgb

    @property
    def extent(self) -> Array:
        """Extent along the axes of its frame, zero along the normal of a plane or a wall, shape (3,) [m]."""
        a, b = self.region.size
        return np.array(
            {"cylinder": (2.0 * a, 2.0 * a, b), "plane": (a, b, 0.0), "wall": (a, 0.0, b)}[self.region.kind]
        )


@dataclass(frozen=True)
class Gauge:
    """One margin against its threshold."""

    name: str
    value: float
    """Distance left to the threshold, which is at zero, in `unit`."""
    unit: str
    """``mm`` or ``°``."""
    share: float
    """`value` relative to the largest possible one; the tightest margin has the smallest share."""
    role: str
    """``kept`` (an inequality), ``held`` (an equality; `value` is its residual) or ``watched`` (not a constraint)."""
    title: str = ""
    """Of the constraint; empty if it has none."""
    color: Rgb = PLAIN.color
    """Red, green, blue."""

    @property
    def label(self) -> str:
        """What pictures call it: its title, or its name."""
        return self.title or self.name.replace("_", " ")


def _gauge(constraint: Constraint, d: float) -> Gauge:
    margin, look = constraint.margin(d), constraint.look
    value, unit = (1e3 * margin, "mm") if constraint.unit == "m" else (math.degrees(margin), "°")
    return Gauge(constraint.name, value, unit, margin / constraint.full_margin, "kept", look.title, look.color)


@dataclass(frozen=True)
class Moment:
    """A state of a walk and the phase it belongs to."""

    time: float
    """[s]"""
    q: Array
    """Shape (n,) [rad]."""
    phase: Phase
    index: int
    """Number of the phase, 0, 1, ... from the beginning of the walk."""
    began: float
    """Time at which the phase began [s]."""
    x_odom_base: Array
    """Pose of the phase's base sole in odom, shape (8,)."""
    label: str = ""
    """Published state of the walk: the phase's name, ``finished``, ``failed``, ..."""
    solver: str = ""
    """Last message about the solver of the quadratic program."""
    dq: Array | None = None
    """Joint velocities, shape (n,) [rad/s]; None if not known."""
    up: Array | None = None
    """Unit vector against gravity in the inertial sensor's frame, shape (3,); None without the sensor."""


@dataclass(frozen=True)
class View:
    """Everything to be drawn of a `Moment`; positions are in odom [m]."""

    moment: Moment
    level: str
    """Of the `Assessment`."""
    bodies: Array
    """Pose of each body of the model, shape (B, 8)."""
    soles: dict[Foot, Array]
    """Shape (8,)."""
    com: Array
    """Shape (3,)."""
    ground: float
    """Height of the ground."""
    polygon: Array
    """Support polygon, counter-clockwise, shape (m, 3)."""
    target: Array | None
    """Target pose of the swing sole, shape (8,)."""
    regions: tuple[NamedRegion, ...]
    gauges: tuple[Gauge, ...]
    error: float
    """Norm of the task error."""
    divergent: Array | None = None
    """Divergent component of motion on the ground, as the joints say, where their velocities are known, shape (3,)."""


def tightest(gauges: Iterable[Gauge]) -> Gauge:
    """Return the inequality with the least share left."""
    return min((g for g in gauges if g.role == "kept"), key=lambda gauge: gauge.share)


class Scene:
    """Turns moments of one walk into views."""

    def __init__(self, config: Config, model: RobotModel) -> None:
        self.config, self.model = config, model
        self._assess: Assessor | None = None

    @cached_property
    def shapes(self) -> tuple[BodyShape, ...]:
        """The visual shapes of the robot."""
        return shapes_of(self.config, self.model)

    def assess(self, moment: Moment) -> tuple[Kinematics, Assessment]:
        """Return the kinematics at a moment, in the frame of the base sole, and the assessment of the state."""
        phase, model = moment.phase, self.model
        if self._assess is None or self._assess.phase is not phase:
            self._assess = Assessor(self.config, model, phase)
        kin = Kinematics.measured(model, moment.q, phase.base, moment.up)
        return kin, self._assess(kin, moment.time - moment.began)

    def look(self, moment: Moment) -> View:
        """Return the view of a moment."""
        phase, model = moment.phase, self.model
        kin, found = self.assess(moment)
        x = np.asarray(moment.x_odom_base)
        polygon = support_polygon(model, phase.base, kin, double=phase.double)
        regions = [(c, shape) for c in phase.inequalities if (shape := c.region(kin)) is not None]
        return View(
            moment=moment,
            level=found.level,
            bodies=bodies_of(kin, x),
            soles={foot: compose(x, kin.pose(model.soles[foot].frame)) for foot in Foot},
            com=DQ(x).transform_point(kin.com),
            ground=float(DQ(x).transform_point(np.zeros(3))[2]),
            polygon=on_ground(polygon, x),
            target=None if phase.swing_target is None else compose(x, phase.swing_target),
            regions=tuple(
                NamedRegion(c.name, replace(shape, pose=compose(x, shape.pose)), c.look.color) for c, shape in regions
            ),
            gauges=self.gauges(phase, found),
            error=found.values["error"],
            divergent=None if moment.dq is None else DQ(x).transform_point(_divergent(kin, moment.dq)),
        )

    def gauges(self, phase: Phase, found: Assessment) -> tuple[Gauge, ...]:
        """Return every margin against its threshold."""
        values = found.values
        half = 0.5 * self.model.soles[Foot.LEFT].width
        margin = values["margin/polygon"]
        return (
            *(_gauge(row, values[f"distance/{row.name}"]) for row in phase.constraints),
            *(
                Gauge(hold.name, 1e3 * values[f"residual/{hold.name}"], "10⁻³", 0.0, "held")
                for hold in phase.equalities
            ),
            Gauge(
                "support_polygon", 1e3 * margin, "mm", margin / half, "watched", "CoM in the soles (not a constraint)"
            ),
        )


def _divergent(kin: Kinematics, dq: Array) -> Array:
    v = kin.com_jacobian @ dq
    return np.append(divergent_component(kin.com[:2], v[:2], kin.com[2:]), 0.0)


def beginning(config: Config, model: RobotModel) -> Moment:
    """Return the moment before the walk: the robot in its first posture."""
    walk = make_walk(config, model)
    begins = walk.following(None, Kinematics(model, walk.posture, Foot.LEFT))
    assert begins is not None  # every walk has a phase
    phase = walk.phase(begins.kind, begins.support, walk.posture, begins.swing_target)
    return Moment(0.0, walk.posture, phase, 0, 0.0, DQ(1.0).vec8(), label=phase.name)


class Moments:
    """The moments of a recorded walk, whose phases are rebuilt once each, unless they are given."""

    def __init__(self, trace: Trace, phases: Iterable[Phase] = ()) -> None:
        self._trace = trace
        self._starts = [record.start for record in trace.phases]
        self._phases = dict(enumerate(phases))

    def at(self, tick: int, label: str = "", solver: str = "") -> Moment:
        """Return the moment of a tick; its label is by default the name of the phase."""
        trace = self._trace
        index = max(int(np.searchsorted(self._starts, tick, side="right")) - 1, 0)
        record = trace.phases[index]
        if index not in self._phases:
            self._phases[index] = record.phase(trace.config, trace.model)
        passed = float(trace.time[tick] - trace.time[tick - 1]) if tick > 0 else 0.0
        return Moment(
            time=float(trace.time[tick]),
            q=trace.q[tick],
            phase=self._phases[index],
            index=index,
            began=record.time,
            x_odom_base=record.x_odom_base,
            label=label or record.name,
            solver=solver,
            dq=(trace.q[tick] - trace.q[tick - 1]) / passed if passed > 0.0 else None,
            up=trace.up(tick),
        )
