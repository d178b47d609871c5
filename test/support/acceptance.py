"""Acceptance test of the whole-body controller, ``make reach``: prints each requirement and its result.

14 walks, including Tests 1 and 2, and equations and solutions compared with independent computations. An aim is an
optional goal: the authors' figures on another robot, or a time that depends on the machine.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from exactness import Answers, checked_walk, condensed_difference, infeasible, model_difference
from joblib import Parallel, delayed, parallel_config

from dqwalk_ros.cli.options import Report
from dqwalk_ros.cli.progress import Progress
from dqwalk_ros.cli.results import write_report
from dqwalk_ros.config import Config, load
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.text_table import aligned
from dqwalk_ros.whole_body import PAPER_TIMES, SCENARIOS, Scenario, WholeBodyController, WholeBodyTrace
from dqwalk_ros.whole_body import figures as reaching
from dqwalk_ros.whole_body.bag import write_body
from dqwalk_ros.whole_body.demands import KEPT, Demand, checks, spread, summary

_TARGET = SCENARIOS["1"].targets[:1]
_HARD: dict[str, tuple[float, float, dict[str, float]]] = {
    "10 N s to the left at 2.5 s": (2.5, 10.0, {}),
    "15 N s to the left at 2.5 s": (2.5, 15.0, {}),
    "20 N s to the left at 2.5 s": (2.5, 20.0, {}),
    "15 N s to the left at 2.3 s": (2.3, 15.0, {}),
    "15 N s, friction 0.4": (2.5, 15.0, {"whole_body.friction": 0.4}),
    "15 N s, N = 8": (2.5, 15.0, {"whole_body.intervals": 8}),
}
"""Time [s] and impulse [N s] of a push to the left, and changed parameters."""


@dataclass(frozen=True)
class Requirement(Demand):
    """A demand under a topic; `must` is False for an aim."""

    topic: str = ""
    must: bool = True

    @property
    def row(self) -> dict[str, Any]:
        """The entry in report.json."""
        given = {"topic": self.topic, "what": self.name, "asked": self.bound}
        return given | {"got": self.got, "ok": self.ok, "must": self.must}


def _under(topic: str, demands: Iterable[Demand]) -> list[Requirement]:
    return [Requirement(**{**vars(demand), "topic": topic}) for demand in demands]


def _at_most(name: str, value: float, most: float, unit: str = "", **more: Any) -> Requirement:
    return Requirement(name, value, unit, f"<= {most:g}", value <= most, **more)


def walks() -> dict[str, tuple[Scenario, Mapping[str, Any]]]:
    """Return the walks that `judge` needs, by name: scenario, and changes of the configuration."""
    one, two = SCENARIOS["1"], SCENARIOS["2"]
    off = {"whole_body.capturability": False}
    found: dict[str, tuple[Scenario, Mapping[str, Any]]] = {"1": (one, {}), "2": (two, {})}
    for k, (when, _) in enumerate(two.pushes):
        others = (*two.pushes[:k], *two.pushes[k + 1 :])
        name = f"Test 2 without push {k + 1}"
        found[f"2 without {k}"] = replace(two, name=name, pushes=others, duration=when + 1.4), {}
    found["paper"] = replace(one, name="Test 1, the paper's times", targets=PAPER_TIMES), {}
    found["in place"] = Scenario("in place", 8.0), {}
    for name, (when, push, changes) in _HARD.items():
        found[name] = Scenario(name, 6.0, _TARGET, ((when, (0.0, push, 0.0)),)), changes
    found["no level 2"] = Scenario("without level 2, with the hand's target", 2.0, _TARGET), off
    found["no level 2, in place"] = Scenario("without level 2, in place", 2.0), off
    return found


def unit_demands(config: Config) -> list[Requirement]:
    """Check the equations without a walk."""
    model = load_model(config.robot)
    mass = WholeBodyController(config, model).point_mass
    forces, places = model_difference(model)
    far = infeasible(config, model)
    least = f"{far.residual:.7f}, {far.least:.7f}"
    found = [
        _at_most("sum of the alpha of (S14), less 1", abs(float(mass.alpha.sum()) - 1.0), 1e-12),
        _at_most("(S14) in closed form, and condensed with A and B: difference", condensed_difference(mass), 1e-12),
        _at_most("H v' + h and Newton's and Euler's laws link by link differ by [N, N m]", forces, 1e-10),
        _at_most("places of soles and CoM, and by dual quaternions, differ by [m]", places, 1e-10),
        Demand("(S14) out of reach: solved by", far.method, "", "level 2 relaxed", far.method == "level 2 relaxed"),
        _at_most("(S14) out of reach: level 1 violated by", far.level1, 1e-6),
        Demand(
            "(S14) out of reach: ||E x - e||, and the least there is [m]",
            least,
            "",
            "equal to 1e-5",
            abs(far.residual - far.least) <= 1e-5 < far.least,
        ),
    ]
    return _under("equations", found)


def judge(walked: Mapping[str, WholeBodyTrace], answers: Answers) -> list[Requirement]:
    """Check the walks of `walks`, and the solutions of Tests 1 and 2."""
    one, two = walked["1"], walked["2"]
    found = {"1": checks(one), "2": checks(two, [walked["2 without 0"], walked["2 without 1"]])}
    found["paper"] = checks(walked["paper"])
    rows = _answers(answers)
    for key in ("1", "paper", "2"):
        topic = walked[key].scenario.name
        rows += _under(topic, (check for check in found[key] if check.bound and not _every_tick(check)))
        rows += _aims(topic, found[key])
    both = [check for key in ("1", "2") for check in found[key] if _every_tick(check)]
    for name in dict.fromkeys(check.name for check in both):
        worst = max if name.startswith("ticks") else min
        tightest = worst((check for check in both if check.name == name), key=lambda check: check.value)
        rows += _under("every tick of both", [tightest])
    rows += _in_place(walked["in place"])
    rows += [_stands("robust", name, walked[name], kept=True) for name in _HARD]
    for name in ("no level 2", "no level 2, in place"):
        w = walked[name]
        end = w.note.partition(":")[0] or "stood"
        falls = w.note.startswith("fell")
        rows.append(Requirement(w.scenario.name, end, "", "falls within 2 s", falls, topic="negative"))
    return rows + _times([one, two])


def _every_tick(check: Demand) -> bool:
    return check.name.startswith(("least ", "ticks "))


def _answers(seen: Answers) -> list[Requirement]:
    topic, ticks = "answers", f"{seen.ticks} ticks"
    return [
        _at_most(f"equality residual of {ticks} of Tests 1 and 2", seen.equality, 1e-6, topic=topic),
        _at_most(f"inequality violation of {ticks}", seen.inequality, 1e-6, topic=topic),
        _at_most(f"v' and Clarabel's, {seen.sampled} ticks, differ by [rad/s^2]", seen.acceleration, 1e-3, topic=topic),
    ]


def _aim(name: str, value: float, aimed: float, unit: str, topic: str, *, at_least: bool = False) -> Requirement:
    """Return an optional goal, and by how much it is missed."""
    lacks = aimed - value if at_least else value - aimed
    got = f"{value:.4g} {unit}" + (f", lacks {lacks:.2g}" if lacks > 0.0 else "")
    return Requirement(
        name, got, "", f"{'>=' if at_least else '<='} {aimed:g} {unit}", lacks <= 0.0, topic=topic, must=False
    )


def _aims(topic: str, found: Sequence[Demand]) -> list[Requirement]:
    """Return the authors' figures as optional goals; 0.10 m where theirs is at least that."""
    rows = []
    for check in found:
        value = float(check.value)
        if check.name.startswith("footstep moved"):
            rows.append(_aim(check.name.replace("footstep", "aim: footstep"), value, 0.1, "m", topic, at_least=True))
        elif check.name.endswith("rms of the last 3 s") and topic != "Test 2":
            rows.append(_aim("the authors' figure for that", round(1e3 * value, 1), 8.4, "mm", topic))
    return rows


