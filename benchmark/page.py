"""Write docs/benchmarks.md: run every benchmark and store its output.

python -m benchmark.page [--peers PYTHON ...] [--out docs/benchmarks.md]
python -m benchmark.page --only tick cycle       run these, keep the others
"""

from __future__ import annotations

import argparse
import datetime
import re
import subprocess
import sys
from pathlib import Path

TEXT = """\
# Benchmarks

This page lists the computing time of a control tick, alone and beside other packages, of the physics loop, of the
nodes, of the start of a program, and of studies. `python -m benchmark.page` writes it; do not edit. Times are medians
of single calls in an interleaved run on a shared machine: compare only numbers of one table, and ratios rather than
times.

**Peers** are other packages (`benchmark/peers.py`) with the same robot, from the state to the joint velocities.

- *In place* is Pinocchio as an experienced user would write it: preallocated arrays, direct call of the solver.
  Clarabel in place uses its default tolerances, without scaling. *qpsolvers* is a simple first version.
- roboplan and placo load different versions of Pinocchio, so they run in separate environments, each beside this
  package. roboplan is C++ throughout, and its single support lacks the CoM cylinder.
- *error* is that of u relative to the largest joint velocity. mink, pink, placo and roboplan use their own tasks for
  the swing foot; their error is the difference of their result from that of (U6).

**Nodes**: a *late* state is one that the plant, here the benchmark, could not send on time while the controller was
working. The *bare loop* sleeps to the same schedule and does nothing else. A *bare machine* has no cache of compiled
code.

"""

TITLES = {
    "tick": "One tick",
    "cycle": "A long walk",
    "physics": "The physics loop",
    "nodes": "The controller as a node (ROS 2)",
    "startup": "From the start of a program to its first answer",
    "studies": "A thousand walks",
}
"""Title of each section, by the name of its benchmark."""


def main() -> None:
    """Run the benchmarks and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--peers", nargs="+", metavar="PYTHON", help="Python of each environment of benchmark/requirements.txt"
    )
    parser.add_argument("--ticks", type=int, default=100_000, help="number of ticks of the long walk")
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parent.parent / "docs" / "benchmarks.md")
    parser.add_argument(
        "--only", nargs="+", choices=TITLES, metavar="NAME", help=f"of {', '.join(TITLES)}; the page keeps the others"
    )
    args = parser.parse_args()
    options = {"tick": ["--peers"] if args.peers else [], "cycle": ["--ticks", str(args.ticks)]}
    sections: dict[str, str] = {}  # by title; the page keeps those that are not measured, or not yet
    if args.out.exists():
        sections |= re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", args.out.read_text("utf-8"), re.M | re.S)
    for name in args.only or TITLES:
        command = [f"benchmark.{name}", *options.get(name, [])]
        shown = f"python -m {' '.join(command)}"
        print(f"{shown} ...", file=sys.stderr, flush=True)
        pythons = args.peers if "--peers" in command else [sys.executable]
        try:
            outs = [
                subprocess.run([python, "-m", *command], stdout=subprocess.PIPE, text=True, check=True).stdout.strip()
                for python in pythons
            ]
        except KeyboardInterrupt:
            sys.exit(f"interrupted; {args.out} keeps what was measured before: --only {name} ... measures the rest")
        date = datetime.date.today().isoformat()
        sections[TITLES[name]] = "\n\n".join([f"\n`{shown}` on {date}", *outs])
        page = [
            TEXT,
            *(f"## {title}\n{sections[title].rstrip()}\n\n" for title in TITLES.values() if title in sections),
        ]
        args.out.write_text("".join(page).rstrip() + "\n", encoding="utf-8")
    print(f"wrote {args.out}", file=sys.stderr)


if __name__ == "__main__":
    main()
