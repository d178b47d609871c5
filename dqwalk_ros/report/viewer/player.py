"""Sources of the page: a recorded walk with controls to play, pause and seek, or a walk that is being computed.

The page of a walk that is being computed runs in its own process, so that it does not slow the walk down: the walk
only passes on the newest moment.
"""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import signal
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Self

import numpy as np
import viser
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.controller import VelocityController
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.qp import make_solver
from dqwalk_ros.paper.state import State
from dqwalk_ros.report.scene import Moment, Moments, Scene
from dqwalk_ros.report.viewer.page import FRAME, Page
from dqwalk_ros.report.viewer.panels import History
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import DqwalkError, ViewerError
from dqwalk_ros.trace import PhaseRecord, Trace

_SPEEDS = ("0.25", "0.5", "1", "2", "5", "10", "20", "50")
_CURVE = 400
"""Points of each curve."""
_WAY = 1500
"""Points of the path of the centre of mass."""
_IDLE = 0.1
"""Period of the checks of the controls while the replay is paused [s]."""


class Player:
    """Plays a walk, of at least one state, on a page."""

    def __init__(self, page: Page, trace: Trace) -> None:
        self._page, self._trace = page, trace
        self._moments = Moments(trace)
        self._solver = make_solver(trace.config.qp.solver)
        self._first, self._last = float(trace.time[0]), float(trace.time[-1])
        self._at = self._first
        self._moved = threading.Event()
        self._changed_at = self._slid_at = 0.0
        scene = Scene(trace.config, trace.model)
        page.set_scene(scene)
        history = History()
        for tick in _spread(trace, _CURVE).tolist():
            history.add(scene.look(self._moments.at(tick)))
        page.replay_of(history, _prints(trace))
        self._way_ticks = _spread(trace, _WAY)
        self._way = np.array([self._com(tick) for tick in self._way_ticks.tolist()])
        self._add_controls()
        self.show()

    def _com(self, tick: int) -> Array:
        moment = self._moments.at(tick)
        kin = Kinematics(self._trace.model, moment.q, moment.phase.base)
        return DQ(moment.x_odom_base).transform_point(kin.com)

    def _add_controls(self) -> None:
        gui = self._page.server.gui
        self._page.controls.visible = True
        length = self._last - self._first
        with self._page.controls:
            self._play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY)
            step = 10.0 ** np.floor(np.log10(max(length, 1e-2) / 1000.0))
            self._slider = gui.add_slider("time [s]", self._first, self._last, float(step), self._first)
            speed = "10" if length > 90.0 else "1"
            self._speed = gui.add_dropdown("speed ×", _SPEEDS, initial_value=speed)
            self._jump = gui.add_button_group("phase", ("start", "‹", "›", "end"))
        self.playing = False
        self._play.on_click(lambda _: self.toggle())
        self._slider.on_update(self._on_slider)
        self._jump.on_click(lambda event: self._on_jump(event.target.value))

    def toggle(self) -> None:
        """Play or pause."""
        if not self.playing and self._at >= self._last:
            self._at = self._first
        self.playing = not self.playing
        self._play.label = "Pause" if self.playing else "Play"
        self._play.icon = viser.Icon.PLAYER_PAUSE if self.playing else viser.Icon.PLAYER_PLAY
        self._moved.set()

    def seek(self, at: float) -> None:
        """Go to a time [s]."""
        self._at = min(max(at, self._first), self._last)
        self._moved.set()

    @property
    def _pace(self) -> float:
        """Speed relative to real time; 1 if the browser sends an invalid value."""
        return float(self._speed.value) if self._speed.value in _SPEEDS else 1.0

    def _on_slider(self, event: viser.GuiEvent[viser.GuiSliderHandle[float]]) -> None:
        at = event.target.value
        if event.client is not None and isinstance(at, int | float) and math.isfinite(at):  # moved by the user
            self._changed_at = time.monotonic()
            self.seek(float(at))

    def _on_jump(self, key: str) -> None:
        starts = [float(self._trace.time[record.start]) for record in self._trace.phases]
        before = [t for t in starts if t < self._at - 1e-3]
        after = [t for t in starts if t > self._at + 1e-3]
        at = {"start": self._first, "‹": before[-1] if before else self._first, "end": self._last}
        at["›"] = after[0] if after else self._last
        if isinstance(key, str) and key in at:
            self.seek(at[key])

    def show(self) -> None:
        """Draw the current time."""
        tick = min(int(np.searchsorted(self._trace.time, self._at)), len(self._trace) - 1)
        over = "finished" if self._trace.finished and tick == len(self._trace) - 1 else ""
        moment = self._moments.at(tick, over, self._solved(tick))
        way = self._way[: int(np.searchsorted(self._way_ticks, tick)) + 1]
        self._page.show(moment, way=way, force=not self.playing)

    def _solved(self, tick: int) -> str:
        """Solve the quadratic program of a tick again; return iterations and active constraints."""
        moment = self._moments.at(tick)
        try:
            limit = self._trace.model.velocity_max
            problem = moment.phase.evaluate(moment.q, dt=self._trace.config.dt, velocity=limit).problem
            found = self._solver.solve(problem)
        except DqwalkError as error:
            return f"failed: {error}"
        active = ", ".join(found.active(problem)[:3]) or "none"
        return f"solved again, {found.iterations} iterations; active: {active}"

    def run(self, going: Callable[[], bool] = lambda: True) -> None:
        """Play until `going` returns False."""
        last = time.monotonic()
        while going():
            began = time.monotonic()
            elapsed, last = began - last, began
            if self.playing:
                self._at = min(self._at + elapsed * self._pace, self._last)
                if self._at >= self._last:
                    self.toggle()
                self._moved.clear()
                self.show()
                self._follow()
                time.sleep(max(0.0, FRAME - (time.monotonic() - began)))
            elif self._moved.wait(_IDLE):
                self._moved.clear()
                self.show()
                self._follow()

    def _follow(self) -> None:
        """Update the slider, unless the user is moving it."""
        now = time.monotonic()
        if now - self._changed_at > 0.3 and (not self.playing or now - self._slid_at > 0.1):
            self._slid_at = now
            self._slider.value = self._at  # type: ignore[misc]