def _in_place(w: WholeBodyTrace) -> list[Requirement]:
    topic = "in place, 8 s"
    places = np.array([place for _, place in w.footholds()])
    drift = float(np.abs(places[2:] - places[:-2]).max()) if len(places) > 2 else float("nan")
    speed = float(np.abs(w.com_velocity[:, 1]).max())
    missed = int((w.residual > 1e-6).sum())
    least = {name: float(margin.min()) for name, margin in w.margins.items()}
    tightest = min(least, key=lambda name: least[name])
    return [
        _stands(topic, "without the hand's objective", w),
        _at_most("a foot's place from one of its steps to the next, at most [m]", drift, 0.06, topic=topic),
        _at_most("CoM off its height, at most [m]", float(np.abs(w.height_error).max()), 1e-3, topic=topic),
        _at_most("torso off upright, at most [rad]", float(w.tilt.max()), 0.02, topic=topic),
        Requirement(
            "lateral speed of the CoM, at most", speed, "m/s", "0.2 to 0.45", 0.2 <= speed <= 0.45, topic=topic
        ),
        Requirement("ticks that miss capturability (S14)", missed, "", "0", missed == 0, topic=topic),
        Requirement(
            "CoP, forces, torques, joints, steps: least distance to a limit",
            f"{least[tightest]:.2g} ({tightest.removesuffix('_margin')})",
            "",
            ">= 0",
            all(value >= KEPT[name] for name, value in least.items()),
            topic=topic,
        ),
    ]


