"""CPU time of a tick of the whole-body controller: ``python -m benchmark.whole_body [--quick]``.

Tests 1 and 2 of the paper in closed loop, without the time of the plant. One thread, so that the CPU time is the
time on one idle core.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from benchmark.timing import table  # first: it sets the number of threads
from dqwalk_ros.config import load
from dqwalk_ros.whole_body import SCENARIOS
from dqwalk_ros.whole_body.experiments import walk

STAGES = ("model", "assembly", "solution", "whole tick")
PAPER = "the paper, 2012: solution 0.92 ms on average, peaks to 20 ms"


def main() -> None:
    """Run it and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="3 s of Test 2 instead of both tests")
    args = parser.parse_args()
    config = load("whole_body")
    scenarios = [replace(SCENARIOS["2"], duration=3.0)] if args.quick else list(SCENARIOS.values())
    times, methods = [], []
    for scenario in scenarios:
        walked = walk(config, scenario)
        times.append(walked.times)
        methods += walked.method
        print(f"{scenario.name}: {len(walked.time)} ticks {walked.note}", flush=True)
    spent = 1e3 * np.vstack(times)
    columns = [[column.mean(), *np.percentile(column, [50, 95, 99]), column.max()] for column in spent.T]
    rows = [[stage, *(f"{value:.2f}" for value in values)] for stage, values in zip(STAGES, columns, strict=True)]
    print("\n" + table(["CPU time [ms]", "mean", "median", "p95", "p99", "max"], rows))
    shares = ", ".join(f"{name} {100.0 * methods.count(name) / len(methods):.1f} %" for name in dict.fromkeys(methods))
    print(f"{shares}; {100.0 * (spent[:, 3] > 5.0).mean():.2f} % of the ticks above 5 ms\n{PAPER}")


if __name__ == "__main__":
    main()
