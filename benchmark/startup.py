"""How long it takes until something can be used, with everything compiled before.

python -m benchmark.startup [--runs 7]
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import time
from collections.abc import Sequence

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

import numpy as np

from benchmark.timing import machine, table
from dqwalk_ros.config import find_share

CONTROLLER = """
import numpy as np
from dqwalk_ros import load, load_model, make_controller
from dqwalk_ros.state import State
config = load("paper")
model = load_model(config.robot)
make_controller(config, model).step(State(time=0.0, q=np.zeros(model.n)), config.dt)
"""
NODE = "import sys; from dqwalk_ros.nodes.command_line import main; sys.exit(main('controller', sys.argv[1:]))"


def run(words: Sequence[str], until: str = "") -> tuple[float, float]:
    """Return wall and CPU time [s] of a program, or of a node until it prints `until`."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE if until else None, text=True
    )
    if until:
        assert process.stderr is not None
        if not any(until in line for line in process.stderr):
            raise SystemExit(f"{words[-1]} ended before it was ready")
        wall = time.perf_counter() - began
        process.kill()  # its end is not what is measured
        process.communicate()
    else:
        process.wait()
        wall = time.perf_counter() - began
        if process.returncode:
            raise SystemExit(f"{words} ended with {process.returncode}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=7)
    args = parser.parse_args()
    params = ["--ros-args", "--params-file", str(find_share("config", "paper.yaml"))]
    cases: dict[str, tuple[list[str], str]] = {
        "Python alone": (["-c", "pass"], ""),
        "import dqwalk_ros": (["-c", "import dqwalk_ros"], ""),
        "dqwalk --help": (["-m", "dqwalk_ros.cli", "--help"], ""),
        "first command of a controller": (["-c", CONTROLLER], ""),
        "controller node ready": (["-c", NODE, *params], "walking"),
    }
    for words, until in cases.values():  # compiles what is not compiled yet
        run(words, until)
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in cases}
    for _ in range(args.runs):
        for name, (words, until) in cases.items():
            times[name].append(run(words, until))
    print(f"{machine()}\n")
    rows = []
    for name, found in times.items():
        wall, cpu = np.median(found, axis=0)
        rows.append([name, f"{wall:.2f}", f"{cpu:.2f}", f"{np.min(found, axis=0)[0]:.2f}"])
    print(table(["from the start of Python", "wall, median [s]", "CPU [s]", "wall, least [s]"], rows))


if __name__ == "__main__":
    main()
