"""The page: a viser server for this machine only, and the drawing of the walk in three dimensions."""

from __future__ import annotations

import contextlib
import io
import time
from collections import deque
from collections.abc import Callable, Iterator
from html import escape
from typing import Any

import numpy as np
import viser

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.report.colors import BLUE, COM, DIVERGENT, FOOT, INK, MUTED, TIGHT, Rgb, hexed
from dqwalk_ros.report.scene import BodyShape, Moment, NamedRegion, Scene, View, tightest, top_of
from dqwalk_ros.report.viewer.guard import HOST, guarded
from dqwalk_ros.report.viewer.panels import History, margins_html, status_html
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ViewerError
from dqwalk_ros.walks.table import walk_type

_PORT = 8080
"""Default port; if it is in use, the next free one."""
FRAME = 1.0 / 30.0
"""Period of the frames [s]."""
_WAYS = {"ahead": (1.0, 0.0, 0.0), "back": (-1.0, 0.0, 0.0), "left": (0.0, 1.0, 0.0), "right": (0.0, -1.0, 0.0)}
_COURSES = {
    "ahead": (1.0, 0.0, 0.0),
    "ahead left": (0.7, 0.0, 0.7),
    "ahead right": (0.7, 0.0, -0.7),
    "back": (-0.7, 0.0, 0.0),
    "turn left": (0.0, 0.0, 1.0),
    "turn right": (0.0, 0.0, -1.0),
    "stop": (0.0, 0.0, 0.0),
}
"""Fractions of the fastest velocities ahead, to the left and about the vertical; at most one together."""
_TEXT = 0.2
"""Period of the updates of the panels [s]."""