def _spread(trace: Trace, count: int) -> NDArray[np.intp]:
    """Return some ticks of a walk, evenly spread."""
    return np.unique(np.linspace(0, len(trace) - 1, min(count, len(trace))).astype(int))


def _prints(trace: Trace) -> Iterator[tuple[int, Foot, Array]]:
    """Yield phase, foot and pose of every footprint, each position once."""
    seen: list[Array] = []
    for index, record in enumerate(trace.phases):
        place = DQ(record.x_odom_base).translation()
        if all(np.abs(place - other).max() > 1e-3 for other in seen):
            seen.append(place)
            yield index, record.base, record.x_odom_base


# ---------------------------------------------------------------------- a walk that is being computed

_PERIOD = 1.0 / 60.0
"""Shortest time between two moments that are passed on [s]."""
_STARTUP = 60.0
"""Longest time for the start of the page's process [s]."""


class Feed:
    """Starts a page in another process, which asks for a moment when it has drawn the one before.

    A `multiprocessing.Queue` would not do: Ctrl-C within `put` can leave a thread of it asleep for good.

    Raises
    ------
    ViewerError
        If the page does not start.
    """

    def __init__(self, config: Config, port: int | None) -> None:
        context = multiprocessing.get_context("spawn")
        self._page, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other, config, port), daemon=True)
        self._process.start()
        other.close()
        try:
            answer = self._page.recv() if self._page.poll(_STARTUP) else "the page did not start"
        except EOFError:
            answer = "the page's process ended"
        if not answer.startswith("http"):
            self.close()
            raise ViewerError(answer)
        self.url: str = answer
        self._due = 0.0

    def offer(self, state: State, controller: VelocityController) -> None:
        """Send a state to the page if it has asked for one, at most sixty times a second."""
        now = time.monotonic()
        if now < self._due or controller.phase_index < 0 or not self._page.poll():
            return
        self._due = now + _PERIOD
        active = ", ".join(controller.active[:3]) or "none"
        solver = f"solved in {1e6 * controller.solve_time:.0f} µs, {controller.iterations} iterations; active: {active}"
        record = PhaseRecord.of(controller, 0, controller.phase_began)  # much smaller than the phase
        with contextlib.suppress(EOFError, OSError):  # the page's process has ended
            self._page.recv()
            self._page.send((record, controller.phase_index, state, solver))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def replay(self, bag: Path) -> None:
        """Replay the bag of the walk on the page."""
        with contextlib.suppress(OSError):  # the page's process has ended
            self._page.send(str(bag))

    def wait(self) -> None:
        """Wait until the page's process ends; Ctrl-C stops it."""
        with contextlib.suppress(KeyboardInterrupt):
            self._process.join()

    def close(self) -> None:
        """Stop the page."""
        self._process.terminate()
        self._process.join(5.0)


def _serve(walk: Connection, config: Config, port: int | None) -> None:
    """Show the received moments until the process is terminated."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the walk; the parent ends this process
    try:
        page = Page(port)
    except ViewerError as error:
        walk.send(str(error))
        return
    walk.send(page.url)
    scene = Scene(config, load_model(config.robot))
    page.set_scene(scene)
    shown: tuple[int, float] | None = None
    while True:
        try:
            walk.send("next")
            item = walk.recv()
        except (EOFError, OSError):  # the walk's process was killed
            return
        if isinstance(item, str):
            break
        drawn = time.monotonic()
        record, index, state, solver = item
        if shown != (index, record.time):
            shown, phase = (index, record.time), record.phase(config, scene.model)
        x, began = record.x_odom_base, record.time
        page.show(Moment(state.time, state.q, phase, index, began, x, record.name, solver, state.dq, state.up))
        time.sleep(max(0.0, FRAME - (time.monotonic() - drawn)))
    from dqwalk_ros.report import bag

    Player(page, bag.read(item, walk=config.gait.walk)).run()
