"""Data of the replay in a report: shapes, poses of the bodies and curves, as compact JSON."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.report.colors import DIVERGENT, Rgb
from dqwalk_ros.report.metrics import Series
from dqwalk_ros.report.scene import BodyShape, Moments, NamedRegion, Scene, shapes_of, tightest, top_of
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array

_FRAMES, _RATE = 2400, 60.0
"""Largest number of frames of a walk, and largest rate [Hz]; the replay interpolates between them."""
_DIGITS = 7
"""Digits of positions in JSON, to keep the file small."""


def frames_of(time: Array) -> NDArray[np.intp]:
    """Return the indices of the states that are the frames of a walk, given the times of its states (N,) [s]."""
    count = min(len(time), _FRAMES, math.ceil(_RATE * float(time[-1] - time[0])) + 1)
    return np.unique(np.linspace(0, len(time) - 1, count).astype(np.intp))


class Stretch(NamedTuple):
    """A part of the walk with one name: its beginning [s], whether both feet stand, and the landing target."""

    time: float
    name: str
    double: bool
    target: tuple[Foot, Array] | None = None
    """Swing foot and corners (4, 3) of its sole [m]."""


class Curve(NamedTuple):
    """A quantity over time (N,), nan where it is absent."""

    title: str
    unit: str
    values: Array


class Mark(NamedTuple):
    """A point over time (N, 3) [m], nan where absent: a ball, or a disc on the ground."""

    color: Rgb
    points: Array
    disc: bool = False


@dataclass(frozen=True, kw_only=True)
class Replay:
    """What the replay shows of a walk, with N frames."""

    config: Config
    model: RobotModel
    time: Array
    bodies: Array
    com: Array
    """Of each frame, shapes (N,) [s], (N, B, 8), (N, 3) [m]: time since the first one, poses of the bodies, centre of
    mass."""
    polygons: Sequence[Array]
    """Support polygon of each frame, shape (m, 3) [m]."""
    prints: Sequence[tuple[float, Foot, Array]]
    """Each footprint with the time from which it is shown [s] and its corners (4, 3) [m]."""
    stretches: Sequence[Stretch]
    curves: Mapping[str, Curve]
    """By the name of the constraint, whose region it belongs to, or another one."""
    marks: Sequence[Mark]
    tight: Sequence[str]
    """Name of the curve that is marked in each frame."""
    regions: Sequence[Sequence[NamedRegion]] = ()
    """Regions of the constraints in each frame."""

    def data(self) -> dict[str, Any]:
        """Return plain data for `replay.js`; arrays of numbers as base64 of little-endian float32."""
        names, shapes = list(dict.fromkeys(self.tight)), shapes_of(self.config, self.model)
        return {
            "shapes": [shape_data(shape) for shape in shapes],
            "height": float(top_of(shapes, self.bodies[0]) - self.polygons[0][:, 2].mean()),
            "t": _packed(self.time),
            "bodies": _packed(_moving(self.bodies)),
            "com": _packed(self.com),
            "polygons": {"counts": _bytes(map(len, self.polygons)), "v": _packed(np.concatenate(self.polygons))},
            "prints": [{"t": t, "foot": foot.value, "c": _points(corners)} for t, foot, corners in self.prints],
            "phases": [_phase(stretch) for stretch in self.stretches],
            "curves": [
                {"name": name, "title": c.title, "unit": c.unit, "v": _packed(c.values)}
                for name, c in self.curves.items()
            ],
            "marks": [{"color": _color(m.color), "disc": m.disc, "v": _packed(m.points)} for m in self.marks],
            "regions": _regions(self.regions),
            "tight": {"names": names, "at": _bytes(names.index(name) for name in self.tight)},
        }


def replay_data(series: Series) -> dict[str, Any]:
    """Return the data of a walk of phases, each frame being a `View`; see `Replay`."""
    trace, model = series.trace, series.trace.model
    starts = [span.start for span in series.spans]
    ticks = np.unique(np.concatenate([frames_of(trace.time), starts]))
    scene, moments = Scene(trace.config, model), Moments(trace, (span.phase for span in series.spans))
    views = [scene.look(moments.at(tick)) for tick in ticks.tolist()]
    curves: dict[str, Curve] = {}
    for row, view in enumerate(views):
        for gauge in view.gauges:
            if gauge.role != "held":
                absent = np.full(len(ticks), np.nan)
                curves.setdefault(gauge.name, Curve(gauge.label, gauge.unit, absent)).values[row] = gauge.value
    if trace.loads is not None:
        for k, foot in enumerate(Foot):
            title = f"load on the {foot.value} sole"
            curves[title] = Curve(title, "N", trace.loads[ticks, k])
    prints, stretches = [], []
    for span in series.spans:
        start, base, x = float(trace.time[span.start] - trace.time[0]), span.phase.base, DQ(span.record.x_odom_base)
        prints.append((start, base, x.transform_point(model.soles[base].corners)))
        landing = None
        if span.phase.swing_target is not None:
            corners = model.soles[base.other].corners
            landing = base.other, (x * DQ(span.phase.swing_target)).transform_point(corners)
        stretches.append(Stretch(start, span.phase.name, span.double, landing))
    divergent = np.array([np.full(3, np.nan) if view.divergent is None else view.divergent for view in views])
    return Replay(
        config=trace.config, model=model, time=trace.time[ticks] - trace.time[0],
        bodies=np.array([view.bodies for view in views]), com=np.array([view.com for view in views]),
        polygons=[view.polygon for view in views], prints=prints, stretches=stretches, curves=curves,
        marks=[Mark(DIVERGENT, divergent, disc=True)], tight=[tightest(view.gauges).name for view in views],
        regions=[view.regions for view in views],
    ).data()  # fmt: skip


def _moving(x: Array) -> Array:
    """Return poses (N, ..., 8) as positions and quaternions (N, ..., 7), which can be interpolated over time."""
    p, r = DQ(x).translation(), DQ(x).rotation().copy()
    r[1:] *= np.where((r[1:] * r[:-1]).sum(-1, keepdims=True) < 0.0, -1.0, 1.0).cumprod(axis=0)  # r and -r are the same
    return np.concatenate([p, r], axis=-1)


def _phase(stretch: Stretch) -> dict[str, Any]:
    target = stretch.target and {"foot": stretch.target[0].value, "c": _points(stretch.target[1])}
    return {"name": stretch.name, "t": stretch.time, "double": stretch.double, "target": target}


def _regions(frames: Sequence[Sequence[NamedRegion]]) -> list[dict[str, Any]]:
    """Return position, quaternion and extent (N, 10) of each region, nan in the frames without it."""
    first = {region.name: region for regions in reversed(frames) for region in regions}
    poses = {name: np.full((len(frames), 8), np.nan) for name in first}
    extents = {name: np.full((len(frames), 3), np.nan) for name in first}
    for row, regions in enumerate(frames):
        for region in regions:
            poses[region.name][row], extents[region.name][row] = region.region.pose, region.extent
    return [
        {
            "name": name, "kind": "cylinder" if region.region.kind == "cylinder" else "box",
            "color": _color(region.color), "v": _packed(np.hstack([_moving(poses[name]), extents[name]])),
        }
        for name, region in first.items()
    ]  # fmt: skip


def shape_data(shape: BodyShape) -> dict[str, Any]:
    """Return the data of a shape: its body, kind, size, colour and pose, and the triangles of a mesh."""
    return {"b": shape.body, "k": shape.kind, **_size(shape), "c": list(shape.color), **_pose(shape.pose)}


def _size(shape: BodyShape) -> dict[str, Any]:
    if shape.vertices is None or shape.faces is None:
        return {"s": list(shape.size)}
    return {"s": [1.0, 1.0, 1.0], "v": _packed(shape.vertices), "f": _packed(shape.faces, "<u4")}


def _pose(x: Array) -> dict[str, list[float]]:
    return {"p": _rounded(DQ(x).translation()), "r": [float(v) for v in x[:4]]}


def _rounded(values: Array) -> list[float]:
    """Return numbers for JSON, rounded to keep the file small."""
    return [round(float(v), _DIGITS) for v in values]


def _points(points: Array) -> list[list[float]]:
    return [_rounded(point) for point in points]


def _color(color: Rgb) -> list[float]:
    return [round(channel / 255.0, 4) for channel in color]


def _bytes(values: Iterable[int]) -> str:
    return base64.b64encode(bytes(values)).decode()


def _packed(values: NDArray[Any], kind: str = "<f4") -> str:
    """Return numbers as base64 of little-endian float32, or of another type."""
    return base64.b64encode(np.ascontiguousarray(values, kind).tobytes()).decode()
