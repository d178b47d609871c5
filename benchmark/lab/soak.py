"""An hour of walking through ROS in lockstep, recorded: memory, open files and lost messages of each node.

    python -m benchmark.lab.soak [--minutes 60] [--out results/soak]

Walks as many whole cycles of the paper as fit into the time. Memory is the resident set of each node, after the
first minute and at the end. Exit code 1 if a node grew by 5 MB or opened more files, or the bag has a gap.
"""

from __future__ import annotations

import argparse
import math
import shutil
import struct
import sys
import time
from pathlib import Path
from typing import Any

import psutil

from benchmark.timing import machine, table  # first: it sets the number of threads
from dqwalk_ros.cli.progress import Progress
from dqwalk_ros.cli.runner import run_walk
from dqwalk_ros.config import Config, load
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.simulation import simulate
from dqwalk_ros.walks.table import make_controller

GROWTH = 5.0
"""Largest permitted growth of a node after the first minute [MB]."""
FIRST = 60.0
"""Time of the first sample [s]."""
STREAMS = ("/joint_states", "/joint_velocity_commands", "/base_pose")


class Watched:
    """Samples memory and handles of the nodes while they walk.

    Attributes
    ----------
    samples : dict of float to dict of str to (float, int)
        Resident set [MB] and open files of each node, by the time since the first sample [s].
    """

    def __init__(self, quiet: bool) -> None:
        self._progress, self._began, self._due = Progress(quiet=quiet).__enter__(), 0.0, 0.0
        self.samples: dict[float, dict[str, tuple[float, int]]] = {}

    def __call__(self, fraction: float, text: str) -> None:
        """Take a sample every two seconds; the progress callback of `run_walk`."""
        self._progress(fraction, text)
        now = time.monotonic()
        if "support" not in text or now < self._due:
            return
        self._began, self._due = self._began or now, now + 2.0
        found = sample()
        if len(found) == 4:
            self.samples[now - self._began] = found

    def close(self) -> None:
        """End the line of the progress."""
        self._progress.__exit__()


def sample() -> dict[str, tuple[float, int]]:
    """Return resident set [MB] and open files of every node."""
    out = {}
    for process in psutil.Process().children(recursive=True):
        try:
            words = process.cmdline()
            if len(words) > 3 and words[2] == "dqwalk_ros.nodes":
                out[words[3]] = (process.memory_info().rss / 1e6, process.num_fds())
        except psutil.Error:
            continue
    return out


def cycles_for(minutes: float, config: Config) -> tuple[int, float]:
    """Return the number of cycles that fill the time, and their duration [s]; the first is shorter than the others."""
    model = load_model(config.robot)
    two = simulate(make_controller(config.updated({"gait.cycles": 2}), model), KinematicPlant(model))
    first = float(two.time[two.phases[4].start])
    other = float(two.time[-1]) - first
    cycles = 1 + max(0, math.ceil((60.0 * minutes - first) / other))
    return cycles, first + (cycles - 1) * other


def gaps(bag: Path, period: int) -> dict[str, tuple[int, int]]:
    """Return the number of messages of each stream of a bag, and of stamps missing between them."""
    from rosbags.rosbag2 import Reader

    found = {topic: [0, 0, -1] for topic in STREAMS}
    with Reader(bag) as reader:
        chosen = [c for c in reader.connections if c.topic in found]
        for connection, _, raw in reader.messages(chosen):
            sec, nanosec = struct.unpack_from("<iI", raw, 4)
            stamp, entry = sec * 10**9 + nanosec, found[connection.topic]
            expected = entry[2] + period if entry[2] >= 0 else 0
            entry[0], entry[1], entry[2] = entry[0] + 1, entry[1] + (stamp != expected), stamp
    return {topic: (count, missing) for topic, (count, missing, _) in found.items()}


def main() -> int:
    """Walk, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0, help="of walking, simulated time")
    parser.add_argument("--out", type=Path, default=Path("results/soak"), help="folder of the bag; replaced")
    parser.add_argument("--keep", action="store_true", help="keep the bag")
    parser.add_argument("--quiet", action="store_true")
    args = parser.parse_args()
    config = load("paper")
    print(machine(), flush=True)
    cycles, duration = cycles_for(args.minutes, config)
    config = config.updated({"gait.cycles": cycles})
    print(f"{cycles} cycles, about {duration / 60.0:.0f} min of walking\n", flush=True)
    shutil.rmtree(args.out, ignore_errors=True)
    watched = Watched(args.quiet)
    try:
        outcome = run_walk(config, args.out / "bag", progress=watched)
    finally:
        watched.close()
    print(outcome)
    ok = report(watched, outcome, config)
    if not args.keep:
        shutil.rmtree(args.out / "bag", ignore_errors=True)
    return 0 if ok else 1


def report(watched: Watched, outcome: Any, config: Config) -> bool:
    """Print growth and missing messages; return whether both are within their limits."""
    times, samples = list(watched.samples), list(watched.samples.values())
    first = next((found for at, found in watched.samples.items() if at >= FIRST), None)
    if first is None:
        print(f"the walk ended before {FIRST:.0f} s: nothing to compare")
        return False
    rows, ok = [], bool(outcome.finished)
    for name, (memory, files) in samples[-1].items():
        (memory0, files0), half = first[name], samples[len(samples) // 2][name][0]
        most = max(found[name][0] for found in samples)
        ok &= memory - memory0 < GROWTH and files <= files0
        sizes = (f"{memory0:.1f}", f"{half:.1f}", f"{memory:.1f}", f"{memory - memory0:+.1f}", f"{most:.1f}")
        rows.append([name, *sizes, f"{files0}", f"{files}"])
    head = ["node", "after 1 min [MB]", "half way [MB]", "at the end [MB]", "growth [MB]", "most [MB]"]
    head += ["files, 1 min", "files, end"]
    print("\n" + table(head, rows))
    size = sum(file.stat().st_size for file in outcome.bag.iterdir()) / 1e6
    for topic, (count, missing) in gaps(outcome.bag, round(config.dt * 1e9)).items():
        ok &= missing == 0 and count >= outcome.ticks
        print(f"{topic}: {count} messages, {missing} missing")
    print(f"bag of {size:.0f} MB; {times[-1] / 60.0:.1f} min of the clock\n{'flat' if ok else 'NOT flat'}")
    return ok


if __name__ == "__main__":
    sys.exit(main())
