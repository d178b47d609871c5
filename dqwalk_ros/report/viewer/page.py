"""The page: a viser server on this machine only, the drawing, and the panels beside it."""

from __future__ import annotations

import contextlib
import http
import io
import socket
import time
from collections import deque
from collections.abc import Iterator
from html import escape
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import viser
import websockets.asyncio.server
from numpy.typing import NDArray

from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import ViewerError
from dqwalk_ros.report.scene import Moment, Scene, View
from dqwalk_ros.report.viewer import PORT
from dqwalk_ros.report.viewer.drawing import Drawing, home
from dqwalk_ros.report.viewer.gauges import History, margins_html, status_html
from dqwalk_ros.robot import Foot

__all__ = ["HOST", "Page"]

Array = NDArray[np.float64]

HOST = "127.0.0.1"
"""The page is for this machine only: it has no password."""
FRAME = 1.0 / 30.0
"""Time between two pictures [s]."""
_TEXT = 0.2
"""Time between two states of the panels [s]."""


class Page:
    """Serves one walk to browsers on this machine.

    Parameters
    ----------
    port : int, optional
        By default the first free one from `PORT` on; 0 lets the system choose.

    Attributes
    ----------
    server : viser.ViserServer
    history : History
        The margins over time, as the curves show them.
    shown : int
        Pictures sent so far.

    Raises
    ------
    ViewerError
        If the port is taken.
    """

    def __init__(self, port: int | None = None) -> None:
        with contextlib.redirect_stdout(io.StringIO()), _local_only():  # viser prints a banner
            self.server = viser.ViserServer(host=HOST, port=_free(port), label="dqwalk", verbose=False)
        gui = self.server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium", brand_color=(31, 95, 180))
        gui.set_panel_label("dqwalk")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(320)
        self._status = gui.add_html(_message("waiting for a walk"))
        self.controls = gui.add_folder("replay", visible=False)
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
        self.total_steps = 0
        self._drawing: Drawing | None = None
        self._scene: Scene | None = None
        self._way: deque[Array] = deque(maxlen=6000)
        self._pictures: deque[float] = deque(maxlen=60)
        self._text_at = 0.0
        self._live = True

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{HOST}:{self.server.get_port()}"

    @property
    def watched(self) -> bool:
        """Whether anybody looks."""
        return bool(self.server.get_clients())

    @property
    def rate(self) -> float:
        """Pictures per second, of late."""
        if len(self._pictures) < 2:
            return 0.0
        return (len(self._pictures) - 1) / max(self._pictures[-1] - self._pictures[0], 1e-9)

    def say(self, text: str) -> None:
        """Say something where the state will be, such as what is being waited for."""
        self._status.content = _message(text)

    def set_scene(self, scene: Scene) -> None:
        """Show another robot from here on."""
        if self._drawing is not None:
            self.server.scene.remove_by_name("/robot")
        self._scene = scene
        self._drawing = Drawing(self.server, scene)

    def replay_of(self, history: History, prints: Iterator[tuple[int, Foot, Array]]) -> None:
        """Take curves and footprints that are known already, instead of collecting them."""
        assert self._drawing is not None  # a replay comes with its scene
        self._live = False
        self.history = history
        self._drawing.forget()
        for index, foot, x in prints:
            self._drawing.add_footprint(index, foot, x)

    def show(self, moment: Moment, *, way: Array | None = None, force: bool = False) -> View:
        """Draw a moment.

        Parameters
        ----------
        moment : Moment
        way : ndarray, shape (N, 3), optional
            Way of the centre of mass up to there; by default that of the moments shown so far.
        force : bool
            Renew the panels too, even if they have just been.
        """
        assert self._scene is not None  # set_scene comes first
        assert self._drawing is not None
        view = self._scene.look(moment)
        now = time.monotonic()
        with self.server.atomic():
            if self._live:
                self._collect(view)
            self._drawing.show(view)
            if self.shown == 0:
                camera = self.server.initial_camera
                camera.position, camera.look_at = home(self._scene.model, view)
            if force or now - self._text_at >= _TEXT:
                self._text_at = now
                self._drawing.trail(np.array(self._way) if way is None else way, view.ground)
                self._show_text(view)
        self.shown += 1
        self._pictures.append(now)
        return view

    def _collect(self, view: View) -> None:
        assert self._drawing is not None
        if self.history.times and view.moment.time < self.history.times[-1]:  # a new walk
            self._way.clear()
            self._drawing.forget()
        self.history.add(view)
        self._way.append(view.com)
        foot = view.moment.phase.base
        self._drawing.add_footprint(view.moment.index, foot, view.soles[foot])

    def _show_text(self, view: View) -> None:
        steps = (view.moment.index + 1) // 2
        if view.moment.label == "finished":
            steps = self.total_steps or steps + 1
        note = f"{self.rate:.0f} pictures per second"
        self._status.content = status_html(view, steps=steps, total=self.total_steps, note=note)
        self._margins.content = margins_html(view, self.history)

    def close(self) -> None:
        """Stop serving."""
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()


def prints_of(records: Iterator[tuple[int, Foot, Array]]) -> Iterator[tuple[int, Foot, Array]]:
    """Yield footprints, each place once."""
    seen: list[Array] = []
    for index, foot, x in records:
        place = DQ(x).translation()
        if all(np.abs(place - other).max() > 1e-3 for other in seen):
            seen.append(place)
            yield index, foot, x


def _message(text: str) -> str:
    style = "font:14px system-ui,sans-serif;color:#57606a;padding:10px"
    return f'<div data-dqwalk="status" style="{style}">{escape(text)} …</div>'


_LOCAL = {HOST, "localhost", "::1"}


@contextlib.contextmanager
def _local_only() -> Iterator[None]:
    """Let a server that is started within answer only to this machine's own names, and to pages that came from it.

    viser has no setting for that. A page on the internet whose name leads to this machine (DNS rebinding), or that
    opens a websocket to it, could else watch the walk and move the controls.
    """
    serve = websockets.asyncio.server.serve

    def guarded(*args: Any, process_request: Any = None, **options: Any) -> Any:
        def check(connection: Any, request: Any) -> Any:
            headers = [*request.headers.get_all("Host"), *request.headers.get_all("Origin")]
            names = {urlsplit(text if "//" in text else f"//{text}").hostname for text in headers}
            if not names or not names <= _LOCAL:
                return connection.respond(http.HTTPStatus.FORBIDDEN, "this page is for this machine only\n")
            return process_request(connection, request) if process_request is not None else None

        return serve(*args, process_request=check, **options)

    websockets.asyncio.server.serve = guarded  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc]


def _free(port: int | None) -> int:
    """Return a port that nobody has.

    Raises
    ------
    ViewerError
        If the port that was asked for is taken.
    """
    for candidate in (port,) if port is not None else (*range(PORT, PORT + 20), 0):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((HOST, candidate))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise ViewerError(f"port {port} is taken on this machine; choose another with --port, or 0 for any")
