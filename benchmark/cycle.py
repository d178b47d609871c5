"""Time of a closed loop of many ticks with either solver, and the difference between the two walks at the end.

python -m benchmark.cycle [--ticks 100000]
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from benchmark.timing import machine, table  # first: it sets the number of threads
from dqwalk_ros.config import load
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.simulation import simulate
from dqwalk_ros.walks.table import make_controller


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ticks", type=int, default=100_000)
    args = parser.parse_args()
    config = load("paper").updated({"gait.cycles": 1000})
    model = load_model(config.robot)
    print(f"{machine()}\n")
    ends, rows = [], []
    for name in ("clarabel", "daqp"):
        controller = make_controller(config.updated({"qp.solver": name}), model)
        simulate(controller, KinematicPlant(model), max_time=10 * config.dt)  # compiles
        controller.reset()
        began, spent = time.perf_counter(), time.process_time()
        trace = simulate(controller, KinematicPlant(model), max_time=args.ticks * config.dt)
        spent, began = time.process_time() - spent, time.perf_counter() - began
        ends.append(trace.q)
        rows.append([name, f"{len(trace)}", f"{began:.1f}", f"{spent:.1f}", f"{1e6 * spent / len(trace):.1f}"])
    print(table(["solver", "ticks", "wall [s]", "CPU [s]", "CPU per tick [us]"], rows))
    print(f"\nlargest difference of a joint angle between the two walks: {np.abs(ends[0] - ends[1]).max():.1e} rad")


if __name__ == "__main__":
    main()
