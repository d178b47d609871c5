"""``dqwalk reach``: the tests of the whole-body paper, judged and drawn; pushes, and everything that must be shown."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from dqwalk_ros.cli.progress import Progress
from dqwalk_ros.cli.settings import config_of
from dqwalk_ros.config import Config
from dqwalk_ros.errors import BagError, ConfigError

if TYPE_CHECKING:
    from dqwalk_ros.whole_body.scenario import Scenario
    from dqwalk_ros.whole_body.trace import Reaching

__all__ = ["run"]


def run(args: argparse.Namespace) -> int:
    """Do it and return the exit code."""
    config, out = config_of(args), Path(args.out)
    scenarios = _scenarios(args)
    if args.plant == "both" and not args.pushes:
        raise ConfigError("--plant both goes with --pushes")
    if (out / "report.json").exists() and not args.force:
        raise BagError(f"'{out}' has a report already; choose another folder with --out, or replace it with --force")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BagError(f"cannot make the folder '{out}': {error}") from error
    if args.pushes:
        return _pushes(args, config, out)
    if args.all:
        return _all(args, config, out)
    return _tests(args, config, scenarios, out)


def _scenarios(args: argparse.Namespace) -> list[Scenario]:
    """Return the tests that were asked for, changed as was asked for."""
    from dqwalk_ros.whole_body.scenario import PAPER_TIMES, SCENARIOS

    targets = [(0.0, _numbers(args.target, 3, "--target X,Y,Z"))] if args.target else None
    extra = [(t, (x, y, z)) for t, x, y, z in (_numbers(text, 4, "--push T,X,Y,Z") for text in args.push)]
    scenarios = []
    for name in ("1", "2") if args.test == "both" else (args.test,):
        scenario = SCENARIOS[name]
        if args.paper_times:
            scenario = replace(scenario, name=f"{scenario.name}, the paper's times", targets=PAPER_TIMES)
        if targets is not None:
            scenario = replace(scenario, name="your target", targets=tuple((t, (p[0], p[1], p[2])) for t, p in targets))
        pushes = (*scenario.pushes, *extra)
        scenarios.append(replace(scenario, pushes=pushes, duration=args.duration or scenario.duration))
    return scenarios


def _tests(args: argparse.Namespace, config: Config, scenarios: Sequence[Scenario], out: Path) -> int:
    """Walk, one after the other."""
    from dqwalk_ros.cli.body import leave
    from dqwalk_ros.whole_body.batch import Walk, walk
    from dqwalk_ros.whole_body.reaching import checks, render_checks, summary

    def make(scenario: Scenario) -> Reaching:
        bar = Progress(quiet=args.quiet)
        try:
            return walk(config, Walk(scenario, plant=args.plant), bar)[0]
        finally:
            bar.close()

    walks, reports = [], []
    for scenario in scenarios:
        walked = make(scenario)
        without = []
        for k, (when, _) in enumerate(scenario.pushes):  # what would have happened: only as far as it matters
            others = (*scenario.pushes[:k], *scenario.pushes[k + 1 :])
            end = min(scenario.duration, when + 2.0 * config.whole_body.single_support)
            name = f"{scenario.name} without push {k + 1}"
            without.append(make(replace(scenario, name=name, pushes=others, duration=end)))
        found = checks(walked, without)
        walks.append(walked)
        reports.append(summary(walked, found))
        if not args.quiet:
            print(render_checks(walked, found) + "\n")
    leave(args, out, reports, walks, _bags(args, walks, out))
    return 0 if all(report["ok"] for report in reports) else 1


def _all(args: argparse.Namespace, config: Config, out: Path) -> int:
    """Make every walk that something must be shown by, and print what was asked and what was got."""
    from dqwalk_ros.cli.body import leave
    from dqwalk_ros.whole_body.acceptance import judge, render, unit_rows, walks
    from dqwalk_ros.whole_body.batch import each, walk
    from dqwalk_ros.whole_body.reaching import checks, summary

    wanted = walks()
    total, done = sum(one.scenario.duration for one in wanted.values()), 0.0
    bar, walked, answers = Progress(quiet=args.quiet), {}, {}
    try:
        rows = unit_rows(config)
        for key, (made, seen) in each(walk, {key: (config, one) for key, one in wanted.items()}, args.jobs):
            walked[key], answers[key] = made, seen
            done += wanted[key].scenario.duration
            bar(done / total, f"{len(walked)} of {len(wanted)} walks")
    finally:
        bar.close()
    rows += judge(walked, answers["1"].joined(answers["2"]))
    both = [walked["1"], walked["2"]]
    report = {"demands": [vars(row) for row in rows], "tests": [summary(one, checks(one)) for one in both]}
    if not args.quiet:
        print(render(rows) + "\n")
    leave(args, out, report, both, _bags(args, both, out))
    return 0 if all(row.ok for row in rows if row.must) else 1


def _pushes(args: argparse.Namespace, config: Config, out: Path) -> int:
    """Look for the hardest push in every direction."""
    from dqwalk_ros.cli.body import leave
    from dqwalk_ros.model import Foot
    from dqwalk_ros.report.figures.reach_pushes import save_pushes
    from dqwalk_ros.whole_body.batch import each
    from dqwalk_ros.whole_body.preview import Stepping
    from dqwalk_ros.whole_body.pushes import DIRECTIONS, PushLimit, limit

    plants = ("physics", "rigid") if args.plant == "both" else (args.plant,)
    asked = {
        (plant, way): (config, way, plant, args.when, args.exact) for plant in plants for way in DIRECTIONS.values()
    }
    found: dict[tuple[str, float], PushLimit] = {}
    bar = Progress(quiet=args.quiet)
    try:
        for key, one in each(limit, asked, args.jobs):
            found[key] = one
            bar(len(found) / len(asked), f"{len(found)} of {len(asked)} directions")
    finally:
        bar.close()
    swing = Stepping.of(config.whole_body, Foot(config.gait.first_support)).swing(args.when)
    limits = {plant: [found[plant, way] for way in DIRECTIONS.values()] for plant in plants}
    if not args.quiet:
        stands = "both feet stand" if swing is None else f"the {swing.foot.other.value} foot stands"
        print(f"largest push survived, smallest that was not [N s]; hit at {args.when:g} s, walking in place, {stands}")
        print(f"{'':14}" + "".join(f"{plant:>16}" for plant in plants))
        for name, way in DIRECTIONS.items():
            cells = [found[plant, way] for plant in plants]
            print(f"{name:14}" + "".join(f"{f'{one.stood:g}, {one.fell:g}':>16}" for one in cells))
        print()
    leave(args, out, {plant: [vars(one) for one in ones] for plant, ones in limits.items()}, [])
    files = (
        [] if args.no_figures else save_pushes(limits, None if swing is None else swing.foot.other, out, args.format)
    )
    if files and not args.quiet:
        print("wrote " + ", ".join(map(str, files)))
    return 0


def _bags(args: argparse.Namespace, walks: Sequence[Reaching], out: Path) -> list[Path]:
    """Write the bag of each walk."""
    from dqwalk_ros.report import bag

    paths = [out / ("bag" if len(walks) == 1 else f"bag_{k + 1}") for k in range(len(walks))]
    for walked, path in zip(walks, paths, strict=True):
        bag.write_body(walked, path, overwrite=args.force)
    return paths


def _numbers(text: str, count: int, what: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count:
        raise ConfigError(f"{what} wants {count} numbers separated by commas, not '{text}'")
    return values
