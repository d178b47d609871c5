"""``dqwalk reach``: the tests of the whole-body paper, evaluated and drawn, and the largest push survived."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import click

from dqwalk_ros.cli.options import (
    Many,
    Numbers,
    Real,
    Report,
    command,
    config_of,
    config_option,
    jobs_option,
    output_options,
    set_option,
)
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.output import make_folder, refuse_existing

if TYPE_CHECKING:
    from dqwalk_ros.config import Config
    from dqwalk_ros.whole_body import Scenario, WholeBodyTrace


@command("""
writes to the folder of --out:
  bag/, or bag_1/ and bag_2/   the walks as rosbag2 (MCAP), as written by the recorder node: `dqwalk report`
  figure2 3 4 5                solving time, the walk from above, reactions to target and pushes
  pushes                       --pushes: the largest push survived in each direction
  report.json                  every figure of the tables

examples:
  dqwalk reach                                             both tests of the paper
  dqwalk reach --pushes --plant both                       the largest push survived, in MuJoCo and on rigid ground
  dqwalk reach --test 1 --target 0.8,-0.3,0.9 --push 2.5,0,15,0     and pushed to the left by 15 N s at 2.5 s
  dqwalk reach --test 1 --set whole_body.capturability=false --duration 3     it falls
  dqwalk report reach/bag_1 --html                         look at the walk: replay in 3D, figures, table
