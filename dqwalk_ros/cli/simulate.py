"""``dqwalk simulate``: walk in this process, write the bag, judge and draw."""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from dqwalk_ros.cli.progress import Progress
from dqwalk_ros.cli.results import prepare, write_results
from dqwalk_ros.cli.settings import config_of
from dqwalk_ros.config import Config
from dqwalk_ros.controllers import Controller, make_controller
from dqwalk_ros.errors import ViewerError
from dqwalk_ros.gait import phase_count
from dqwalk_ros.model import load_model
from dqwalk_ros.phases import PhaseKind
from dqwalk_ros.plants import make_plant
from dqwalk_ros.report import bag
from dqwalk_ros.simulation import simulate
from dqwalk_ros.standing.course import Course

if TYPE_CHECKING:
    from dqwalk_ros.report.viewer.feed import Feed

__all__ = ["run"]


def run(args: argparse.Namespace) -> int:
    """Do it and return the exit code."""
    config, out = config_of(args), Path(args.out)
    model, course = load_model(config.robot), Course.parse(args.cmd_vel)
    prepare(out, force=args.force)
    controller = make_controller(config, model)
    plant = make_plant(args.plant, config, model)
    with contextlib.ExitStack() as stack:
        feed = stack.enter_context(_page(config, args.port)) if args.view else None
        if feed is not None:
            plant = feed.watch(plant, controller)
        bar = Progress(quiet=args.quiet)
        pilot = _Pilot(controller, course) if course.legs else None
        done = _Fraction(controller) if pilot is None else pilot.fraction
        try:
            trace = simulate(controller, plant, progress=lambda _, text: bar(done(), text), pilot=pilot)
        finally:
            bar.close()
        if not trace.finished:
            print(f"dqwalk: {'; '.join(trace.notes)}", file=sys.stderr)
        bag.write(trace, out / "bag")
        report = write_results(trace, out, formats=args.format, figures=not args.no_figures, quiet=args.quiet)
        if feed is not None:
            feed.replay(out / "bag")
            print(f"{feed.url} plays the walk until Ctrl-C", flush=True)
            feed.wait()
    return 0 if trace.finished and report["ok"] else 1


def _page(config: Config, port: int | None) -> Feed:
    """Return a page in a process of its own."""
    if importlib.util.find_spec("viser") is None:
        raise ViewerError("--view needs viser: pip install 'dqwalk_ros[view]'")
    from dqwalk_ros.report.viewer.feed import Feed

    feed = Feed(config, port)
    print(f"{feed.url} shows the walk", flush=True)
    return feed


class _Pilot:
    """Steers along a course, then stops."""

    def __init__(self, controller: Controller, course: Course) -> None:
        self._controller, self._course, self._time = controller, course, 0.0

    def fraction(self) -> float:
        """Return how much of the course is done."""
        return min(1.0, self._time / self._course.duration)

    def __call__(self, time: float) -> None:
        self._time = time
        asked = self._course.at(time)
        if asked is None:
            self._controller.stop()
        else:
            self._controller.steer(*asked)


class _Fraction:
    """How much of a walk is done: by phases, and within single support by the decay of its error."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._total = phase_count(controller.config) or math.inf
        self._threshold = controller.config.ssp.threshold
        self._index, self._first = -1, 0.0

    def __call__(self) -> float:
        """Return the fraction done."""
        controller = self._controller
        index, error = controller.phase_index, max(controller.error, self._threshold)
        if index != self._index:
            self._index, self._first = index, error
        within = 0.0
        if controller.phase.kind is PhaseKind.SINGLE_SUPPORT and self._first > self._threshold:
            within = math.log(self._first / error) / math.log(self._first / self._threshold)
        return (index + max(0.0, within)) / self._total