class Page:
    """Serves one walk to browsers on this machine.

    Parameters
    ----------
    port : int or None
        None: the first free one from `_PORT` on; 0: any.

    Attributes
    ----------
    history : History
        The margins over time, for the curves.
    shown : int
        Number of frames sent.

    Raises
    ------
    ViewerError
        If the port is in use, or there is no such port.
    """

    def __init__(self, port: int | None) -> None:
        if port is not None and not 0 <= port <= 65535:
            raise ViewerError(f"there is no port {port}; ports are 0 to 65535, 0 for any")
        wanted = _PORT if port is None else port
        with contextlib.redirect_stdout(io.StringIO()), guarded():  # viser prints a banner
            self.server = viser.ViserServer(host=HOST, port=wanted, label="dqwalk", verbose=False)
        if port and self.server.get_port() != port:  # viser takes the next free one
            self.close()
            raise ViewerError(f"port {port} is in use on this machine; choose another with --port, or 0 for any")
        gui = self.server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium", brand_color=BLUE)
        gui.set_panel_label("dqwalk")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(320)
        self._status = gui.add_html(_message("waiting for a walk"))
        self.controls = gui.add_folder("replay", visible=False)
        self._push: Any = None
        self._steering: Any = None
        panel = gui.add_panel()
        with panel.add_tab("margins"):
            self._margins = gui.add_html("")
        panel.dock_left()
        panel.set_width(340)
        scene = self.server.scene
        scene.set_up_direction("+z")
        scene.configure_default_lights(cast_shadow=True)
        scene.add_grid(
            "/ground",
            infinite_grid=True,
            cell_size=0.05,
            section_size=0.25,
            cell_color=(226, 230, 234),
            section_color=(190, 197, 204),
            fade_distance=4.0,
            shadow_opacity=0.15,
        )
        self.history = History()
        self.shown = 0
        self.phases = 0
        self._drawing: _Drawing | None = None
        self._way: deque[Array] = deque(maxlen=6000)
        self._pictures: deque[float] = deque(maxlen=60)
        self._text_at = 0.0
        self._live = True

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.server.get_port()}"

    @property
    def rate(self) -> float:
        """Frames per second, averaged over the last ones."""
        if len(self._pictures) < 2:
            return 0.0
        return (len(self._pictures) - 1) / max(self._pictures[-1] - self._pictures[0], 1e-9)

    def say(self, text: str) -> None:
        """Show a message in place of the state, such as what the page is waiting for."""
        self._status.content = _message(text)

    def offer_push(self, push: Callable[[Array], None], impulse: float) -> None:
        """Add the controls that push a simulated robot.

        `push` is called with an impulse (3,) in the frame of the base sole [N s]. Its default is `impulse` [N s]; the
        slider ends at ten times this value.
        """
        if self._push is not None:
            return
        gui = self.server.gui
        self._push = gui.add_folder("push")
        with self._push:
            size = gui.add_slider("impulse [N s]", 0.0, 10.0 * impulse, 0.1 * impulse, impulse)
            ways = gui.add_button_group("to", tuple(_WAYS))

        def pushed(event: Any) -> None:  # the browser may send an invalid value
            way = _WAYS.get(event.target.value) if isinstance(event.target.value, str) else None
            strength = size.value
            if way is not None and isinstance(strength, int | float) and 0.0 <= strength <= 10.0 * impulse:
                push(float(strength) * np.array(way))

        ways.on_click(pushed)

    def offer_steering(self, steer: Callable[[Array], None], fastest: Array) -> None:
        """Add the controls that steer a walk.

        `steer` is called with a velocity (3,): ahead, to the left [m/s], and about the vertical [rad/s]. It lasts until
        the next call. `fastest` (3,) has the largest of each.
        """
        gui = self.server.gui
        self._steering = gui.add_folder("steer")
        with self._steering:
            speed = gui.add_slider("speed [%]", 0.0, 100.0, 5.0, 70.0)
            ways = gui.add_button_group("walk", tuple(_COURSES))

        def steered(event: Any) -> None:  # the browser may send an invalid value
            way = _COURSES.get(event.target.value) if isinstance(event.target.value, str) else None
            percent = speed.value
            if way is not None and isinstance(percent, int | float) and 0.0 <= percent <= 100.0:
                steer(0.01 * float(percent) * np.array(way) * fastest)

        ways.on_click(steered)

    @property
    def steers(self) -> bool:
        """Whether the page has the controls that steer."""
        return self._steering is not None

    @property
    def is_watched(self) -> bool:
        """Whether a browser shows the page."""
        return bool(self.server.get_clients())

    def set_scene(self, scene: Scene, opacity: float = 1.0) -> None:
        """Set the robot to be shown; with an opacity below 1 its interior is visible."""
        if self._drawing is not None:
            self.server.scene.remove_by_name("/robot")
        self.phases = walk_type(scene.config).phases(scene.config)
        self._drawing = _Drawing(self.server, scene, opacity)

    def replay_of(self, history: History, prints: Iterator[tuple[int, Foot, Array]]) -> None:
        """Show the complete curves and footprints of a recorded walk, instead of collecting them."""
        assert self._drawing is not None  # a replay comes with its scene
        self._live = False
        self.history = history
        self._drawing.forget()
        for index, foot, x in prints:
            self._drawing.add_footprint(index, foot, x)

    def show(self, moment: Moment, *, way: Array | None = None, force: bool = False) -> View:
        """Draw a moment, and the path (N, 3) of the centre of mass, by default that of the moments shown so far.

        With `force` the panels are updated even if they were updated recently.
        """
        drawing = self._drawing
        assert drawing is not None  # set_scene comes first
        view = drawing.scene.look(moment)
        now = time.monotonic()
        with self.server.atomic():
            if self._live:
                self._collect(drawing, view)
            drawing.show(view)
            if self.shown == 0:
                camera = self.server.initial_camera
                camera.position, camera.look_at = _home(drawing.scene, view)
            if force or now - self._text_at >= _TEXT:
                self._text_at = now
                drawing.trail(np.array(self._way) if way is None else way, view.ground)
                self._show_text(view)
        self.shown += 1
        self._pictures.append(now)
        return view

    def point_ahead(self, view: View) -> None:
        """Draw an arrow on the ground between the soles, in the forward direction."""
        assert self._drawing is not None  # set_scene comes first
        self._drawing.point_ahead(view)

    def _collect(self, drawing: _Drawing, view: View) -> None:
        if self.history.times and view.moment.time < self.history.times[-1]:  # a new walk
            self.history = History()
            self._way.clear()
            drawing.forget()
        self.history.add(view)
        self._way.append(view.com)
        foot = view.moment.phase.base
        drawing.add_footprint(view.moment.index, foot, view.soles[foot])

    def _show_text(self, view: View) -> None:
        note = f"{self.rate:.0f} frames per second"
        self._status.content = status_html(view, total=self.phases, note=note)
        self._margins.content = margins_html(view, self.history)

    def close(self) -> None:
        """Stop serving."""
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()


