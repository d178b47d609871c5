"""``dqwalk simulate``: walks in this process, writes the bag, evaluates and draws."""

from __future__ import annotations

import contextlib
import sys
from typing import TYPE_CHECKING

import click

from dqwalk_ros.cli.options import Report, command, output_options, port_option, walk_options
from dqwalk_ros.plants.table import SIMULATORS

if TYPE_CHECKING:
    from dqwalk_ros.config import Config


@command("""
writes to the folder of --out:
  bag/                 the walk as a rosbag2 (MCAP): ros2 bag, Foxglove, PlotJuggler, `dqwalk report`
  report.json          every phase, distance, margin and violation
  top_view, figure9    the walk from above, and the joint angles; of the paper's walk also figure7 and figure8, its
                       errors and distances; in physics also on_the_ground, the true motion

Ctrl-C stops the walk and saves it up to there.

examples:
  dqwalk simulate                                          the paper's walk, one cycle
  dqwalk simulate --cycles 3 --first right --out walk
  dqwalk simulate --set gait.step_length=0.03 --set dsp.flat_feet=false
  dqwalk simulate --config my_robot.yaml --format png,pdf
  dqwalk simulate --view                                   show it in the browser while it is computed
  dqwalk simulate --config poppy --plant physics           the standing walk, in MuJoCo (pip install mujoco)
  dqwalk simulate --config poppy --plant physics --cmd-vel 0.015,0,0,20 --cmd-vel=-0.01,0,0,20    forward, then back
""")
@walk_options(SIMULATORS)
@click.option("--view", is_flag=True, help="Show the walk in the browser, live, then as a replay.")
@port_option
@output_options("walk")
def simulate(config: Config, course: tuple[str, ...], plant: str, view: bool, port: int | None, output: Report) -> int:
    """Walk in this process, without ROS."""
    from dqwalk_ros import simulation
    from dqwalk_ros.cli.progress import Progress
    from dqwalk_ros.cli.results import prepare, write_results
    from dqwalk_ros.plants.table import make_plant
    from dqwalk_ros.report import bag
    from dqwalk_ros.report.table import why
    from dqwalk_ros.robot.model import load_model
    from dqwalk_ros.walks.course import Course
    from dqwalk_ros.walks.table import make_controller

    model, legs = load_model(config.robot), Course.parse(course)
    controller = make_controller(config, model)
    body = make_plant(plant, config, model)
    prepare(output.folder, "report.json", force=output.force)
    with contextlib.ExitStack() as stack:
        feed = None
        if view:
            from dqwalk_ros.report.viewer.player import Feed

            feed = stack.enter_context(Feed(config, port))
            print(f"{feed.url} shows the walk", flush=True)
        begin, steer = body.state.time, legs.steering(controller) if course else None

        def before_step(time: float) -> None:
            if feed is not None:
                feed.offer(body.state, controller)
            if steer is not None:
                steer(time)

        def progress(done: float, text: str) -> None:
            bar((body.state.time - begin) / legs.duration if course else done, text)

        with Progress(quiet=output.quiet) as bar:
            trace = simulation.simulate(controller, body, progress=progress, before_step=before_step)
        try:
            bag.write(trace, output.folder / "bag")
        finally:  # on a full disk at least the report is printed
            report = write_results(trace, output)
        if not trace.finished:
            print(f"dqwalk: {'; '.join([*trace.notes, *why(report)[:1]])}", file=sys.stderr)
        if feed is not None:
            feed.replay(output.folder / "bag")
            print(f"{feed.url} plays the walk until Ctrl-C", flush=True)
            feed.wait()
    return 0 if trace.finished and report["ok"] else 1
