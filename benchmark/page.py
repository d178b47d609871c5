"""Write docs/benchmarks.md: run every benchmark and keep what it prints.

python -m benchmark.page [--peers PYTHON] [--out docs/benchmarks.md]
"""

from __future__ import annotations

import argparse
import datetime
import subprocess
import sys
from pathlib import Path

TEXT = """\
# Benchmarks

Written by `python -m benchmark.page` on {date}; do not edit. Times are medians of single calls of an interleaved
run on a machine that other programs used as well: compare figures of one table only, and ratios rather than times.
A peer's tick is its own kinematics, the rows in numpy as one writes them by hand, and its usual solver; its error is
that of u relative to the largest joint velocity. The robots are made up (`benchmark/robots.py`). placo knows no task
but its own: its error says how far another program's answer is. Clarabel "in place" is at its default tolerances,
unscaled. "Clarabel's own solve" is with the inequalities within reach, as in the tick. A late state of the nodes is one
that the plant, which is the benchmark here, could not send on time beside a controller at work; the bare loop sleeps
to the same schedule and does nothing.

"""


def main() -> None:
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peers", metavar="PYTHON", help="Python of an environment with benchmark/requirements.txt")
    parser.add_argument("--ticks", type=int, default=100_000, help="of the long walk")
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parent.parent / "docs" / "benchmarks.md")
    args = parser.parse_args()
    runs = [
        ("One tick", ["benchmark.tick", *(["--peers"] if args.peers else [])]),
        ("Growth", ["benchmark.growth"]),
        ("A long walk", ["benchmark.cycle", "--ticks", str(args.ticks)]),
        ("The controller as a node (ROS 2)", ["benchmark.nodes"]),
        ("Start-up", ["benchmark.startup"]),
        ("A thousand walks", ["benchmark.studies"]),
    ]
    parts = [TEXT.format(date=datetime.date.today().isoformat())]
    for title, command in runs:
        shown = f"python -m {' '.join(command)}"
        print(f"{shown} ...", file=sys.stderr, flush=True)
        python = args.peers if "--peers" in command else sys.executable
        out = subprocess.run([python, "-m", *command], capture_output=True, text=True, check=True).stdout
        parts.append(f"## {title}\n\n`{shown}`\n\n{out.strip()}\n\n")
    args.out.write_text("".join(parts).rstrip() + "\n", encoding="utf-8")
    print(f"wrote {args.out}", file=sys.stderr)


if __name__ == "__main__":
    main()
