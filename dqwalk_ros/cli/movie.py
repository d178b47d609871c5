"""``dqwalk movie``: a recorded walk as a movie and as a strip of pictures."""

from __future__ import annotations

import argparse
from pathlib import Path

from dqwalk_ros.cli.progress import Progress
from dqwalk_ros.errors import ConfigError
from dqwalk_ros.report import bag
from dqwalk_ros.report.movie import save_movie, save_strip

__all__ = ["run"]


def run(args: argparse.Namespace) -> int:
    """Do it and return the exit code."""
    out = Path(args.out)
    if out.suffix.lower() not in (".gif", ".webp", ".png"):
        raise ConfigError(f"--out wants a .gif, a .webp, or a .png for a strip, not '{args.out}'")
    if args.speed <= 0.0 or args.rate <= 0.0 or args.strip < 1:
        raise ConfigError("--speed, --rate and --strip must be more than zero")
    trace = bag.read(args.bag, namespace=args.namespace)
    bar = Progress(quiet=args.quiet)
    try:
        if out.suffix.lower() == ".png":
            between = None
            if args.between:
                first, _, last = args.between.partition(",")
                between = float(first), float(last)
            save_strip(trace, out, count=args.strip, between=between, progress=bar)
        else:
            save_movie(trace, out, speed=args.speed, rate=args.rate, progress=bar)
    finally:
        bar.close()
    print(f"wrote {out}")
    return 0