def _times(walked: Sequence[WholeBodyTrace]) -> list[Requirement]:
    spent = 1e3 * np.vstack([w.times for w in walked])
    solve, tick, topic = spread(spent[:, 2]), spread(spent[:, 3]), "CPU time, Tests 1, 2"

    def below(name: str, value: float, most: float) -> Requirement:
        return Requirement(name, f"{value:.2f} ms", "", f"< {most:g} ms", value < most, topic=topic)

    return [
        below("solution, mean (the paper's: 0.92 ms, 2012)", solve["mean"], 0.92),
        _aim("solution, mean", solve["mean"], 0.5, "ms", topic),
        below("solution, 99 %", solve["p99"], 1.5),
        below("whole tick, 99 %", tick["p99"], 5.0),
    ]


def _stands(topic: str, name: str, w: WholeBodyTrace, *, kept: bool = False) -> Requirement:
    """Check whether the robot stands, and with `kept` whether it also keeps every limit."""
    end = f"stood {w.time[-1] + w.config.dt:.1f} s" if w.stood else w.note
    broken = [name for name, values in w.margins.items() if kept and values.min() < KEPT[name]]
    asked = "stands, limits kept" if kept else "stands"
    return Requirement(name, ", beyond ".join([end, *broken]), "", asked, w.stood and not broken, topic=topic)


def render(demands: Sequence[Requirement]) -> str:
    """Return the table of all demands, and the number of those that are met."""
    rows = [("", "", "asked", "got", "")]
    topic = ""
    for demand in demands:
        word = "ok" if demand.ok else "NOT OK" if demand.must else "aim not reached"
        rows.append(("" if demand.topic == topic else demand.topic, demand.name, demand.bound, demand.got, word))
        topic = demand.topic
    lines = aligned(rows).splitlines()
    must, aims = [one for one in demands if one.must], [one for one in demands if not one.must]
    met, reached = sum(one.ok for one in must), sum(one.ok for one in aims)
    total = f"{met} of {len(must)} requirements met, {reached} of {len(aims)} aims reached"
    return "\n".join([lines[0], "-" * max(map(len, lines)), *lines[1:], "", total])


def main() -> int:
    """Run the walks, print requirements and results, write report, figures and bags; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--config", default="whole_body", help="name or path")
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time")
    parser.add_argument("--out", type=Path, default=Path("results/reach"))
    args = parser.parse_args()
    config, wanted = load(args.config), walks()
    total, done = sum(scenario.duration for scenario, _ in wanted.values()), 0.0
    found: dict[str, tuple[WholeBodyTrace, Answers]] = {}
    with Progress() as bar, parallel_config("loky", inner_max_num_threads=1):
        bar.stage(0.0, "requirements without a walk")
        demands = unit_demands(config)
        bar.stage(0.0, f"0 of {len(wanted)} walks")
        parallel = Parallel(args.jobs, return_as="generator_unordered", batch_size=1)
        named = (delayed(_named)(key, config.updated(dict(changes)), one) for key, (one, changes) in wanted.items())
        for key, one in parallel(named):
            found[key] = one
            done += wanted[key][0].duration
            bar(done / total, f"{len(found)} of {len(wanted)} walks")
    demands += judge({key: walked for key, (walked, _) in found.items()}, found["1"][1].joined(found["2"][1]))
    print(render(demands) + "\n")
    both = [found["1"][0], found["2"][0]]
    report = {"demands": [one.row for one in demands], "tests": [summary(one, checks(one)) for one in both]}
    args.out.mkdir(parents=True, exist_ok=True)
    bags = [args.out / "bag_1", args.out / "bag_2"]
    for walked, path in zip(both, bags, strict=True):
        write_body(walked, path, overwrite=True)
    output = Report(out=args.out, formats=("png",), no_figures=False)
    write_report(output, report, "", reaching.drawn(both), more=bags)
    return 0 if all(one.ok for one in demands if one.must) else 1


def _named(key: str, config: Config, scenario: Scenario) -> tuple[str, tuple[WholeBodyTrace, Answers]]:
    return key, checked_walk(config, scenario)


if __name__ == "__main__":
    try:
        raise SystemExit(main())
    except KeyboardInterrupt:
        raise SystemExit("interrupted: requirements are judged, and bags written, after the last walk") from None
