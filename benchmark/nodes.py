"""The controller node in a process of its own, over DDS: round trips from state to command.

    python -m benchmark.nodes [--ticks 3000]

This process is the plant: in lockstep, it sends the next state when the command to the last one is there. Needs ROS 2.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

import numpy as np
import psutil

from benchmark.timing import machine, table
from dqwalk_ros.config import find_share, load
from dqwalk_ros.model import load_model


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ticks", type=int, default=3000)
    args = parser.parse_args()
    print(f"{machine()}\n")
    rows = [_run(solver, args.ticks) for solver in ("clarabel", "daqp")]
    print(table(["solver", "ticks", "ticks/s", "round trip [us]", "p99 [us]", "controller, CPU per tick [us]"], rows))


def _run(solver: str, ticks: int) -> list[str]:
    import rclpy
    from sensor_msgs.msg import JointState

    from dqwalk_ros.nodes import messages as ros

    config = load("paper")
    model = load_model(config.robot)
    options = ["-p", "plant.lockstep:=true", "-p", f"qp.solver:={solver}"]
    code = "import sys; from dqwalk_ros.nodes.controller import main; sys.exit(main(sys.argv[1:]))"
    params = ["--ros-args", "--params-file", str(find_share("config", "paper.yaml"))]
    controller = subprocess.Popen([sys.executable, "-c", code, *params, *options], stderr=subprocess.DEVNULL)
    rclpy.init()
    try:
        node = rclpy.create_node("benchmark_plant")
        pub = node.create_publisher(JointState, "joint_states", ros.stream(1, reliable=True))
        answers: dict[int, np.ndarray] = {}
        reader = {name: i for i, name in enumerate(model.joint_names)}

        def on_command(msg: JointState) -> None:
            velocity = np.empty(model.n)
            for name, value in zip(msg.name, msg.velocity, strict=True):
                velocity[reader[name]] = value
            answers[ros.nanoseconds(msg.header.stamp)] = velocity

        node.create_subscription(JointState, "joint_velocity_commands", on_command, ros.stream(1, reliable=True))
        write, q, period = ros.JointWriter(model.joint_names), np.zeros(model.n), round(config.dt * 1e9)
        process, trips = psutil.Process(controller.pid), []
        spent = 0.0
        for tick in range(ticks):
            stamp = (tick + 1) * period
            began = sent = time.perf_counter()
            pub.publish(write(stamp, position=q))
            while stamp not in answers:
                rclpy.spin_once(node, timeout_sec=0.2)
                if time.perf_counter() - sent > 1.0:  # nobody listened yet
                    if controller.poll() is not None or time.perf_counter() - began > 60.0:
                        raise SystemExit("the controller does not answer")
                    sent = time.perf_counter()
                    pub.publish(write(stamp, position=q))
            if tick == 0:
                spent = sum(process.cpu_times()[:2])
            else:
                trips.append(time.perf_counter() - began)
            q = q + config.dt * answers.pop(stamp)
        spent = sum(process.cpu_times()[:2]) - spent
    finally:
        controller.terminate()
        controller.wait(10.0)
        rclpy.shutdown()
    micro = 1e6 * np.array(trips)
    return [
        solver,
        str(ticks),
        f"{1e6 / micro.mean():.0f}",
        f"{np.median(micro):.0f}",
        f"{np.percentile(micro, 99):.0f}",
        f"{1e6 * spent / len(trips):.0f}",
    ]


if __name__ == "__main__":
    main()
