"""The controller node in its own process, over DDS, with this process as the plant. Needs ROS 2.

    python -m benchmark.nodes [--ticks 3000] [--seconds 20] [--busy 1]

In lockstep the next state is sent when the command for the last one has arrived. In real time, in a dynamic walk,
states are sent at a fixed rate, and a loop that only sleeps to the same schedule is timed in the same minute; a period
is missed if its command has not arrived when the next state is due. The rates of robots are measured beside processes
that never sleep, too. It takes six minutes, and says on stderr what it measures.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

import numpy as np
import psutil

from benchmark.timing import machine, table
from dqwalk_ros.config import find_share, load
from dqwalk_ros.robot.model import load_model

OF_ROBOTS = (50, 100, 200)
"""Rates at which robots are controlled [1/s]."""
RATES = {**dict.fromkeys(OF_ROBOTS, 1.0), 500: 1 / 3, 1000: 1 / 3}
"""In real time: states per second, and the part of ``--seconds`` for which they are sent."""


@dataclass
class Plant:
    """The plant of a controller: publishes states and stores the commands."""

    node: object
    controller: psutil.Process
    send: Callable[[int, np.ndarray], None]
    spin: Callable[[float], None]
    start: np.ndarray  # joint angles [rad]
    began: float  # start of the controller's process [s]
    # by stamp: time of receipt [s], velocity
    answers: dict[int, tuple[float, np.ndarray]] = field(default_factory=dict)
    computed: list[float] = field(default_factory=list)  # compute times that the controller reports [s]

    def spent(self) -> float:
        """CPU time of the controller so far [s]."""
        return sum(self.controller.cpu_times()[:2])


@contextmanager
def plant(name: str, solver: str, *, lockstep: bool, dt: float) -> Iterator[Plant]:
    """Start a controller of a shipped configuration with this process as its plant."""
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import JointState

    from dqwalk_ros.nodes import messages as ros

    config = load(name)
    model = load_model(config.robot)
    values = {"plant.lockstep": str(lockstep).lower(), "qp.solver": solver, "dt": dt, "monitor.rate": 20.0}
    values["gait.steps"] = 1000
    options = [word for key, value in values.items() for word in ("-p", f"{key}:={value}")]
    code = "import sys; from dqwalk_ros.nodes.command_line import main; sys.exit(main('controller', sys.argv[1:]))"
    params = ["--ros-args", "--params-file", str(find_share("config", f"{name}.yaml"))]
    began = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-c", code, *params, *options], stderr=subprocess.DEVNULL)
    rclpy.init()
    try:
        node = rclpy.create_node("benchmark_plant")
        profile = 1 if lockstep else ros.best_effort(1)
        states = node.create_publisher(JointState, "joint_states", profile)
        write, index = ros.JointWriter(model.joint_names), {name: i for i, name in enumerate(model.joint_names)}
        made = Plant(
            node=node,
            controller=psutil.Process(process.pid),
            send=lambda stamp, q: states.publish(write(stamp, position=q)),
            spin=lambda timeout: rclpy.spin_once(node, timeout_sec=timeout),
            start=model.posture(config.standing.posture),
            began=began,
        )

        def on_command(msg: JointState) -> None:
            now, velocity = time.perf_counter(), np.zeros(model.n)
            for name, value in zip(msg.name, msg.velocity, strict=True):
                velocity[index[name]] = value
            made.answers[ros.nanoseconds(msg.header.stamp)] = now, velocity

        def on_diagnostics(msg: DiagnosticArray) -> None:
            for status in msg.status:
                made.computed += [float(pair.value) for pair in status.values if pair.key == "compute time"]

        node.create_subscription(JointState, "joint_velocity_commands", on_command, profile)
        node.create_subscription(DiagnosticArray, "diagnostics", on_diagnostics, 10)
        wait_for(made, lambda: states.get_subscription_count() and node.count_publishers("joint_velocity_commands"))
        yield made
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(10.0)
        rclpy.shutdown()


def wait_for(made: Plant, condition: Callable[[], object]) -> None:
    """Spin until a condition holds."""
    deadline = time.monotonic() + 60.0
    while not condition():
        if not made.controller.is_running() or time.monotonic() > deadline:
            raise SystemExit("the controller does not answer")
        made.spin(0.05)


def first_answer(made: Plant) -> float:
    """Send states until the first command; return the time since the start of the controller's process [s]."""

    def answered() -> bool:
        made.send(time.time_ns(), made.start)
        return bool(made.answers)

    wait_for(made, answered)
    when, _ = next(iter(made.answers.values()))
    made.answers.clear()
    return when - made.began


def in_lockstep(solver: str, ticks: int) -> list[str]:
    """Measure round trips."""
    print(f"in lockstep: {solver}, {ticks} ticks ...", file=sys.stderr, flush=True)
    dt = load("paper").dt
    with plant("paper", solver, lockstep=True, dt=dt) as made:
        q, trips, spent, period = made.start, [], 0.0, round(dt * 1e9)
        for tick in range(ticks + 1):
            stamp = (tick + 1) * period
            began = sent = time.perf_counter()
            made.send(stamp, q)
            while stamp not in made.answers:
                made.spin(0.2)
                if time.perf_counter() - sent > 1.0:  # the state was lost
                    if time.perf_counter() - began > 60.0:
                        raise SystemExit("the controller does not answer")
                    sent = time.perf_counter()
                    made.send(stamp, q)
            if tick == 0:
                spent = made.spent()
            else:
                trips.append(time.perf_counter() - began)
            q = q + dt * made.answers.pop(stamp)[1]
        spent = made.spent() - spent
    micro = 1e6 * np.array(trips)
    middle, high = np.percentile(micro, [50, 99])
    return [
        solver,
        str(ticks),
        f"{1e6 / micro.mean():.0f}",
        f"{middle:.0f}",
        f"{high:.0f}",
        f"{1e6 * spent / ticks:.0f}",
    ]