""")
@config_option("whole_body")
@click.option("--test", type=click.Choice(["1", "2", "both"]), default="both", help="Test of the paper.")
@click.option("--pushes", is_flag=True, help="Find the largest push survived, in eight directions.")
@click.option("--when", metavar="S", type=Real(0.0, 600.0), default=2.5, help="--pushes: time of the push [s].")
@click.option(
    "--tolerance", metavar="NS", type=Real(0.0, 1e3, min_open=True), default=1.0,
    help="--pushes: accuracy of each impulse [N s].",
)  # fmt: skip
@jobs_option
@click.option(
    "--plant",
    type=click.Choice(["rigid", "physics", "both"]),
    default="rigid",
    help="rigid: rigid bodies and ground; physics: MuJoCo.",
)
@click.option("--paper-times", is_flag=True, help="The target jumps at 4 and 8 s (paper), not as in the thesis.")
@click.option("--target", metavar="X,Y,Z", type=Numbers(3), help="One target of the hand instead of the test's [m].")
@click.option(
    "--push",
    metavar="T,X,Y,Z",
    type=Numbers(4),
    multiple=True,
    help="Another push of the torso [s, N s]; may be repeated.",
)
@click.option(
    "--duration", metavar="S", type=Real(0.0, 600.0, min_open=True), help="Duration instead of the test's 14 s [s]."
)
@set_option
@output_options("reach")
def reach(
    config: str,
    test: str,
    pushes: bool,
    when: float,
    tolerance: float,
    jobs: int,
    plant: str,
    paper_times: bool,
    target: tuple[float, float, float] | None,
    push: tuple[tuple[float, float, float, float], ...],
    duration: float | None,
    changes: tuple[str, ...],
    output: Report,
) -> int:
    """Reach for a target with the whole body, under pushes.

    A robot of HRP-2's size reaches for a target with its right hand and walks there without footsteps planned in
    advance. Test 1 moves the target in mid-swing, Test 2 also pushes the torso, 15 N s twice. Needs
    pinocchio: pip install pin

    Exit code 1 if a requirement of its table is not met.

    Times are CPU time of this process; set OPENBLAS_NUM_THREADS=1, because more threads are not faster here.
    """
    from dqwalk_ros.config import is_whole_body
    from dqwalk_ros.robot.model import load_model
    from dqwalk_ros.whole_body import PAPER_TIMES, SCENARIOS, WholeBodyController
    from dqwalk_ros.whole_body.scenario import fitted

    made, out = config_of(config, changes), output.folder
    if not is_whole_body(made):
        raise ConfigError(f"'{config}' is not a configuration of the whole-body controller: it has no such section")
    if plant == "both" and not pushes:
        raise ConfigError("--plant both requires --pushes")
    names = () if pushes else ("bag",) if test != "both" else ("bag_1", "bag_2")
    if not output.force:
        refuse_existing(out / name for name in ("report.json", *names))
    controller = WholeBodyController(made, load_model(made.robot))
    if pushes:
        return _pushes(made, output, plant, when, tolerance, jobs)
    extra = [(t, (x, y, z)) for t, x, y, z in push]
    scenarios = []
    for name in ("1", "2") if test == "both" else (test,):
        scenario = SCENARIOS[name]
        if paper_times:
            scenario = replace(scenario, name=f"{scenario.name}, the paper's times", targets=PAPER_TIMES)
        scenario = fitted(scenario, controller)
        if target is not None:
            scenario = replace(scenario, name="your target", targets=((0.0, target),))
        scenarios.append(replace(scenario, pushes=(*scenario.pushes, *extra), duration=duration or scenario.duration))
    make_folder(out)
    return _tests(made, output, plant, scenarios)


def _tests(config: Config, output: Report, plant: str, scenarios: Sequence[Scenario]) -> int:
    """Run the scenarios one after the other and write the results; return the exit code."""
    from dqwalk_ros.cli.progress import Progress
    from dqwalk_ros.cli.results import write_report
    from dqwalk_ros.whole_body import figures as reaching
    from dqwalk_ros.whole_body.bag import write_body
    from dqwalk_ros.whole_body.demands import checks, render_checks, summary
    from dqwalk_ros.whole_body.experiments import walk

    def make(scenario: Scenario) -> WholeBodyTrace:
        with Progress(quiet=output.quiet) as bar:
            return walk(config, scenario, plant, progress=bar)

    walks: list[WholeBodyTrace] = []
    reports, bags = [], []
    for scenario in scenarios:
        walked = make(scenario)
        without = []
        for k, (when, _) in enumerate(scenario.pushes):  # the walk without this push, as far as needed for comparison
            others = (*scenario.pushes[:k], *scenario.pushes[k + 1 :])
            end = min(scenario.duration, when + 2.0 * config.whole_body.single_support)
            name = f"{scenario.name} without push {k + 1}"
            without.append(make(replace(scenario, name=name, pushes=others, duration=end)))
        found = checks(walked, without)
        bags.append(output.folder / ("bag" if len(scenarios) == 1 else f"bag_{len(walks) + 1}"))
        write_body(walked, bags[-1], overwrite=output.force)
        walks.append(walked)
        reports.append(summary(walked, found))
        if not output.quiet:
            print(render_checks(walked, found) + "\n")
    write_report(output, reports, "", reaching.drawn(walks), more=bags)
    return 0 if all(report["ok"] for report in reports) else 1


def _pushes(config: Config, output: Report, plant: str, when: float, tolerance: float, jobs: int) -> int:
    """Find the largest push survived in every direction and write the results; return the exit code."""
    from dqwalk_ros.cli.results import write_report
    from dqwalk_ros.report.figures.studies import pushes_figure
    from dqwalk_ros.report.figures.style import Drawn
    from dqwalk_ros.support.text_table import aligned
    from dqwalk_ros.whole_body import torso_pushes
    from dqwalk_ros.whole_body.preview import Stepping

    plants = ("physics", "rigid") if plant == "both" else (plant,)
    many = Many(out=output.out, force=output.force, quiet=output.quiet, jobs=jobs, scheduler=None)
    with many.options("directions") as options:
        found = torso_pushes.limits(config, output.folder, plants, when=when, tolerance=tolerance, **options)
    by_plant = {plant: [one for one in found if one.moment == plant] for plant in plants}
    swing = Stepping.of(config).swing(when)
    stands = "on both feet" if swing is None else f"on the {swing.foot.other.value} foot"
    title = f"pushed at {when:g} s, walking in place, {stands}"
    cells = [[f"{one.survived:g}, {one.failed or math.inf:g}" for one in by_plant[plant]] for plant in plants]
    table = aligned(list(zip(torso_pushes.DIRECTIONS, *cells, strict=True)), ("", *plants), range(1, len(plants) + 1))
    text = f"largest push survived, smallest not survived [N s]; {title}\n{table}\n"
    rows = {
        plant: [
            {"direction": math.degrees(one.direction), "stood": one.survived, "fell": one.failed, "reason": one.reason}
            for one in ones
        ]
        for plant, ones in by_plant.items()
    }
    figure = pushes_figure(by_plant, f"Largest push survived [N s]\n{title}")
    write_report(output, rows, text, [Drawn("pushes", figure)])
    return 0