def _message(text: str) -> str:
    style = f"font:14px system-ui,sans-serif;color:{hexed(MUTED)};padding:10px"
    return f'<div data-dqwalk="status" style="{style}">{escape(text)} …</div>'


# ---------------------------------------------------------------------- the drawing

_COM_SOFT: Rgb = (240, 160, 160)
_TRAIL = 600
"""Points of the path of the centre of mass."""
_THIN = 0.0012
_ORIGIN = np.zeros(3)
_LIFT = np.array([0.0, 0.0, 0.002])
_FAR_BELOW = (0.0, 0.0, -100.0)


def _place(x: Array) -> dict[str, Any]:
    return {"position": DQ(x).translation(), "wxyz": x[:4]}


class _Drawing:
    """Draws the views of one robot into a viser scene; `opacity` is that of the robot's shapes."""

    def __init__(self, server: viser.ViserServer, scene: Scene, opacity: float) -> None:
        self.scene, self._model, self._scene = scene, scene.model, server.scene
        self._bodies = [self._scene.add_frame(f"/robot/{b}", show_axes=False) for b in range(len(self._model.bodies))]
        for number, shape in enumerate(scene.shapes):
            _add_shape(self._scene, f"/robot/{shape.body}/{number}", shape, opacity)
        self._soles = {foot: self._sole(f"/soles/{foot.value}", foot, 0.9) for foot in Foot}
        self._target = {foot: self._sole(f"/target/{foot.value}", foot, 0.35) for foot in Foot}
        self._com = self._scene.add_icosphere("/com/point", 0.011, color=COM)
        self._shadow = self._scene.add_cylinder("/com/shadow", 0.008, 0.0015, color=COM, cast_shadow=False)
        self._divergent = self._scene.add_cylinder("/com/divergent", 0.008, 0.0015, color=DIVERGENT, cast_shadow=False)
        self._plumb = self._scene.add_cylinder("/com/plumb", 0.0012, 1.0, color=COM, cast_shadow=False)
        self._regions: dict[str, tuple[Array, Any]] = {}  # extent when it was added, and handle
        self._footprints: dict[int, Any] = {}
        self._polygon: Array | None = None

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
        """Add a footprint at `x` (8,) that is visible from phase `index` on; a phase has one footprint."""
        if index in self._footprints:
            return
        name, corners = f"/footprints/{index}", self._model.soles[foot].corners + np.array([0.0, 0.0, 0.0008])
        self._footprints[index] = self._scene.add_frame(name, show_axes=False, **_place(x))
        self._outline(f"{name}/outline", corners, FOOT[foot], 2.0)

    def forget(self) -> None:
        """Remove the footprints and the trail."""
        for handle in self._footprints.values():
            handle.remove()
        self._footprints.clear()
        self.trail(np.empty((0, 3)), 0.0)

    def trail(self, way: Array, ground: float) -> None:
        """Draw the path (N, 3) of the centre of mass, and its projection on the ground."""
        name = "/com/trail"
        if len(way) < 2:
            self._scene.remove_by_name(name)
            self._scene.remove_by_name(f"{name}_ground")
            return
        way = way[:: max(1, len(way) // _TRAIL)]
        flat = way * [1.0, 1.0, 0.0] + [0.0, 0.0, ground + 0.0015]
        for path, points, color in ((name, way, _COM_SOFT), (f"{name}_ground", flat, COM)):
            pairs = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
            self._scene.add_line_segments(path, pairs, np.array(color), thickness=2.5, thickness_units="screen")

    def point_ahead(self, view: View) -> None:
        """Draw an arrow on the ground from between the soles, half as long as the CoM is high."""
        centers = [DQ(x).transform_point(self._model.soles[foot].center) for foot, x in view.soles.items()]
        begin = np.mean(centers, axis=0) + _LIFT
        length = 0.5 * float(view.com[2] - view.ground)
        end = begin + length * DQ(view.soles[view.moment.phase.base]).rotation_matrix()[:, 0]
        self._scene.add_arrows(
            "/ahead", np.array([[begin, end]], np.float32), np.array(INK), shaft_radius=0.012 * length,
            head_radius=0.04 * length, head_length=0.12 * length,
        )  # fmt: skip

    def _sole(self, name: str, foot: Foot, opacity: float) -> Any:
        sole = self._model.soles[foot]
        return self._scene.add_box(
            name,
            FOOT[foot],
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
        self._divergent.visible = view.divergent is not None
        if view.divergent is not None:
            self._divergent.position = view.divergent + _LIFT

    def _show_polygon(self, view: View) -> None:
        before = self._polygon
        if before is not None and before.shape == view.polygon.shape and np.abs(before - view.polygon).max() < 2e-4:
            return
        self._polygon = view.polygon
        outside = view.gauges[-1].value < 0.0
        self._outline("/support/polygon", view.polygon + _LIFT, COM if outside else INK, 3.0)

    def _outline(self, name: str, corners: Array, color: Rgb, thickness: float) -> None:
        pairs = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1).astype(np.float32)
        self._scene.add_line_segments(name, pairs, np.array(color), thickness=thickness, thickness_units="screen")

    def _show_regions(self, view: View) -> None:
        # hidden instead of removed: the browser may show a new shape before it has its pose
        present = {r.name for r in view.regions}
        for name, (_, handle) in self._regions.items():
            if handle.visible != (name in present):
                handle.visible = name in present
        tight = tightest(view.gauges).name
        for drawn in view.regions:
            if drawn.name not in self._regions:
                self._regions[drawn.name] = (drawn.extent, self._add_region(drawn))
            first, handle = self._regions[drawn.name]
            _move(handle, drawn.region.pose, _ORIGIN)
            scale = tuple(np.divide(drawn.extent, first, out=np.ones(3), where=first > 0.0).tolist())
            if not np.allclose(handle.scale, scale, rtol=0.005):
                handle.scale = scale
            color = TIGHT if drawn.name == tight else drawn.color
            if tuple(handle.color) != color:
                handle.color = color

    def _add_region(self, drawn: NamedRegion) -> Any:
        name, found = f"/regions/{drawn.name}", drawn.region
        looks: dict[str, Any] = {
            "opacity": 0.22,
            "side": "double",
            "cast_shadow": False,
            "receive_shadow": False,
            **_place(found.pose),
        }
        if found.kind == "cylinder":
            return self._scene.add_cylinder(name, *found.size, drawn.color, radial_segments=64, **looks)
        return self._scene.add_box(name, drawn.color, np.maximum(drawn.extent, _THIN), **looks)


def _move(handle: Any, x: Array, offset: Array) -> None:
    handle.position, handle.wxyz = DQ(x).transform_point(offset), x[:4]


def _add_shape(scene: viser.SceneApi, name: str, shape: BodyShape, opacity: float) -> None:
    r, g, b, a = shape.color
    a *= opacity
    color = (round(255 * r), round(255 * g), round(255 * b))
    looks: dict[str, Any] = {"opacity": None if a >= 1.0 else a, **_place(shape.pose)}
    if shape.kind == "box":
        scene.add_box(name, color, np.array(shape.size), **looks)
    elif shape.kind == "cylinder":
        scene.add_cylinder(name, shape.size[0], shape.size[1], color, **looks)
    elif shape.vertices is not None and shape.faces is not None:
        # viser.extras.ViserUrdf draws meshes, too, but needs the file, not the repaired robot, and moves its own joints
        scene.add_mesh_simple(name, shape.vertices, shape.faces, color=color, side="double", flat_shading=True, **looks)
    else:
        scene.add_icosphere(name, shape.size[0], color, **looks)


def _home(scene: Scene, view: View) -> tuple[Array, Array]:
    """Return position and target of the camera: from ahead and the left, with the whole robot in view."""
    reach = max(top_of(scene.shapes, view.bodies) - view.ground, 0.2)
    at = np.array([view.com[0], view.com[1], view.ground + 0.52 * reach])
    return at + reach * np.array([1.25, 0.95, 0.5]), at
