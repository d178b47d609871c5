"""The Poppy driver with emulated servos, over topics in real time: its rate, and how well the angles follow.

    python -m benchmark.lab.driver [--full]

Commanded angles are those of `joint_goals`, which the servos had when they were read; read-back angles are those of
`joint_states`. A servo follows a goal as a ramp, a period or two later, so a read-back angle should be one that the
goal had a few periods ago; the table shows how many. The period is that of the stamps, compared with a loop in
another process that only sleeps. Exit code 1 if the walk did not finish, the rate was not kept, or an angle did not
follow.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "test" / "support"))

import numpy as np

from benchmark.timing import machine
from dqwalk_ros.cli.runner import private_domain
from dqwalk_ros.config import Config, load, overlaid
from dqwalk_ros.plants.poppy.motors import load_motors
from dqwalk_ros.robot.servos import load_types

FAST = {"gait.step_length": 0.02, "task.eta": 0.5, "ssp.threshold": 0.02}
"""A cycle in 70 s instead of five minutes."""
CLOSE = 0.6
"""Tolerance between a read-back angle and a goal, in steps of the servo's encoder."""
PERIODS = 5
"""A read-back angle must be within the goals of this many preceding periods."""


def config_for(full: bool) -> Config:
    """Return the paper's walk with the parameters of the plant, combined as in the launch file."""
    own = {"poppy.dummy": True, "poppy.activate": True, "node.autostart": True, "node.exit_when_done": True}
    return overlaid(load("paper"), "poppy").updated({**({} if full else FAST), **own})


def bare_loop(period: float, stop: Any, answer: Any) -> None:
    """Sleep to a fixed period until `stop` is set; send the times at which each sleep ended [s]."""
    times, due = [], time.monotonic()
    while not stop.is_set():
        due = max(due + period, time.monotonic())
        time.sleep(max(0.0, due - time.monotonic()))
        times.append(time.monotonic())
    answer.send(times)


def walked(config: Config, timeout: float) -> tuple[dict[str, list[Any]], np.ndarray, str]:
    """Walk; return the messages by topic, the times of a bare loop [s], and the last log line of the controller."""
    from live import Live
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import JointState

    spawn = multiprocessing.get_context("spawn")
    stop, (mine, other) = spawn.Event(), spawn.Pipe()
    loop = spawn.Process(target=bare_loop, args=(1.0 / config.poppy.rate, stop, other), daemon=True)
    with tempfile.TemporaryDirectory() as folder, private_domain() as domain:
        live = Live(Path(folder), domain, config, name="listener")
        goals = live.got.setdefault("joint_goals", [])
        live.node.create_subscription(JointState, "joint_goals", goals.append, QoSProfile(depth=1000))
        loop.start()
        try:
            for name in ("poppy_driver", "phase_monitor", "controller"):
                live.start(name)
            code = live.processes.exit_code
            live.until(lambda: code("controller") is not None or code("poppy_driver") is not None, timeout, "")
            if code("poppy_driver") is not None:
                raise SystemExit(f"the driver ended: {live.processes.last_error('poppy_driver')}")
            end = live.processes.last_error("controller")
            stop.set()
            times = mine.recv() if mine.poll(10.0) else []
        finally:
            stop.set()
            live.close()
    return live.got, np.array(times), end


def periods(times: np.ndarray) -> str:
    """Describe the periods of a loop."""
    ms = 1e3 * np.diff(times)
    most = f"longest {ms.max():.1f} ms after {times[ms.argmax()] - times[0]:.1f} s"
    return f"median {np.median(ms):.2f} ms, p99 {np.percentile(ms, 99):.2f} ms, {most}"


def main() -> int:
    """Walk, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true", help="the paper's own cycle, some five minutes")
    args = parser.parse_args()
    config = config_for(args.full)
    print(machine(("numpy", "dynamixel_sdk")), flush=True)
    got, bare, end = walked(config, 900.0 if args.full else 240.0)
    return 0 if report(config, got, bare, end) else 1


def report(config: Config, got: dict[str, list[Any]], bare: np.ndarray, end: str) -> bool:
    """Print the results; return whether all requirements are met."""
    known = load_types(config.servo.table)
    motors = load_motors(config.poppy.motors, known)
    states = {m.header.stamp.sec * 10**9 + m.header.stamp.nanosec: m for m in got["joint_states"]}
    goals = {m.header.stamp.sec * 10**9 + m.header.stamp.nanosec: m for m in got["joint_goals"]}
    stamps = sorted(states.keys() & goals.keys())
    q = np.degrees([list(states[s].position) for s in stamps])
    goal = np.degrees([list(goals[s].position) for s in stamps])
    names = list(states[stamps[0]].name)
    phases = [m.data for m in got["phase_log"]]
    finished = "finished" in phases
    phases = [name for name in phases if "/" in name]
    at = 1e-9 * np.array(stamps)
    print(f"motors           {len(names)}, emulated, at {config.poppy.rate:g} Hz")
    print(f"walk             {'finished' if finished else end}: {', '.join(phases)}; {at[-1] - at[0]:.1f} s")
    print(f"joint_states     {periods(at)}, {len(stamps)} of them")
    print(f"a bare loop      {periods(bare)}, beside it")
    low, high = np.array([motors[name].limits for name in names]).T
    types = [known[motors[name].type] for name in names]
    close = np.array([CLOSE * kind.range / (kind.positions - 1) for kind in types])  # [deg]
    inside = bool((q >= low - close).all() and (q <= high + close).all())
    behind = np.abs(q - goal)
    moving = int((np.ptp(goal, axis=0) > 1.0).sum())
    median, p99 = np.percentile(behind.max(axis=1), [50, 99])
    print(f"goal - read back median {median:.3f} deg, p99 {p99:.3f} deg, largest {behind.max():.3f} deg")
    share = 0.0
    for n in range(1, PERIODS + 1):
        past = np.stack([goal[PERIODS - k : len(goal) - k] for k in range(n)])
        there = (q[PERIODS:] >= past.min(axis=0) - close) & (q[PERIODS:] <= past.max(axis=0) + close)
        share = 100.0 * float(there.all(axis=1).mean())
        print(f"                 {share:6.2f} % of the states are where the goals of the last {n} periods were")
    print(f"limits           {'all 25 motors inside theirs' if inside else 'LEFT'}; {moving} joints moved by a degree")
    latencies = [
        1e3 * float(value.value)
        for array in got["diagnostics"]
        for status in array.status
        if status.name == "poppy_driver: plant"
        for value in status.values
        if value.key == "latency"
    ]
    print(f"latency          {np.median(latencies):.1f} ms from the angles to the goals that answer them (median)")
    period = 1e3 / config.poppy.rate
    held = abs(float(np.median(1e3 * np.diff(at))) - period) < 0.02 * period
    ok = finished and inside and held and share > 99.0
    print("all requirements met" if ok else "NOT all requirements met")
    return ok


if __name__ == "__main__":
    sys.exit(main())