def on_schedule(rate: float, seconds: float, at_each: Callable[[int, float], None], wait: Callable[[float], None]):
    """Call something at a fixed rate; return how late each call was [s]."""
    start, late = time.perf_counter() + 0.01, []
    for k in range(int(rate * seconds)):
        due = start + k / rate
        while (left := due - time.perf_counter()) > 0.0:
            wait(left)
        late.append(time.perf_counter() - due)
        at_each(k, due)
    return np.array(late)


def bare(rate: float, seconds: float) -> np.ndarray:
    """Return how late a loop that only sleeps is [s]."""
    return on_schedule(rate, seconds, lambda k, due: None, time.sleep)


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Let some processes compute without a pause, at normal priority."""

    def normal() -> None:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))

    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"], preexec_fn=normal) for _ in range(count)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def by_the_clock(solver: str, rate: int, seconds: float) -> list[str]:
    """Measure latency, lateness, and missed periods."""
    print(f"by the clock: {rate} Hz, {solver}, {seconds:.0f} s ...", file=sys.stderr, flush=True)
    alone = [bare(rate, 0.25 * seconds)]
    with plant("poppy_dynamic", solver, lockstep=False, dt=1.0 / rate) as made:
        q, sent, first = made.start, {}, time.time_ns()
        latency, missed = [], 0
        first_command = first_answer(made)

        def tick(k: int, due: float) -> None:
            nonlocal q, missed
            if sent:
                stamp, when = sent.popitem()
                answer = made.answers.pop(stamp, None)
                made.answers.clear()
                if answer is None:
                    missed += 1
                else:
                    latency.append(answer[0] - when)
                    q = q + answer[1] / rate
            stamp = first + round(k * 1e9 / rate)
            sent[stamp] = time.perf_counter()
            made.send(stamp, q)

        def wait(left: float) -> None:
            """Wait for the command, and after its arrival only sleep, as a driver does."""
            if sent and next(iter(sent)) in made.answers:
                time.sleep(left)
            else:
                made.spin(left)

        on_schedule(rate, 2.0, tick, wait)  # the first command is the slowest
        sent.clear()
        latency.clear()
        made.computed.clear()
        first, missed = time.time_ns(), 0
        spent, began = made.spent(), time.perf_counter()
        late = on_schedule(rate, seconds, tick, wait)
        share = (made.spent() - spent) / (time.perf_counter() - began)
        computed = np.array(made.computed)
    alone.append(bare(rate, 0.25 * seconds))
    lateness, lone = np.percentile(late, 99), np.percentile(np.concatenate(alone), 99)
    middle, high, most = np.percentile(latency, [50, 99, 100])
    return [
        str(rate),
        solver,
        f"{first_command:.1f}",
        f"{1e3 * np.median(computed):.2f}",
        f"{1e3 * middle:.2f}",
        f"{1e3 * high:.2f}",
        f"{1e3 * most:.1f}",
        f"{100 * missed / (rate * seconds):.2f}",
        f"{1e3 * lateness:.2f}",
        f"{1e3 * lone:.2f}",
        f"{lateness / lone:.2f}",
        f"{100 * share:.0f}",
    ]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ticks", type=int, default=3000, help="in lockstep")
    parser.add_argument(
        "--seconds", type=float, default=20.0, help="by the clock up to 200 Hz, a third of it at others"
    )
    parser.add_argument("--busy", type=int, default=1, help="processes that never sleep, in the last table")
    args = parser.parse_args()
    print(f"{machine()}\n\n### In lockstep\n")
    rows = [in_lockstep(solver, args.ticks) for solver in ("clarabel", "daqp")]
    print(table(["solver", "ticks", "ticks/s", "round trip [us]", "p99 [us]", "controller, CPU per tick [us]"], rows))
    header = [
        "rate [Hz]",
        "solver",
        "first command [s]",
        "computes [ms]",
        "state to command [ms]",
        "p99 [ms]",
        "max [ms]",
    ]
    header += ["missed [%]", "late, p99 [ms]", "bare loop, p99 [ms]", "ratio", "controller, CPU [%]"]
    print("\n### By the clock\n", flush=True)
    rows = [by_the_clock("clarabel", rate, args.seconds * share) for rate, share in RATES.items()]
    rows.append(by_the_clock("daqp", 1000, args.seconds / 3.0))
    print(table(header, rows))
    print(f"\n### By the clock, beside busy processes: {args.busy}\n", flush=True)
    with busy(args.busy):
        print(table(header, [by_the_clock("clarabel", rate, args.seconds) for rate in OF_ROBOTS]))


if __name__ == "__main__":
    main()
