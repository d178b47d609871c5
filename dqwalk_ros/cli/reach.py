"""``dqwalk reach``: Tests 1 and 2 of the whole-body paper, judged and drawn."""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

from dqwalk_ros.cli.progress import Progress
from dqwalk_ros.cli.settings import config_of
from dqwalk_ros.exceptions import BagError, ConfigError
from dqwalk_ros.model import load_model

__all__ = ["run"]


def run(args: argparse.Namespace) -> int:
    """Do it and return the exit code."""
    from dqwalk_ros.analysis.figures.reaching import save_reaching
    from dqwalk_ros.analysis.reaching import checks, render_checks, summary
    from dqwalk_ros.controllers.whole_body import BodyState, WholeBodyController
    from dqwalk_ros.plants.rigid import RigidPlant
    from dqwalk_ros.reach import PAPER_TIMES, SCENARIOS, BodyPlant, Reaching, Scenario, follow

    config, out = config_of(args), Path(args.out)
    model = load_model(config.robot)
    chosen = [SCENARIOS[name] for name in (("1", "2") if args.test == "both" else (args.test,))]
    targets = [(0.0, _numbers(args.target, 3, "--target X,Y,Z"))] if args.target else None
    extra = [(t, (x, y, z)) for t, x, y, z in (_numbers(text, 4, "--push T,X,Y,Z") for text in args.push)]
    scenarios = []
    for scenario in chosen:
        if args.paper_times:
            scenario = replace(scenario, name=f"{scenario.name}, the paper's times", targets=PAPER_TIMES)
        if targets is not None:
            scenario = replace(scenario, name="your target", targets=tuple((t, (p[0], p[1], p[2])) for t, p in targets))
        pushes = (*scenario.pushes, *extra)
        scenarios.append(replace(scenario, pushes=pushes, duration=args.duration or scenario.duration))
    if (out / "report.json").exists() and not args.force:
        raise BagError(f"'{out}' has a report already; choose another folder with --out, or replace it with --force")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BagError(f"cannot make the folder '{out}': {error}") from error

    def make_plant(state: BodyState) -> BodyPlant:
        torso = config.whole_body.torso
        if args.plant == "physics":
            from dqwalk_ros.plants.torque import TorquePlant

            return TorquePlant(model, state, pushed=torso)
        return RigidPlant(model, state, pushed=torso, damping=config.whole_body.contact_damping)

    def walk(scenario: Scenario) -> Reaching:
        bar = Progress(quiet=args.quiet)
        controller = WholeBodyController(config, model, clock=time.process_time)
        plant = make_plant(controller.start)
        try:
            return follow(controller, plant, scenario, clock=time.process_time, progress=bar)
        finally:
            bar.close()

    walks, reports = [], []
    for scenario in scenarios:
        walked = walk(scenario)
        without = []
        for k in range(len(scenario.pushes)):  # what would have happened: only as far as it matters
            others = (*scenario.pushes[:k], *scenario.pushes[k + 1 :])
            end = min(scenario.duration, scenario.pushes[k][0] + 2.0 * config.whole_body.single_support)
            name = f"{scenario.name} without push {k + 1}"
            without.append(walk(replace(scenario, name=name, pushes=others, duration=end)))
        found = checks(walked, without)
        walks.append(walked)
        reports.append(summary(walked, found))
        if not args.quiet:
            print(render_checks(walked, found) + "\n")
    (out / "report.json").write_text(json.dumps(reports, indent=2) + "\n", encoding="utf-8")
    files = [out / "report.json"]
    if not args.no_figures:
        files += save_reaching(walks, out, args.format)
    if not args.quiet:
        print("wrote " + ", ".join(str(file) for file in files))
    return 0 if all(report["ok"] for report in reports) else 1


def _numbers(text: str, count: int, what: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count:
        raise ConfigError(f"{what} wants {count} numbers separated by commas, not '{text}'")
    return values
