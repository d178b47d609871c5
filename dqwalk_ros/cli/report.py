"""``dqwalk report``: judge and draw a recorded walk."""

from __future__ import annotations

import argparse
from pathlib import Path

from dqwalk_ros import bag
from dqwalk_ros.cli.results import write_results

__all__ = ["run"]


def run(args: argparse.Namespace) -> int:
    """Do it and return the exit code."""
    path = Path(args.bag)
    out = Path(args.out) if args.out else path.with_name(path.resolve().name + "_report")
    trace = bag.read(path, namespace=args.namespace)
    report = write_results(
        trace, out, formats=args.format, figures=not args.no_figures, quiet=args.quiet, as_json=args.json
    )
    return 0 if report["ok"] else 1
