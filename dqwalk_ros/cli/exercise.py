"""``dqwalk exercise``: moves every joint of a suspended robot, and records the motion of the servos."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import click

from dqwalk_ros.cli.options import (
    Setup,
    command,
    folder_option,
    force_option,
    parse_overrides,
    quiet_option,
    setup_options,
)
from dqwalk_ros.plants.table import PHYSICS
from dqwalk_ros.support.ros_environment import check_ros_environment


@command("""
The pelvis is fixed and level, with all limbs free (docs/hardware.md). Each joint is moved slowly over 0.5 rad or
its range, back and forth, in small steps, and by oscillations up to 7 Hz, 20 s in total, while the other joints keep a
posture in which gravity loads it; the limbs move at the same time. A Poppy takes 5 minutes.

writes to the folder of --out:
  bag/                 the exercise as a rosbag2 (MCAP), for `dqwalk identify`, and for `dqwalk view` as any walk

examples:
  dqwalk exercise --out exercise                        the as-built Poppy, in MuJoCo
  dqwalk exercise --plant poppy --out exercise          the real Poppy, through ROS 2; suspend it first
  dqwalk exercise --ros --out exercise                  MuJoCo through ROS 2
  dqwalk exercise --config my_robot.yaml --plant physics --cycles 2
  dqwalk exercise --set 'robot.lock=["head_*", "*_arm_*"]'       without these joints
then:
  dqwalk identify exercise/bag
""")
@setup_options("poppy", [*PHYSICS, "poppy"], "poppy_as_built")
@click.option("--cycles", metavar="N", type=int, default=1, help="Exercise each joint N times.")
@click.option("--ros", is_flag=True, help="Use ROS 2, as always for the real robot.")
@folder_option("exercise")
@force_option
@quiet_option
def exercise(
    setup: Setup,
    cycles: int,
    ros: bool,
    out: Path,
    force: bool,
    quiet: bool,
) -> int:
    """Move each joint of a suspended robot, to identify its servos."""
    from dqwalk_ros.cli.progress import Progress
    from dqwalk_ros.cli.results import prepare
    from dqwalk_ros.identification.exercise import duration, exercise_config
    from dqwalk_ros.robot.model import load_model

    plant, made = setup.plant, exercise_config(setup.made(), cycles)
    made = made.updated(parse_overrides(setup.changes), source="command line")
    if plant == "poppy":
        from dqwalk_ros.plants.poppy.motors import load_motors, typed
        from dqwalk_ros.robot.servos import load_types

        made = typed(made, load_motors(made.poppy.motors, load_types(made.servo.table)).values())
    if ros := ros or plant == "poppy":
        check_ros_environment()
    prepare(out, *(["log"] if ros else []), force=force)
    with Progress(quiet=quiet) as bar:
        bar(0.0, "computing postures")
        model = load_model(made.robot)
        total = duration(model, made.gait.cycles)
        if ros:
            from dqwalk_ros.cli.runner import run_walk

            outcome = run_walk(made, out / "bag", plant=plant, lockstep=plant != "poppy", duration=total, progress=bar)
            reason = "" if outcome.finished else str(outcome)
        else:
            from dqwalk_ros.plants.table import make_plant
            from dqwalk_ros.report import bag
            from dqwalk_ros.simulation import simulate
            from dqwalk_ros.walks.table import make_controller

            controller, body = make_controller(made, model), make_plant(plant, made, model)
            trace = simulate(
                controller, body, before_step=lambda time: bar(time / total, f"{time:.0f} of {total:.0f} s")
            )
            bag.write(trace, out / "bag", diagnostics=False)
            reason = "" if trace.finished else "; ".join(trace.notes)
    if reason:
        print(f"dqwalk: {reason}", file=sys.stderr)
    if not quiet and (out / "bag").exists():
        then = shlex.join(["dqwalk", "identify", str(out / "bag")])
        print(f"wrote {out / 'bag'}" + ("" if reason else f"; next: {then}"))
    return 1 if reason else 0
