"""The three-dimensional half of the page: robot, soles, regions, centre of mass, footprints."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.report.scene import Region, Scene, Shape, View, shapes_of
from dqwalk_ros.report.viewer import colors
from dqwalk_ros.robot import Foot, RobotModel

__all__ = ["Drawing"]

Array = NDArray[np.float64]
_TRAIL = 600
"""Points of the way of the centre of mass."""
_THIN = 0.0012
_ORIGIN = np.zeros(3)
_LIFT = np.array([0.0, 0.0, 0.002])
_FAR_BELOW = (0.0, 0.0, -100.0)


def _place(x: Array) -> dict[str, Any]:
    return {"position": DQ(x).translation(), "wxyz": x[:4]}


class Drawing:
    """Draws the views of one robot into a viser scene.

    Parameters
    ----------
    server : viser.ViserServer
    scene : Scene
    """

    def __init__(self, server: viser.ViserServer, scene: Scene) -> None:
        self._scene, self._server, self._model = server.scene, server, scene.model
        self._bodies = [self._scene.add_frame(f"/robot/{b}", show_axes=False) for b in range(len(self._model.bodies))]
        for number, shape in enumerate(shapes_of(self._model)):
            _add_shape(self._scene, f"/robot/{shape.body}/{number}", shape)
        self._soles = {foot: self._sole(f"/soles/{foot.value}", foot, 0.9) for foot in Foot}
        self._target = {foot: self._sole(f"/target/{foot.value}", foot, 0.35) for foot in Foot}
        self._com = self._scene.add_icosphere("/com/point", 0.011, color=colors.COM)
        self._shadow = self._scene.add_cylinder("/com/shadow", 0.008, 0.0015, color=colors.COM, cast_shadow=False)
        self._plumb = self._scene.add_cylinder("/com/plumb", 0.0012, 1.0, color=colors.COM, cast_shadow=False)
        self._regions: dict[str, tuple[Region, Any]] = {}
        self._footprints: dict[int, Any] = {}
        self._polygon: Array | None = None
        self._phase = -1
        self.follow: Array | None = None

    def show(self, view: View) -> None:
        """Draw a view."""
        for handle, x in zip(self._bodies, view.bodies, strict=True):
            _move(handle, x, _ORIGIN)
        for foot, x in view.soles.items():
            _move(self._soles[foot], x, self._model.soles[foot].center)
        swing = view.moment.phase.base.other
        for foot, handle in self._target.items():
            handle.visible = view.target is not None and foot is swing
        if view.target is not None:
            _move(self._target[swing], view.target, self._model.soles[swing].center)
        self._show_com(view)
        self._show_polygon(view)
        self._show_regions(view)
        for index, handles in self._footprints.items():
            if handles.visible != (index <= view.moment.index):
                handles.visible = index <= view.moment.index

    def add_footprint(self, index: int, foot: Foot, x: Array) -> None:
        """Leave a print of a sole at `x` (8,) that is seen from phase `index` on; a phase has one print."""
        if index in self._footprints:
            return
        name = f"/footprints/{index}"
        sole = self._model.soles[foot]
        x = (DQ(x) * DQ.from_pose(sole.center)).vec8()
        frame = self._scene.add_frame(name, show_axes=False, **_place(x))
        size = np.array([sole.length, sole.width, 0.0])
        corners = 0.5 * size * np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]) + [0.0, 0.0, 0.0008]
        self._outline(f"{name}/outline", corners, colors.FOOT[foot], 2.0)
        self._footprints[index] = frame

    def forget(self) -> None:
        """Wipe the footprints and the trail."""
        for handle in self._footprints.values():
            handle.remove()
        self._footprints.clear()
        self.trail(np.empty((0, 3)), 0.0)

    def trail(self, way: Array, ground: float) -> None:
        """Draw the way (N, 3) of the centre of mass, and its projection on the ground."""
        name = "/com/trail"
        if len(way) < 2:
            self._scene.remove_by_name(name)
            self._scene.remove_by_name(f"{name}_ground")
            return
        way = way[:: max(1, len(way) // _TRAIL)]
        flat = way * [1.0, 1.0, 0.0] + [0.0, 0.0, ground + 0.0015]
        for path, points, color in ((name, way, colors.COM_SOFT), (f"{name}_ground", flat, colors.COM)):
            pairs = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
            self._scene.add_line_segments(path, pairs, np.array(color), thickness=2.5, thickness_units="screen")

    def _sole(self, name: str, foot: Foot, opacity: float) -> Any:
        sole = self._model.soles[foot]
        return self._scene.add_box(
            name,
            colors.FOOT[foot],
            (sole.length, sole.width, _THIN),
            opacity=opacity,
            cast_shadow=False,
            receive_shadow=False,
            position=_FAR_BELOW,
        )

    def _show_com(self, view: View) -> None:
        x, y, z = view.com
        self._com.position = view.com
        self._shadow.position = (x, y, view.ground + 0.0015)
        self._plumb.position = (x, y, 0.5 * (z + view.ground))
        self._plumb.scale = (1.0, 1.0, max(float(z - view.ground), 1e-3))

    def _show_polygon(self, view: View) -> None:
        before = self._polygon
        if before is not None and before.shape == view.polygon.shape and np.abs(before - view.polygon).max() < 2e-4:
            return
        self._polygon = view.polygon
        outside = view.gauges[-1].value < 0.0
        self._outline("/support/polygon", view.polygon + _LIFT, colors.BAD if outside else colors.INK, 3.0)

    def _outline(self, name: str, corners: Array, color: tuple[int, int, int], thickness: float) -> None:
        pairs = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1).astype(np.float32)
        self._scene.add_line_segments(name, pairs, np.array(color), thickness=thickness, thickness_units="screen")

    def _show_regions(self, view: View) -> None:
        # kept and hidden, not removed and added again: the browser may show a new one before it is placed
        present = {r.name for r in view.regions}
        for name, (_, handle) in self._regions.items():
            if handle.visible != (name in present):
                handle.visible = name in present
        tight = view.tightest.name
        for found in view.regions:
            if found.name not in self._regions:
                self._regions[found.name] = (found, self._add_region(found))
            first, handle = self._regions[found.name]
            _move(handle, found.pose, _ORIGIN)
            a, b = found.size[0] / first.size[0], found.size[1] / first.size[1]
            scale = {"cylinder": (a, a, b), "plane": (a, b, 1.0)}.get(found.kind, (a, 1.0, b))
            if not np.allclose(handle.scale, scale, rtol=0.005):
                handle.scale = scale
            color = colors.TIGHT if found.name == tight else colors.of_region(found.name)
            if tuple(handle.color) != color:
                handle.color = color

    def _add_region(self, found: Region) -> Any:
        name, color = f"/regions/{found.name}", colors.of_region(found.name)
        looks: dict[str, Any] = {
            "opacity": 0.22,
            "side": "double",
            "cast_shadow": False,
            "receive_shadow": False,
            **_place(found.pose),
        }
        a, b = found.size
        if found.kind == "cylinder":
            return self._scene.add_cylinder(name, a, b, color, radial_segments=64, **looks)
        size = (a, b, _THIN) if found.kind == "plane" else (a, _THIN, b)
        return self._scene.add_box(name, color, size, **looks)


def _move(handle: Any, x: Array, offset: Array) -> None:
    handle.position, handle.wxyz = DQ(x).transform_point(offset), x[:4]


def _add_shape(scene: viser.SceneApi, name: str, shape: Shape) -> None:
    r, g, b, a = shape.color
    color = (round(255 * r), round(255 * g), round(255 * b))
    looks: dict[str, Any] = {"opacity": None if a >= 1.0 else a, **_place(shape.pose)}
    if shape.kind == "box":
        scene.add_box(name, color, np.array(shape.size), **looks)
    elif shape.kind == "cylinder":
        scene.add_cylinder(name, shape.size[0], shape.size[1], color, **looks)
    else:
        scene.add_icosphere(name, shape.size[0], color, **looks)


def home(model: RobotModel, view: View) -> tuple[Array, Array]:
    """Return where the camera stands and what it looks at: from ahead and the left, the whole robot in sight."""
    height = float(np.max(DQ(view.bodies).translation()[:, 2])) - view.ground
    reach = max(height, 0.2)
    at = np.array([view.com[0], view.com[1], view.ground + 0.52 * reach])
    return at + reach * np.array([1.25, 0.95, 0.5]), at
