"""``dqwalk walk``: walks through ROS 2, records, evaluates and draws."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

import click

from dqwalk_ros.cli.options import Report, command, output_options, walk_options
from dqwalk_ros.plants.table import PLANTS
from dqwalk_ros.support.errors import BagError, ConfigError
from dqwalk_ros.support.ros_environment import check_ros_environment

if TYPE_CHECKING:
    from dqwalk_ros.config import Config


@command("""
examples:
  dqwalk walk --out walk
  dqwalk walk --cycles 2 --set ssp.com_radius=0.045
  dqwalk walk --realtime                                   in real time, at 1/dt
  dqwalk walk --config poppy --plant physics --set gait.steps=20        20 steps in MuJoCo
  dqwalk walk --config poppy --plant physics --cmd-vel 0.015,0,0.03,30  steered by the node pilot on cmd_vel
""")
@walk_options([name for name in PLANTS if name != "ros2_control"])
@click.option("--realtime", is_flag=True, help="Run in real time, at 1/dt, instead of in lockstep.")
@output_options("walk")
def walk(config: Config, course: tuple[str, ...], plant: str, realtime: bool, output: Report) -> int:
    """Walk through ROS 2: four nodes, in lockstep.

    Starts controller, plant, phase_monitor and recorder in lockstep (each state waits for its command, so the walk is
    reproducible and as fast as the machine allows), records a bag, and evaluates it.
    """
    from dqwalk_ros.cli.progress import Progress
    from dqwalk_ros.cli.results import prepare, write_results
    from dqwalk_ros.cli.runner import run_walk
    from dqwalk_ros.report import bag
    from dqwalk_ros.walks.table import walk_type

    check_ros_environment()
    if not course and not walk_type(config).phases(config):
        if "ROS_DOMAIN_ID" not in os.environ:  # the nodes are in a domain of their own
            raise ConfigError("the walk is steered: add --cmd-vel, or set ROS_DOMAIN_ID and publish cmd_vel")
        print("waiting for cmd_vel; controller/stop ends the walk", file=sys.stderr)
    prepare(output.folder, "report.json", "log", force=output.force)
    with Progress(quiet=output.quiet) as progress:
        outcome = run_walk(
            config,
            output.folder / "bag",
            plant=plant,
            course=course,
            lockstep=not realtime and plant != "poppy",  # a real robot does not wait for commands
            progress=progress,
        )
    if not output.quiet or not outcome.finished:
        print(outcome, file=sys.stderr)
    if not outcome.finished and not outcome.ticks:
        return 1  # what was recorded, if anything, is a walk of other nodes
    try:
        with Progress(quiet=output.quiet) as bar:
            bar.stage(0.0, "reading")
            trace = bag.read(outcome.bag, walk=config.gait.walk)
    except BagError as error:
        if outcome.finished:
            raise
        print(f"dqwalk: no report: {error}", file=sys.stderr)
        return 1
    report = write_results(trace, output)
    return 0 if outcome.finished and report["ok"] else 1
