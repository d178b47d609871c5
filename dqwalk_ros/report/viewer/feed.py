"""A walk that is being computed, on a page in a process of its own, so that looking costs the walk nothing."""

from __future__ import annotations

import contextlib
import multiprocessing
import queue
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.controller import VelocityController
from dqwalk_ros.errors import ViewerError
from dqwalk_ros.report.scene import Moment, Scene
from dqwalk_ros.robot import Foot, load_model
from dqwalk_ros.simulation import make_walk
from dqwalk_ros.state import State
from dqwalk_ros.walk import Phase, PhaseKind

__all__ = ["Feed"]

Array = NDArray[np.float64]
_PERIOD = 1.0 / 60.0
"""Least time between two moments that are passed on [s]."""
_STARTUP = 60.0
"""Longest time the page's process may take to come up [s]."""


@dataclass(frozen=True)
class _News:
    """A state and the phase it belongs to, small enough to be sent sixty times a second."""

    time: float
    q: Array
    kind: PhaseKind
    support: Foot
    q_start: Array
    swing_target: Array | None
    index: int
    began: float
    x_odom_base: Array
    solver: str


class Feed:
    """Starts a page in another process and passes moments on to it; what it cannot take in time is dropped.

    Parameters
    ----------
    config : Config
    port : int, optional
        As `Page`.

    Attributes
    ----------
    url : str

    Raises
    ------
    ViewerError
        If the page does not come up.
    """

    def __init__(self, config: Config, port: int | None = None) -> None:
        context = multiprocessing.get_context("spawn")
        self._queue: Any = context.Queue(8)
        mine, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(self._queue, other, config, port), daemon=True)
        self._process.start()
        other.close()
        try:
            answer = mine.recv() if mine.poll(_STARTUP) else "the page did not come up"
        except EOFError:
            answer = "the page's process ended"
        if not answer.startswith("http"):
            self.close()
            raise ViewerError(answer)
        self.url: str = answer
        self._due = 0.0

    def offer(self, state: State, controller: VelocityController) -> None:
        """Pass a state on, unless one has just been."""
        now = time.monotonic()
        if now < self._due or controller.phase_index < 0:
            return
        self._due = now + _PERIOD
        phase, last = controller.phase, controller.last
        solver = f"solved in {1e6 * last.solve_time:.0f} µs, {last.iterations} iterations; "
        self._put(
            _News(
                state.time,
                state.q,
                phase.kind,
                phase.support,
                phase.q_start,
                phase.swing_target,
                controller.phase_index,
                controller.phase_time0,
                controller.x_odom_base,
                solver + f"active: {', '.join(last.active[:3]) or 'none'}",
            )
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _put(self, news: Any) -> None:
        with contextlib.suppress(queue.Full):
            self._queue.put_nowait(news)

    def replay(self, bag: Path) -> None:
        """Let the page go on with the bag of the walk."""
        self._queue.put(str(bag))

    def wait(self) -> None:
        """Wait until the page's process ends; Ctrl-C ends it."""
        with contextlib.suppress(KeyboardInterrupt):
            self._process.join()

    def close(self) -> None:
        """End the page."""
        self._queue.cancel_join_thread()
        self._process.terminate()
        self._process.join(5.0)


def _serve(news: Any, parent: Any, config: Config, port: int | None) -> None:
    """Show what comes, until the process is terminated."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the walk; the parent ends this process
    from dqwalk_ros.report.viewer.page import FRAME, Page

    try:
        page = Page(port)
    except ViewerError as error:
        parent.send(str(error))
        return
    parent.send(page.url)
    scene = Scene(config, load_model(config.robot))
    page.set_scene(scene)
    page.total_steps = 2 * config.gait.cycles
    phases: dict[tuple[int, float], Phase] = {}
    while True:
        item = news.get()
        with contextlib.suppress(queue.Empty):
            while not isinstance(item, str):
                item = news.get_nowait()
        if isinstance(item, str):
            break
        began = time.monotonic()
        key = item.index, item.began
        if key not in phases:
            walk = make_walk(config, scene.model)
            phases = {key: walk.phase(item.kind, item.support, item.q_start, item.swing_target)}
        phase = phases[key]
        page.show(Moment(item.time, item.q, phase, item.index, item.began, item.x_odom_base, phase.name, item.solver))
        time.sleep(max(0.0, FRAME - (time.monotonic() - began)))
    from dqwalk_ros.report import bag
    from dqwalk_ros.report.viewer.player import Player

    Player(page, bag.read(item)).run()
