"""The time from the start of a program to what it prints or commands first. Needs ROS 2.

python -m benchmark.startup [--runs 10]

`dqwalk --help` should take less than 0.15 s, and the controller's first command less than 5 s, on a bare machine, which
has no cache of compiled code, less than 30 s.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time

from benchmark.nodes import first_answer, plant
from benchmark.timing import machine, table


def run(words: list[str]) -> tuple[float, float]:
    """Return the time on the clock and the CPU time [s] of a program."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    took, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return took, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def controller(name: str) -> tuple[float, float]:
    """Return the times until the first command of the controller node of a shipped configuration [s]."""
    with plant(name, "clarabel", lockstep=name == "paper", dt=0.005) as made:
        took = first_answer(made)
        return took, made.spent()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=10, help="of which the shortest is printed; fewer of the nodes")
    args = parser.parse_args()
    print(f"{machine()}\n")
    words = [sys.executable, "-c", "import sys; from dqwalk_ros.programs import dqwalk; sys.exit(dqwalk())"]
    cases = {
        f"dqwalk {argument}": [run([*words, argument]) for _ in range(args.runs)] for argument in ("--help", "version")
    }
    for name in ("paper", "poppy_dynamic"):
        controller(name)  # fills the cache
        cases[f"controller, {name}"] = [controller(name) for _ in range(max(args.runs // 3, 1))]
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_CACHE_HOME"] = folder
        cases["controller, poppy_dynamic, on a bare machine"] = [controller("poppy_dynamic")]
    rows = [[name, *(f"{min(times):.2f}" for times in zip(*runs, strict=True))] for name, runs in cases.items()]
    print(table(["program", "wall [s]", "CPU [s]"], rows))


if __name__ == "__main__":
    main()
