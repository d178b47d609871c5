"""``dqwalk view``: look at a recorded walk in the browser."""

from __future__ import annotations

import argparse
import sys
import threading
import webbrowser

from dqwalk_ros.cli.progress import Progress
from dqwalk_ros.errors import ViewerError
from dqwalk_ros.trace import Trace

__all__ = ["run"]


def run(args: argparse.Namespace) -> int:
    """Do it and return the exit code."""
    try:
        from dqwalk_ros.report.viewer.page import Page
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "viser":
            raise
        raise ViewerError("the page needs viser: pip install 'dqwalk_ros[view]'") from error

    page = Page(args.port)
    try:
        print(f"{page.url}  (Ctrl-C ends it)", flush=True)
        page.say(f"reading {args.bag}")
        if args.open:
            webbrowser.open(page.url)
        trace = _read(args)
        from dqwalk_ros.report.viewer.player import Player

        player = Player(page, trace)
        if args.play:
            player.toggle()
        for note in trace.notes:
            print(f"note: {note}", file=sys.stderr)
        player.run()
    except KeyboardInterrupt:
        pass
    finally:
        page.close()
    return 0


def _read(args: argparse.Namespace) -> Trace:
    """Read the bag, and say so where it takes long."""
    from dqwalk_ros.report import bag

    bar, done = Progress(), threading.Event()
    waiting = threading.Thread(target=_tick, args=(bar, done), daemon=True)
    waiting.start()
    try:
        return bag.read(args.bag, namespace=args.namespace)
    finally:
        done.set()
        waiting.join()
        bar.close()


def _tick(bar: Progress, done: threading.Event) -> None:
    while not done.wait(2.0):
        bar(0.0, "reading the bag")
