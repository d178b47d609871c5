"""Adopts robots from other packages and walks them: one row per robot description.

python -m benchmark.lab.robots PATH ... [--out results/robots] [--only NAME]

PATH is a URDF, a xacro, or a folder to search, such as those of the packages example-robot-data and jvrc-description
(`make robots`). Robots that are not bipeds are listed with the reason.

Each robot is adopted and walks `gait.steps` of its own configuration in MuJoCo, one cycle of the paper's walk, and
three metres of the dynamic walk in MuJoCo, whose mean speed is given; - if it falls or the report finds a violation.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path
from typing import Any

from benchmark.timing import machine, table  # first: it sets the number of threads
from dqwalk_ros.adopt import adopt
from dqwalk_ros.adopt.trial import dynamic_walks, first_walks
from dqwalk_ros.cli.progress import Progress
from dqwalk_ros.config import Config, load, overlaid
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.report import analyse, report
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.simulation import simulate
from dqwalk_ros.support.errors import DqwalkError
from dqwalk_ros.support.interrupts import is_interrupt
from dqwalk_ros.walks.table import make_controller


def row(path: Path, out: Path) -> list[Any]:
    """Adopt one robot, walk it, and return its row."""
    began = time.perf_counter()
    found = adopt(path, out)
    *_, (last, cure) = first_walks(found, {})
    for _ in dynamic_walks(found, {}, last.changes if last.stood else {}):
        pass  # it writes the best of them
    took = time.perf_counter() - began
    config = load(out / "robot.yaml")
    model = load_model(config.robot)
    walked, whole = walk(config, "physics"), walk(load(out / "paper.yaml"), "integrator")
    ground = walked["physics"]
    return [
        path.stem,
        f"{model.mass:.1f}",
        f"{took:.0f}",
        cure or "-" if last.stood else "none helped",
        f"{ground['way']:.2f}",
        f"{ground['way'] / walked['walk']['duration']:.3f}",
        f"{math.degrees(ground['tilt']['value']):.2f}",
        f"{100.0 * ground['cop_inside']:.1f}",
        f"{math.degrees(abs(ground['turned'])):.1f}",
        "yes" if walked["ok"] and walked["walk"]["finished"] else "no",
        "yes" if whole["ok"] and whole["walk"]["finished"] else "no",
        dynamic_speed(out),
    ]


def walk(config: Config, plant: str) -> dict[str, Any]:
    """Walk on a plant and return the report."""
    config = overlaid(config, plant) if plant == "physics" else config
    model = load_model(config.robot)
    return report(analyse(simulate(make_controller(config, model), make_plant(plant, config, model))))


def dynamic_speed(folder: Path) -> str:
    """Return the mean speed over three metres of an adopted robot's dynamic walk [m/s]."""
    config = load(folder / "dynamic.yaml")
    walked = walk(config.updated({"gait.steps": math.ceil(3.0 / config.gait.step_length) + 8}), "physics")
    if not (walked["ok"] and walked["walk"]["finished"]):
        return "-"
    return f"{walked['physics']['way'] / walked['walk']['duration']:.3f}"


def main() -> int:
    """Print the table; return 1 if it is empty, or Ctrl-C has ended it before the last robot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, default=Path("results/robots"))
    parser.add_argument("--only", default="", help="only files with this text in their path")
    args = parser.parse_args()
    files = [f for p in args.paths for f in (sorted(p.rglob("*.urdf")) if p.is_dir() else [p]) if args.only in str(f)]
    rows, refused = [], []
    whole = True
    with Progress() as bar:
        try:
            for number, file in enumerate(files, 1):
                bar.stage((number - 1) / len(files), f"{number} of {len(files)}: {file.stem}")
                try:
                    rows.append(row(file, args.out / f"{number}_{file.stem}"))
                except DqwalkError as error:
                    refused.append(f"- `{file.name}`: {error}")
        except (KeyboardInterrupt, SystemError) as error:
            if not is_interrupt(error):
                raise
            whole = False
            bar.print(f"interrupted: the {len(files) - number + 1} robots from {file.stem} on are not in the table")
    head = ["robot", "kg", "adopted in [s]", "cure", "way [m]", "m/s", "tilt [deg]", "CoP inside [%]", "turned [deg]",
            "stands", "paper's walk", "dynamic walk [m/s]"]  # fmt: skip
    print(f"\n{machine()}\n\n{table(head, rows)}")
    if refused:
        print("\nNot adopted:\n\n" + "\n".join(refused))
    return 0 if rows and whole else 1


if __name__ == "__main__":
    raise SystemExit(main())
