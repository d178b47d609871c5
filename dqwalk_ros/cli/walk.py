"""``dqwalk walk``: walk through ROS 2, record, judge and draw."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from dqwalk_ros.cli.progress import Progress
from dqwalk_ros.cli.results import prepare, write_results
from dqwalk_ros.cli.settings import config_of
from dqwalk_ros.errors import BagError
from dqwalk_ros.report import bag
from dqwalk_ros.runner import run_walk

__all__ = ["run"]


def run(args: argparse.Namespace) -> int:
    """Do it and return the exit code."""
    config, out = config_of(args), Path(args.out)
    prepare(out, force=args.force)
    progress = Progress(quiet=args.quiet)
    try:
        outcome = run_walk(
            config,
            out / "bag",
            plant=args.plant,
            course=args.cmd_vel,
            lockstep=not args.realtime and args.plant != "poppy",  # a robot does not wait
            progress=progress,
        )
    finally:
        progress.close()
    if not args.quiet or not outcome.finished:
        print(outcome, file=sys.stderr)
    try:
        trace = bag.read(outcome.bag)
    except BagError as error:
        if outcome.finished:
            raise
        print(f"dqwalk: no report: {error}", file=sys.stderr)
        return 1
    report = write_results(trace, out, formats=args.format, figures=not args.no_figures, quiet=args.quiet)
    return 0 if outcome.finished and report["ok"] else 1
