"""Walks of one robot in MuJoCo: our dynamic walk, and those of other packages.

python -m benchmark.walks [--robot small_humanoid|t1] [--seeds 20] [--steps 20]

small_humanoid is test/data/small_humanoid.urdf, of the size of a ROBOTIS OP3, beside placo's walk pattern generator
(`benchmark/placo_walk.py`). t1 is Booster's T1, beside the learned walks of holosoma (`benchmark/learned_walk.py`).
Our walk is as `dqwalk adopt` configures the robot, and all are to have its speed; `benchmark/scene.py` says what they
are judged by.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path

from benchmark.timing import machine, table  # isort: skip  first: it sets the number of threads
from benchmark.learned_walk import learned_walk, robot
from benchmark.placo_walk import placo_walk
from benchmark.scene import HEAD, Walker, row
from dqwalk_ros.adopt import adopt
from dqwalk_ros.config import Config, load, overlaid
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.studies.pushes import impulse_scale
from dqwalk_ros.walks.table import make_controller, make_walk

SMALL = Path("test/data/small_humanoid.urdf")


def dynamic_config(folder: Path, steps: int, longer: float = 1.0) -> Config:
    """Return the configuration of our dynamic walk in physics, with steps longer by a factor."""
    config = overlaid(load(folder / "dynamic.yaml"), "physics").updated({"gait.steps": steps, "qp.solver": "daqp"})
    length = longer * config.gait.step_length
    return config.updated({"gait.step_length": length, "gait.most_length": max(length, config.gait.most_length)})


def our_walk(config: Config) -> Walker:
    """Return our walk."""
    posture = make_walk(config, load_model(config.robot)).posture
    make = lambda c: make_controller(c, load_model(c.robot))  # noqa: E731
    return Walker("our dynamic walk", config, make, posture, config.gait.steps * config.gait.step_length)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", choices=("small_humanoid", "t1"), default="small_humanoid")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--steps", type=int, default=20)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        adopt(SMALL if args.robot == "small_humanoid" else robot(), folder)
        dynamic = dynamic_config(folder, args.steps)
        period = dynamic.standing.transfer_duration + dynamic.standing.swing_duration
        speed, scale = dynamic.gait.step_length / period, impulse_scale(dynamic)
        rivals: list[Callable[[float], Walker]] = [lambda factor: placo_walk(dynamic, factor * speed)]
        if args.robot == "t1":
            rivals = [
                lambda factor, name=name: learned_walk(dynamic, name, factor * speed, args.steps * period)
                for name in ("fastsac", "ppo")
            ]
        ours = lambda factor: our_walk(dynamic_config(folder, args.steps, factor))  # noqa: E731
        rows = [row(make, speed, scale, args.seeds) for make in (*rivals, ours)]
    packages = ("numpy", "mujoco", "daqp", "placo" if args.robot == "small_humanoid" else "holosoma-inference")
    print(f"\n{machine(packages)}\n\n{table(HEAD, rows)}")


if __name__ == "__main__":
    main()
